"""Values of a field on the corners of a cubic grid, evaluated only where needed.

Other corners hold a lower bound of the distance with a certain sign, or nothing.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import RgraspError
from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.cubic_cells import STENCIL
from pointsdf_cli.geometry.marching_cubes import CORNERS, cell_cases

NetworkField = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""A signed distance field: points [N, 3] f4 → values [N], negative inside."""

Cells = NDArray[np.int32]
"""[C, 3]: cells named by their lowest corner, in steps of the finest grid."""

# The points of a halved cell that are not corners of the whole, in half steps, and for each the
# corners of the edge, face or cell that it is the middle of.
_MIDDLES = [np.array(m) for m in product((0, 1, 2), repeat=3) if 1 in m]
_ENDS = [np.flatnonzero((np.abs(2 * CORNERS - m) <= 1).all(axis=1)) for m in _MIDDLES]
_THIRDS = np.array(list(product((0, 1, 2), repeat=3)))


class SampledGrid:
    """A field's values on some corners of a cubic grid.

    Coarse and fine levels are strides on the same grid, so they share values.

    Args:
        field: Negative inside.
        resolution: Cells along each side.
        half_width: The grid spans [-half_width, half_width]³.
        batch: Number of points evaluated at once.
    """

    def __init__(self, field: NetworkField, resolution: int, half_width: float, batch: int) -> None:
        self._field, self.half_width, self._batch = field, half_width, batch
        self.side = resolution + 1
        self.step = 2 * half_width / resolution
        # 1 + the row of each corner, 0 where it was never looked at. Flat numbers fit 32 bits.
        self._slot = sparse_zeros(self.side**3)
        self._flat = np.zeros(0, dtype=np.int32)
        self.values = np.zeros(0, dtype=np.float32)
        self.exact = np.zeros(0, dtype=bool)
        self.queries = 0

    def ask(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Evaluate the field at points [N, 3], cut to the box.

        The maximum with the SDF of the box, shrunk by half a step, cuts the object off flat and
        makes the outermost corners outside.

        Raises:
            RgraspError: The field is not finite.
        """
        points = np.ascontiguousarray(points, dtype=np.float32)
        starts = range(0, len(points), self._batch)
        answers = [np.asarray(self._field(points[i : i + self._batch])) for i in starts]
        values = np.concatenate(answers) if answers else np.zeros(0)
        self.queries += len(points)
        if values.shape != (len(points),) or not np.isfinite(values).all():
            raise RgraspError("the field gave values that are not finite numbers, one a point")
        return np.maximum(values, self._wall(points)).astype(np.float32)

    def positions(self, rows: NDArray[np.integer]) -> Array:
        """Positions of the corners of `rows` [N]: [N, 3], in the field's units."""
        return self.places(rows).astype(np.float64) * self.step - self.half_width

    def places(self, rows: NDArray[np.integer]) -> NDArray[np.int32]:
        """Places [N, 3] of the corners of `rows` [N], in steps from the box's lowest corner."""
        index = np.unravel_index(self._flat[rows], (self.side,) * 3)
        return np.stack(index, axis=1).astype(np.int32)

    def values_around(self, cells: Cells, stride: int) -> NDArray[np.float32]:
        """The field [C, 64] at the corners around cells of size `stride` (`cubic_cells.STENCIL`),
        the outermost ones repeated beyond the box; corners with bounds are evaluated."""
        flat = self._flat_of(self._places_around(cells, stride))
        unknown = self._once(flat[self._slot[flat] == 0])
        self._add([unknown], [np.zeros(len(unknown), np.float32)])
        rows = self._slot[flat] - np.int32(1)
        self.settle(rows)
        return self.values[rows].reshape(len(cells), len(STENCIL))

    def known_around(self, cells: Cells, stride: int) -> NDArray[np.float32]:
        """The values of `values_around`, NaN for corners without one; nothing is evaluated."""
        rows = self._slot[self._flat_of(self._places_around(cells, stride))] - 1
        values = np.full(rows.shape, np.nan, dtype=np.float32)
        known = np.flatnonzero(rows >= 0)
        known = known[self.exact[rows[known]]]
        values[known] = self.values[rows[known]]
        return values.reshape(len(cells), len(STENCIL))

    def fill(self, cells: Cells, stride: int, blocks: NDArray[np.float32]) -> None:
        """Set unknown values on the halves of cells of size 2 · `stride` to `blocks` [C, 3, 3,
        3]."""
        flat = (self._flat_of(cells)[:, None] + self._flat_of(stride * _THIRDS)).reshape(-1)
        new = np.flatnonzero(self._slot[flat] == 0)
        new = new[one_entry_each(self._slot, flat[new])]
        rows = self._add([flat[new]], [blocks.reshape(-1)[new]])
        self.values[rows] = np.maximum(self.values[rows], self._wall(self.positions(rows)))
        self.exact[rows] = True

    def corner_rows(self, cells: Cells, stride: int) -> NDArray[np.int32]:
        """Rows [C, 8] of the corners of cells of size `stride`; new ones are evaluated."""
        base = self._flat_of(cells)
        rows = np.empty((len(cells), 8), dtype=np.int32)
        fresh = []
        for k, offset in enumerate(self._flat_of(stride * CORNERS)):
            rows[:, k] = self._slot[base + offset] - 1
            unknown = np.flatnonzero(rows[:, k] < 0)
            if len(unknown):
                flat = self._once(base[unknown] + offset)
                fresh.append(self._add([flat], [np.zeros(len(flat), np.float32)]))
                rows[unknown, k] = self._slot[base[unknown] + offset] - 1
        if fresh:
            self.settle(np.concatenate(fresh))
        return rows

    def values_at(self, cells: Cells, stride: int) -> NDArray[np.float32]:
        """The values or bounds [C, 8] at the corners of cells of size `stride`."""
        rows = self.corner_rows(cells, stride)
        return self.values[rows]

    def cases(self, rows: NDArray[np.integer]) -> NDArray[np.uint8]:
        """Inside corners as bits, u1 [C] (`cell_cases`), of cells with corner rows [C, 8]."""
        # Compare before gathering: random access then covers bytes, a quarter of the memory.
        return cell_cases((self.values < 0)[rows])

    def halve(self, cells: Cells, stride: int, slope: float) -> Cells:
        """Split cells with known corners into children of size `stride`, half their size.

        The children's corners get bounds if their sign is certain; otherwise they are evaluated.
        """
        # Corners first: rows of eight numbers are slow to take the largest of.
        values = np.ascontiguousarray(self.values_at(cells, 2 * stride).T)
        base = self._flat_of(cells)
        places, bounds, certainties = [], [], []
        added = len(self._flat)
        for middle, ends in zip(_MIDDLES, _ENDS, strict=True):
            flat = base + self._flat_of(stride * middle[None])
            new = np.flatnonzero(self._slot[flat] == 0)
            self._slot[flat[new]] = np.arange(added + 1, added + 1 + len(new), dtype=np.int32)
            added += len(new)
            change = slope * stride * self.step * np.sqrt(np.count_nonzero(middle == 1))
            ends_here = values[ends[:, None], new]
            above, below = ends_here.max(axis=0) - change, ends_here.min(axis=0) + change
            places.append(flat[new])
            bounds.append(np.where(above > 0, above, below).astype(np.float32))
            certainties.append((above > 0) != (below < 0))  # both: they contradict each other
        rows = self._add(places, bounds)
        self.settle(rows[~np.concatenate(certainties)])
        return (cells[:, None] + stride * CORNERS.astype(np.int32)).reshape(-1, 3)

    def settle(self, rows: NDArray[np.integer]) -> NDArray[np.integer]:
        """Evaluate the field at those corners `rows` that hold bounds; returns the rows whose sign
        was wrong."""
        wanted = np.zeros(len(self.values), dtype=bool)
        wanted[rows] = True
        rows = np.flatnonzero(wanted & ~self.exact)
        rows = rows[np.argsort(self._flat[rows])]  # neighbours side by side: kinder to caches
        believed = self.values[rows] < 0
        self.values[rows] = self.ask(self.positions(rows))
        self.exact[rows] = True
        return rows[(self.values[rows] < 0) != believed]

    def _places_around(self, cells: Cells, stride: int) -> NDArray[np.integer]:
        places = np.clip(cells[:, None] + stride * STENCIL, 0, self.side - 1)
        return places.reshape(-1, 3)

    def _wall(self, points: NDArray[np.floating]) -> NDArray[np.floating]:
        wall: NDArray[np.floating] = np.abs(points).max(axis=1, initial=0)
        return wall - (self.half_width - self.step / 2)

    def _flat_of(self, cells: NDArray[np.integer]) -> NDArray[np.int32]:
        x, y, z = cells.astype(np.int32, copy=False).T
        return (x * np.int32(self.side) + y) * np.int32(self.side) + z

    def _once(self, flat: NDArray[np.int32]) -> NDArray[np.int32]:
        """New corners without repeats: neighbouring cells share them."""
        return flat[one_entry_each(self._slot, flat)]

    def _add(
        self, places: list[NDArray[np.int32]], values: list[NDArray[np.float32]]
    ) -> NDArray[np.integer]:
        """New rows for the corners at flat indices `places`, holding `values` as bounds."""
        first = len(self._flat)
        self._flat = np.concatenate([self._flat, *places])
        self.values = np.concatenate([self.values, *values])
        rows = np.arange(first, len(self._flat))
        self._slot[self._flat[rows]] = rows + 1
        self.exact = np.concatenate([self.exact, np.zeros(len(rows), bool)])
        return rows


def sparse_zeros(count: int) -> NDArray[np.int32]:
    """int32 zeros [count] that take memory only where they are written, page by small page.

    A surface writes to few pages; NumPy's own zeros use huge pages, which would all be allocated.
    """
    memory = mmap.mmap(-1, 4 * count)
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype=np.int32)


def one_entry_each(slot: NDArray[np.int32], flat: NDArray[np.int32]) -> Mask:
    """Mask of the entries of `flat` [N], one for each distinct place.

    Writes each entry's number to its place in `slot`, where it stays, and reads them back: ten
    times as fast as a sort.
    """
    entries = np.arange(1, len(flat) + 1, dtype=np.int32)
    slot[flat] = entries
    return slot[flat] == entries
