"""Neighbour search, farthest points and signed distances by CUDA kernels; elsewhere by the package.

PyTorch's own neighbour search sorts a row of distances for each query, which takes most of a step
on a GPU. CuPy compiles kernels.cu when a kernel is first used.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.models.neighbours import farthest_point_order, nearest_neighbours

SOURCE = Path(__file__).with_name("kernels.cu")
BLOCK = 128
MOST_POINTS = 3072
"""Largest cloud of `farthest_first`."""


@torch.no_grad()
def nearest(queries: Tensor, points: Tensor, count: int) -> Tensor:
    """`nearest_neighbours` of queries [B, Q, D] among points [B, N, D]: int64 [B, Q, count]."""
    if not queries.is_cuda:
        return nearest_neighbours(queries, points, count)
    queries, points = queries.detach().float().contiguous(), points.detach().float().contiguous()
    batch, wanted, dimensions = queries.shape
    found = torch.empty(batch, wanted, count, dtype=torch.int64, device=queries.device)
    kernel = _kernel("knn", DIM=dimensions, COUNT=count)
    sizes = (np.int32(wanted), np.int32(points.shape[1]), np.int32(batch))
    _launch(kernel, -(-batch * wanted // BLOCK), BLOCK, queries, points, found, *sizes)
    return found


@torch.no_grad()
def farthest_first(points: Tensor, count: int) -> Tensor:
    """`farthest_point_order` of points [B, N ≤ MOST_POINTS, 3]: int64 [B, count]."""
    if not points.is_cuda:
        return farthest_point_order(points, count)
    if points.shape[1] > MOST_POINTS:
        raise ValueError(f"{points.shape[1]} points, at most {MOST_POINTS}")
    points = points.float().contiguous()
    order = torch.empty(len(points), count, dtype=torch.int64, device=points.device)
    sizes = (np.int32(points.shape[1]), np.int32(count))
    _launch(_kernel("fps"), len(points), 256, points, order, *sizes)
    return order


@torch.no_grad()
def signed_distance(x: Tensor, triangles: Tensor) -> Tensor:
    """Signed distances [N] of x [N, 3] to a closed surface of triangles [F, 9], negative inside.

    The sign is that of the winding number (Van Oosterom and Strackee 1983).
    """
    x, triangles = x.float().contiguous(), triangles.float().contiguous()
    if not x.is_cuda:
        corners = triangles.reshape(-1, 3).numpy()
        vertices, faces = np.unique(corners, axis=0, return_inverse=True)
        return torch.from_numpy(SignedDistance(vertices, faces.reshape(-1, 3), 1)(x.numpy()))
    distance = torch.empty(len(x), device=x.device)
    sizes = (np.int32(len(x)), np.int32(len(triangles)))
    _launch(_kernel("sdf"), -(-len(x) // BLOCK), BLOCK, x, triangles, distance, *sizes)
    return distance


@cache
def _kernel(name: str, **defines: int) -> Any:
    import cupy

    values = {"DIM": 3, "COUNT": 1, "MOST": MOST_POINTS} | defines
    text = "".join(f"#define {key} {value}\n" for key, value in values.items())
    return cupy.RawModule(code=text + SOURCE.read_text(), options=("-std=c++17",)).get_function(
        name
    )


def _launch(kernel: Any, blocks: int, threads: int, *arguments: Any) -> None:
    """Run a kernel on PyTorch's current stream: CUDA graphs record it there."""
    import cupy

    plain = tuple(a.data_ptr() if isinstance(a, Tensor) else a for a in arguments)
    with cupy.cuda.ExternalStream(torch.cuda.current_stream().cuda_stream):
        kernel((blocks,), (threads,), plain)
