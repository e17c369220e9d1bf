"""Parts of the decoder of `pointsdf-ray`: local read-outs, attention, residual blocks."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pointsdf_cli.models.linear import Linear
from pointsdf_cli.models.neighbours import gather

HEADS = 4
"""Number of weighted means of a local read-out over the same neighbours."""


class LocalFeatures(nn.Module):
    """A PointConv-like read-out at the queries: relu(A f_j + B (x − c_j)), weighted over j.

    A f_j − B c_j is one table per cloud, made at encoding; a query only gathers rows of it.
    """

    def __init__(self, channels: int, width: int, radius: float) -> None:
        super().__init__()
        self.inverse_radius = 1.0 / radius
        self.from_features = Linear(channels, width)
        self.from_offset = Linear(3, width, bias=False)
        self.score = Linear(width, HEADS)
        self.out = Linear(HEADS * width, width)

    def table(self, features: Tensor, centres: Tensor) -> Tensor:
        """[B, M, width] from features [B, M, C] at centres [B, M, 3]."""
        at_centres = self.from_offset(centres * self.inverse_radius)
        return self.from_features(features) - at_centres

    def forward(self, x: Tensor, table: Tensor, index: Tensor) -> Tensor:
        """[B, Q, width] at x [B, Q, 3] from rows `index` [B, Q, K] of the table."""
        at_queries = self.from_offset(x * self.inverse_radius)
        # In place: these are the largest tensors of the decoder, bound by memory bandwidth.
        hidden = gather(table, index).add_(at_queries.unsqueeze(2)).relu_()
        weights = self.score(hidden).softmax(dim=2).to(hidden.dtype)
        read = torch.matmul(weights.transpose(-1, -2), hidden)
        return self.out(read.flatten(-2))


HEAD_SIZE = 32
"""Width of each head of the attention."""


class CentreAttention(nn.Module):
    """Multi-head attention of queries over the centres of one encoder level."""

    def __init__(self, width: int, channels: int, heads: int) -> None:
        super().__init__()
        self.heads, self.size = heads, HEAD_SIZE
        self.norm = nn.LayerNorm(width)
        self.query = Linear(width, heads * HEAD_SIZE)
        self.key_value = Linear(channels + 3, 2 * heads * HEAD_SIZE)
        self.out = Linear(heads * HEAD_SIZE, width)

    def keys_and_values(self, features: Tensor, centres: Tensor) -> dict[str, Tensor]:
        """Keys and values [B, heads, M, size] of features [B, M, C] at centres [B, M, 3]."""
        both = self.key_value(torch.cat([features, centres.to(features.dtype) * 4.0], dim=-1))
        keys, values = both.unflatten(-1, (2, self.heads, self.size)).unbind(-3)
        return {"keys": keys.transpose(1, 2), "values": values.transpose(1, 2)}

    def forward(self, h: Tensor, keys: Tensor, values: Tensor) -> Tensor:
        """[B, Q, width] from h [B, Q, width]."""
        queries = self.query(self.norm(h)).unflatten(-1, (self.heads, self.size)).transpose(1, 2)
        weights = torch.matmul(queries * self.size**-0.5, keys.transpose(-1, -2).to(queries.dtype))
        read = torch.matmul(weights.softmax(-1).to(values.dtype), values)
        return self.out(read.transpose(1, 2).flatten(-2))


class ResidualBlock(nn.Module):
    """h + W₂ gelu(W₁ norm(h))."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.first = Linear(width, width)
        self.second = Linear(width, width)

    def forward(self, h: Tensor) -> Tensor:
        return h + self.second(torch.nn.functional.gelu(self.first(self.norm(h))))
