"""A signed distance field sampled on a grid: a look-up instead of a pass through the network.

The grid is fine near the surface, where constraints are decided, and coarse elsewhere. Trilinear
interpolation is a weighted mean of the cell's corners x_i, so for a field of slope at most L

    |Σ w_i f(x_i) − f(x)| ≤ L Σ w_i |x_i − x| ≤ L √(Σ w_i |x_i − x|²)
                         = L √(Σ_k t_k (1 − t_k)) h ≤ (√3 / 2) L h

(Jensen; t_k in [0, 1] is the place in the cell along axis k, h the cell's side). A corner that was
itself interpolated on a coarser level adds its own bound, with the same weights. So every value has
an error bound.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import torch
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Indices, Surface
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.marching_cubes import CORNERS, cross_cells
from pointsdf_cli.planning.fields import SeenField

SLOPE = 1.0
"""L, the largest slope assumed: exact for a distance, and as measured for the networks."""
OUTSIDE = 1e-6
"""Least value [m] on the sides of the box, which close a surface."""
END_GAP = 1e-3
"""Vertices keep this share of an edge away from its ends: triangles do not shrink to nothing."""


@dataclass(frozen=True)
class GridConfig:
    """Resolution of the grid.

    Attributes:
        step: Side of the finest cells [m].
        levels: Number of levels; each halves the cells of the one before.
        band: The field is sampled on the finest level wherever its absolute value is below this
            [m].
    """

    step: float = 0.004
    levels: int = 4
    band: float = 0.004

    def __post_init__(self) -> None:
        if not (self.step > 0 and 1 <= self.levels <= 8 and self.band >= 0):
            raise InputError(f"the grid {self}", allowed="step > 0, 1 to 8 levels, band ≥ 0")


class GridField:
    """A `Field` interpolated on a grid; `with_bound` also bounds its error.

    Outside of its box the value is √(|x − p|² + f(p)²) with p the nearest point of the box: for a
    surface that lies within the box this never exceeds the true distance.

    Args:
        field: Field to sample; evaluated only here.
        low, high: [3], the box [m]; it must enclose the surface.
        config: Resolution.

    Attributes:
        low: [3], lowest corner of the box, m.
        queries: Number of queries of the field.
    """

    def __init__(
        self, field: Field, low: Array, high: Array, config: GridConfig | None = None
    ) -> None:
        self.config = config or GridConfig()
        self.low = np.asarray(low, dtype=np.float64)
        coarse = self.config.step * 2 ** (self.config.levels - 1)
        wide = np.asarray(high, dtype=np.float64) - self.low
        cells = np.maximum(1, np.ceil(wide / coarse - 1e-9)).astype(np.int64)
        if (cells > 256).any():
            raise InputError(f"a grid of {cells.tolist()} coarse cells", allowed="256 along a side")
        self.queries = 0
        self._build(field, cells, coarse)
        self._index()

    def _index(self) -> None:
        self._nodes = np.array(self._values.shape)
        self._high = self.low + self.config.step * (self._nodes - 1)
        self._strides = np.array([self._nodes[1] * self._nodes[2], self._nodes[2], 1])
        self._corner_offsets = CORNERS @ self._strides
        self._flat = self._values.ravel()

    def __call__(self, points: Array) -> Array:
        place, beyond = self._place(points)
        return _with_gap(_interpolate(self._values, place), beyond)

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        place, beyond = self._place(points)
        inside, slope = self._corner_gradient(place)
        value = _with_gap(inside, beyond)
        out = beyond.any(axis=1)
        # Along clamped axes the nearest point of the box does not move.
        along = np.where(beyond[out] == 0, slope[out], 0.0)
        slope[out] = (beyond[out] + inside[out, None] * along) / value[out, None]
        return value, slope

    def with_bound(self, points: Array) -> tuple[Array, Array]:
        """Values [N] and error bounds [N], m: |grid − field| at most inside the box; outside, the
        value minus the bound never exceeds the distance."""
        place, beyond = self._place(points)
        t = place - np.floor(place)
        spread = np.sqrt((t * (1 - t)).sum(axis=1))
        error = _interpolate(self._error, place) + spread * (self.config.step * SLOPE)
        return _with_gap(_interpolate(self._values, place), beyond), error

    def minimum_with(self, seen: SeenField) -> GridField:
        """A grid of the minimum of this field and the distance to seen points, at every node.

        The minimum at a node has no larger error than this field's own value, so the bounds still
        hold.
        """
        nodes = np.stack(np.meshgrid(*map(np.arange, self._nodes), indexing="ij"), axis=-1)
        places = self.low + self.config.step * nodes.reshape(-1, 3)
        joint = copy(self)
        joint._values = seen.at_most(places, self._flat).reshape(self._values.shape)
        joint._index()
        return joint

    def raised(self, least: Callable[[Array], Array], beyond: float) -> GridField:
        """A grid of the maximum of this field and lower bounds of it, at the nodes between the
        surface and the value `beyond` [m]; the error bounds still hold.

        Args:
            least: Function from points [N, 3] to bounds [N], m.
            beyond: Larger values stay as they are.
        """
        rows = np.flatnonzero((self._flat > 0) & (self._flat < beyond))
        places = np.stack(np.unravel_index(rows, self._values.shape), axis=1)
        values = self._flat.copy()
        values[rows] = np.maximum(values[rows], least(self.low + self.config.step * places))
        higher = copy(self)
        higher._values = values.reshape(self._values.shape)
        higher._index()
        return higher

    def inside(self) -> Array:
        """The nodes [N, 3] of the finest level whose values are negative, m."""
        return self.low + self.config.step * np.argwhere(self._values < 0)

    def halved_at_surface(self, field: Field) -> tuple[Array, float]:
        """Values [I, J, K] m on the nodes of halved cells, from the box's lowest corner, and their
        step [m]: `field`'s own within a step of the surface, else interpolated."""
        step, exact = self.config.step / 2, self._error == 0
        wanted = _any_corner(self._values < 0) & _any_corner(self._values >= 0)
        wanted |= _any_corner(np.abs(self._values) <= step)  # sheets between the nodes
        known = np.zeros(2 * self._nodes - 1, dtype=bool)
        known[::2, ::2, ::2] = exact
        fine = _halve(self._values)
        near = _corners_of(wanted.repeat(2, 0).repeat(2, 1).repeat(2, 2)) & (np.abs(fine) <= step)
        new = np.argwhere(near & ~known)
        fine[tuple(new.T)] = self._ask(field, new, step)
        return fine, step

    def _build(self, field: Field, cells: NDArray[np.int64], step: float) -> None:
        slope, band = SLOPE, self.config.band
        exact = np.ones(cells + 1, dtype=bool)
        values = self._ask(field, np.argwhere(exact), step).reshape(exact.shape)
        error = np.zeros(exact.shape)
        refined = np.ones(cells, dtype=bool)  # cells whose corners are all exact
        for _ in range(self.config.levels - 1):
            # Some point of a cell is within the band only if a corner is at most this far off it.
            near = np.abs(values) <= band + slope * np.sqrt(3) / 2 * step
            wanted = refined & _any_corner(near)
            values, error = _halve(values), _halve(error)
            inherited = np.zeros(values.shape, dtype=bool)
            inherited[::2, ::2, ::2] = exact
            error = np.where(inherited, 0.0, error + slope * np.sqrt(3) / 2 * step)
            refined = wanted.repeat(2, 0).repeat(2, 1).repeat(2, 2)
            step /= 2
            exact = inherited | _corners_of(refined)
            new = np.argwhere(exact & ~inherited)
            values[tuple(new.T)] = self._ask(field, new, step)
            error[exact] = 0.0
        self._values, self._error = values, error

    def _ask(self, field: Field, nodes: NDArray[np.int64], step: float) -> Array:
        self.queries += len(nodes)
        return field(self.low + nodes * step)

    def _place(self, points: Array) -> tuple[Array, Array]:
        """The nearest places in the box [N, 3], in steps from its lowest corner, and the offsets
        [N, 3] m of the points from there."""
        points = np.asarray(points, dtype=np.float64)
        inside = np.clip(points, self.low, self._high)
        return (inside - self.low) / self.config.step, points - inside

    def _corner_gradient(self, place: Array) -> tuple[Array, Array]:
        """Values [N] m and gradients [N, 3] of the interpolation at places [N, 3]."""
        cell = np.minimum(place.astype(np.int64), self._nodes - 2)
        x, y, z = (place - cell).T
        corners = self._flat[(cell @ self._strides)[:, None] + self._corner_offsets]
        # Corners are ordered by (x, y, z) bits; each axis is folded in turn.
        along_z = corners[:, 0::2] + (corners[:, 1::2] - corners[:, 0::2]) * z[:, None]
        along_y = along_z[:, 0::2] + (along_z[:, 1::2] - along_z[:, 0::2]) * y[:, None]
        value = along_y[:, 0] + (along_y[:, 1] - along_y[:, 0]) * x
        slope_z = corners[:, 1::2] - corners[:, 0::2]
        slope_z = slope_z[:, 0::2] + (slope_z[:, 1::2] - slope_z[:, 0::2]) * y[:, None]
        slope_y = along_z[:, 1::2] - along_z[:, 0::2]
        slope = [
            along_y[:, 1] - along_y[:, 0],
            slope_y[:, 0] + (slope_y[:, 1] - slope_y[:, 0]) * x,
            slope_z[:, 0] + (slope_z[:, 1] - slope_z[:, 0]) * x,
        ]
        return value, np.stack(slope, axis=1) / self.config.step


def _interpolate(nodes: Array, place: Array) -> Array:
    """Trilinear interpolation [N] of values at nodes [X, Y, Z] at places [N, 3], in steps."""
    found = scipy.ndimage.map_coordinates(nodes, place.T, order=1, mode="nearest", prefilter=False)
    return np.asarray(found)


def _with_gap(value: Array, beyond: Array) -> Array:
    """Values [N] m at the nearest places in the box, enlarged by the offset [N, 3] m from there."""
    square = np.einsum("ij,ij->i", beyond, beyond)
    return np.where(square > 0, np.sqrt(square + value * value), value)


def surface_box(field: Field, low: Array, high: Array, step: float) -> tuple[Array, Array]:
    """Tight box (low [3], high [3]) around the surface within a wide one, from few queries.

    Args:
        field: Field to evaluate on a grid of `step` [m].
        low, high: [3], the wide box [m].
        step: Step of that grid; the result is tight to about as much.

    Raises:
        InputError: All values are too large for a surface in any cell.
    """
    low = np.asarray(low, dtype=np.float64)
    wide = np.asarray(high, dtype=np.float64) - low
    cells = np.maximum(1, np.ceil(wide / step - 1e-9)).astype(np.int64)
    nodes = np.argwhere(np.ones(cells + 1, dtype=bool))
    values = field(low + nodes * step).reshape(cells + 1)
    # What is inside of a cell is no farther from its nearest corner than half its diagonal.
    occupied = np.argwhere(_any_corner(values <= np.sqrt(3) / 2 * step))
    if not len(occupied):
        raise InputError("the object's field is positive everywhere", allowed="a field with inside")
    return low + occupied.min(axis=0) * step, low + (occupied.max(axis=0) + 1) * step


def grid_surface(grid: GridField, field: Field) -> Surface | None:
    """Zero level of a field by marching cubes with half the grid's cells; world frame, m.

    Args:
        grid: The field on a grid.
        field: The field; evaluated near the surface.

    Returns:
        None where the field is nowhere negative.
    """
    values, step = grid.halved_at_surface(field)
    for axis in range(3):
        sides = np.moveaxis(values, axis, 0)[[0, -1]]
        np.moveaxis(values, axis, 0)[[0, -1]] = np.maximum(sides, OUTSIDE)
    strides = np.array([values.shape[1] * values.shape[2], values.shape[2], 1])
    flat = values.ravel()
    inside = values < 0
    cells = np.argwhere(_any_corner(inside) & _any_corner(~inside))
    corners = (cells @ strides)[:, None] + CORNERS @ strides
    if not len(corners):
        return None
    crossed = cross_cells(corners, flat)
    below, above = flat[crossed.low], flat[crossed.high]
    share = np.clip(below / (below - above), END_GAP, 1 - END_GAP)[:, None]
    start, end = _places(crossed.low, values.shape), _places(crossed.high, values.shape)
    return grid.low + step * (start + share * (end - start)), crossed.faces.astype(np.int32)


def _places(rows: Indices, shape: tuple[int, ...]) -> Array:
    return np.stack(np.unravel_index(rows, shape), axis=1).astype(np.float64)


def _halve(values: Array) -> Array:
    """Values on nodes of halved cells, interpolated; nodes [n, ...] → [2 n − 1, ...]."""
    fine = [2 * n - 1 for n in values.shape]
    tensor = torch.from_numpy(np.ascontiguousarray(values))[None, None]
    halved = torch.nn.functional.interpolate(
        tensor, size=fine, mode="trilinear", align_corners=True
    )
    return halved[0, 0].numpy()


def _any_corner(nodes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """For each cell [X, Y, Z], whether one of its corners [X + 1, Y + 1, Z + 1] is marked."""
    cells = np.zeros(np.array(nodes.shape) - 1, dtype=bool)
    for corner in CORNERS:
        cells |= nodes[tuple(slice(c, n - 1 + c) for c, n in zip(corner, nodes.shape, strict=True))]
    return cells


def _corners_of(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The nodes that are corners of marked cells."""
    nodes = np.zeros(np.array(cells.shape) + 1, dtype=bool)
    for corner in CORNERS:
        nodes[tuple(slice(c, n + c) for c, n in zip(corner, cells.shape, strict=True))] |= cells
    return nodes
