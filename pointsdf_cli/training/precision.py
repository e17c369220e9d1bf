"""Fast training on one processor core: bfloat16 where supported."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import torch

from pointsdf_cli.errors import InputError


@cache
def processor_has_bfloat16() -> bool:
    """Whether the processor has instructions for matrix products in bfloat16 (AVX512-BF16, AMX)."""
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return "avx512_bf16" in flags or "amx_bf16" in flags


def autocast_dtype(precision: str, device: torch.device) -> torch.dtype | None:
    """The type for autocast, None for plain float32.

    Raises:
        InputError: No such precision.
    """
    if precision not in ("auto", "bfloat16", "float32"):
        raise InputError(
            f"no precision {precision!r}", where="--precision", allowed="auto, bfloat16, float32"
        )
    if precision == "float32":
        return None
    if precision == "bfloat16":
        return torch.bfloat16
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    return torch.bfloat16 if processor_has_bfloat16() else None
