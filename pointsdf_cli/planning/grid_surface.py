"""Surface of a field from its grid: the field is evaluated once more, between the grid's nodes."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Indices, Surface
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.marching_cubes import CORNERS, cross_cells
from pointsdf_cli.planning.grid import GridField, any_corner

OUTSIDE = 1e-6
"""Least value [m] on the sides of the box, which close the surface."""
END_GAP = 1e-3
"""Vertices keep this share of an edge away from its ends: triangles do not shrink to nothing."""


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
    cells = np.argwhere(any_corner(inside) & any_corner(~inside))
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
