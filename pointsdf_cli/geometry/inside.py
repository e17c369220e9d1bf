"""Inside of a closed mesh, for single points asked thousands of times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array

FEW = 4096
"""Meshes of more faces are not tested for being convex."""

FLAT = 1e-9
"""Corners may stand out of a face's plane by this [m]."""


class Inside:
    """Whether a point lies inside of a closed mesh: by the faces' planes where it is convex, else
    by its signed distance.

    Args:
        vertices: [V, 3], m.
        faces: [F, 3], counter-clockwise seen from outside.
    """

    def __init__(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        self._planes = _planes(vertices, faces)
        if self._planes is None:
            # Open3D takes half a second to load, and most obstacles are hulls.
            from pointsdf_cli.geometry.signed_distance import SignedDistance

            self._distance = SignedDistance(vertices, faces, threads=1)

    def __call__(self, point: Array) -> bool:
        """Whether a point [3] is inside; on the surface either may be said."""
        if self._planes is None:
            return bool(self._distance(point[None])[0] < 0)
        normals, offsets = self._planes
        return bool((normals @ point < offsets).all())


def _planes(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, Array] | None:
    """Unit normals [F, 3] and offsets [F] of the faces, or None where a corner lies before one."""
    if len(faces) > FEW:
        return None
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    real = length[:, 0] > 0
    normals = normals[real] / length[real]
    offsets = (normals * a[real]).sum(axis=1)
    corners = vertices[np.unique(faces)]
    if not len(normals) or (corners @ normals.T > offsets + FLAT).any():
        return None
    return normals, offsets
