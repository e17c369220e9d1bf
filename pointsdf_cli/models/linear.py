"""Linear layer whose float32 products are fast on AMD processors, too.

PyTorch multiplies float32 matrices with MKL, which on AMD uses half of the width of AVX-512: 100
GFLOP/s on one Zen 5 core, where oneDNN, which PyTorch uses for bfloat16, reaches 240.
"""

from __future__ import annotations

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
