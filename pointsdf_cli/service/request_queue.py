"""A bounded queue of requests with one worker."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from pointsdf_cli.errors import RgraspError
from pointsdf_cli.planning.cancellation import CancelledError, cancellable


class BusyError(RgraspError):
    """The queue is full."""


class ClosingError(RgraspError):
    """The server is stopping: running work is finished, nothing else begins."""


@dataclass(eq=False)
class Job:
    """A place in the queue; its work may be submitted later.

    Attributes:
        future: Result or error of the work.
        work: The work; None before it is submitted, and when it is done.
        cancelled: Whether it was cancelled: work that waits is not begun, running work stops where
            it can.
    """

    future: Future[Any] = field(default_factory=Future)
    work: Callable[[], Any] | None = None
    cancelled: bool = False


class RequestQueue:
    """A queue that answers one request at a time, in a thread of its own.

    Args:
        places: Jobs that may wait beside the one that runs.
        after: Called after each job, in the same thread.
    """

    def __init__(self, places: int = 8, after: Callable[[], None] = lambda: None) -> None:
        self.places = places
        self._after = after
        self._jobs: set[Job] = set()
        self._ready: deque[Job] = deque()
        self._changed = threading.Condition()
        self._closing = False
        self.done = 0
        self._thread = threading.Thread(target=self._run, name="planner", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Jobs that have a place, the one that runs among them."""
        return len(self._jobs)

    def require_open(self) -> None:
        """Refuse what has not begun when the server stops.

        Raises:
            ClosingError: It stops.
        """
        if self._closing:
            raise ClosingError("the server is stopping", hint="ask again when it is back")

    def take_place(self) -> Job:
        """A place in the queue, to be filled by `submit` or given back by `leave`.

        Raises:
            BusyError: All places are taken.
            ClosingError: The server stops.
        """
        with self._changed:
            self.require_open()
            if len(self._jobs) > self.places:
                raise BusyError(
                    f"{len(self._jobs)} requests are being answered or wait",
                    hint="ask again in a few seconds",
                )
            job = Job()
            self._jobs.add(job)
            return job

    def submit(self, job: Job, work: Callable[[], Any]) -> Future[Any]:
        """Have `work` done in its turn."""
        with self._changed:
            if self._closing:
                self._jobs.discard(job)
                job.future.set_exception(ClosingError("the server is stopping"))
                return job.future
            job.work = work
            self._ready.append(job)
            self._changed.notify_all()
        return job.future

    def leave(self, job: Job) -> None:
        """Give a place back; work that has begun stops where it can."""
        job.cancelled = True
        with self._changed:
            if job.work is None:
                self._jobs.discard(job)
            elif job in self._ready:
                self._ready.remove(job)
                self._jobs.discard(job)
                job.future.set_exception(CancelledError("cancelled"))

    def close(self) -> None:
        """Begin nothing more: waiting jobs are refused, running work is finished."""
        with self._changed:
            self._closing = True
            waiting = list(self._ready)
            self._ready.clear()
            self._jobs.difference_update(waiting)
            self._changed.notify_all()
        for job in waiting:
            job.future.set_exception(ClosingError("the server is stopping"))

    def join(self) -> None:
        """Wait for the work that ran when the queue was closed."""
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ready or self._closing)
                if not self._ready:
                    return
                job = self._ready.popleft()
            self._do(job)
            with self._changed:
                self._jobs.discard(job)
                self.done += 1
            self._after()

    def _do(self, job: Job) -> None:
        assert job.work is not None
        try:
            with cancellable(lambda: job.cancelled):
                if job.cancelled:
                    raise CancelledError("cancelled")
                outcome = job.work()
        except BaseException as error:  # the worker outlives whatever a request brings about
            job.future.set_exception(error)
        else:
            job.future.set_result(outcome)
        job.work = None
