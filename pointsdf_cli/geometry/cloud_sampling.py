"""Systematic sampling: a subset of a cloud that is spread over the image as the cloud is.

Independent random samples leave gaps that differ from sample to sample, and a network predicts a
different hidden side from each. Points taken at equal steps along a space-filling curve leave no
such gaps: two samples of one cloud differ by a fraction of the point spacing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.geometry.arrays import Array, Indices


def systematic_sample(plane: ArrayLike, count: int, rng: np.random.Generator) -> Indices:
    """Indices of `count` points; a smaller cloud is kept whole and filled up by repeats.

    Args:
        plane: [N, 2] with N ≥ 1, places in the image: x and y in the camera's axes, or x/z and y/z.
        count: Points wanted.
        rng: Random generator of the first step, and of repeats.

    Returns:
        int64 [count] below N, each once before any twice.
    """
    places = np.asarray(plane, dtype=np.float64)
    total = len(places)
    if total < count:
        return np.concatenate([np.arange(total), rng.integers(total, size=count - total)])
    order = _along_curve(places)
    steps = ((np.arange(count) + rng.random()) * (total / count)).astype(np.int64)
    return order[np.minimum(steps, total - 1)]


def all_but_every(plane: ArrayLike, step: int, first: int) -> Indices:
    """Indices of all points but every `step`-th along the curve, from number `first` on.

    Args:
        plane: [N, 2], as in `systematic_sample`.
        step: Distance along the curve between points that are left out, at least 2.
        first: Number of the first point that is left out, below `step`.
    """
    order = _along_curve(np.asarray(plane, dtype=np.float64))
    return np.sort(order[np.arange(len(order)) % step != first])


def _along_curve(places: Array) -> Indices:
    """Indices of the points in their order along the curve."""
    return np.argsort(_curve_position(places), kind="stable")


def _curve_position(plane: Array) -> NDArray[np.uint64]:
    """Positions [N] of points [N, 2] along a Morton curve over their box."""
    extent = float(np.ptp(plane, axis=0).max()) or 1.0
    cell = ((plane - plane.min(axis=0)) / extent * 65535.0).astype(np.uint64)
    # Spread the 16 bits of each coordinate, then interleave both.
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        cell = (cell | (cell << np.uint64(shift))) & np.uint64(mask)
    return cell[:, 0] | (cell[:, 1] << np.uint64(1))
