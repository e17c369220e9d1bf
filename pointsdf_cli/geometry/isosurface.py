"""From a signed distance field to a closed mesh.

MISE finds the cells (`mise.py`), marching cubes interpolates the field's own values (not a
thresholded copy, which would leave stairs), and one Newton step along each crossed edge pulls the
vertices to zero. With `coarse = resolution` and no bound on the slope the extraction is dense; it
gives the same surface wherever the coarse grid detects any of it.

Limit: a separate part is missed if no corner of the coarse grid lies inside it or within half a
cell of it. A sheet is always found; a ball thinner than √3 − 1 = 0.73 coarse cells may be missed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import EmptyResultError, InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.fine_cells import FineGrid, refine_cells
from pointsdf_cli.geometry.marching_cubes import cross_cells
from pointsdf_cli.geometry.mise import SearchRules, find_surface_cells
from pointsdf_cli.geometry.sampled_grid import NetworkField, SampledGrid

MAX_RESOLUTION = 512
_END_GAP = 1e-3
"""Vertices keep this share of an edge away from its ends, so that no triangle shrinks to nothing
when the mesh is stored in float32."""


class EmptySurfaceError(EmptyResultError):
    """The field is nowhere negative inside the box, as far as the coarse grid shows."""


BATCH = 1 << 16
"""Number of points evaluated at once."""


@dataclass(frozen=True)
class IsosurfaceConfig:
    """Settings of the search for the zero level.

    Attributes:
        resolution: Cells along each side of the box: `coarse` times a power of two, at most 512.
        coarse: Cells of the grid on which every corner's sign is determined, by value or bound.
        half_width: The box is [-half_width, half_width]³, in the field's units.
        rules: Rules of MISE's search.
        asked: The finest grid on which the field itself is evaluated; finer corners are
            interpolated (`fine_cells.py`).
        newton: Refine each vertex by one Newton step along its edge (one more query), unless
            interpolated.
        smallest_part: Parts that enclose less than this share of the largest part's volume are
            dropped; 1 keeps only the largest, 0 all.
    """

    resolution: int = 128
    coarse: int = 32
    half_width: float = 0.8
    rules: SearchRules = field(default_factory=SearchRules)
    asked: int = MAX_RESOLUTION
    newton: bool = True
    smallest_part: float = 0.05

    def __post_init__(self) -> None:
        fine = [self.coarse << k for k in range(10) if 0 < self.coarse << k <= MAX_RESOLUTION]
        if self.resolution not in fine:
            raise InputError(
                f"no grid of {self.resolution} cells is refined from one of {self.coarse}",
                where="--resolution",
                allowed=", ".join(map(str, fine)) or f"a coarse grid of 1 to {MAX_RESOLUTION}",
            )
        if min(self.resolution, self.asked) not in fine:
            what = f"no grid of {self.asked} cells is among those that are refined"
            raise InputError(what, where="asked", allowed=", ".join(map(str, fine)))
        if not (self.half_width > 0 and 0 <= self.smallest_part <= 1):
            what = "the isosurface options are out of range"
            raise InputError(what, where=self, allowed="half_width > 0, 0 ≤ smallest_part ≤ 1")


@dataclass(frozen=True)
class Isosurface:
    """A closed surface around the inside of a field.

    Attributes:
        vertices: [V, 3] f8, in the field's units.
        faces: [F, 3] i4, counter-clockwise seen from outside.
        queries: Number of points at which the field was evaluated.
        parts_dropped: Number of parts that were too small to keep.
    """

    vertices: Array
    faces: NDArray[np.int32]
    queries: int
    parts_dropped: int


def extract_isosurface(sdf: NetworkField, config: IsosurfaceConfig | None = None) -> Isosurface:
    """Extract the zero level of `sdf` in the box, closed at the box's sides.

    Args:
        sdf: Negative inside, float32 points in.
        config: Resolution and the rest; by default 128³ refined from 32³.

    Raises:
        EmptySurfaceError: Nothing is inside at the first grid's corners or near them.
        RgraspError: The field is not finite.
    """
    config = config or IsosurfaceConfig()
    asked = min(config.resolution, config.asked)
    grid = SampledGrid(sdf, asked, config.half_width, BATCH)
    corners = find_surface_cells(grid, config.coarse, config.rules)
    if len(corners) == 0:
        what = "no surface: the field is nowhere negative in the box"
        raise EmptySurfaceError(what, allowed="a field that is negative inside the object")
    if asked == config.resolution:
        crossed = cross_cells(corners, grid.values)
        vertices = _vertices(grid, crossed.low, crossed.high, grid if config.newton else None)
    else:
        fine, corners = refine_cells(grid, corners, config.resolution // asked)
        crossed = cross_cells(corners, fine.values)
        vertices = _vertices(fine, crossed.low, crossed.high)
    vertices, faces, dropped = _keep_large_parts(vertices, crossed.faces, config.smallest_part)
    return Isosurface(vertices, faces, grid.queries, dropped)


def _vertices(
    grid: SampledGrid | FineGrid,
    low: NDArray[np.integer],
    high: NDArray[np.integer],
    asked: SampledGrid | None = None,
) -> Array:
    """Zero crossings [V, 3] of the edges between the corners `low` and `high` [V], refined by one
    Newton step where a field is given."""
    start, end = grid.positions(low), grid.positions(high)
    value_low, value_high = (grid.values[row].astype(np.float64) for row in (low, high))
    share = value_low / (value_low - value_high)
    if asked is not None:
        share = np.clip(share, _END_GAP, 1 - _END_GAP)
        here = asked.ask(start + share[:, None] * (end - start)).astype(np.float64)
        share = _newton_step(share, value_low, here, value_high)
    share = np.clip(share, _END_GAP, 1 - _END_GAP)
    return start + share[:, None] * (end - start)


def _newton_step(t: Array, at_0: Array, at_t: Array, at_1: Array) -> Array:
    """One Newton step from t on each unit edge, kept between the two samples of opposite sign.

    The slope is that of the parabola through the three samples, so no gradient is asked for, the
    error falls from the second to the third order in the edge's length, and a vertex never leaves
    its edge (the mesh cannot fold).
    """
    slope = (at_t - at_0) / t + (at_1 - at_t) / (1 - t) - (at_1 - at_0)
    same_side = (at_t < 0) == (at_0 < 0)
    low, high = np.where(same_side, t, 0.0), np.where(same_side, 1.0, t)
    with np.errstate(divide="ignore", invalid="ignore"):
        stepped = t - at_t / slope
    return np.where(np.isfinite(stepped), np.clip(stepped, low, high), t)


def _keep_large_parts(
    vertices: Array, faces: NDArray[np.int32], smallest: float
) -> tuple[Array, NDArray[np.int32], int]:
    """Connected parts that enclose at least `smallest` of the largest part's volume.

    A cavity is a part of its own, measured by the volume that it encloses. It is smaller than its
    body, so it is dropped with it.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())
    links = coo_array((np.ones(len(ends[0]), bool), ends), shape=(len(vertices),) * 2)
    count, part = connected_components(links, directed=False)
    if count == 1:
        return vertices, faces, 0
    a, b, c = vertices[faces].swapaxes(0, 1)
    under_face = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    volume = np.abs(np.bincount(part[faces[:, 0]], under_face, count))
    keep = volume >= smallest * volume.max()
    if smallest == 1:
        keep = np.arange(count) == volume.argmax()
    kept_vertex = keep[part]
    renumber = np.cumsum(kept_vertex, dtype=np.int32) - 1
    faces = renumber[faces[kept_vertex[faces[:, 0]]]]
    return vertices[kept_vertex], faces, int((~keep).sum())
