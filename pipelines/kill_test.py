"""Kills pipelines/paper.sh in each of its steps, again and again, and looks what is lost.

    python pipelines/kill_test.py WORK [--kills 60] [--longest 60] [--reference DIR]

A step is killed at a random time after its begin: within the time that it took in the reference
(the folder of a run that nobody killed), and equally often for each step; without a reference
within --longest. After each SIGKILL of the whole process group every file with a final name must be
readable, and every finished view and label file must be byte for byte what it was. In the end the
pipeline runs through: nothing of rgrasp may be left in the folder of temporary files, and with
--reference views, labels and grasps must equal that run's, the networks' weights but for what
rounding makes of another number of threads (which follows the machine's load), and the trials but
for planning times and a tenth of a millimetre. Prints one line a kill and how many kills each step
had; exit code 1 if anything was lost.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_checkpoint, read_train_state
from pointsdf_cli.io.describe import describe
from pointsdf_cli.io.grasps import read_grasps
from pointsdf_cli.io.trials import TrialRow, read_trial, read_trials

SCRIPT = Path(__file__).with_name("paper.sh")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--longest", type=float, default=60.0, help="seconds a step may live")
    parser.add_argument("--reference", type=Path, help="an uninterrupted run's folder")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, started = random.Random(options.seed), time.monotonic()
    finished: dict[Path, str] = {}
    losses = 0
    killed: Counter[str] = Counter()
    lengths = step_lengths(options.reference) if options.reference else {}
    shares = {
        step: options.kills // len(lengths) + (number < options.kills % len(lengths))
        for number, step in enumerate(lengths)
    }

    def patience(step: str) -> float:
        """Seconds until a step that has just begun is killed."""
        if killed[step] >= shares.get(step, math.inf):
            return math.inf
        return rng.uniform(0.0, lengths.get(step, options.longest))

    while killed.total() < options.kills:
        step = run(options.work, patience)
        found = look(options.work, finished)
        losses += len(found)
        steps = len(list((options.work / "done").glob("*")))
        what = f"killed in {step}" if step else "ended by itself"
        print(f"{what}: {steps} steps done, {len(finished)} files, lost: {found or 'nothing'}")
        killed[step] += bool(step)
        if not step:  # from the beginning of what can be made again, so that later kills count too
            for mark in (options.work / "done").glob("*"):
                mark.unlink()
    assert run(options.work, lambda _: math.inf) == ""
    found = look(options.work, finished)
    if options.reference:
        found += differing(options.work, options.reference)
    found += [f"{left} is left" for left in temporary_of(options.work).glob(".rgrasp*")]
    losses += len(found)
    print("kills by step:", ", ".join(f"{n} {step}" for step, n in killed.items() if n))
    print(
        f"{killed.total()} kills in {time.monotonic() - started:.0f} s, then run through; "
        f"lost: {losses} {found or ''}"
    )
    sys.exit(losses > 0)


def step_lengths(reference: Path) -> dict[str, float]:
    """Seconds that each step of an uninterrupted run took, by the times of their marks."""
    begun = (reference / "done" / ".asked").stat().st_mtime
    lengths = {}
    for mark in sorted((reference / "done").glob("[!.]*"), key=lambda path: path.stat().st_mtime):
        ended = mark.stat().st_mtime
        lengths[mark.name], begun = ended - begun, ended
    return lengths


def run(work: Path, patience: Callable[[str], float]) -> str:
    """Start the pipeline and kill it with all its children.

    Args:
        work: Its folder.
        patience: Seconds that a step may live, drawn when it begins.

    Returns:
        The step that was killed, "" if the pipeline ended before.
    """
    log = work.with_name(work.name + ".log")
    log.parent.mkdir(parents=True, exist_ok=True)
    temporary_of(work).mkdir(exist_ok=True)
    temporary = str(temporary_of(work).resolve())
    with open(log, "a") as output:
        before = output.tell()
        process = subprocess.Popen(
            ["bash", str(SCRIPT), str(work.resolve())],
            env={**os.environ, "SCALE": "tiny", "JOBS": "1", "TMPDIR": temporary},
            stdout=output, stderr=output, start_new_session=True,
        )  # fmt: skip
    step, end = "", math.inf
    while process.poll() is None:
        if (now := step_of(log, before)) != step:
            step, end = now, time.monotonic() + patience(now)
        if time.monotonic() > end:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return step
        time.sleep(0.02)
    if process.returncode:
        sys.exit(f"the pipeline failed with {process.returncode}: see {log}")
    return ""


def temporary_of(work: Path) -> Path:
    """The folder of temporary files of all runs."""
    return work.with_name(work.name + ".tmp")


def step_of(log: Path, start: int = 0) -> str:
    """The step that was begun last, by the log from a place on; "" before the first."""
    with open(log, encoding="utf-8") as lines:
        lines.seek(start)
        begun = [line.split()[1] for line in lines if line.startswith("== ")]
    return begun[-1].rstrip(":") if begun else ""


def look(work: Path, finished: dict[Path, str]) -> list[str]:
    """Damaged and missing files; `finished` collects the check sums of new ones."""
    found = []
    for path in work.rglob("*.h5"):
        if path.name.startswith("."):
            continue
        try:
            read = {"grasps": read_grasps, "trials": _read_trials}
            parts = path.relative_to(work).parts
            next((read[part] for part in parts if part in read), describe)(path)
        except InputError as error:
            found.append(error.message)
        if path.is_relative_to(work / "views") or path.is_relative_to(work / "labels"):
            total = hashlib.sha256(path.read_bytes()).hexdigest()
            if finished.setdefault(path, total) != total:
                found.append(f"{path} has changed")
    found += [f"{path} is gone" for path in finished if not path.exists()]
    for state in work.rglob("train_state.pt"):
        if ".partial-" not in str(state):
            try:
                read_train_state(state.parent)
                if (state.parent / "model.safetensors").exists():
                    read_checkpoint(state.parent)
            except InputError as error:
                found.append(error.message)
    return found


def _read_trials(path: Path) -> object:
    return read_trials(path) if path.name == "trials.h5" else read_trial(path)


def differing(work: Path, reference: Path) -> list[str]:
    """Artifacts whose arrays are not those of the uninterrupted run."""
    found = []
    for kind in ("views", "labels", "grasps"):
        for one in sorted((reference / kind).rglob("*.h5")):
            other = work / one.relative_to(reference)
            if not other.exists():
                found.append(f"{other} is missing")
                continue
            with h5py.File(one) as a, h5py.File(other) as b:
                same = set(a) == set(b) and all(
                    np.array_equal(a[n][()], b[n][()], equal_nan=a[n].dtype.kind == "f") for n in a
                )
            if not same:
                found.append(f"{other} differs")
    for one in sorted(reference.glob("*/*/model.safetensors")):
        other = work / one.relative_to(reference)
        if not other.exists() or not same_weights(one.parent, other.parent):
            found.append(f"{other} differs or is missing")
    rows = [
        [repr(comparable(row)) for row in read_trials(folder / "trials" / "trials.h5")]
        for folder in (reference, work)
    ]
    return found + (["the trials differ"] if rows[0] != rows[1] else [])


def same_weights(one: Path, other: Path) -> bool:
    """Whether two checkpoints hold the same numbers, but for rounding."""
    mine, theirs = read_checkpoint(one).weights, read_checkpoint(other).weights
    return set(mine) == set(theirs) and all(
        np.allclose(mine[name].float(), theirs[name].float(), rtol=0, atol=1e-6) for name in mine
    )


def comparable(row: TrialRow) -> TrialRow:
    """A trial without what differs from run to run."""
    lengths = {
        name: round(getattr(row, name), 4) for name in ("moved", "penetration", "final_height")
    }
    return replace(row, planning_time=0.0, planning_cpu=0.0, **lengths)


if __name__ == "__main__":
    main()
