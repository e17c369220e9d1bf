"""Inside of a closed mesh, for single points asked thousands of times."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array

if TYPE_CHECKING:
    from pointsdf_cli.geometry.signed_distance import SignedDistance

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
        self._mesh = vertices, faces
        self._low, self._high = vertices.min(axis=0), vertices.max(axis=0)

    def __call__(self, point: Array) -> bool:
        """Whether a point [3] is inside; on the surface either may be said."""
        if (point < self._low).any() or (point > self._high).any():
            return False
        if self._planes is None:
            return bool(self._distance(point[None])[0] < 0)
        normals, offsets = self._planes
        return bool((normals @ point < offsets).all())

    @cached_property
    def _distance(self) -> SignedDistance:
        # Open3D takes half a second to load, and few points ever lie within a mesh's box.
        from pointsdf_cli.geometry.signed_distance import SignedDistance

        return SignedDistance(*self._mesh, threads=1)


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
