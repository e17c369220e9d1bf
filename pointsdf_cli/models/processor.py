"""Settings of the whole process that make networks fast on a CPU."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch
from torch import Tensor


def use_threads(count: int) -> None:
    """Set PyTorch's number of threads; more than are free makes it several times slower."""
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


def return_freed_memory() -> None:
    """Return the freed memory that `keep_large_allocations` kept to the system.

    For long-lived processes, between requests: kept blocks fragment, so that every plan would add
    some megabytes. Does nothing where the C library has no `malloc_trim`.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


@contextmanager
def one_thread() -> Iterator[None]:
    """PyTorch's operations here by one thread, and by one in threads that begin meanwhile.

    Two that share out an operation of some microseconds wait for each other at its end: as long as
    a time slice of the system, where another program has one of the processors. The number is the
    whole process's: not for several threads of Python at once.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


FEWEST = 256
"""Rows that are worth a thread of their own."""
ALIGNED = 64
"""Multiple of rows in a part: kernels compute remaining rows at a part's end by other instructions,
and a value must not depend on the number of threads."""


def even_parts(rows: Tensor, most: int) -> list[Tensor]:
    """Rows [N, ...] in parts of at most `most`: equally many for each of PyTorch's threads and all
    about as long, so that no thread waits for another's last part. On a device other than the CPU,
    parts of `most`."""
    if rows.device.type != "cpu":
        return list(rows.split(most))
    threads = max(1, min(torch.get_num_threads(), len(rows) // FEWEST))
    count = max(1, -(-len(rows) // (most * threads))) * threads
    length = max(1, -(-len(rows) // (count * ALIGNED))) * ALIGNED
    return list(rows.split(min(length, most)))


def side_by_side(function: Callable[[Tensor], Tensor], parts: Sequence[Tensor]) -> list[Tensor]:
    """`[function(part) for part in parts]`, the parts shared out over PyTorch's threads.

    PyTorch shares out each operation instead, and its threads wait for each other at the end of
    every one of hundreds: two took as long as one for a reconstruction's queries, and many times as
    long where another program held one of the processors. So a part is always one thread's, also
    the only one. After an error no further part is begun. Not for several threads of Python at
    once (`one_thread`).

    Args:
        function: Applied as it would be here: with this thread's autocast and gradient mode.
        parts: Tensors on one device; on another than the CPU nothing is gained, and nothing done.
    """
    if not parts or parts[0].device.type != "cpu":
        return [function(part) for part in parts]
    lowers, dtype = torch.is_autocast_enabled("cpu"), torch.get_autocast_dtype("cpu")
    gradients, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()
    waiting = iter(enumerate(parts))  # whoever is free takes the next
    answers: dict[int, Tensor] = {}

    def work() -> None:
        try:
            for number, part in waiting:
                answers[number] = function(part)
        except BaseException:
            deque(waiting, maxlen=0)  # nobody else goes on
            raise

    def help_out() -> None:
        # All three are settings of a thread, and this is another one.
        with (
            torch.inference_mode(inference),
            torch.set_grad_enabled(gradients),
            torch.autocast("cpu", dtype, enabled=lowers),
        ):
            work()

    # This thread works too: its memory is warm, and an idle one would only wait.
    helpers = min(torch.get_num_threads(), len(parts)) - 1
    with one_thread(), ThreadPoolExecutor(max(1, helpers)) as pool:
        others = [pool.submit(help_out) for _ in range(helpers)]
        work()
        for other in others:
            other.result()
    return [answers[number] for number in range(len(parts))]
