"""One stage over many files: processes, shards, resumption, and a report of bad files."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.atomic import UnwritableError, remove_leftovers
from pointsdf_cli.io.hdf5 import OptionsDifferError
from pointsdf_cli.io.one_thread import one_thread_each
from pointsdf_cli.io.untrusted import is_whole_number

Task = TypeVar("Task")
Result = TypeVar("Result")

AGAIN = "mend or remove them and run the same command again, or add --skip-bad"


@dataclass
class StageReport(Generic[Result]):
    """Outcome of a stage's files.

    Attributes:
        made: Results of the tasks that ran, by task name.
        kept: Names of artifacts that existed already.
        refused: Name and error of every unusable input.
        seconds: Wall time.
    """

    made: dict[str, Result] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    refused: list[tuple[str, InputError]] = field(default_factory=list)
    seconds: float = 0.0

    def raise_if_refused(self, again: str = AGAIN) -> None:
        """Raise one error for all that was refused, if anything was.

        Args:
            again: Hint where there are several inputs.

        Raises:
            InputError: With the first few messages; the good files were finished all the same.
        """
        if not self.refused:
            return
        if len(self.refused) == 1 and not self.made and not self.kept:
            raise self.refused[0][1]
        shown = "\n".join(f"  {error.message}" for _, error in self.refused[:10])
        more = f"\n  and {len(self.refused) - 10} more" if len(self.refused) > 10 else ""
        raise InputError(
            f"{len(self.refused)} of {len(self.refused) + len(self.made) + len(self.kept)} inputs "
            f"cannot be used (the others are done):\n{shown}{more}",
            hint=again,
        )


def run_stage(
    tasks: Sequence[tuple[str, Task]],
    work: Callable[[Task], Result | None],
    *,
    jobs: int,
    folders: Iterable[Path] = (),
    on_done: Callable[[str, Result | None], None] | None = None,
) -> StageReport[Result]:
    """Run `work` on every named task.

    `work` must be a function at module level, because it is sent to other processes. Results do not
    depend on the order in which tasks finish: each draws from `task_seed`.

    Args:
        tasks: Names and tasks.
        work: Function that makes one artifact from a task; returns None if it exists already.
        jobs: Number of processes.
        folders: Folders of the artifacts. Leftovers of killed runs there are removed before, to
            free space, and afterwards, for processes that were still ending before.
        on_done: Called with each name and result.

    Raises:
        RgraspError: Any error but bad input stops the stage; finished artifacts stay.
    """
    report: StageReport[Result] = StageReport()
    started = time.monotonic()

    def finish(name: str, outcome: Result | InputError | None) -> None:
        if isinstance(outcome, InputError):
            report.refused.append((name, outcome))
            outcome = None
        elif outcome is None:
            report.kept.append(name)
        else:
            report.made[name] = outcome
        if on_done:
            on_done(name, outcome)

    folders = set(folders)
    _tidy(folders)
    try:
        if jobs == 1 or len(tasks) < 2:
            # Products here are of small matrices: a second thread would only wait for them.
            with threadpool_limits(1, user_api="blas"):
                for name, task in tasks:
                    finish(name, _guarded(work, task))
        else:
            _run_parallel(tasks, work, jobs, finish)
    finally:
        _tidy(folders)
    # Processes finish in any order; the report does not depend on it.
    report.made = {name: report.made[name] for name, _ in tasks if name in report.made}
    report.kept.sort()
    report.refused.sort(key=lambda pair: pair[0])
    report.seconds = time.monotonic() - started
    return report


def shard_of(tasks: Sequence[Task], shard: str | None) -> list[Task]:
    """Every n-th task, for `--shard i/n`, i from 0.

    Raises:
        InputError: Not of that form.
    """
    if shard is None:
        return list(tasks)
    index, slash, count = shard.partition("/")
    numbers = slash and is_whole_number(index) and is_whole_number(count)
    if not (numbers and int(index) < int(count)):
        raise InputError(
            f"{shard!r} is not a shard",
            where="--shard",
            allowed="i/n with 0 ≤ i < n, such as 0/4, 1/4, 2/4 and 3/4 for four machines",
        )
    return list(tasks[int(index) :: int(count)])


def task_seed(seed: int, name: str) -> np.random.Generator:
    """Random generator of one task; depends only on seed and name."""
    return np.random.default_rng([seed, zlib.crc32(name.encode("utf-8", "surrogateescape"))])


def _tidy(folders: Iterable[Path]) -> None:
    for folder in folders:
        remove_leftovers(folder)


def _guarded(work: Callable[[Task], Result | None], task: Task) -> Result | InputError | None:
    try:
        return work(task)
    except (OptionsDifferError, UnwritableError):
        raise
    except InputError as error:
        return error


def _run_parallel(
    tasks: Sequence[tuple[str, Task]],
    work: Callable[[Task], Result | None],
    jobs: int,
    finish: Callable[[str, Any], None],
) -> None:
    # Spawned, not forked: h5py handles, embree and torch threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    workers, told = min(jobs, len(tasks)), (os.getpid(),)
    with one_thread_each(), ProcessPoolExecutor(workers, context, _start_worker, told) as pool:
        try:
            pending: dict[Future[Any], str] = {}
            queue = iter(tasks)
            while True:
                # A short queue ahead of the workers: results are small, tasks need not be.
                for name, task in islice(queue, 4 * jobs - len(pending)):
                    pending[pool.submit(_guarded, work, task)] = name
                if not pending:
                    break
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    finish(pending.pop(future), future.result())
        except BrokenProcessPool as error:
            raise RgraspError(
                "a worker process died (killed from outside, or out of memory)",
                hint="run the same command again: it resumes; with fewer --jobs it needs less "
                "memory",
            ) from error
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _start_worker(parent: int) -> None:
    """Let a worker end when its parent ends."""
    # Ctrl-C reaches the whole process group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: die with the parent

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
