"""Precision of a network's products: bfloat16 where that is faster."""

from __future__ import annotations

import torch

from pointsdf_cli.choices import Precision, require_choice
from pointsdf_cli.models.processor import fast_products


def autocast_dtype(precision: str, device: torch.device) -> torch.dtype | None:
    """The type for autocast, None for plain float32.

    Raises:
        InputError: No such precision.
    """
    require_choice(precision, Precision, "--precision")
    if precision == "float32":
        return None
    if precision == "bfloat16":
        return torch.bfloat16
    return fast_products(device)
