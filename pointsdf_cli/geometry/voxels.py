"""Clouds thinned to one point a voxel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Indices


class Thinned(NamedTuple):
    """One point for each occupied voxel.

    Attributes:
        first: i8 [M], the point that stands for each voxel.
        voxel: i8 [N], the voxel of each point: `first[voxel]` is its representative.
    """

    first: Indices
    voxel: Indices


def thin(points: Array, side: float) -> Thinned:
    """Keep the first point of each voxel.

    Args:
        points: [N, 3], m; finite.
        side: Side of a voxel [m].

    Raises:
        InputError: The points reach too far for voxels of this size.
    """
    if not len(points):
        return Thinned(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    cell = np.floor((points - points.min(axis=0)) / side)
    shape = cell.max(axis=0) + 1
    if not float(np.prod(shape)) < 2**62:
        raise InputError(
            f"a cloud {np.ptp(points, axis=0).max():.3g} m across",
            allowed="some metres",
            hint="check the unit (--unit m, cm, mm, inch)",
        )
    whole = cell.astype(np.int64)
    key = (whole[:, 0] * int(shape[1]) + whole[:, 1]) * int(shape[2]) + whole[:, 2]
    _, index, voxel = np.unique(key, return_index=True, return_inverse=True)
    return Thinned(index.astype(np.int64), voxel.astype(np.int64))
