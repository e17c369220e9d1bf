"""Limit of numerical libraries to one thread, for work that is already divided."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Limit modules loaded within, and processes started within, to one thread each.

    Libraries read these numbers once, when they are loaded: a started process must find them said
    already, because NumPy is loaded before it runs anything of ours.
    """
    before = {name: os.environ[name] for name in NAMES if name in os.environ}
    os.environ.update(dict.fromkeys(NAMES, "1"))
    try:
        yield
    finally:
        for name in NAMES:
            del os.environ[name]
        os.environ.update(before)
