"""PointSDF as published (paper section III-A, figure 2): PointConv encoder, one embedding, FC head.

Presets: `paper` has the published sizes, `small` is for a processor core. Batch norm and dropout
are off in evaluation mode, so values and gradients then depend on one cloud and one query alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn

from pointsdf_cli.models.linear import dense
from pointsdf_cli.models.neighbours import (
    farthest_point_order,
    gather,
    inverse_density,
    nearest_neighbours,
)
from pointsdf_cli.models.pointconv import ChannelNorm, PointConv
from pointsdf_cli.models.shape_model import PACKED_CENTRES, PACKED_NEIGHBOURS, Encoding, ShapeModel
from pointsdf_cli.models.surroundings import Surroundings

BANDWIDTHS = (0.05, 0.1, 0.2, 0.4)
"""Bandwidth of the density's Gaussian kernel in each layer, network units."""
MLPS = ((32, 32, 64), (64, 64, 64), (128, 128, 256), (256, 256, 512))
"""Widths of the layers' mlps in the paper."""


class PointSDF(ShapeModel):
    """See the module's docstring; the default arguments are the paper's numbers.

    Args:
        centres: Centres of the four PointConv layers.
        neighbours: Neighbours in each.
        mlps: Widths of each layer's mlp; the last is the layer after the weight product.
        weight_channels: Output channels of the weight nets.
        query_width: Width of the query branch.
        head: Widths before the joint input is concatenated again.
        tail: Widths after it.
        dropout: In the query branch.
    """

    architecture = "pointsdf"

    def __init__(
        self,
        centres: Sequence[int] = (512, 256, 64, 36),
        neighbours: Sequence[int] = (32, 32, 32, 32),
        mlps: Sequence[Sequence[int]] = MLPS,
        weight_channels: int = 32,
        query_width: int = 512,
        head: Sequence[int] = (512, 512, 256),
        tail: Sequence[int] = (512, 512, 512, 512),
        dropout: float = 0.2,
    ) -> None:
        super().__init__()
        self.keep_arguments(locals())
        self.centres, self.neighbours = tuple(centres), tuple(neighbours)
        if centres[0] <= PACKED_CENTRES and neighbours[0] <= PACKED_NEIGHBOURS:
            self.packed_neighbours = (centres[0], neighbours[0])
        inputs = (0, *(mlp[-1] for mlp in mlps[:-1]))
        self.layers = nn.ModuleList(
            PointConv(channels, mlp, weight_channels=weight_channels)
            for channels, mlp in zip(inputs, mlps, strict=True)
        )
        batch_norm = partial(ChannelNorm, kind="batch")
        self.to_embedding = dense([centres[-1] * mlps[-1][-1], self.embedding_size], batch_norm)
        self.query = nn.Sequential(
            nn.Linear(3, query_width),
            nn.ReLU(),
            nn.Linear(query_width, self.embedding_size),
            nn.ReLU(),
            nn.Dropout(dropout),
        )
        joint = 2 * self.embedding_size
        self.head = dense([joint, *head], batch_norm)
        self.tail = dense([head[-1] + joint, *tail], batch_norm)
        self.leave = nn.Linear(tail[-1], 1)

    def encode(
        self,
        cloud: Tensor,
        camera: Tensor,
        neighbours: Tensor | None = None,
        surroundings: Surroundings | None = None,
    ) -> Encoding:
        points = cloud
        if neighbours is None:
            points = gather(cloud, farthest_point_order(cloud, self.centres[0]))
        below, features = cloud, None
        levels = zip(self.layers, self.centres, self.neighbours, BANDWIDTHS, strict=True)
        for layer, count, k, bandwidth in levels:
            # Farthest point orders are nested: a coarser level is a prefix of the finer one.
            centres = points[:, :count]
            index = nearest_neighbours(centres, below, k) if neighbours is None else neighbours
            features = layer(below, features, centres, index, inverse_density(below, bandwidth))
            below, neighbours = centres, None
        assert features is not None
        return Encoding(self.to_embedding(features.flatten(1)), {})

    def decode(self, encoding: Encoding, x: Tensor) -> Tensor:
        embedding = encoding.embedding.unsqueeze(1).expand(-1, x.shape[1], -1)
        query = self.query(x)
        joint = torch.cat([embedding.to(query.dtype), query], dim=-1)
        h = self.tail(torch.cat([self.head(joint), joint], dim=-1))
        return torch.tanh(self.leave(h)).squeeze(-1).to(x.dtype)
