"""Search trees of point clouds, cached for the lifetime of the clouds, which have many queries."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from pointsdf_cli.io.one_thread import one_thread_each

# pykdtree splits each search over threads of its own OpenMP, as many as are set when it is loaded.
# Queries are split already (`processor.map_in_parallel`): more threads would only compete.
with one_thread_each():
    from pykdtree.kdtree import KDTree

_TREES = WeakIdKeyDictionary()
"""Trees by the tensors of their points."""


def nearest_by_tree(queries: Tensor, points: Tensor, count: int) -> Tensor:
    """The points nearest to each query, nearest first, by a search tree.

    Args:
        queries: [B, Q, D], on the CPU.
        points: [B, N, D] with N ≥ count.
        count: Number of neighbours.

    Returns:
        int64 indices [B, Q, count].

    Raises:
        ValueError: A query or a point is not finite, or there are fewer than `count` points.
    """
    if points.shape[1] < count:
        raise ValueError(f"{count} neighbours of {points.shape[1]} points")
    places = _finite(queries)
    found = np.empty((*places.shape[:2], count), dtype=np.int64)
    for cloud, tree in enumerate(_trees_of(points)):
        _, index = tree.query(places[cloud], k=count, sqr_dists=True)
        found[cloud] = index.reshape(-1, count)
    return torch.from_numpy(found)


def _finite(places: Tensor) -> NDArray[np.float32]:
    found: NDArray[np.float32] = np.ascontiguousarray(places.detach().float().numpy())
    # A tree gives meaningless neighbours for numbers that are not finite.
    if not np.isfinite(found).all():
        raise ValueError("places must be finite")
    return found


def _trees_of(points: Tensor) -> list[KDTree]:
    """Trees of clouds [B, N, D], cached while this tensor lives and its version counter stays.
    (Tensors made in inference mode have no counter: their trees are not cached.)"""
    version = None if points.is_inference() else points._version
    kept_version, trees = _TREES.get(points, (None, None))
    if trees is None or version is None or version != kept_version:
        # Copies: a tree reads its points later, and PyTorch's memory may change.
        trees = [KDTree(cloud.copy()) for cloud in _finite(points)]
        if version is not None:
            _TREES[points] = version, trees
    return trees
