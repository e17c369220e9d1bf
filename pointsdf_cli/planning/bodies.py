"""Exact distances of the robot's shapes to each other, to the table and to obstacles (coal).

The paper's a_SDF(M_e, FK_l(q)), by GJK for convex shapes and bounding volumes for meshes. Beyond
`exact_to`, a pair gets the gap between its bounding spheres, and a mesh the distance to its convex
hull: lower bounds, whose constraints are inactive. The depth inside of a solid mesh is that behind
one of its triangles, or that in its hull where the way off the triangle does not lead out.
"""

from __future__ import annotations

from copy import copy
from functools import cache, partial

import coal
import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.planning.contacts import WORLD, Contacts, Poses
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.robot_geometry import Body, CollisionMesh, RobotGeometry, link_body
from pointsdf_cli.robot.shapes import Shape

OUTWARDS = 0.5
"""Cosine to a face's normal from which a direction leads out of the mesh."""


class BodyDistances:
    """Distances between all pairs of the robot's shapes that may not touch, and to the world.

    Each column of the result is one pair of shapes; a link of several shapes has several columns.

    Args:
        geometry: Geometry of the robot.
        environment: Obstacles and table.
        exact_to: Distances up to here [m] are exact.

    Attributes:
        names: Each column's two bodies, as ("link", "link") or ("link", "obstacle").
        is_table: [M], whether the second is the table.
    """

    def __init__(
        self, geometry: RobotGeometry, environment: Environment, exact_to: float = 0.05
    ) -> None:
        _settle_boxes()
        robot, self.exact_to = geometry.kinematics.robot, exact_to
        self._bodies = list(geometry.bodies)
        moving = len(self._bodies)
        if environment.table:
            below = coal.Halfspace(np.array([0.0, 0.0, 1.0]), environment.table_height)
            self._bodies.append(Body(WORLD, "table", below, np.eye(4), np.zeros(3), 0.0))
        # By index: an obstacle may have a link's name.
        self._meshes: dict[int, CollisionMesh] = {}
        for obstacle in environment.obstacles:
            mesh = obstacle.prepared
            if mesh is None and obstacle.vertices is not None and obstacle.faces is not None:
                mesh = CollisionMesh.of(obstacle.vertices, obstacle.faces)
            if mesh is not None:
                self._meshes[len(self._bodies)] = mesh
            self._bodies.append(_obstacle_body(obstacle, mesh))
        checked = {frozenset(pair) for pair in robot.checked_pairs}
        pairs = []
        for i, a in enumerate(self._bodies[:moving]):
            for j in range(i + 1, len(self._bodies)):
                b = self._bodies[j]
                if j < moving and frozenset((a.name, b.name)) not in checked:
                    continue
                if environment.table and j == moving and a.name in robot.links_on_table:
                    continue
                pairs.append((i, j))
        self._pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self.names = tuple((self._bodies[i].name, self._bodies[j].name) for i, j in pairs)
        links = np.array([body.link for body in self._bodies])
        self.link: Indices = links[self._pairs[:, 0]]
        self.other_link: Indices = links[self._pairs[:, 1]]
        self._links = links
        self._centres = np.array([body.centre for body in self._bodies])
        self._local = np.array([body.pose for body in self._bodies])
        self._radii = np.array([body.radius for body in self._bodies])
        self._table_height = environment.table_height
        self._table = np.arange(len(links)) == (moving if environment.table else WORLD)
        self.is_table: NDArray[np.bool_] = self._table[self._pairs[:, 1]]
        self._request = coal.DistanceRequest()
        self._request.enable_signed_distance = True

    def exact_up_to(self, exact_to: float) -> BodyDistances:
        """A copy whose distances are exact up to `exact_to` [m]."""
        other = copy(self)
        other.exact_to = exact_to
        return other

    def __call__(self, poses: Poses, wanted: NDArray[np.bool_] | None = None) -> Contacts:
        """Distances [B, M] of all pairs, with witness points.

        Args:
            poses: Poses of B configurations.
            wanted: bool [M], pairs to measure exactly; the others get the gap between their balls.
        """
        count = len(poses.rotation)
        rotation = np.concatenate([poses.rotation, np.broadcast_to(np.eye(3), (count, 1, 3, 3))], 1)
        position = np.concatenate([poses.position, np.zeros((count, 1, 3))], 1)
        turn, at = rotation[:, self._links], position[:, self._links]  # WORLD is the last row
        centre = (turn @ self._centres[:, :, None])[..., 0] + at
        first, second = self._pairs.T
        one, other = centre[:, first], centre[:, second]
        between = one - other
        length = np.sqrt((between**2).sum(-1)) + 1e-300
        normal = between / length[..., None]
        gap = length - self._radii[first] - self._radii[second]
        low = self._table[second]
        gap[:, low] = centre[:, first[low], 2] - self._table_height - self._radii[first[low]]
        normal[:, low] = (0.0, 0.0, 1.0)
        contacts = Contacts(gap, self.link, one, normal, self.other_link, other)
        near = gap < self.exact_to
        if wanted is not None:
            near &= wanted
        shape_turn = turn @ self._local[:, :3, :3]
        shape_at = (turn @ self._local[:, :3, 3, None])[..., 0] + at

        @cache
        def placement(b: int, body: int) -> coal.Transform3s:
            return coal.Transform3s(shape_turn[b, body], shape_at[b, body])

        result = coal.DistanceResult()
        for b, m in np.argwhere(near).tolist():
            i, j = self._pairs[m].tolist()
            gap[b, m], inside = self._measure(i, j, placement(b, i), placement(b, j), result)
            contacts.point[b, m] = result.getNearestPoint1()
            contacts.other_point[b, m] = result.getNearestPoint2()
            # coal's normal points from the first to the second.
            contacts.normal[b, m] = result.normal if inside else -result.normal
        return contacts

    def of(self, poses: Poses, rows: Indices, columns: Indices) -> Array:
        """Distances [K], m, of the pairs `columns` [K] at the configurations `rows` [K]: as in a
        call, but of these alone and without witness points."""
        first, second = self._pairs[columns].T
        centre, other = (self._centred(poses, rows, body) for body in (first, second))
        gap = np.sqrt(((centre - other) ** 2).sum(-1)) - self._radii[first] - self._radii[second]
        above = centre[:, 2] - self._table_height - self._radii[first]
        gap = np.where(self._table[second], above, gap)
        near = np.flatnonzero(gap < self.exact_to)
        placement, result = cache(partial(self._placement, poses)), coal.DistanceResult()
        for k in near.tolist():
            row, i, j = int(rows[k]), int(first[k]), int(second[k])
            gap[k], _ = self._measure(i, j, placement(row, i), placement(row, j), result)
        return np.asarray(gap)

    def _centred(self, poses: Poses, rows: Indices, bodies: Indices) -> Array:
        """Centres [K, 3] of the bodies' balls in the world, m."""
        links, points = self._links[bodies], self._centres[bodies]
        turned = (poses.rotation[rows, links] @ points[:, :, None])[..., 0]
        return np.where((links == WORLD)[:, None], points, turned + poses.position[rows, links])

    def _placement(self, poses: Poses, row: int, body: int) -> coal.Transform3s:
        """Pose of a body's shape in the world."""
        local, link = self._local[body], self._links[body]
        if link == WORLD:
            return coal.Transform3s(local[:3, :3], local[:3, 3])
        turn = poses.rotation[row, link]
        place = turn @ local[:3, 3] + poses.position[row, link]
        return coal.Transform3s(turn @ local[:3, :3], place)

    def _measure(
        self,
        first: int,
        second: int,
        one: coal.Transform3s,
        two: coal.Transform3s,
        result: coal.DistanceResult,
    ) -> tuple[float, bool]:
        """Exact distance [m] of two bodies, and whether the first is wholly inside of the second.

        Args:
            first, second: The bodies.
            one, two: Poses of their shapes.
            result: Is overwritten with coal's nearest points and normal.
        """
        shape, other = self._bodies[first].geometry, self._bodies[second].geometry
        mesh = self._meshes.get(second)
        if mesh is not None:
            result.clear()
            least = coal.distance(shape, one, mesh.hull, two, self._request, result)
            if least > self.exact_to or mesh.inside.is_convex:
                return least, False
        result.clear()
        distance = coal.distance(shape, one, other, two, self._request, result)
        if mesh is None:
            return distance, False
        point = (result.getNearestPoint1() - two.getTranslation()) @ two.getRotation()
        overlaps = not distance > 0
        if not overlaps and not mesh.inside(point):
            return distance, False
        if mesh.is_solid and not (overlaps and _leads_out(mesh, two, result)):
            result.clear()
            return coal.distance(shape, one, mesh.hull, two, self._request, result), False
        if overlaps:
            return distance, False
        # A shape that is wholly inside of a closed mesh does not touch its triangles: its shortest
        # way out is through the nearest one.
        return -distance - self._radii[first], True


def _leads_out(mesh: CollisionMesh, pose: coal.Transform3s, result: coal.DistanceResult) -> bool:
    """Whether the way off a triangle leads out of the mesh. The shortest one may lead inwards or
    along the surface: a triangle has no inside."""
    a, b, c = mesh.vertices[mesh.faces[result.b1]]
    outwards = np.cross(b - a, c - a)
    steepness = -result.normal @ pose.getRotation() @ outwards
    return bool(steepness > OUTWARDS * np.linalg.norm(outwards))


def _settle_boxes() -> None:
    """Make boxes equally large in every process.

    At the first query of a box, coal 3 decides for the whole process whether boxes are 1e-10 larger
    along one side: if that query's support direction has a zero component. Plans then differ by
    1e-13, and simulated contacts more. So this makes a first query without zeros.
    """
    turned = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3
    coal.distance(
        coal.Cylinder(1.0, 1.0),  # its frame is where directions begin with (1, 0, 0)
        coal.Transform3s.Identity(),
        coal.Box(1.0, 1.0, 1.0),
        coal.Transform3s(turned, np.array([3.0, 2.0, 1.0])),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )


def _obstacle_body(obstacle: Obstacle, mesh: CollisionMesh | None) -> Body:
    if mesh is None:
        shape = Shape(obstacle.kind, obstacle.size, obstacle.pose)
        return link_body(WORLD, obstacle.name, shape)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(mesh.vertices - middle, axis=1).max())
    centre = obstacle.pose[:3, :3] @ middle + obstacle.pose[:3, 3]
    return Body(WORLD, obstacle.name, mesh.surface, obstacle.pose, centre, radius)
