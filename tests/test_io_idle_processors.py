"""How many threads a command takes: what is busy now, not what was."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from pointsdf_cli.io.idle_processors import IdleProcessors, idle_processors


def test_busy_processors_are_left_alone() -> None:
    assert 1 <= idle_processors() <= len(os.sched_getaffinity(0))
    busy = [
        subprocess.Popen(
            [sys.executable, "-c", "print(flush=True)\nwhile True: pass"], stdout=subprocess.PIPE
        )
        for _ in os.sched_getaffinity(0)
    ]
    try:
        for process in busy:
            assert process.stdout is not None
            process.stdout.readline()
        assert idle_processors() == 1
    finally:
        for process in busy:
            process.kill()
            process.communicate()


def test_own_work_does_not_count_as_anothers() -> None:
    idle = IdleProcessors()
    before = idle_processors()
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        pass
    if idle_processors() == before == len(os.sched_getaffinity(0)):  # nobody else works here
        assert idle.count() == before
    assert idle.count() >= 1
