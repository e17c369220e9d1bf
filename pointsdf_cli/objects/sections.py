"""Outlines and curves in the plane, for turned, extruded and swept solids."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy
from manifold3d import CrossSection, JoinType, OpType

Vector = Sequence[float] | np.ndarray
Points = Sequence[Vector] | np.ndarray
"""Points [N, D], m."""


def polygon(points: Points) -> CrossSection:
    """The region inside a closed polygon [N, 2], whichever way it is wound."""
    outline = np.asarray(points, dtype=float)
    return CrossSection([outline[::-1] if signed_area(outline) < 0 else outline])


def symmetric(side: Points) -> CrossSection:
    """The region between a polyline [N, 2] to the right of x = 0 and its mirror image."""
    right = np.asarray(side, dtype=float)
    return polygon(np.concatenate([right, right[::-1] * [-1, 1]]))


def signed_area(outline: np.ndarray) -> float:
    """Area in m² inside a polygon [N, 2], negative if it is wound clockwise."""
    x, y = outline.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


def rounded(section: CrossSection, convex: float, concave: float | None = None) -> CrossSection:
    """The region with its outer corners rounded by `convex` and its inner ones by `concave` m.

    Parts that are thinner than twice `convex` vanish.
    """
    concave = convex if concave is None else concave
    if concave > 0:
        section = _offset(_offset(section, concave), -concave)
    if convex > 0:
        section = _offset(_offset(section, -convex), convex)
    return section.simplify(2e-5)


def stroke(points: Points, thickness: float | np.ndarray) -> CrossSection:
    """The region within half the thickness of an open polyline [N, 2]: round-ended, m."""
    radii = np.broadcast_to(np.asarray(thickness, dtype=float) / 2, (len(points),))
    discs = [
        CrossSection.circle(float(radius), 12).translate(tuple(map(float, point)))
        for point, radius in zip(points, radii, strict=True)
    ]
    links = [CrossSection.batch_hull(pair) for pair in pairwise(discs)]
    return CrossSection.batch_boolean(links, OpType.Add).simplify(3e-5)


def smooth_curve(points: Points, count: int) -> np.ndarray:
    """A cubic spline through [K, D] points, sampled at `count` even steps of chord length."""
    knots = np.asarray(points, dtype=float)
    chord = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    return scipy.interpolate.CubicSpline(chord, knots)(np.linspace(0, chord[-1], count))


def smooth_steps(at: Vector, values: Vector, where: np.ndarray) -> np.ndarray:
    """Monotone cubic interpolation: passes through the values and never overshoots them."""
    return scipy.interpolate.PchipInterpolator(at, values)(where)


def arc(
    radius: float, start: float, end: float, count: int, centre: Vector = (0.0, 0.0)
) -> np.ndarray:
    """Points [count, 2] of a circular arc, angles in radians."""
    angle = np.linspace(start, end, count)
    return np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def ellipse(half_x: float, half_y: float, count: int) -> np.ndarray:
    """Points [count, 3] around an ellipse in the plane z = 0, m."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.column_stack([half_x * np.cos(angle), half_y * np.sin(angle), np.zeros(count)])


def soften(points: Points, passes: int = 3) -> np.ndarray:
    """Cut the corners of an open polyline [N, D], ends kept (Chaikin)."""
    points = np.asarray(points, dtype=float)
    for _ in range(passes):
        low = 0.75 * points[:-1] + 0.25 * points[1:]
        high = 0.25 * points[:-1] + 0.75 * points[1:]
        inner = np.stack([low, high], axis=1).reshape(-1, points.shape[1])[1:-1]
        points = np.concatenate([points[:1], inner, points[-1:]])
    return points


def grid(columns: int, rows: int, pitch: float) -> list[tuple[float, float]]:
    """Places of a grid about the origin, `pitch` m apart, column by column."""
    x = pitch * (np.arange(columns) - (columns - 1) / 2)
    y = pitch * (np.arange(rows) - (rows - 1) / 2)
    return [(float(a), float(b)) for a in x for b in y]


def _offset(section: CrossSection, distance: float) -> CrossSection:
    return section.offset(distance, JoinType.Round, 2.0, 16)
