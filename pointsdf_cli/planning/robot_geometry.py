"""Geometry for distances: convex bodies, closed meshes, and patches of surface points."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.inside import Inside
from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.planning.screen import HandOutline
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.shapes import Shape, bounding_box
from pointsdf_cli.robot.surface import robot_surface

PATCH = 16
"""Largest number of samples in a patch."""

SPACING = 0.006
"""Spacing of the samples [m]. Between samples a finger can be nearer to an object than any of them:
in executed plans by up to 3.3 mm at 1 cm, 1.7 mm at 6 mm (docs/notebook.md)."""


SOLID = 0.5
"""Share of its convex hull from which a mesh is solid: bins and shelves are not."""


@dataclass(frozen=True)
class Body:
    """One convex shape of a link, or one obstacle, which may be a mesh.

    Attributes:
        link: Index of the link that it moves with.
        name: Name of the link or of the obstacle.
        geometry: The shape in coal.
        pose: [4, 4], the shape in the link.
        centre, radius: Bounding ball, in the link's frame.
    """

    link: int
    name: str
    geometry: coal.CollisionGeometry
    pose: Array
    centre: Array
    radius: float


@dataclass(frozen=True)
class CollisionMesh:
    """A closed mesh prepared for distances: made once, by the task that makes the mesh.

    Attributes:
        vertices: [V, 3], m.
        faces: [F, 3], counter-clockwise seen from outside.
        surface: Its triangles, without an inside.
        hull: Its convex hull, which shows fifty times as fast that something is far.
        inside: Whether a point is inside.
        is_solid: Whether it fills at least `SOLID` of its hull.
    """

    vertices: Array
    faces: NDArray[np.integer]
    surface: coal.CollisionGeometry
    hull: coal.CollisionGeometry
    inside: Inside
    is_solid: bool

    @classmethod
    def of(cls, vertices: Array, faces: NDArray[np.integer]) -> CollisionMesh:
        """Prepare a mesh of vertices [V, 3] m and faces [F, 3]."""
        surface = coal.BVHModelOBBRSS()
        surface.beginModel(len(faces), len(vertices))
        surface.addVertices(np.asarray(vertices, dtype=np.float64))
        surface.addTriangles(np.asarray(faces, dtype=np.int64))
        surface.endModel()
        surface.buildConvexHull(True, "Qt")
        hull = surface.convex
        solid = enclosed_volume(vertices, faces) >= SOLID * hull.computeVolume()
        return cls(vertices, faces, surface, hull, Inside(vertices, faces), solid)


@dataclass(frozen=True)
class Patches:
    """M groups of surface samples, each a few centimetres wide.

    Attributes:
        link: [M], index of each patch's link.
        points: [M, PATCH, 3], link frame; short patches repeat samples.
        centre, radius: [M, 3] and [M], bounding spheres.
    """

    link: Indices
    points: Array
    centre: Array
    radius: Array


class RobotGeometry:
    """Shape of a robot for planning.

    Args:
        kinematics: Kinematics of the robot.

    Attributes:
        bodies: Bodies, one for each shape.
        patches: Patches of all links' surfaces.
        reach: [L + 1, J], see `link_reach`.
        hand: The hand's surface for any preshape.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self.kinematics = kinematics
        tree = kinematics.robot.tree
        shapes = [(link, shape) for link in tree.links for shape in tree.shapes[link]]
        self.bodies = tuple(link_body(kinematics.index(link), link, one) for link, one in shapes)
        links, patches = [], []
        for link, points in robot_surface(kinematics.robot, SPACING).items():
            for patch in _split(points):
                links.append(kinematics.index(link))
                # Repeats make all patches equally long; they change no minimum.
                patches.append(patch[np.arange(PATCH) % len(patch)])
        stacked = np.array(patches)
        centre = (stacked.min(axis=1) + stacked.max(axis=1)) / 2
        radius = np.linalg.norm(stacked - centre[:, None], axis=2).max(axis=1)
        self.reach = link_reach(kinematics)
        self.hand = HandOutline(kinematics)
        self.patches = Patches(np.array(links), stacked, centre, radius)


def link_reach(kinematics: Kinematics) -> Array:
    """Largest distance of any point of a link from a joint's axis [L + 1, J], m; 1 for sliding
    joints.

    By the triangle inequality along the chain: the offsets of the joints between, the travel of
    those that slide, and the farthest corner of the link's box. Joints that do not move the link,
    and the last row, which stands for the world, have 0.
    """
    robot = kinematics.robot
    tree = robot.tree
    columns = {name: j for j, name in enumerate(robot.joint_names)}
    reach = np.zeros((len(tree.links) + 1, len(columns)))
    for link, shapes in tree.shapes.items():
        if not shapes:
            continue
        low, high = bounding_box(shapes)
        farthest = float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
        for joint in tree.joints_to_root(link):
            if joint.name in columns:
                slides = joint.kind == "prismatic"
                reach[kinematics.index(link), columns[joint.name]] = 1.0 if slides else farthest
                farthest += max(abs(joint.lower), abs(joint.upper)) if slides else 0.0
            farthest += float(np.linalg.norm(joint.T_parent_joint[:3, 3]))
    return reach


def link_body(link: int, name: str, shape: Shape) -> Body:
    """A shape of a link, or of the world."""
    centre = shape.bounds().mean(axis=0)
    if shape.kind == "box":
        geometry = coal.Box(*map(float, shape.size))
        radius = float(np.linalg.norm(shape.size)) / 2
    elif shape.kind == "cylinder":
        geometry = coal.Cylinder(*map(float, shape.size))
        radius = float(np.hypot(shape.size[0], shape.size[1] / 2))
    elif shape.kind == "sphere":
        geometry, radius = coal.Sphere(float(shape.size[0])), float(shape.size[0])
    else:
        corners, faces = shape.triangles()
        points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        points.extend(list(np.asarray(corners, dtype=np.float64)))
        triangles.extend([coal.Triangle(*map(int, face)) for face in faces])
        geometry = coal.Convex(points, triangles)
        radius = float(np.linalg.norm(apply_transform(shape.pose, corners) - centre, axis=1).max())
    return Body(link, name, geometry, np.asarray(shape.pose), centre, radius)


def _split(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Compact groups of at most PATCH points, by halving the longest side."""
    if len(points) <= PATCH:
        return [points]
    axis = int(np.ptp(points, axis=0).argmax())
    order = np.argsort(points[:, axis], kind="stable")
    half = len(points) // 2
    return _split(points[order[:half]]) + _split(points[order[half:]])
