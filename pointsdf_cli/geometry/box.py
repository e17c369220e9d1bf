"""Boxes along the axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def strictly_inside(points: ArrayLike, low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
    """Mask of the points [N, 3] inside a box with the corners `low` and `high` [3], its faces
    excluded.

    Points that are not numbers lie nowhere: False. One axis after the other, as NumPy takes three
    times as long to reduce many short rows.
    """
    points = np.asarray(points)
    inside = np.ones(len(points), dtype=bool)
    for axis, (least, most) in enumerate(zip(np.asarray(low), np.asarray(high), strict=True)):
        inside &= (points[:, axis] > least) & (points[:, axis] < most)
    return inside
