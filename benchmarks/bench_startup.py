"""Seconds of `rgrasp --help` and of a bare interpreter, in turn, in one run.

python benchmarks/bench_startup.py
"""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median

COMMANDS = {
    "python -c pass": [sys.executable, "-c", "pass"],
    "rgrasp --help": [sys.executable, "-m", "pointsdf_cli.cli.main", "--help"],
    "rgrasp render --help": [sys.executable, "-m", "pointsdf_cli.cli.main", "render", "--help"],
}


def main() -> None:
    seconds: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(11):
        for name, command in COMMANDS.items():
            started = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            seconds[name].append(time.perf_counter() - started)
    for name, times in seconds.items():
        print(f"{name:24} {median(times):.3f} s (of 11: {min(times):.3f} to {max(times):.3f})")


if __name__ == "__main__":
    main()
