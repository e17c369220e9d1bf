"""Settings of the whole process that make networks fast on a CPU."""

from __future__ import annotations

import ctypes

import torch


def use_threads(count: int) -> None:
    """Let PyTorch use so many threads; more than are free makes it several times slower."""
    keep_large_allocations()
    torch.set_num_threads(max(1, count))


def keep_large_allocations() -> None:
    """Ask the C library to keep freed memory: a network frees and takes the same large blocks.

    Otherwise every block is given back and its pages are faulted in again, thousands a step.
    Does nothing where the C library has no `mallopt`.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return
    trim_threshold, mmap_max = -1, -4
    mallopt(trim_threshold, 2**31 - 1)
    mallopt(mmap_max, 0)
