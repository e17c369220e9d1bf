"""Planes through three points each, and through many."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array

LEAST_AREA = 1e-6
"""Length of the normal's cross product [m²] up to which three points lie in a line."""


def planes_through(triples: Array) -> tuple[Array, Array]:
    """Unit normals [K, 3] of the planes through triples of points, and a point [K, 3] on each.

    Args:
        triples: [T, 3, 3], T times three points, m. Those in a line are left out.
    """
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > LEAST_AREA
    return normals[usable] / length[usable, None], triples[usable, 0]


def least_squares_plane(points: Array) -> tuple[Array, Array]:
    """Unit normal [3], of either sign, and centre [3] of the plane nearest to points [N, 3]."""
    centre = points.mean(axis=0)
    away = points - centre
    _, axes = np.linalg.eigh(away.T @ away)
    return axes[:, 0], centre
