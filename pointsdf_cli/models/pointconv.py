"""PointConv (Wu et al. 2018) without compiled operators.

One layer takes features at N points to features at M centres:

    F(c) = σ( W · Σ_k  w(p_k − c) ⊗ [ s(ρ_k) · mlp(p_k − c, f_k) ] )

with k over the K points nearest to c, w the weight net, s(ρ) the density net on inverse density,
and W the layer after the weight product. The mlp's first layer is linear in (p_k − c, f_k), so it
is applied to every point and every centre once, *before* the gather: N + M products, not M · K.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn

from pointsdf_cli.models.linear import Linear, dense
from pointsdf_cli.models.neighbours import gather


class ChannelNorm(nn.Module):
    """Normalisation over the last axis: `batch` (the paper), `layer` or `none`."""

    def __init__(self, channels: int, kind: str) -> None:
        super().__init__()
        self.kind = kind
        norms: dict[str, type[nn.Module]] = {"batch": nn.BatchNorm1d, "layer": nn.LayerNorm}
        self.norm = norms.get(kind, nn.Identity)(channels)

    def forward(self, x: Tensor) -> Tensor:
        if self.kind == "batch":
            return self.norm(x.reshape(-1, x.shape[-1])).view(x.shape)
        return self.norm(x)


class PointConv(nn.Module):
    """One PointConv layer.

    Args:
        in_channels: Channels of the input features; 0 for bare points.
        mlp: Widths of the pointwise mlp; the last is the layer after the weight product.
        weight_channels: Output channels of the weight net.
        weight_hidden: Widths of the weight net's hidden layers.
        density: Whether inverse density scales the neighbours (density net [16, 1], sigmoid).
        norm: `batch` or `layer`.
        radius: Typical neighbourhood size; offsets are divided by it before the nets.
    """

    def __init__(
        self,
        in_channels: int,
        mlp: Sequence[int],
        weight_channels: int = 32,
        weight_hidden: Sequence[int] = (),
        density: bool = True,
        norm: str = "batch",
        radius: float = 1.0,
    ) -> None:
        super().__init__()
        *hidden, out_channels = mlp
        self.inverse_radius = 1.0 / radius
        self.from_offset = Linear(3, hidden[0], bias=False)
        self.from_features = Linear(in_channels, hidden[0]) if in_channels else None
        self.bias = None if in_channels else nn.Parameter(torch.zeros(hidden[0]))
        inner_norm = norm if norm == "batch" else "none"
        self.first_norm = ChannelNorm(hidden[0], inner_norm)
        self.mlp = dense(hidden, partial(ChannelNorm, kind=inner_norm), linear=Linear)
        widths = [3, *weight_hidden, weight_channels]
        layers: list[nn.Module] = []
        for step, (a, b) in enumerate(itertools.pairwise(widths)):
            layers += [Linear(a, b), ChannelNorm(b, inner_norm)]
            if norm == "batch" or step < len(widths) - 2:
                layers.append(nn.ReLU())
        self.weight_net = nn.Sequential(*layers)
        self.density_net = None
        if density:
            self.density_net = nn.Sequential(Linear(1, 16), nn.ReLU(), Linear(16, 1), nn.Sigmoid())
        self.out = Linear(hidden[-1] * weight_channels, out_channels)
        self.out_norm = ChannelNorm(out_channels, norm)

    def forward(
        self,
        points: Tensor,
        features: Tensor | None,
        centres: Tensor,
        index: Tensor,
        inverse_density: Tensor | None = None,
    ) -> Tensor:
        """Features at the centres.

        Args:
            points: [B, N, 3].
            features: [B, N, C] or None.
            centres: [B, M, 3].
            index: int64 [B, M, K], each centre's neighbours among the points.
            inverse_density: [B, N], needed if the layer has a density net.

        Returns:
            [B, M, C'].
        """
        points_scaled = points * self.inverse_radius
        centres_scaled = centres * self.inverse_radius
        at_points = self.from_offset(points_scaled)
        if self.from_features is not None:
            at_points = at_points + self.from_features(features)
        else:
            at_points = at_points + self.bias.to(at_points.dtype)  # type: ignore[union-attr]
        # Negated while small: a broadcast addition is several times faster than a subtraction.
        minus_centres = self.from_offset(-centres_scaled)
        hidden = gather(at_points, index) + minus_centres.unsqueeze(2)
        hidden = self.mlp(torch.relu(self.first_norm(hidden)))
        offsets = gather(points_scaled, index) - centres_scaled.unsqueeze(2)
        weights = self.weight_net(offsets)
        if self.density_net is not None:
            scale = gather(self.density_net(inverse_density.unsqueeze(-1)), index)  # type: ignore[union-attr]
            weights = weights * scale
        product = torch.matmul(weights.transpose(-1, -2).to(hidden.dtype), hidden)
        return torch.relu(self.out_norm(self.out(product.flatten(-2))))
