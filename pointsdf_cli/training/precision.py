"""Fast training on one processor core: bfloat16 where supported, and no competing threads."""

from __future__ import annotations

import os
import time
from functools import cache
from pathlib import Path

import torch

from pointsdf_cli.errors import InputError


@cache
def processor_has_bfloat16() -> bool:
    """Whether matrix products in bfloat16 run on instructions of their own (AVX512-BF16, AMX)."""
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


def idle_processors() -> int:
    """Number of idle processors, at least 1; measured for a tenth of a second.

    Two threads that share a processor with another process are several times slower than one that
    does not, so this errs on the side of fewer. The load of the past minute would not do: it is
    mostly that of the command before.
    """
    mine = os.sched_getaffinity(0)
    before = _idle_ticks(mine)
    time.sleep(0.1)
    after = _idle_ticks(mine)
    shares = [
        (idle - before[cpu][0]) / max(1, total - before[cpu][1])
        for cpu, (idle, total) in after.items()
        if cpu in before
    ]
    if not shares:  # no /proc: as many as there are
        return len(mine)
    return max(1, int(sum(shares) + 0.25))


def _idle_ticks(processors: set[int]) -> dict[int, tuple[int, int]]:
    """(idle, all) ticks of each processor since the machine started."""
    try:
        lines = Path("/proc/stat").read_text(encoding="ascii").splitlines()
    except OSError:
        return {}
    ticks = {}
    for line in lines:
        name, *fields = line.split()
        if name.startswith("cpu") and name[3:].isdigit() and int(name[3:]) in processors:
            # user, nice, system, idle, waiting, …: guests are counted as users already.
            values = [int(field) for field in fields[:8]]
            ticks[int(name[3:])] = values[3] + values[4], sum(values)
    return ticks
