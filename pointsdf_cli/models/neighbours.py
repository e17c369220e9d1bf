"""Neighbourhoods in point clouds: sampling, nearest points, gathers and density, in plain PyTorch.

Everything is batched over clouds and has no compiled operator, so it runs wherever PyTorch runs.
Indices are found without gradients; distances that a loss needs are recomputed from the gathered
points, so gradients with respect to the queries are exact wherever the neighbours do not change.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.models.search_trees import nearest_by_tree

TREE_FROM = 32
"""Number of queries per cloud from which a search tree pays off."""

SEARCHES: dict[str, Callable[[Tensor, Tensor, int], Tensor]] = {}
"""Implementations of `nearest_neighbours` by type of device; pipelines/gpu adds one for "cuda"."""


def squared_distances(queries: Tensor, points: Tensor) -> Tensor:
    """Squared distances between two sets by one matrix product.

    Args:
        queries: [B, Q, D].
        points: [B, N, D].

    Returns:
        [B, Q, N], not below zero, float32. Good for ranking neighbours; for a value close to zero
        subtract the points instead.
    """
    queries, points = queries.float(), points.float()
    # [−2q, |q|², 1] · [p, 1, |p|²]: one product in place of a product and two broadcast sums.
    query_squares = (queries * queries).sum(-1, keepdim=True)
    point_squares = (points * points).sum(-1, keepdim=True)
    left = torch.cat([-2.0 * queries, query_squares, torch.ones_like(query_squares)], dim=-1)
    right = torch.cat([points, torch.ones_like(point_squares), point_squares], dim=-1)
    with torch.autocast(queries.device.type, enabled=False):
        return torch.bmm(left, right.transpose(1, 2)).clamp_(min=0.0)


@torch.no_grad()
def nearest_neighbours(queries: Tensor, points: Tensor, count: int) -> Tensor:
    """The `count` points nearest to each query, nearest first.

    Args:
        queries: [B, Q, D].
        points: [B, N, D] with N ≥ count.

    Returns:
        int64 indices [B, Q, count] into the points.
    """
    if search := SEARCHES.get(points.device.type):
        return search(queries, points, count)
    if queries.shape[1] >= TREE_FROM and points.device.type == "cpu":
        return nearest_by_tree(queries, points, count)
    distances = squared_distances(queries, points)
    return distances.topk(count, dim=-1, largest=False, sorted=True).indices


@torch.no_grad()
def farthest_point_order(points: Tensor, count: int) -> Tensor:
    """Farthest point sampling from the first point: each next one is the farthest from all before.

    The order is nested: its first m entries are the farthest point sample of size m, so one call
    serves every level of an encoder.

    Args:
        points: [B, N, 3].
        count: Number of points, at most N.

    Returns:
        int64 indices [B, count].
    """
    batch, total, _ = points.shape
    if batch == 1 and points.device.type == "cpu":
        return torch.from_numpy(_order_of_one(points[0].detach().float().numpy(), count))[None]
    # Coordinates first: the inner loop then runs along contiguous memory.
    coordinates = points.float().transpose(1, 2).contiguous()
    order = torch.empty(batch, count, dtype=torch.int64, device=points.device)
    nearest = torch.full((batch, total), torch.inf, device=points.device)
    current = torch.zeros(batch, dtype=torch.int64, device=points.device)
    for step in range(count):
        order[:, step] = current
        chosen = coordinates.gather(2, current[:, None, None].expand(-1, 3, 1))
        nearest = torch.minimum(nearest, (coordinates - chosen).square_().sum(1))
        current = nearest.argmax(1)
    return order


def _order_of_one(points: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """`farthest_point_order` [count] of one cloud [N, 3]. NumPy needs a third of PyTorch's time for
    a thousand points; the values are the same."""
    x, y, z = np.ascontiguousarray(points.T)
    order = np.empty(count, dtype=np.int64)
    nearest = np.full(len(points), np.inf, dtype=np.float32)
    current = 0
    for step in range(count):
        order[step] = current
        across, along, up = x - x[current], y - y[current], z - z[current]
        np.minimum(nearest, across * across + along * along + up * up, out=nearest)
        current = int(nearest.argmax())
    return order


class _GatherRows(torch.autograd.Function):
    """Row gather with a backward pass of one `index_add_`; PyTorch's own is several times
    slower."""

    @staticmethod
    def forward(ctx, rows: Tensor, index: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
        ctx.save_for_backward(index)
        ctx.shape = rows.shape
        return torch.nn.functional.embedding(index, rows)

    @staticmethod
    def backward(ctx, gradient: Tensor):  # type: ignore[no-untyped-def]
        (index,) = ctx.saved_tensors
        # GPUs add float32 at once, bfloat16 by compare and swap, and many gradients meet in a row.
        kind = torch.float32 if gradient.is_cuda else gradient.dtype
        total = torch.zeros(ctx.shape, dtype=kind, device=gradient.device)
        total.index_add_(0, index, gradient.to(kind).contiguous())
        return total.to(gradient.dtype), None


def gather(values: Tensor, index: Tensor) -> Tensor:
    """Rows of each cloud's table: `out[b, ...] = values[b, index[b, ...]]`.

    Args:
        values: [B, N, C].
        index: int64 [B, ...] into N.

    Returns:
        [B, ..., C], with gradients to `values`.
    """
    batch, total, channels = values.shape
    offset = torch.arange(batch, device=index.device).view(-1, *[1] * (index.dim() - 1)) * total
    flat = (index + offset).reshape(-1)
    rows = values.reshape(batch * total, channels)
    if rows.requires_grad:
        picked = _GatherRows.apply(rows, flat)
    else:
        picked = torch.nn.functional.embedding(flat, rows)
    return picked.view(*index.shape, channels)


@torch.no_grad()
def inverse_density(points: Tensor, bandwidth: float) -> Tensor:
    """Inverse Gaussian kernel density at each point, scaled to at most 1 in each cloud.

    PointConv's density compensation (Wu et al. 2018, section 3.1).

    Args:
        points: [B, N, 3].
        bandwidth: Standard deviation of the kernel, in the points' unit.

    Returns:
        [B, N], in (0, 1]; 1 where the cloud is sparsest.
    """
    exponent = squared_distances(points, points).mul_(-0.5 / bandwidth**2)
    # Farther points weigh nothing, but their exponentials would be denormal numbers, which are
    # slow.
    kernel = exponent.clamp_(min=-40.0).exp_()
    inverse = 1.0 / kernel.mean(-1)
    return (inverse / inverse.amax(-1, keepdim=True)).to(points.dtype)
