"""Unevenness of a table as a depth camera measures it.

The error of a depth camera varies slowly over the image: millimetres at 1 m, a centimetre at 1.5 m.
A flat table comes out wavy, and its waves rise above any thin band around the fitted plane. They
rise gently, though, while an object ends in a step.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array

CELL = 0.01
"""Side of a cell of the height map [m]."""

GENTLE = 0.25
"""Largest slope of a wave: a wave of 10 mm over a tenth of the image at 1.5 m has less."""

HIGHEST = 0.014
"""Largest height of a wave [m]."""

FEWEST = 3
"""Least number of points that give a cell a height."""


def table_relief(level: Array, height: Array, band: Array) -> Array:
    """Height of the measured table below each point, above the fitted plane.

    Starting from cells within the band, the table goes on in neighbouring cells of a height map
    for as long as it rises gently.

    Args:
        level: [N, 2], places of points along the plane, m.
        height: [N], their heights above it, m.
        band: [N], height up to which a point belongs to the table anyway, m.

    Returns:
        [N], m, 0 where the point's cell is not a part of the table, or lies below the plane.
    """
    cell = np.floor((level - level.min(axis=0)) / CELL).astype(np.int64)
    shape = tuple(cell.max(axis=0) + 1)
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    middle, count = _medians(flat, height, shape[0] * shape[1])
    limit = np.zeros(len(middle))
    limit[flat] = band
    known = (count >= FEWEST).reshape(shape)
    tall = middle.reshape(shape)
    table = known & (np.abs(tall) < limit.reshape(shape))
    table = _grown(table, known & (tall < HIGHEST), tall)
    relief = np.where(table, np.maximum(tall, 0.0), 0.0)
    return np.asarray(relief.ravel()[flat])


def _medians(cell: NDArray[np.int64], values: Array, size: int) -> tuple[Array, NDArray[np.int64]]:
    """Median of the values [N] in each of `size` cells, 0 in empty ones, and their number."""
    order = np.lexsort((values, cell))
    count = np.bincount(cell, minlength=size)
    first = np.cumsum(count) - count
    filled = np.flatnonzero(count)
    middle = np.zeros(size)
    middle[filled] = values[order[first[filled] + count[filled] // 2]]
    return middle, count


def _grown(table: NDArray[np.bool_], free: NDArray[np.bool_], tall: Array) -> NDArray[np.bool_]:
    """Cells [H, W] that are joined to the table by gentle steps through `free` cells."""
    number = np.arange(tall.size).reshape(tall.shape)
    usable = free | table
    starts, ends = [], []
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        gentle = np.abs(tall[one] - tall[other]) < GENTLE * CELL
        joined = usable[one] & usable[other] & gentle
        starts.append(number[one][joined])
        ends.append(number[other][joined])
    rows, columns = np.concatenate(starts), np.concatenate(ends)
    graph = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), (tall.size, tall.size))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    reached = np.zeros(tall.size, dtype=bool)
    reached[label[table.ravel()]] = True
    found: NDArray[np.bool_] = reached[label].reshape(tall.shape)
    return found & usable
