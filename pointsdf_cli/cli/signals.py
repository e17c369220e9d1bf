"""Ctrl-C and SIGTERM as a polite request, for commands that must leave a state to resume from."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class StopRequest:
    """Whether someone asked to stop.

    Attributes:
        exit_code: Exit code of a stopped command: 130 after Ctrl-C, 143 after SIGTERM, as if the
            signal had ended it, so that a script does not take the work for done.
    """

    def __init__(self) -> None:
        self.exit_code = 0

    def __call__(self) -> bool:
        return self.exit_code != 0


@contextmanager
def stop_requests() -> Iterator[StopRequest]:
    """Turn the first signal into a request while the block runs; a second Ctrl-C stops at once."""
    request = StopRequest()

    def ask(number: int, frame: FrameType | None) -> None:
        request.exit_code = 128 + number
        for name, handler in before.items():
            signal.signal(name, handler)

    # What is ignored stays so: `nohup … &` in a script keeps Ctrl-C for the script's own commands.
    both = (signal.SIGINT, signal.SIGTERM)
    heard = [name for name in both if signal.getsignal(name) is not signal.SIG_IGN]
    before = {name: signal.signal(name, ask) for name in heard}
    try:
        yield request
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
