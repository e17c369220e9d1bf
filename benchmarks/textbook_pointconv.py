"""PointSDF with PointConv written the textbook way, to compare with.

As the public PyTorch implementations do it: neighbours by a full sort of all distances, features
gathered by fancy indexing, coordinates and features concatenated *after* the gather, every mlp a
1×1 convolution with batch norm over [B, C, K, M], density and sampling from scratch in each layer.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from pointsdf_cli.models.pointsdf import BANDWIDTHS, PointSDF
from pointsdf_cli.models.shape_model import Encoding


def square_distance(a: Tensor, b: Tensor) -> Tensor:
    return (
        -2 * torch.matmul(a, b.transpose(1, 2))
        + (a**2).sum(-1).unsqueeze(2)
        + (b**2).sum(-1).unsqueeze(1)
    )


def index_points(points: Tensor, index: Tensor) -> Tensor:
    batch = torch.arange(len(points)).view(-1, *[1] * (index.dim() - 1)).expand_as(index)
    return points[batch, index, :]


def farthest_point_sample(xyz: Tensor, count: int) -> Tensor:
    batch, total, _ = xyz.shape
    centroids = torch.zeros(batch, count, dtype=torch.long)
    distance = torch.ones(batch, total) * 1e10
    farthest = torch.zeros(batch, dtype=torch.long)
    rows = torch.arange(batch)
    for step in range(count):
        centroids[:, step] = farthest
        centroid = xyz[rows, farthest, :].view(batch, 1, 3)
        d = torch.sum((xyz - centroid) ** 2, -1)
        mask = d < distance
        distance[mask] = d[mask]
        farthest = torch.max(distance, -1)[1]
    return centroids


def _convolutions(widths: Sequence[int]) -> nn.Sequential:
    return nn.Sequential(
        *[
            layer
            for a, b in itertools.pairwise(widths)
            for layer in (nn.Conv2d(a, b, 1), nn.BatchNorm2d(b), nn.ReLU())
        ]
    )


class TextbookPointConv(nn.Module):
    """One layer."""

    def __init__(
        self, channels: int, mlp: Sequence[int], weights: int, count: int, k: int, bandwidth: float
    ) -> None:
        super().__init__()
        *hidden, out = mlp
        self.count, self.k, self.bandwidth = count, k, bandwidth
        self.mlp = _convolutions([3 + channels, *hidden])
        self.weight_net = _convolutions([3, weights])
        self.density_net = nn.Sequential(
            nn.Conv2d(1, 16, 1), nn.ReLU(), nn.Conv2d(16, 1, 1), nn.Sigmoid()
        )
        self.linear = nn.Linear(weights * hidden[-1], out)
        self.norm = nn.BatchNorm1d(out)

    def forward(self, xyz: Tensor, features: Tensor | None) -> tuple[Tensor, Tensor]:
        density = torch.exp(-square_distance(xyz, xyz) / (2 * self.bandwidth**2)).mean(-1)
        inverse = 1.0 / density
        centres = index_points(xyz, farthest_point_sample(xyz, self.count))
        index = square_distance(centres, xyz).argsort(dim=-1)[:, :, : self.k]
        offsets = index_points(xyz, index) - centres.unsqueeze(2)
        grouped = offsets
        if features is not None:
            grouped = torch.cat([offsets, index_points(features, index)], dim=-1)
        scale = index_points(inverse.unsqueeze(-1), index)
        scale = scale / scale.amax(2, keepdim=True)
        hidden = self.mlp(grouped.permute(0, 3, 2, 1))
        hidden = hidden * self.density_net(scale.permute(0, 3, 2, 1))
        weights = self.weight_net(offsets.permute(0, 3, 2, 1))
        product = torch.matmul(hidden.permute(0, 3, 1, 2), weights.permute(0, 3, 2, 1))
        out = self.linear(product.reshape(len(xyz), self.count, -1))
        out = self.norm(out.permute(0, 2, 1)).permute(0, 2, 1)
        return centres, torch.relu(out)


class TextbookPointSDF(PointSDF):
    """The same sizes and the same head as `PointSDF`, with textbook layers."""

    def __init__(self, **arguments: object) -> None:
        super().__init__(**arguments)  # type: ignore[arg-type]
        self.packed_neighbours = None
        config = PointSDF(**arguments).config()  # type: ignore[arg-type]
        inputs = (0, *(mlp[-1] for mlp in config["mlps"][:-1]))
        self.layers = nn.ModuleList(
            TextbookPointConv(channels, mlp, config["weight_channels"], count, k, bandwidth)
            for channels, mlp, count, k, bandwidth in zip(
                inputs, config["mlps"], self.centres, self.neighbours, BANDWIDTHS, strict=True
            )
        )

    def encode(
        self, cloud: Tensor, camera: Tensor, neighbours: Tensor | None = None, **evidence: object
    ) -> Encoding:
        xyz, features = cloud, None
        for layer in self.layers:
            xyz, features = layer(xyz, features)
        assert features is not None
        return Encoding(self.to_embedding(features.flatten(1)), {})
