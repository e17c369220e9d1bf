"""Multiresolution search for the grid cells that the zero level of a field crosses.

MISE (Mescheder et al. 2019): the field is evaluated on a coarse grid, and only cells that the
surface crosses are subdivided. Three rules go beyond the paper's:

- A corner, also of the coarse grid, is evaluated only if its sign is in doubt, or if it ends an
  edge that the surface crosses. The slope of an SDF is bounded, so a neighbour's distance often
  determines the sign; such a corner holds a lower bound with that sign until its value is needed.
- If a value contradicts a bound (a network's slope has no guaranteed bound), every corner of the
  cells around it is evaluated.
- If the surface leaves the refined cells through a face, the cell beyond is searched too, without
  new bounds: a sheet is followed to its end once any of it is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Mask
from pointsdf_cli.geometry.cubic_cells import bends, cubic_cells
from pointsdf_cli.geometry.marching_cubes import CORNERS, cell_cases
from pointsdf_cli.geometry.sampled_grid import Cells, SampledGrid

SMOOTH_FROM = 64
"""Cells along the box from which on `SearchRules.smooth` applies."""
_FEWEST = 8
"""Cells along each side of the largest cells that the search may begin with."""
# Tables over the 256 patterns of a cell's inside corners (`cell_cases`): the corners that end a
# crossed edge [256, 8], and the faces that the surface cuts [6, 256], with the step across each.
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
        slope: Largest slope of the field for bounds; 1 for an exact SDF, infinity for the paper's
            rule (every corner of a subdivided cell is evaluated).
        reach: Distance to the surface, in cells, below which coarse cells are subdivided although
            the signs at their corners agree; 0 is the paper's rule.
        smooth: Bend of the field (`bends`), in sides of a cell, below which halved cells are
            interpolated instead of evaluated; 0 for none.
    """

    slope: float = 1.25
    reach: float = 0.5
    smooth: float = 0.0


def find_surface_cells(grid: SampledGrid, coarse: int, rules: SearchRules) -> NDArray[np.int32]:
    """The corner rows [C, 8] of the finest cells that the surface crosses.

    Every end of a crossed edge holds the field's own value. Cells that the bound on the slope
    dropped wrongly are found again where finer cells lead to them; without finer cells
    (`coarse` = resolution) a steeper field may leave holes.

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
    if len(halved) >= SMOOTH_FROM and rules.smooth > 0:
        _interpolate_smooth(grid, parents, stride, rules.smooth)
    while len(parents):
        halved[tuple((parents // (2 * stride)).T)] = True
        children = grid.halve(parents, stride, slope)
        cells = np.concatenate([cells, children])
        rows = np.concatenate([rows, grid.corner_rows(children, stride)])
        # All cells, not only new ones: values around these may contradict bounds elsewhere.
        _settle_crossed_edges(grid, rows)
        beyond = _led_to(cells, grid.cases(rows), stride) // (2 * stride)
        beyond = np.unique(beyond[~halved[tuple(beyond.T)]], axis=0)
        parents = beyond * np.int32(2 * stride)
        # These are few, and their corners missed the surface: evaluate all new corners at once.
        slope = np.inf
    crossed = _straddling(grid.cases(rows))
    return cells[crossed], rows[crossed]


def _interpolate_smooth(grid: SampledGrid, cells: Cells, stride: int, smooth: float) -> None:
    """Fill the halves of those cells of size 2 · `stride` that are smooth (`SearchRules`)."""
    limit = smooth * 2 * stride * grid.step
    # The known values exclude most cells of thin walls without new evaluations.
    cells = cells[bends(grid.known_around(cells, 2 * stride)) < limit]
    around = grid.values_around(cells, 2 * stride)
    flat = bends(around) < limit
    grid.fill(cells[flat], stride, cubic_cells(around[flat], 2))


def _straddling(cases: NDArray[np.uint8]) -> Mask:
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
