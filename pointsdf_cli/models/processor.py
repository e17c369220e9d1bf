"""Settings of the process that make networks fast on a CPU."""

from __future__ import annotations

import ctypes
import functools
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from pathlib import Path
from typing import Any, TypeVar

import torch
from threadpoolctl import ThreadpoolController, threadpool_limits
from torch import Tensor

from pointsdf_cli.errors import InputError

T = TypeVar("T")


def use_threads(count: int) -> None:
    """Set PyTorch's number of threads; more than free cores make it several times slower.

    NumPy and SciPy get one: their products here are small, and a second thread would only wait.
    """
    keep_large_allocations()
    torch.set_num_threads(max(1, count))
    threadpool_limits(1, user_api="blas")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for what is loaded later


def keep_large_allocations() -> None:
    """Let the C library keep freed memory: networks free and allocate the same large blocks.

    Otherwise every block is returned to the system and its pages are faulted in again, thousands a
    step. Does nothing without `mallopt` in the C library.
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
    some megabytes. Does nothing without `malloc_trim` in the C library.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def usable_device(name: str) -> str:
    """Check that PyTorch can compute on the device `name`, and return it.

    Raises:
        InputError: It is none, or not on this machine.
    """
    count = torch.cuda.device_count()
    here = ["cpu", *(f"cuda:{k}" for k in range(count))]
    allowed = ", ".join(here)
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(f"no device {name!r}", where="--device", allowed=allowed) from error
    if device.type != "cpu" and f"{device.type}:{device.index or 0}" not in here:
        what = f"{name} is not on this machine ({count} CUDA devices)"
        raise InputError(what, where="--device", allowed=allowed)
    return name


def settle_thread() -> None:
    """Make PyTorch's number of threads hold in a new Python thread.

    OpenMP counts threads in each thread anew. PyTorch tells it the number when that is first asked
    for there; oneDNN, MKL and everything else would use all processors until then.
    """
    torch.get_num_threads()


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which PyTorch's operations use one thread.

    Threads that share a short operation wait for each other at its end: for a time slice of the
    system if another program holds one of the processors. The setting is the process's: use it in
    one Python thread at a time.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context in which NumPy's and SciPy's products use one thread.

    They are small here: a second thread would spin between them, on a processor that PyTorch needs.
    """
    with _blas_libraries().limit(limits=1):
        yield


@functools.cache
def _blas_libraries() -> ThreadpoolController:
    """Libraries of NumPy's and SciPy's products that are loaded; to look for them takes 2 ms.

    These alone: at the end of a limit, all libraries of a controller get the number of threads that
    they had before, and OpenMP's may not have been settled in this thread (`settle_thread`).
    """
    return ThreadpoolController().select(user_api="blas")


def bfloat16_is_faster() -> bool:
    """Whether this processor multiplies matrices faster in bfloat16 than in float32.

    By its name and flags, so that results do not depend on a measured time. With `avx512_bf16` an
    AMD Zen 5 is four times as fast, an Intel Sapphire Rapids without AMX takes 1.7 times as long;
    with AMX it is eight times as fast.
    """
    has = cpu_features()
    return "amx_bf16" in has or {"avx512_bf16", "AuthenticAMD"} <= has


@functools.cache
def cpu_features() -> frozenset[str]:
    """Words of Linux's description of the processor, such as `AuthenticAMD` and `avx512f`; none on
    other systems."""
    try:
        described = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return frozenset()
    return frozenset(described.split())


def fast_products(device: torch.device) -> torch.dtype | None:
    """Type of the fastest products on a device; None for float32."""
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    return torch.bfloat16 if device.type == "cpu" and bfloat16_is_faster() else None


FEWEST = 256
"""Least number of rows for a thread of their own."""
ALIGNED = 64
"""Divisor of the number of rows in a part: kernels compute remainders by other instructions, and
values must not depend on the number of threads."""


def run_in_parallel(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Run tasks side by side, each on one of PyTorch's threads; return their results in order.

    For tasks of many short operations, which are not faster when each is split between threads.

    Args:
        tasks: Functions that do not depend on each other.

    Raises:
        Exception: The error of the first task that failed, after all tasks have ended.
    """
    threads = min(torch.get_num_threads(), len(tasks))
    if threads <= 1:
        return [task() for task in tasks]

    with one_thread(), ThreadPoolExecutor(threads, initializer=settle_thread) as pool:
        begun = [pool.submit(copy_context().run, task) for task in tasks]
    return [each.result() for each in begun]


def timed(task: Callable[..., T], *arguments: Any) -> tuple[T, float]:
    """A task's result and how long it took [s]."""
    began = time.perf_counter()
    return task(*arguments), time.perf_counter() - began


@contextmanager
def timed_stage(timings: dict[str, float], stage: str) -> Iterator[None]:
    """Context whose duration [s] is added to that of a stage."""
    began = time.perf_counter()
    yield
    timings[stage] = timings.get(stage, 0.0) + time.perf_counter() - began


def even_parts(rows: Tensor, most: int) -> list[Tensor]:
    """Split rows [N, ...] into parts of at most `most`: equally many for each of PyTorch's threads
    and about equally long, so that no thread waits for another. On other devices than the CPU, into
    parts of `most`."""
    if rows.device.type != "cpu":
        return list(rows.split(most))
    threads = max(1, min(torch.get_num_threads(), len(rows) // FEWEST))
    count = max(1, -(-len(rows) // (most * threads))) * threads
    length = max(1, -(-len(rows) // (count * ALIGNED))) * ALIGNED
    return list(rows.split(min(length, most)))


def in_steps(rows: Tensor, step: int) -> Tensor:
    """Rows [N, ...] with the last one repeated up to a multiple of `step`.

    oneDNN makes and keeps a kernel for each number of rows of a product in bfloat16: hundreds of
    them take a quarter of a second and half a gigabyte.
    """
    missing = -len(rows) % step
    return torch.cat([rows, rows[-1:].expand(missing, *rows.shape[1:])]) if missing else rows


def map_in_parallel(function: Callable[[Tensor], Tensor], parts: Sequence[Tensor]) -> list[Tensor]:
    """Compute `[function(part) for part in parts]`, each part in one of PyTorch's threads.

    PyTorch itself splits each operation, and its threads wait for each other at the end of every
    one of hundreds: two threads took as long as one for a reconstruction's queries, and many times
    as long with another program on one of the processors. After an error no further part is begun.
    Use it in one Python thread at a time (`one_thread`).

    Args:
        function: Function of a part, called with this thread's autocast and gradient mode.
        parts: Tensors on one device; on others than the CPU they are computed in turn.
    """
    if not parts or parts[0].device.type != "cpu":
        return [function(part) for part in parts]
    lowers, dtype = torch.is_autocast_enabled("cpu"), torch.get_autocast_dtype("cpu")
    gradients, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()
    waiting = iter(enumerate(parts))  # a free thread takes the next
    answers: dict[int, Tensor] = {}

    def work() -> None:
        try:
            for number, part in waiting:
                answers[number] = function(part)
        except BaseException:
            deque(waiting, maxlen=0)  # leave nothing for the other threads
            raise

    def help_out() -> None:
        # These three settings belong to a thread; set them in this one too.
        with (
            torch.inference_mode(inference),
            torch.set_grad_enabled(gradients),
            torch.autocast("cpu", dtype, enabled=lowers),
        ):
            work()

    # This thread works too: its memory is warm, and an idle one would only wait.
    helpers = min(torch.get_num_threads(), len(parts)) - 1
    with one_thread(), ThreadPoolExecutor(max(1, helpers), initializer=settle_thread) as pool:
        others = [pool.submit(help_out) for _ in range(helpers)]
        work()
        for other in others:
            other.result()
    return [answers[number] for number in range(len(parts))]
