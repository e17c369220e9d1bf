"""Rims: the near and the far wall of a bowl that is seen from the side.

Where the view ends at the near rim and goes on at the far wall, the two meet at a concave edge, as
two touching objects do. Their upper edges are parts of one circle.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

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
    joined = label.copy()
    for one, other in combinations(parts, 2):
        if shares_rim(points[label == one], points[label == other], camera):
            joined[joined == other] = joined[label == one][0]
    return joined


def shares_rim(first: Array, second: Array, camera: Array) -> bool:
    """Whether two parts are the near and the far wall of one bowl.

    Args:
        first, second: [N, 3] and [M, 3], points of the parts, world, m.
        camera: [3], its position, m.
    """
    tops = [np.percentile(part[:, 2], 99) for part in (first, second)]
    if abs(tops[0] - tops[1]) > LEVEL:
        return False
    rims = [
        part[np.abs(part[:, 2] - top) < TOP, :2]
        for part, top in zip((first, second), tops, strict=True)
    ]
    if min(map(len, rims)) < FEWEST:
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
