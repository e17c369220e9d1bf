"""`python -m tests.fuzz --count 20000 [--seed 0] [--keep DIR]`; exit code 1 if anything fails."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from .runner import fuzz


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="write the files that fail here")
    options = parser.parse_args()
    started = time.monotonic()
    outcome = fuzz(options.first, options.count, options.seed, options.keep)
    print("\n".join(outcome.failures))
    for kind, tried in sorted(outcome.by_kind.items()):
        print(f"  {tried:6} {kind}")
    print(
        f"{options.count} files: {outcome.refused} refused, {outcome.read} read, "
        f"{len(outcome.failures)} failed; slowest {outcome.slowest[0]:g} s "
        f"({outcome.slowest[1]}); {time.monotonic() - started:.0f} s"
    )
    sys.exit(bool(outcome.failures))


main()
