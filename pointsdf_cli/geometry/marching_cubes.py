"""Marching cubes on any set of grid cells: which edges the zero level crosses, and the triangles.

The 256 cases are derived here from two rules instead of being typed in. On each face of the cell
the contour goes around the *outside* corners, so two diagonal inside corners stay joined: thin
walls keep together, and since the rule looks at the face alone, both cells that share it draw the
same contour. Each closed contour is then triangulated without a chord lying in a face (the
neighbour might draw the same chord, and the edge would have four triangles). Together the two
rules make every edge of the surface belong to exactly two triangles.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

#: Corner k of a cell sits at (k >> 2 & 1, k >> 1 & 1, k & 1); [8, 3].
CORNERS = np.array(list(product((0, 1), repeat=3)), dtype=np.int64)
#: The 12 edges as pairs (low corner, high corner), and the axis along which each runs.
EDGES = [(a, a | bit) for bit in (4, 2, 1) for a in range(8) if not a & bit]
EDGE_LOW = np.array([low for low, _ in EDGES])
EDGE_HIGH = np.array([high for _, high in EDGES])
EDGE_AXIS = np.repeat(np.arange(3), 4)


class CrossedCells(NamedTuple):
    """The topology of a zero level on a set of cells."""

    low: np.ndarray
    """[V] row of the sample at the lower end of the edge that each vertex lies on."""
    high: np.ndarray
    """[V] row of the sample at its upper end."""
    axis: np.ndarray
    """[V] 0, 1 or 2: the direction of that edge."""
    faces: np.ndarray
    """[F, 3] triangles over the V vertices, counter-clockwise seen from the positive side."""


def cell_cases(inside: np.ndarray) -> np.ndarray:
    """[C] u1: which of the corners [C, 8] are inside, corner k as bit k."""
    return np.packbits(inside.reshape(-1), bitorder="little")


def cross_cells(corners: np.ndarray, values: np.ndarray) -> CrossedCells:
    """The triangles of the zero level on given cells.

    Args:
        corners: [C, 8] rows of `values`, in the order of CORNERS; cells share samples by row.
        values: [R] field, negative inside.

    Returns:
        One vertex for each crossed edge, numbered by (row of its lower end, axis), and faces.
    """
    table, counts = _cases()
    inside = values < 0
    inside_corner = inside[corners]
    case = cell_cases(inside_corner)

    # Mark each crossed edge at its lower end; cells that share it write the same thing.
    upper_end = np.full((len(values), 3), -1, dtype=np.int64)
    for low, high, axis in zip(EDGE_LOW, EDGE_HIGH, EDGE_AXIS, strict=True):
        crossed = inside_corner[:, low] != inside_corner[:, high]
        upper_end[corners[crossed, low], axis] = corners[crossed, high]
    low_row, axis_of_vertex = np.nonzero(upper_end >= 0)
    vertex_of_edge = np.full(upper_end.shape, -1, dtype=np.int32)
    vertex_of_edge[low_row, axis_of_vertex] = np.arange(len(low_row), dtype=np.int32)

    faces = []
    for triangle in range(table.shape[1]):
        cell = np.flatnonzero(counts[case] > triangle)
        edge = table[case[cell], triangle]  # [n, 3]
        faces.append(vertex_of_edge[corners[cell[:, None], EDGE_LOW[edge]], EDGE_AXIS[edge]])
    return CrossedCells(
        low=low_row,
        high=upper_end[low_row, axis_of_vertex],
        axis=axis_of_vertex,
        faces=np.concatenate(faces) if faces else np.zeros((0, 3), np.int32),
    )


@lru_cache(maxsize=1)
def _cases() -> tuple[np.ndarray, np.ndarray]:
    """Edge numbers of the triangles, [256, T, 3], and how many of the T each case has, [256]."""
    triangles = [[t for loop in _contours(case) for t in _triangulate(loop)] for case in range(256)]
    counts = np.array([len(t) for t in triangles])
    table = np.zeros((256, counts.max(), 3), dtype=np.int64)
    for case, rows in enumerate(triangles):
        table[case, : len(rows)] = np.array(rows).reshape(-1, 3)
    return table, counts


@lru_cache(maxsize=1)
def _faces() -> list[list[int]]:
    """The corners of the six faces, each counter-clockwise seen from outside the cell."""
    faces = []
    for axis, side in product(range(3), (0, 1)):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        cycle = [(0, 0), (1, 0), (1, 1), (0, 1)]
        face = []
        for a, b in cycle if side else cycle[::-1]:
            corner = [0, 0, 0]
            corner[axis], corner[u], corner[v] = side, a, b
            face.append(corner[0] << 2 | corner[1] << 1 | corner[2])
        faces.append(face)
    return faces


@lru_cache
def _edge_between(a: int, b: int) -> int:
    return EDGES.index((min(a, b), max(a, b)))


def _contours(case: int) -> list[list[int]]:
    """The closed contours of a case as lists of edges; bit k of `case` says corner k is inside."""
    inside = [bool(case >> k & 1) for k in range(8)]
    following: dict[int, int] = {}
    for face in _faces():
        for i in range(4):
            if inside[face[i - 1]] and not inside[face[i]]:  # a run of outside corners begins
                j = i
                while not inside[face[(j + 1) % 4]]:
                    j += 1
                first = _edge_between(face[i - 1], face[i])
                last = _edge_between(face[j % 4], face[(j + 1) % 4])
                following[last] = first
    loops = []
    while following:
        start, edge = following.popitem()
        loop = [start]
        while edge != start:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append(loop)
    return loops


@lru_cache(maxsize=256)
def _share_face(edge_a: int, edge_b: int) -> bool:
    corners = {*EDGES[edge_a], *EDGES[edge_b]}
    return any(corners <= set(face) for face in _faces())


def _triangulate(loop: list[int]) -> list[tuple[int, int, int]]:
    """Triangles of a contour whose chords all run through the cell's interior."""

    def split(polygon: list[int]) -> list[tuple[int, int, int]] | None:
        if len(polygon) < 3:
            return []
        first, last = polygon[0], polygon[-1]
        for k in range(1, len(polygon) - 1):
            apex = polygon[k]
            if k > 1 and _share_face(first, apex):
                continue
            if k < len(polygon) - 2 and _share_face(apex, last):
                continue
            left, right = split(polygon[: k + 1]), split(polygon[k:])
            if left is not None and right is not None:
                return [*left, (first, apex, last), *right]
        return None

    triangles = split(loop)
    if triangles is None:
        raise AssertionError(f"contour {loop} has no triangulation inside its cell")
    return triangles
