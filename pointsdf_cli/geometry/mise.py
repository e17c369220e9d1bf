"""Multiresolution search for the grid cells that the zero level of a field crosses.

MISE (Mescheder et al. 2019): a coarse grid is asked everywhere, and only the
cells that the surface crosses are subdivided. Three rules go beyond the paper's:

- A corner, also of the coarse grid, is asked only where its sign is in doubt, or where it ends an
  edge that the surface crosses. An SDF cannot change faster than its slope allows, so a
  neighbour's distance often settles the sign; such a corner holds a lower bound with that sign
  until it is needed.
- Where an answer refutes a bound (a network's slope is not bounded by a theorem), every corner of
  the cells around it is asked.
- Where the surface leaves the refined cells through a face, the cell beyond is searched too, with
  no new bounds: a sheet is followed to its end once any of it is seen.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import RgraspError
from pointsdf_cli.geometry.cubic_cells import STENCIL, bends, cubic_cells
from pointsdf_cli.geometry.marching_cubes import CORNERS, cell_cases

NetworkField = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""A signed distance field: points [N, 3] f4 → values [N], negative inside."""

Cells = NDArray[np.int32]
"""[C, 3]: cells named by their lowest corner, in steps of the finest grid."""

_FEWEST = 8
"""Cells along each side of the largest cells that the search may begin with."""
# The points of a halved cell that are not corners of the whole, in half steps, and for each the
# corners of the edge, face or cell that it is the middle of.
_MIDDLES = [np.array(m) for m in product((0, 1, 2), repeat=3) if 1 in m]
_ENDS = [np.flatnonzero((np.abs(2 * CORNERS - m) <= 1).all(axis=1)) for m in _MIDDLES]
_THIRDS = np.array(list(product((0, 1, 2), repeat=3)))
# By which of a cell's corners are inside (`cell_cases`): which corners end a crossed edge [256, 8],
# and which faces the surface cuts [6, 256], with the way across each.
_INSIDE = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little") > 0
_CROSSED_ENDS = np.any([_INSIDE[:, np.arange(8) ^ bit] != _INSIDE for bit in (4, 2, 1)], axis=0)
_FACES = [(axis, side) for axis in range(3) for side in (0, 1)]
_ON_FACES = [_INSIDE[:, CORNERS[:, axis] == side] for axis, side in _FACES]
_CUT_FACES = np.stack([face.any(axis=1) & ~face.all(axis=1) for face in _ON_FACES])
_ACROSS = [(2 * side - 1) * np.eye(3, dtype=np.int32)[axis] for axis, side in _FACES]


@dataclass(frozen=True)
class SearchRules:
    """Thresholds of trust in the field's values.

    Attributes:
        slope: The steepest change of the field that bounds are made with; 1 for an exact SDF,
            infinity for the paper's rule (every corner of a subdivided cell is asked).
        reach: Cells of the coarse grid with a corner nearer to the surface than this many cells
            are subdivided although their corners agree; 0 is the paper's rule.
        smooth: Cells around which the field bends by less than so many of their sides (`bends`)
            are not asked again when they are halved: it is interpolated. 0 never does that.
        smooth_from: Cells along the box from which on that holds.
    """

    slope: float = 1.25
    reach: float = 0.5
    smooth: float = 0.0
    smooth_from: int = 64


class SampledGrid:
    """A field's values on those corners of a cubic grid that were looked at.

    Coarse and fine levels are strides on the same grid, so one answer serves all of them.

    Args:
        field: Negative inside.
        resolution: Cells along each side.
        half_width: The grid spans [-half_width, half_width]³.
        batch: Points asked at once.
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
        """The field at points [N, 3], cut to the box.

        The box's own SDF, shrunk by half a step, takes part by max(): what sticks out is cut off
        flat, and the outermost corners are always outside.

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

    def positions(self, rows: NDArray[np.integer]) -> NDArray[np.float64]:
        """Positions of the corners of `rows` [N]: [N, 3], in the field's units."""
        return self.places(rows).astype(np.float64) * self.step - self.half_width

    def places(self, rows: NDArray[np.integer]) -> NDArray[np.int32]:
        """The same in steps from the box's lowest corner: [N, 3]."""
        index = np.unravel_index(self._flat[rows], (self.side,) * 3)
        return np.stack(index, axis=1).astype(np.int32)

    def rows_at(self, places: NDArray[np.integer]) -> NDArray[np.int32]:
        """The rows [N] of the corners at `places` [N, 3]; those that hold no value are asked."""
        flat = self._flat_of(places)
        unknown = self._once(flat[self._slot[flat] == 0])
        self._add([unknown], [np.zeros(len(unknown), np.float32)])
        rows = self._slot[flat] - np.int32(1)
        self.settle(rows)
        return rows

    def values_around(self, cells: Cells, stride: int) -> NDArray[np.float32]:
        """The field [C, 64] at the corners around cells of size `stride` (`cubic_cells.STENCIL`),
        the outermost ones repeated beyond the box; those that hold bounds are asked."""
        rows = self.rows_at(self._places_around(cells, stride))
        return self.values[rows].reshape(len(cells), len(STENCIL))

    def known_around(self, cells: Cells, stride: int) -> NDArray[np.float32]:
        """The same, NaN where a corner holds no value of the field; nothing is asked."""
        rows = self._slot[self._flat_of(self._places_around(cells, stride))] - 1
        values = np.full(rows.shape, np.nan, dtype=np.float32)
        known = np.flatnonzero(rows >= 0)
        known = known[self.exact[rows[known]]]
        values[known] = self.values[rows[known]]
        return values.reshape(len(cells), len(STENCIL))

    def fill(self, cells: Cells, stride: int, blocks: NDArray[np.float32]) -> None:
        """Take `blocks` [C, 3, 3, 3] for the field on the halves of cells of size 2 · `stride`,
        wherever nothing is known yet."""
        flat = (self._flat_of(cells)[:, None] + self._flat_of(stride * _THIRDS)).reshape(-1)
        new = np.flatnonzero(self._slot[flat] == 0)
        new = new[one_entry_each(self._slot, flat[new])]
        rows = self._add([flat[new]], [blocks.reshape(-1)[new]])
        self.values[rows] = np.maximum(self.values[rows], self._wall(self.positions(rows)))
        self.exact[rows] = True

    def corner_rows(self, cells: Cells, stride: int) -> NDArray[np.int32]:
        """The rows [C, 8] of the corners of cells of size `stride`; new ones are asked."""
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
        """Mask of the cells with corner rows [C, 8] that are inside (`cell_cases`) [C]."""
        # Bytes before they are picked: a quarter of the memory that is jumped about in.
        return cell_cases((self.values < 0)[rows])

    def halve(self, cells: Cells, stride: int, slope: float) -> Cells:
        """The children, of size `stride`, of cells of twice that size whose corners are known.

        Children's corners get bounds where the sign is certain, and are asked elsewhere.
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
        flat: NDArray[np.int32] = (x * np.int32(self.side) + y) * np.int32(self.side) + z
        return flat

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

    A surface writes to few pages. NumPy's own zeros ask for huge pages, and would take them all.
    """
    memory = mmap.mmap(-1, 4 * count)
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype=np.int32)


def one_entry_each(slot: NDArray[np.int32], flat: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Mask of the entries of `flat` [N], one for each distinct place.

    A sort takes ten times as long as writing each entry's number at its place in `slot`, and
    reading them back; there they stay.
    """
    entries = np.arange(1, len(flat) + 1, dtype=np.int32)
    slot[flat] = entries
    return slot[flat] == entries


def find_surface_cells(grid: SampledGrid, coarse: int, rules: SearchRules) -> NDArray[np.int32]:
    """The corner rows [C, 8] of the finest cells that the surface crosses.

    Every end of a crossed edge holds the field's own value.

    Args:
        grid: Empty; filled on the way.
        coarse: Cells along each side of the first grid; divides the resolution.
        rules: When to ask and where to look.
    """
    stride = (grid.side - 1) // coarse
    cells = _coarse_cells(grid, stride, rules.slope)
    rows = grid.corner_rows(cells, stride)
    _settle_crossed_edges(grid, rows)
    near = _straddling(grid.cases(rows))
    if stride > 1:
        near |= np.abs(grid.values[rows]).min(axis=1) < rules.reach * stride * grid.step
    cells, rows = cells[near], rows[near]
    while stride > 1:
        stride //= 2
        cells, rows = _subdivide(grid, cells, stride, rules)
    return rows


def _coarse_cells(grid: SampledGrid, stride: int, slope: float) -> Cells:
    """The cells of the coarse grid, but for those that cannot hold any of the surface.

    Most of the box is far away from it, and far away a few samples vouch for many: the search
    begins with larger cells, and drops those with no corner near enough.
    """
    resolution, size = grid.side - 1, stride
    while np.isfinite(slope) and resolution % (2 * size) == 0 and resolution // size > _FEWEST:
        size *= 2
    axis = np.arange(0, resolution, size, dtype=np.int32)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    while size > stride:
        # No point of a cell is further from its nearest corner than half the diagonal.
        change = slope * np.sqrt(0.75) * size * grid.step
        values = grid.values_at(cells, size)
        cells = cells[np.abs(values).min(axis=1) <= change]
        size //= 2
        cells = grid.halve(cells, size, slope)
    return cells


def _subdivide(
    grid: SampledGrid, parents: Cells, stride: int, rules: SearchRules
) -> tuple[Cells, NDArray[np.int32]]:
    """The cells of size `stride` that the surface crosses in `parents` or, from there, beyond.

    Returns:
        The cells [C, 3] and their corner rows [C, 8].
    """
    halved = np.zeros(((grid.side - 1) // (2 * stride),) * 3, dtype=bool)
    cells, rows = np.zeros((0, 3), np.int32), np.zeros((0, 8), np.int32)
    slope = rules.slope
    if len(halved) >= rules.smooth_from and rules.smooth > 0:
        _interpolate_smooth(grid, parents, stride, rules.smooth)
    while len(parents):
        halved[tuple((parents // (2 * stride)).T)] = True
        children = grid.halve(parents, stride, slope)
        cells = np.concatenate([cells, children])
        rows = np.concatenate([rows, grid.corner_rows(children, stride)])
        # All cells, not the new ones alone: what was asked around these may refute others' bounds.
        _settle_crossed_edges(grid, rows)
        beyond = _led_to(cells, grid.cases(rows), stride) // (2 * stride)
        beyond = np.unique(beyond[~halved[tuple(beyond.T)]], axis=0)
        parents = beyond * np.int32(2 * stride)
        # These are few, and the surface hid from their corners: what is new there is asked, and in
        # one question instead of several small ones.
        slope = np.inf
    crossed = _straddling(grid.cases(rows))
    return cells[crossed], rows[crossed]


def _interpolate_smooth(grid: SampledGrid, cells: Cells, stride: int, smooth: float) -> None:
    """Fill the halves of those cells of size 2 · `stride` that are smooth (`SearchRules`)."""
    limit = smooth * 2 * stride * grid.step
    # What is known already shows of most cells of thin walls that they bend.
    cells = cells[bends(grid.known_around(cells, 2 * stride)) < limit]
    around = grid.values_around(cells, 2 * stride)
    flat = bends(around) < limit
    grid.fill(cells[flat], stride, cubic_cells(around[flat], 2))


def _straddling(cases: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Mask of the cells that the zero level crosses."""
    return (cases != 0) & (cases != 255)


def _led_to(cells: Cells, cases: NDArray[np.uint8], stride: int) -> Cells:
    """The neighbours across every face that the surface cuts, with repeats.

    The grid's outermost corners are always outside, so none of them lies beyond the grid.
    """
    across = [np.flatnonzero(cut[cases]) for cut in _CUT_FACES]
    return np.concatenate([cells[c] + stride * w for c, w in zip(across, _ACROSS, strict=True)])


def _settle_crossed_edges(grid: SampledGrid, rows: NDArray[np.int32]) -> None:
    """Ask the ends of all crossed edges of the cells with corner rows [C, 8].

    Where an answer refutes a bound, every corner of the cells around it is asked.
    """
    wrong = grid.settle(rows[_CROSSED_ENDS[grid.cases(rows)]])
    while len(wrong):
        refuted = np.zeros(len(grid.values), dtype=bool)
        refuted[wrong] = True
        around = cell_cases(refuted[rows]) > 0
        wrong = grid.settle(rows[around].ravel())
