"""Precision of a network's products: bfloat16 where that is faster."""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path

import torch

from pointsdf_cli.choices import Precision, require_choice
from pointsdf_cli.models.processor import one_thread

ROWS, WIDTH = 2048, 256
"""Size of the products that are timed: a decoder's, for a few thousand queries."""
FASTER = 1.3
"""bfloat16 is taken where its products are faster by this factor."""


@cache
def bfloat16_is_faster() -> bool:
    """Whether matrix products in bfloat16 are clearly faster than in float32 on this processor.

    The processor's flags do not tell: of two processors with AVX512-BF16 one multiplied bfloat16
    four times as fast as float32, the other at 0.6 of its speed. So both are timed, once a process
    (10 to 30 ms), where the processor has instructions for bfloat16 at all.
    """
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    if "avx512_bf16" not in flags and "amx_bf16" not in flags:
        return False
    rows, weights = torch.ones(ROWS, WIDTH), torch.ones(WIDTH, WIDTH)
    seconds = [_product_seconds(rows.to(t), weights.to(t)) for t in (torch.float32, torch.bfloat16)]
    return seconds[0] > FASTER * seconds[1]


def _product_seconds(rows: torch.Tensor, weights: torch.Tensor, repeats: int = 5) -> float:
    """Least processor time of this thread for one product; the first one, which sets up, is not
    counted."""
    with one_thread(), torch.inference_mode(), torch.autocast("cpu", enabled=False):
        times = []
        for _ in range(repeats + 1):
            began = time.thread_time()
            torch.mm(rows, weights)
            times.append(time.thread_time() - began)
    return min(times[1:])


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
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    return torch.bfloat16 if bfloat16_is_faster() else None
