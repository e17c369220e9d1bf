"""Large things as convex parts: walls, shelves, trays and boxes, of which the network has learned
none.

One hull would fill a bin, and the corner of two walls. Points are therefore divided, seen from
above, for as long as that makes their hulls smaller. Below its lowest point a part reaches down as
far as no camera saw free space: to the table below a pedestal, but not below the board of a shelf.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.box import thin_directions

NARROWEST = 0.05
"""Level side [m] up to which a part is not divided further."""
EXCESS = 0.15
"""Share of its hull's volume that dividing a part must save."""
SLIMMEST = 40.0
"""Largest ratio of a part's level sides."""
THIN = 0.02
"""Thickness [m] that a part has at least when volumes are compared: noise makes thin hulls of
walls thicker, the longer they are."""
STEP, SAMPLES = 0.02, 40
"""Distance [m] of the levels, and number of the places at each, that are looked at below a part."""
FEW = 100
"""Number of points up to which all of them count as corners."""
LEAST_THICKNESS = 0.001
"""Thickness [m] that flat parts are given."""

IsFree = Callable[[Array], Mask]
"""Mask of places [N, 3], world, m, that a camera saw to be free."""


def nothing_free(places: Array) -> Mask:
    """No place [N, 3] is known to be free."""
    return np.zeros(len(places), dtype=bool)


def convex_parts(points: Array, free: IsFree) -> list[Array]:
    """Corners [K, 3] of convex parts that hold all points [N, 3] of a large thing (world, m)."""
    return [part.corners for part in _divided(_Part.of(points, free), free)]


def with_foot(points: Array, free: IsFree) -> Array:
    """Corners [K, 3] of the hull of points [N, 3] and of the unseen space below them (world, m)."""
    corners = _corners(points)
    some = points[:: -(-len(points) // SAMPLES)]
    foot = float(points[:, 2].min())
    levels = np.arange(foot - STEP, 0.0, -STEP)
    below = np.repeat(some[None] * [1.0, 1.0, 0.0], len(levels), axis=0)
    below[..., 2] = levels[:, None]
    seen = free(below.reshape(-1, 3)).reshape(len(levels), len(some)).mean(axis=1) > 0.5
    foot = float(levels[seen.argmax()]) + STEP if seen.any() else min(foot, 0.0)
    return np.concatenate([corners, corners * [1.0, 1.0, 0.0] + [0.0, 0.0, foot]])


def thickened(corners: Array, least: float = LEAST_THICKNESS) -> Array:
    """Corners [K, 3] of a solid that is `least` thick [m]: a plane side of a box may be all that is
    seen of a part, and distances to flat hulls fail."""
    for across in thin_directions(corners, least):
        shift = least / 2 * across
        corners = np.concatenate([corners - shift, corners + shift])
    return corners


class _Part(NamedTuple):
    """Points [N, 3] of a part, the corners [K, 3] of its hull, and the volume of that [m³]."""

    points: Array
    corners: Array
    volume: float

    @classmethod
    def of(cls, points: Array, free: IsFree) -> _Part:
        corners = with_foot(points, free)
        return cls(points, corners, _volume(corners))


def _divided(part: _Part, free: IsFree) -> list[_Part]:
    """A part, or those into which it is divided if these have much smaller hulls in all.

    Each is halved across x or y, whichever saves more; of a square the first halves of a ring save
    nothing, but their halves do.
    """
    best: list[_Part] = []
    extent = np.ptp(part.points[:, :2], axis=0)
    for axis in np.argsort(-extent):
        if extent[axis] > max(NARROWEST, extent.max() / SLIMMEST):
            middle = part.points[:, axis].min() + extent[axis] / 2
            low = part.points[:, axis] < middle
            halves = [_Part.of(half, free) for half in (part.points[low], part.points[~low])]
            if not best or _total(halves) < _total(best):
                best = halves
    parts = [leaf for half in best for leaf in _divided(half, free)]
    return parts if parts and _total(parts) < (1.0 - EXCESS) * part.volume else [part]


def _total(parts: list[_Part]) -> float:
    return sum(part.volume for part in parts)


def _volume(corners: Array) -> float:
    """Volume [m³] of the hull of corners [K, 3], at least `THIN` in every direction."""
    return float(scipy.spatial.ConvexHull(thickened(corners, THIN)).volume)


def _corners(points: Array) -> Array:
    """Those of points [N, 3] that span their hull; all of few or flat ones."""
    if len(points) < FEW:
        return points
    try:
        return np.asarray(points[scipy.spatial.ConvexHull(points).vertices])
    except scipy.spatial.QhullError:
        return points
