"""Linear layer whose float32 products are fast on AMD processors, too.

PyTorch multiplies float32 matrices with MKL, which on AMD uses half of the width of AVX-512: 100
GFLOP/s on one Zen 5 core, where oneDNN, which PyTorch uses for bfloat16, reaches 240.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from pointsdf_cli.models.processor import cpu_features


class Linear(nn.Linear):
    """`nn.Linear`, evaluated by oneDNN where that is faster and no gradient is needed."""

    def forward(self, x: Tensor) -> Tensor:
        plain = x.device.type == "cpu" and x.dtype == self.weight.dtype == torch.float32
        if not plain or torch.is_grad_enabled() or torch.is_autocast_enabled("cpu"):
            return super().forward(x)
        if not onednn_is_faster():
            return super().forward(x)
        return torch.ops.mkldnn._linear_pointwise(x, self.weight, self.bias, "none", [], "")


def onednn_is_faster() -> bool:
    """Whether oneDNN multiplies float32 matrices faster than MKL, by the processor's name and
    flags; False where this PyTorch does not offer it."""
    wide = {"AuthenticAMD", "avx512f"} <= cpu_features()
    has_operator = hasattr(torch.ops.mkldnn, "_linear_pointwise")
    return wide and torch.backends.mkldnn.is_available() and has_operator


def dense(
    widths: Sequence[int],
    norm: Callable[[int], nn.Module],
    dropout: float = 0.0,
    linear: type[nn.Linear] = nn.Linear,
) -> nn.Sequential:
    """Linear layer, normalisation, ReLU and dropout for each pair of widths.

    Args:
        widths: Channels before the first layer and after each.
        norm: Makes the normalisation of so many channels.
        dropout: Dropout after each layer; 0 for none.
        linear: Kind of linear layer.
    """
    layers: list[nn.Module] = []
    for a, b in itertools.pairwise(widths):
        layers += [linear(a, b), norm(b), nn.ReLU()]
        if dropout:
            layers.append(nn.Dropout(dropout))
    return nn.Sequential(*layers)
