"""Objects that stand on the table: parts that hang in the air, or lie beside it, do not."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.segmentation import clusters
from pointsdf_cli.camera.table_objects import TABLE, TableObjects
from pointsdf_cli.geometry.arrays import Array

HIDDEN = 0.08
"""Height [m] above the table of an object's lowest seen point up to which it may stand in any
view."""
FROM_ABOVE = np.deg2rad(60)
"""Elevation of the camera, seen from the object, above which a foot hides below the top."""
BESIDE = 0.01
"""Angle [rad] between the rays to a foot and to a nearer object that hides it."""
FOOT = 0.02
"""Height [m] of the lowest seen part of an object."""
MOST = 200
"""Number of points of a foot that are tested at most."""


def standing_objects(objects: TableObjects, points: Array, camera: Array) -> NDArray[np.bool_]:
    """Mask of the objects [T] that stand on the table; all if no table was seen.

    An object's lowest seen point is near the table, or the camera could not see its foot: it looks
    down on the object, or a nearer object is in the way.

    Args:
        objects: The object of each point.
        points: [N, 3], world, m.
        camera: [3], position of the camera in the world, m.
    """
    stands = np.ones(objects.count, dtype=bool)
    label, plane = objects.label, objects.plane
    table = points[label == TABLE]
    if plane is None or not len(table):
        return stands
    height = points @ plane[:3] - plane[3]
    on_table = height[label == TABLE] > -0.02
    if not on_table.any():
        return stands
    level = table[on_table] * [1.0, 1.0, 0.0]
    # A wall or another table at the same height is not the table.
    piece, sizes = clusters(level, 0.05)
    low, high = np.percentile(level[piece == sizes.argmax(), :2], [1, 99], axis=0)
    for one in range(objects.count):
        mine = label == one
        if not mine.any() or one in objects.raised:  # a mask took all of it, or it is carried
            continue
        lowest = mine & (height < height[mine].min() + FOOT)
        foot = points[lowest] - height[lowest, None] * plane[:3]
        over = ((foot[:, :2] > low - 0.03) & (foot[:, :2] < high + 0.03)).all(axis=1).mean() > 0.5
        near = np.percentile(height[mine], 1) < HIDDEN
        others = points[(label >= 0) & ~mine]
        stands[one] = bool(over) and (near or _hidden(foot, others, camera))
    return stands


def _hidden(foot: Array, others: Array, camera: Array) -> bool:
    """Whether a camera cannot see places [N, 3] on the table below an object: from steeply above,
    or for points [M, 3] of nearer objects."""
    way = camera - np.median(foot, axis=0)
    if np.arctan2(way[2], np.linalg.norm(way[:2])) > FROM_ABOVE:
        return True
    if not len(others):
        return False
    rays = foot[:: -(-len(foot) // MOST)] - camera
    reach = np.linalg.norm(rays, axis=1)
    across = others - camera
    distance = np.linalg.norm(across, axis=1)
    tree = scipy.spatial.cKDTree(across / distance[:, None])
    away, nearest = tree.query(rays / reach[:, None])
    return bool(((away < BESIDE) & (distance[nearest] < reach)).mean() > 0.5)
