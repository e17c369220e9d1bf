"""Walls of even thickness, and handles, for cups, bowls and jugs."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.objects.family import Draw
from pointsdf_cli.objects.sections import Points, polygon, soften, stroke
from pointsdf_cli.objects.solids import tube, turn

THINNEST_WALL, THICKEST_WALL = 0.0012, 0.005


def shell(line: Points, wall: float) -> Manifold:
    """The wall around a centre line [N, 2] of (radius, z) from the axis to the rim."""
    return turn(stroke(line, wall))


def cavity(line: np.ndarray, wall: float) -> Manifold:
    """Space enclosed by the wall of `shell`, up to the level of its rim."""
    rim = float(line[-1, 1]) + wall
    inside = polygon(np.concatenate([line, [(line[-1, 0], rim), (0, rim)]]))
    return turn(inside - stroke(line, wall))


def solid_of(line: np.ndarray, wall: float) -> Manifold:
    """The vessel filled up to its rim, as a scanner sees a closed one."""
    inside = polygon(np.concatenate([line, [(0, line[-1, 1])]]))
    return turn(inside + stroke(line, wall))


def wall_thickness(draw: Draw) -> float:
    """A wall between drawn steel and stoneware, m."""
    return draw.log_uniform("wall", THINNEST_WALL, THICKEST_WALL)


def side_handle(
    line: np.ndarray,
    low: float,
    high: float,
    reach: float,
    squareness: float,
    half_width: float,
    half_height: float,
    sunk: float = 1.0,
) -> Manifold:
    """An `ear` at the side of a vessel with centre line [N, 2], between two heights [m].

    Its ends are at `sunk` times the radius of the line there.
    """
    start, end = sunk * np.interp([low, high], line[:, 1], line[:, 0])
    return ear((start, low), (end, high), reach, squareness, half_width, half_height)


def ear(
    low: tuple[float, float],
    high: tuple[float, float],
    reach: float,
    squareness: float,
    half_width: float,
    half_height: float,
) -> Manifold:
    """A handle in the (x, z) plane from (x, z) `low` to `high`, standing out by `reach`."""
    out = max(low[0], high[0]) + reach
    rise = high[1] - low[1]
    knots = [
        (low[0], 0, low[1]),
        (low[0] + (0.55 + 0.35 * squareness) * (out - low[0]), 0, low[1] + 0.04 * rise),
        (out, 0, low[1] + (0.42 - 0.15 * squareness) * rise),
        (out, 0, low[1] + (0.62 + 0.15 * squareness) * rise),
        (high[0] + (0.55 + 0.35 * squareness) * (out - high[0]), 0, high[1] - 0.02 * rise),
        (high[0], 0, high[1]),
    ]
    path = soften(knots)
    return tube(path, half_width, half_height, up=(0, 1, 0), corners=14, round_ends=False)
