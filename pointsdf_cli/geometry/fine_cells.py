"""Cells finer than the grid on which a field was evaluated, by interpolation between its corners.

A network that read a thousand points has no detail finer than a fraction of their spacing, and
evaluating it costs a hundred times as much as interpolation. So beyond some resolution the field is
the piecewise cubic through its values on the coarser grid.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.cubic_cells import cubic_cells
from pointsdf_cli.geometry.marching_cubes import CORNERS
from pointsdf_cli.geometry.sampled_grid import Cells, SampledGrid, one_entry_each, sparse_zeros

_CHUNK = 1 << 14
"""Number of cells interpolated at once."""


class FineGrid(NamedTuple):
    """Values on the corners of a finer grid near the surface.

    Attributes:
        values: [R] f4.
        places: [R, 3] i4, in steps from the box's lowest corner.
        step: Length of a step.
        half_width: The grid spans [-half_width, half_width]³.
    """

    values: NDArray[np.float32]
    places: NDArray[np.int32]
    step: float
    half_width: float

    def positions(self, rows: NDArray[np.integer]) -> Array:
        """Positions of the corners of `rows` [N]: [N, 3], in the field's units."""
        return self.places[rows] * self.step - self.half_width


def refine_cells(
    grid: SampledGrid, rows: NDArray[np.int32], factor: int
) -> tuple[FineGrid, NDArray[np.int32]]:
    """The finer cells that the surface crosses, inside the given ones and, from there, beyond.

    Args:
        grid: Has values at the corners of these cells; corners around them are evaluated.
        rows: [C, 8], the corner rows of the grid's finest cells that the surface crosses.
        factor: Finer cells along each side of one.

    Returns:
        The values, and the corner rows [F, 8] of the finer cells.
    """
    cells = grid.places(rows[:, 0])
    last = grid.side - 2
    taken = np.zeros((last + 1,) * 3, dtype=bool)
    side = (last + 1) * factor + 1
    strides = np.array([side**2, side, 1], dtype=np.int32)
    flats: list[NDArray[np.int32]] = []
    values: list[NDArray[np.float32]] = []
    while len(cells):
        taken[tuple(cells.T)] = True
        beyond = []
        for part in np.array_split(cells, -(-len(cells) // _CHUNK)):
            block = _interpolated(grid, part, factor)
            inside = block < 0
            which, *place = np.nonzero(_straddling(inside))
            corner = np.stack(place, axis=1)[:, None] + CORNERS
            x, y, z = corner.transpose(2, 0, 1)
            values.append(block[which[:, None], x, y, z].reshape(-1))
            first = (part[which] * factor) @ strides
            flats.append((first[:, None] + corner @ strides).astype(np.int32).reshape(-1))
            beyond.append(_led_to(part, inside, last))
        found = np.concatenate(beyond)
        cells = np.unique(found[~taken[tuple(found.T)]], axis=0)
    flat, value = np.concatenate(flats), np.concatenate(values)
    slot = sparse_zeros(side**3)
    kept = np.flatnonzero(one_entry_each(slot, flat))  # up to eight cells list a corner
    slot[flat[kept]] = np.arange(len(kept), dtype=np.int32)
    places = np.stack(np.unravel_index(flat[kept], (side,) * 3), axis=1).astype(np.int32)
    fine = FineGrid(value[kept], places, grid.step / factor, grid.half_width)
    return fine, slot[flat].reshape(-1, 8)


def _interpolated(grid: SampledGrid, cells: Cells, factor: int) -> NDArray[np.float32]:
    """The field [C, f + 1, f + 1, f + 1] on the finer corners of cells [C, 3], cut to the box."""
    block = cubic_cells(grid.values_around(cells, 1), factor)
    step = grid.step / factor
    along = (cells[..., None] * factor + np.arange(factor + 1)) * step - grid.half_width
    wall = (np.abs(along) - (grid.half_width - step / 2)).astype(np.float32)
    block = np.maximum(block, wall[:, 0, :, None, None])
    block = np.maximum(block, wall[:, 1, None, :, None])
    return np.maximum(block, wall[:, 2, None, None, :])


def _straddling(inside: Mask) -> Mask:
    """Mask of the finer cells [C, f, f, f] that the surface crosses."""
    any_of, all_of = inside, inside
    for axis in (1, 2, 3):
        low = [slice(None)] * 4
        high = [slice(None)] * 4
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        any_of = any_of[tuple(low)] | any_of[tuple(high)]
        all_of = all_of[tuple(low)] & all_of[tuple(high)]
    return any_of & ~all_of


def _led_to(cells: Cells, inside: Mask, last: int) -> Cells:
    """The neighbours, inside the grid, across every face that the surface cuts."""
    beyond = [np.zeros((0, 3), np.int32)]
    for axis, end in product(range(3), (0, -1)):
        face = np.take(inside, end, axis=axis + 1)
        cut = face.any(axis=(1, 2)) & ~face.all(axis=(1, 2))
        neighbour = cells[cut]
        neighbour[:, axis] += 1 if end else -1
        beyond.append(neighbour[(neighbour[:, axis] >= 0) & (neighbour[:, axis] <= last)])
    return np.concatenate(beyond)
