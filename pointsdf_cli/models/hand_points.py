"""Points that stand for the links of a closing hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
import torch
from numpy.typing import NDArray
from torch import Tensor

PAD = 0.15
"""Share of a link's surface samples on its leading side."""

PAD_EDGE = 1.4
"""Distance of a pad's outer points from its middle, in standard deviations of its leading side."""

Motion = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def pad_points(points: NDArray[np.float64], motion: Motion, count: int) -> NDArray[np.float64]:
    """Pad [count, 3] of a link's surface [P, 3]: the middle of its leading side, and points of that
    side to the left, right, front and back of it."""
    ahead = points @ motion(points.mean(axis=0))
    least = np.quantile(ahead, 1 - PAD) - 1e-3 * np.ptp(ahead)  # ties belong to it
    leading = points[ahead >= least]
    middle = leading.mean(axis=0)
    if count == 1:
        return middle[None]
    spread = np.cov(leading.T, bias=True).reshape(3, 3)
    normal = np.linalg.eigh(spread)[1][:, 0]
    # The link's own axes, in the plane of the pad: the order of principal axes of equal length
    # would depend on rounding, and the features with it.
    across = np.sort(np.argsort(-np.abs(normal).round(3), kind="stable")[1:])
    axes = np.eye(3)[across] - np.outer(normal[across], normal)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    reach = PAD_EDGE * np.sqrt(np.einsum("ki,ij,kj->k", axes, spread, axes))[:, None] * axes
    return np.concatenate([middle[None], middle + reach, middle - reach])


def box_grid(points: Tensor, counts: tuple[int, int, int], narrowest: float) -> Tensor:
    """A grid over the box of points [N, 3], widened about its middle to `narrowest`: middles of
    cells, so that none lies on its border."""
    low, high = points.amin(0), points.amax(0)
    wider = (narrowest - (high - low)).clamp(min=0.0) / 2
    low, high = low - wider, high + wider
    axes = [low[k] + (torch.arange(n) + 0.5) / n * (high[k] - low[k]) for k, n in enumerate(counts)]
    return torch.cartesian_prod(*axes)


def middles(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Means of `count` parts of a cloud [P, 3] along its length."""
    along = points - points.mean(axis=0)
    axis = np.linalg.svd(along, full_matrices=False)[2][0]
    order = np.quantile(along @ axis, (np.arange(count) + 0.5) / count)
    start = points.mean(axis=0) + order[:, None] * axis
    if count == 1 or len(points) <= count:
        return start
    return scipy.cluster.vq.kmeans2(points, start, minit="matrix")[0]
