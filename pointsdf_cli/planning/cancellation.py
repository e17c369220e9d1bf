"""Cancellation of plans that no client waits for.

    with cancellable(stopped): planner.plan(...)     # raises CancelledError once stopped() is true

Planning checks between stages, rounds and motions, and while it searches for a motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from pointsdf_cli.errors import RgraspError

_stopped: ContextVar[Callable[[], bool]] = ContextVar("stopped", default=lambda: False)


class CancelledError(RgraspError):
    """The client no longer waits."""


def is_cancelled() -> bool:
    """Whether the work of this thread was cancelled."""
    return _stopped.get()()


def stop_if_cancelled() -> None:
    """End the work of this thread if it was cancelled.

    Raises:
        CancelledError: It was cancelled.
    """
    if is_cancelled():
        raise CancelledError("cancelled")


@contextmanager
def cancellable(stopped: Callable[[], bool]) -> Iterator[None]:
    """Context in which `stop_if_cancelled` in this thread raises once `stopped()` is true."""
    token = _stopped.set(stopped)
    try:
        yield
    finally:
        _stopped.reset(token)
