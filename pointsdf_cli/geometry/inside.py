"""Inside of a closed mesh, for single points asked thousands of times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import rotation_from_wxyz

FEW = 4096
"""Meshes of more faces are not tested for being convex."""

_UP = rotation_from_wxyz((0.81, 0.43, -0.31, 0.25))
"""Turns a mesh so that rays along z run in no face and through no edge of a box."""

FLAT = 1e-9
"""Corners may stand out of a face's plane by this [m]."""


class Inside:
    """Whether a point lies inside of a closed mesh: by the faces' planes where it is convex, else
    by the faces that a ray from the point crosses, outwards less inwards.

    Args:
        vertices: [V, 3], m.
        faces: [F, 3], counter-clockwise seen from outside.
    """

    def __init__(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        self._planes = _planes(vertices, faces)
        self._corners = (vertices @ _UP.T)[faces]
        self._seen_from = self._corners[..., :2].min(axis=1).T.copy()
        self._seen_to = self._corners[..., :2].max(axis=1).T.copy()
        self._low, self._high = vertices.min(axis=0), vertices.max(axis=0)

    @property
    def is_convex(self) -> bool:
        """Whether the mesh is known to be convex; large ones never are."""
        return self._planes is not None

    def __call__(self, point: Array) -> bool:
        """Whether a point [3] is inside; on the surface either may be said."""
        if (point < self._low).any() or (point > self._high).any():
            return False
        if self._planes is None:
            return self._crossings(_UP @ point) > 0
        normals, offsets = self._planes
        return bool((normals @ point < offsets).all())

    def _crossings(self, point: Array) -> float:
        """Faces that the ray from a turned point [3] along z leaves through, less those that it
        enters."""
        (x, y), (left, low), (right, high) = point[:2], self._seen_from, self._seen_to
        near = self._corners[(left <= x) & (x <= right) & (low <= y) & (y <= high)] - point
        a, b, c = near.swapaxes(0, 1)
        # Twice the areas of the triangles between the ray and each edge: weights of the corners.
        at = np.stack([_area(b, c), _area(c, a), _area(a, b)], axis=1)
        side = np.sign(at)
        height = (at * near[..., 2]).sum(axis=1) * side[:, 0]
        crossed = (side == side[:, :1]).all(axis=1) & (height > 0)
        return float(side[crossed, 0].sum())


def _area(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def face_planes(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, Array]:
    """Unit normals [F, 3] and offsets [F] m of the planes of a mesh's faces with an area.

    Args:
        vertices: [V, 3], m.
        faces: [F, 3], counter-clockwise seen from outside.
    """
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    real = length[:, 0] > 0
    normals = normals[real] / length[real]
    return normals, (normals * a[real]).sum(axis=1)


def _planes(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, Array] | None:
    """The faces' planes, or None where a corner lies before one."""
    if len(faces) > FEW:
        return None
    normals, offsets = face_planes(vertices, faces)
    corners = vertices[np.unique(faces)]
    # A few corners tell of most meshes that they are not convex; all of them take a hundred times
    # as long.
    for some in (corners[:: len(corners) // 32 + 1], corners):
        if not len(normals) or (some @ normals.T > offsets + FLAT).any():
            return None
    return normals, offsets
