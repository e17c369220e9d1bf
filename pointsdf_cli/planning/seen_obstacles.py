"""Other objects on the table as obstacles: reconstructions, or hulls of their seen points.

A hull ends where the camera's view does; a reconstruction has a back, too. Each object is completed
from the view that shows it, with the evidence of that view. Walls, shelves and trays, of which the
network has learned none, are divided into convex parts (planning/seen_parts.py).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from itertools import count

import coal
import numpy as np
import scipy

from pointsdf_cli.camera.raised_support import BAND, NARROWEST, within_hull
from pointsdf_cli.camera.segmentation import GAP, clusters
from pointsdf_cli.camera.table_objects import LOOSE, VOXEL
from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array, Mask, Surface
from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.geometry.offset import offset_surface
from pointsdf_cli.geometry.voxels import thin
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.processor import run_in_parallel, timed
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.cancellation import stop_if_cancelled
from pointsdf_cli.planning.environment import Obstacle
from pointsdf_cli.planning.labelled_view import LabelledView, sighting
from pointsdf_cli.planning.object_choice import ListedObject
from pointsdf_cli.planning.robot_geometry import CollisionMesh
from pointsdf_cli.planning.seen_parts import IsFree, convex_parts, nothing_free, thickened
from pointsdf_cli.planning.table_top import TableTop, view_of
from pointsdf_cli.planning.target import completed

RESOLUTION = 32
"""Cells along the network's box for an obstacle's surface: 0.2 s an object on one core, where 64
take 0.5 s (docs/planning.md)."""

ON_TABLE = 0.02
"""A reconstruction that begins higher than this [m] above the table lacks its hidden foot."""

KEPT_OFF = 0.004
"""Reconstructions err by a few millimetres on the unseen side, and arms lag as much: obstacles are
larger all round by this [m]."""

LEVEL = 0.001
"""Value of the field [m] where an obstacle ends. Where nothing was seen the field stays near zero:
its level of 4 mm encloses six times the object's volume, its level of 0 misses a third of it
(docs/notebook.md)."""

MISSED, FEWEST_MISSED = 0.006, 20
"""Seen points farther than this [m] from a reconstruction are a part that it misses, if so many lie
together, one a voxel."""

FACES = 8
"""Number of the nearest faces; a point behind all of them is inside."""

SMALLEST = 12
"""Number of points, one a voxel, from which a group of them is an obstacle: a die 2 cm wide has 23
at 1.2 m. Smaller groups are mostly noise on the table (docs/notebook.md)."""


LONGEST = 0.6
"""Level extent [m] above which a thing is divided into convex parts."""

Found = tuple[list[CollisionMesh], float]
"""Meshes of objects, and how long they took [s]."""


def seen_obstacles(
    seen: TableTop,
    network: ShapeModel | None,
    taken: Collection[str] = (),
    seed: int = 0,
    cleaned: bool = True,
) -> tuple[tuple[Obstacle, ...], float]:
    """Everything that was seen beside the object.

    Args:
        seen: The table top.
        network: Completes each object; None for the hulls of the seen points.
        taken: Names that other obstacles have.
        seed: Random seed of the resampling of the clouds.
        cleaned: Whether specks and outliers of an object are dropped.

    Returns:
        The obstacles, called seen_1, seen_2, …, and how long they took [s].
    """
    return named_obstacles(run_in_parallel(obstacle_tasks(seen, network, seed, cleaned)), taken)


def obstacle_tasks(
    seen: TableTop, network: ShapeModel | None, seed: int = 0, cleaned: bool = True
) -> list[Callable[[], Found]]:
    """Tasks of `seen_obstacles`, which do not depend on each other."""
    free = partial(_seen_free, [labelled for labelled, _ in seen.labelled])
    if network is None:
        return [partial(timed, partial(hulls, seen.others, free=free))]
    tasks: list[Callable[[], Found]] = []
    for labelled, target in seen.labelled:
        for item in labelled.listed:
            if item.label != target:
                more = seed, cleaned, free
                tasks.append(partial(timed, _completed, network, labelled, item, *more))
        loose = labelled.world[labelled.objects.label == LOOSE]
        tasks.append(partial(timed, partial(hulls, loose, free=free)))
    return tasks


def named_obstacles(
    found: Sequence[Found], taken: Collection[str] = ()
) -> tuple[tuple[Obstacle, ...], float]:
    """The obstacles of `obstacle_tasks`' results, and how long they took in all [s]; `taken` are
    names that other obstacles have."""
    names = (name for k in count(1) if (name := f"seen_{k}") not in taken)
    bodies = [(mesh.vertices, mesh.faces, mesh) for meshes, _ in found for mesh in meshes]
    made = tuple(Obstacle(next(names), "mesh", (), np.eye(4), *body) for body in bodies)
    return made, sum(seconds for _, seconds in found)


def _seen_free(views: Sequence[LabelledView], places: Array) -> Mask:
    """Mask of the places [N, 3], world, m, that any of the cameras saw to be free."""
    return np.any([np.zeros(len(places), bool), *(v.free.holds(places) for v in views)], axis=0)


def _completed(
    network: ShapeModel,
    labelled: LabelledView,
    item: ListedObject,
    seed: int,
    cleaned: bool,
    free: IsFree,
) -> list[CollisionMesh]:
    stop_if_cancelled()
    points = labelled.world[labelled.objects.label == item.label]
    plane, level = labelled.objects.plane, labelled.objects.supports.get(item.label)
    if plane is not None and level is not None:
        # The hull of floor and wall would be a wedge.
        floor = np.abs(points @ plane[:3] - plane[3] - level) < BAND
        return [*hulls(points[floor], 0.0, free), *hulls(points[~floor], 0.0, free)]
    if item.size[0] > LONGEST or _surrounds(points, labelled.listed, item):
        return hulls(points, 0.0, free)
    view = view_of(labelled, sighting(labelled, item, cleaned, is_target=False), item.label)
    return obstacle_surfaces(network, view, seed)


def _surrounds(points: Array, listed: Sequence[ListedObject], item: ListedObject) -> bool:
    """Whether a wide object, of which these points [N, 3] are seen, is around another one, as a bin
    is."""
    if item.size[1] < NARROWEST or len(listed) < 2:
        return False
    sides = scipy.spatial.ConvexHull(points[:, :2]).equations
    others = np.array([one.centre[:2] for one in listed if one.label != item.label])
    return bool(within_hull(others, sides).any())


def obstacle_surfaces(network: ShapeModel, view: View, seed: int = 0) -> list[CollisionMesh]:
    """An object's reconstruction, and the hulls of seen parts that it misses.

    An object that is too large, or without a reconstruction, becomes the hull of its seen points
    down to the table; one whose reconstruction floats, the hull of both.
    """
    points = view.in_world
    points = points[thin(points, VOXEL).first] if len(points) else points
    if len(points) < FEWEST_MISSED or _level_extent(points) > LONGEST:
        return hulls(points)
    shape = completed(network, view, seed).in_fast_precision
    try:
        whole = CollisionMesh.of(*_enlarged(shape))
    except EmptySurfaceError:
        return hulls(points)
    if whole.vertices[:, 2].min() > ON_TABLE:
        return hulls(np.concatenate([points, whole.vertices]))
    missed = _missed(points, whole)
    return [whole, *map(_hull, _groups(missed, FEWEST_MISSED))]


def _enlarged(shape: Reconstruction) -> Surface:
    """The reconstruction, enlarged on all sides. For a vessel, the filled outside is used, because
    its wall is thinner than the cells."""
    if shape.vessel is not None:
        return offset_surface(shape.vessel.vessel.filled.surface(), KEPT_OFF)
    mesh = mesh_reconstruction(shape, RESOLUTION, field=lambda x: shape.sdf(x) - LEVEL)
    return offset_surface((mesh.vertices, mesh.faces), KEPT_OFF - LEVEL)


def _missed(points: Array, mesh: CollisionMesh) -> Array:
    """Those of the points [N, 3] that are farther than `MISSED` outside a closed mesh."""
    # What is near a point of the surface is not missed: most are near a corner or a face's middle.
    corners = mesh.vertices[mesh.faces]
    middles = corners.mean(axis=1)
    surface = scipy.spatial.KDTree(np.concatenate([mesh.vertices, middles]))
    far = points[surface.query(points)[0] > MISSED]
    if len(far) < FEWEST_MISSED:
        return far[:0]
    # Nor is what lies behind all faces near it: most of the rest.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    _, near = scipy.spatial.KDTree(middles).query(far, k=min(FACES, len(middles)))
    before = ((far[:, None] - middles[near]) * normals[near]).sum(axis=-1) > 0
    far = far[before.any(axis=1)]
    point, here, there = coal.Sphere(1e-9), coal.Transform3s.Identity(), coal.Transform3s.Identity()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    missed = np.zeros(len(far), dtype=bool)
    for k, place in enumerate(far):
        there.setTranslation(place)
        result.clear()
        apart = coal.distance(mesh.surface, here, point, there, request, result)
        missed[k] = apart > MISSED and not mesh.inside(place)
    return np.asarray(far[missed])


def hulls(
    points: Array, longest: float = LONGEST, free: IsFree = nothing_free
) -> list[CollisionMesh]:
    """The convex hull of each cluster of points, down to the table; the convex parts of a long one.

    Args:
        points: [N, 3], world, m; what one camera saw, or several.
        longest: Level extent [m] above which a cluster is divided.
        free: Places that were seen to be free.
    """
    found: list[CollisionMesh] = []
    for cluster in _groups(points, SMALLEST):
        if _level_extent(cluster) <= longest:
            found.append(_hull(np.concatenate([cluster, cluster * [1.0, 1.0, 0.0]])))
        else:
            found += [_hull(corners) for corners in convex_parts(cluster, free)]
    return found


def _groups(points: Array, fewest: int) -> list[Array]:
    """Clusters [K, 3] of points [N, 3] with `fewest` points or more."""
    if not len(points):
        return []
    label, counts = clusters(points, GAP)
    return [points[label == k] for k in np.flatnonzero(counts >= fewest)]


def _hull(corners: Array) -> CollisionMesh:
    """The convex hull of corners [N, 3]."""
    import trimesh  # a quarter of a second, which a scene of whole objects does without

    hull = trimesh.convex.convex_hull(thickened(corners))
    vertices, faces = np.asarray(hull.vertices, float), np.asarray(hull.faces, np.int32)
    return CollisionMesh.of(vertices, faces)


def _level_extent(points: Array) -> float:
    """Diagonal [m] of the upright box around points [N, 3], seen from above."""
    return float(np.linalg.norm(np.ptp(points[:, :2], axis=0)))
