"""Rims: the near and the far wall of a bowl that is seen from the side.

Where the view ends at the near rim and goes on at the far wall, the two meet at a concave edge, as
two touching objects do. Their upper edges are parts of one circle.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array

TOP = 0.005
"""Height [m] of the strip below a part's top that counts as its rim."""
LEVEL = 0.012
"""Largest difference [m] of the heights of the two rims."""
OFF, FAR_OFF = 0.004, 0.01
"""Largest distance [m] from the circle of half the points, and of nine tenths: a can's top is full,
and an edge of a box is straight."""
FEWEST = 15
"""Least number of points of each rim."""
EACH, BOTH = 60.0, 200.0
"""Least angles [deg] about the centre in which each rim and both are seen."""
SECTOR = 10.0
"""Sectors [deg] in which these angles are counted."""


def joined_at_rims(
    points: Array, label: NDArray[np.int64], parts: Iterable[int], camera: Array
) -> NDArray[np.int64]:
    """The label [N] of each point with the walls of a bowl as one.

    Args:
        points: [N, 3], world, m.
        label: [N], the part of each.
        parts: The labels that may be walls.
        camera: [3], its position, m.
    """
    rims = {one: Rim.of(points[label == one]) for one in parts}
    joined = label.copy()
    for one, other in combinations(rims, 2):
        if on_one_circle(rims[one], rims[other], camera):
            joined[joined == other] = joined[label == one][0]
    return joined


class Rim(NamedTuple):
    """The upper edge of a part: its height [m], and places [R, 2] of its points, world, m."""

    height: float
    places: Array

    @classmethod
    def of(cls, points: Array) -> Rim:
        """The rim of points [N, 3], world, m."""
        top = float(np.percentile(points[:, 2], 99))
        return cls(top, points[np.abs(points[:, 2] - top) < TOP, :2])


def on_one_circle(first: Rim, second: Rim, camera: Array) -> bool:
    """Whether two rims are those of the near and the far wall of one bowl; the camera is at [3]
    (world, m)."""
    rims = first.places, second.places
    if abs(first.height - second.height) > LEVEL or min(map(len, rims)) < FEWEST:
        return False
    centre, radius = _circle(np.concatenate(rims))
    away = np.abs(np.linalg.norm(np.concatenate(rims) - centre, axis=1) - radius)
    if np.median(away) > OFF or np.percentile(away, 90) > FAR_OFF:
        return False
    sectors = [_sectors(rim - centre) for rim in rims]
    if min(map(len, sectors)) * SECTOR < EACH or len(set.union(*sectors)) * SECTOR < BOTH:
        return False
    # One lies on the camera's side of the centre, the other beyond it.
    towards = [float((rim.mean(axis=0) - centre) @ (camera[:2] - centre)) for rim in rims]
    return min(towards) < 0 < max(towards)


def _circle(places: Array) -> tuple[Array, float]:
    """Centre [2] and radius of the circle through places [N, 2], by least squares of
    x² + y² = 2 a x + 2 b y + c (Kåsa 1976)."""
    middle = places.mean(axis=0)
    x = places - middle
    columns = np.column_stack([2 * x, np.ones(len(x))])
    (a, b, c), *_ = np.linalg.lstsq(columns, (x**2).sum(axis=1), rcond=None)
    return middle + [a, b], float(np.sqrt(max(c + a**2 + b**2, 0.0)))


def _sectors(away: Array) -> set[int]:
    """Sectors in which offsets [N, 2] from the centre lie."""
    return set(np.floor(np.rad2deg(np.arctan2(*away.T[::-1])) / SECTOR).astype(int).tolist())
