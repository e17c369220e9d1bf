"""Search trees of point clouds, kept for as long as the clouds are: a cloud is asked many times."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from pointsdf_cli.io.one_thread import one_thread_each

# It shares out each search over threads of its own, as many as it is told when its OpenMP is loaded
# (its own: the wheels bring one). Parts of queries are shared out already
# (`processor.side_by_side`): more threads would only be in the way.
with one_thread_each():
    from pykdtree.kdtree import KDTree

_TREES = WeakIdKeyDictionary()
"""Trees by the tensors of their points."""


def nearest_by_tree(queries: Tensor, points: Tensor, count: int) -> Tensor:
    """The points nearest to each query, nearest first; a tree asks few points, not all.

    Args:
        queries: [B, Q, D], on the CPU.
        points: [B, N, D] with N ≥ count.
        count: Neighbours wanted.

    Returns:
        int64 indices [B, Q, count].

    Raises:
        ValueError: A query or a point is not finite, or there are fewer points than are wanted.
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
    # To what is not finite nothing is nearest, and the tree would answer all the same.
    if not np.isfinite(found).all():
        raise ValueError("places must be finite")
    return found


def _trees_of(points: Tensor) -> list[KDTree]:
    """The trees of clouds [B, N, D], kept for as long as this tensor lives and PyTorch counts no
    change of it. (It counts none of tensors made in inference mode: theirs are not kept.)"""
    version = None if points.is_inference() else points._version
    kept_version, trees = _TREES.get(points, (None, None))
    if trees is None or version is None or version != kept_version:
        # Copies: a tree looks at its points again, and what is PyTorch's may change.
        trees = [KDTree(cloud.copy()) for cloud in _finite(points)]
        if version is not None:
            _TREES[points] = version, trees
    return trees
