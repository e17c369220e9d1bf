"""Partial-view grasping's obstacle: the seen points alone, meshed at 32³ (the paper, section V-C).

It leaves the unseen side free: the baseline of the reconstruction method.
"""

from __future__ import annotations

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Surface

RESOLUTION = 32
SPAN = 26
"""Number of voxels along the cloud's longest side, as in the voxel network's input."""


def partial_mesh(points: Array) -> Surface:
    """A closed surface around the voxels that hold points.

    Args:
        points: [N, 3], m.

    Returns:
        vertices [V, 3] m in the points' frame and faces [F, 3], seen counter-clockwise from
        outside.

    Raises:
        InputError: There are no points, or all are equal.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"a cloud of shape {points.shape}", allowed="[N, 3] with N ≥ 1")
    low, high = points.min(axis=0), points.max(axis=0)
    side = float((high - low).max()) / SPAN
    if not side > 0:
        raise InputError("all points of the cloud are the same", allowed="a cloud with extent")
    origin = (low + high) / 2 - RESOLUTION / 2 * side
    place = np.floor((points - origin) / side).astype(np.int64)
    occupancy = np.zeros((RESOLUTION,) * 3, dtype=np.float32)
    occupancy[tuple(place.T)] = 1.0
    from skimage.measure import marching_cubes

    # Values stand for the middles of voxels.
    vertices, faces, _, _ = marching_cubes(occupancy, 0.5, gradient_direction="ascent")
    return origin + (vertices + 0.5) * side, faces.astype(np.int32)
