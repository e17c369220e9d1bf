"""Split long edges of a solid, so that a smooth map can bend its flat faces.

Replaces `refine_to_length` of manifold3d, which in version 3.5.4 sometimes reads outside its memory
(a segmentation fault for one jug in thirty).
"""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold, Mesh64


def refine(solid: Manifold, longest: float) -> Manifold:
    """The same solid with no edge longer than `longest` m; the surface does not move."""
    mesh = solid.to_mesh64()
    before = np.array(mesh.vert_properties, dtype=np.float64)
    vertices, faces = split_long_edges(before, np.array(mesh.tri_verts, dtype=np.int64), longest)
    if len(vertices) == len(before):
        return solid
    return Manifold(Mesh64(vertices, faces.astype(np.uint64)))


def split_long_edges(
    vertices: np.ndarray, faces: np.ndarray, longest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Halve every edge longer than `longest` until none remains.

    Args:
        vertices: [V, 3].
        faces: [F, 3] of a closed mesh.
        longest: In the units of the vertices, more than 0.

    Returns:
        The vertices, the old ones first, and faces that cover the old ones exactly.
    """
    while True:
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        codes = edges[:, 0] * len(vertices) + edges[:, 1]
        code, edge_of_corner = np.unique(codes, return_inverse=True)
        start, end = np.divmod(code, len(vertices))
        too_long = np.linalg.norm(vertices[end] - vertices[start], axis=1) > longest
        if not too_long.any():
            return vertices, faces
        middle = np.full(len(code), -1)
        middle[too_long] = len(vertices) + np.arange(np.count_nonzero(too_long))
        halves = (vertices[start[too_long]] + vertices[end[too_long]]) / 2
        vertices = np.concatenate([vertices, halves])
        faces = _split_faces(faces, middle[edge_of_corner.reshape(-1, 3)], vertices)


def _split_faces(faces: np.ndarray, middles: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Faces split at their edges' midpoints; `middles` [F, 3] is −1 where an edge stays whole."""
    count = np.count_nonzero(middles >= 0, axis=1)
    # Rotate each face's corners so that its first edge is split; of two, the first two.
    last_whole = (count == 2) * ((middles[:, 0] < 0) * 1 + (middles[:, 1] < 0) * 2)
    first_split = (count == 1) * np.argmax(middles >= 0, axis=1)
    turn = (np.arange(3) + (last_whole + first_split)[:, None]) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    ab, bc, ca = np.take_along_axis(middles, turn, axis=1).T

    one, two, three = count == 1, count == 2, count == 3
    # Two split edges leave a quadrangle (a, ab, bc, c), cut along its shorter diagonal.
    first = np.linalg.norm(vertices[a[two]] - vertices[bc[two]], axis=1)
    second = np.linalg.norm(vertices[ab[two]] - vertices[c[two]], axis=1)
    near = np.flatnonzero(two)[first <= second]
    far = np.flatnonzero(two)[first > second]

    def faces_at(rows: np.ndarray, *corners: np.ndarray) -> np.ndarray:
        return np.stack([corner[rows] for corner in corners], axis=-1)

    return np.concatenate(
        [
            faces[count == 0],
            faces_at(one, a, ab, c),
            faces_at(one, ab, b, c),
            faces_at(two, ab, b, bc),
            faces_at(near, a, ab, bc),
            faces_at(near, a, bc, c),
            faces_at(far, a, ab, c),
            faces_at(far, ab, bc, c),
            faces_at(three, a, ab, ca),
            faces_at(three, ab, b, bc),
            faces_at(three, bc, c, ca),
            faces_at(three, ab, bc, ca),
        ]
    )
