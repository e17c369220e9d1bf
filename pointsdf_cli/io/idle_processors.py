"""Number of idle processors: how many threads a command may take."""

from __future__ import annotations

import os
import time
from pathlib import Path

SHORTEST = 0.1
"""Shortest time [s] that says anything: the system counts in hundredths of a second."""


class IdleProcessors:
    """Counts the processors that others leave idle, from its making to `count`.

    Two threads that share a processor with another process are several times slower than one that
    does not, so the count errs on the side of fewer. The load of the past minute would not do: it
    is mostly that of the command before.
    """

    def __init__(self) -> None:
        self._mine = os.sched_getaffinity(0)
        self._began = time.monotonic()
        self._before, self._own = _ticks(self._mine), _own_ticks()

    def count(self) -> int:
        """Number of idle processors, at least 1. What this process used counts as idle."""
        time.sleep(max(0.0, self._began + SHORTEST - time.monotonic()))
        after = _ticks(self._mine)
        pairs = [(self._before[cpu], after[cpu]) for cpu in after if cpu in self._before]
        spans = [(now[0] - then[0], now[1] - then[1]) for then, now in pairs]
        if not spans:  # no /proc: as many as there are
            return len(self._mine)
        longest = max(1, *(total for _, total in spans))
        idle = sum(idle for idle, _ in spans) + _own_ticks() - self._own
        return max(1, min(len(self._mine), int(idle / longest + 0.25)))


def idle_processors() -> int:
    """Number of processors that are idle now, at least 1; measured for `SHORTEST`."""
    return IdleProcessors().count()


def _own_ticks() -> float:
    used = os.times()
    return (used.user + used.system) * os.sysconf("SC_CLK_TCK")


def _ticks(processors: set[int]) -> dict[int, tuple[int, int]]:
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
