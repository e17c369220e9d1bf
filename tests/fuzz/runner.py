"""Runs damaged files through readers in a child process that may crash, hang or eat memory."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import select
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np

from pointsdf_cli.errors import InputError

from .inputs import INPUTS, write_inputs
from .mutations import mutate
from .structure import mutate_gzip, mutate_hdf5

HANG = 10.0
"""Seconds of processor time after which a reader counts as hung; or ten times that by the clock."""
MEMORY = 2 << 30
"""Bytes that a reader may take beyond what the process has when it starts."""

COMMIT = "0123456789ab"
"""The commit that the files name."""


@dataclass
class Outcome:
    """What became of the damaged files.

    Attributes:
        refused, read: How many ended in an InputError, and how many were still readable.
        failures: One line for each that did neither: kind, number, what happened.
        slowest: Seconds of the slowest file, and its kind.
        by_kind: Files tried, by kind.
    """

    refused: int = 0
    read: int = 0
    failures: list[str] = field(default_factory=list)
    slowest: tuple[float, str] = (0.0, "")
    by_kind: Counter[str] = field(default_factory=Counter)


def fuzz(first: int, count: int, seed: int = 0, keep: Path | None = None) -> Outcome:
    """Try `count` damaged files; file n is the same for the same seed, whatever `first` is.

    Args:
        first: Number of the first file.
        count: How many.
        seed: Of kinds and damages.
        keep: A folder for the files that failed.
    """
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        # What is damaged, and so what happens, must not depend on the commit.
        with mock.patch("pointsdf_cli.io.hdf5.git_commit", return_value=COMMIT):
            write_inputs(work / "good")
        at = first
        while at < first + count:
            at = _watch_child(work, at, first + count, seed, outcome, keep)
    return outcome


def kind_of(number: int, seed: int) -> int:
    """Index into INPUTS of file `number`."""
    shares = np.array([i.share for i in INPUTS])
    return int(
        np.random.default_rng([seed, number, 0]).choice(len(INPUTS), p=shares / shares.sum())
    )


def _watch_child(
    work: Path, first: int, end: int, seed: int, outcome: Outcome, keep: Path | None
) -> int:
    """Run files from `first` in a child until all are done or it dies; the next file's number."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            _child(work, first, end, seed, writing)
        finally:
            os._exit(0)  # never back into the parent's frames
    os.close(writing)
    number, started, rest = first, time.monotonic(), b""
    used = 0.0
    with open(reading, "rb", buffering=0) as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], HANG / 2)
            if not ready and not _hung(child, used, started):
                continue
            if not ready:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                _failed(work, number, seed, f"hung for {HANG:g} s", outcome, keep)
                return number + 1
            piece = pipe.read(1 << 16)
            if not piece:
                break
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                verdict, seconds = json.loads(line)
                kind = INPUTS[kind_of(number, seed)].name
                outcome.by_kind[kind] += 1
                outcome.slowest = max(outcome.slowest, (round(seconds, 2), kind))
                if verdict == "refused":
                    outcome.refused += 1
                elif verdict == "read":
                    outcome.read += 1
                else:
                    _failed(work, number, seed, verdict, outcome, keep)
                number, started, used = number + 1, time.monotonic(), _processor_time(child)
    _, status = os.waitpid(child, 0)
    if number < end:
        _failed(work, number, seed, f"killed the process (status {status})", outcome, keep)
        number += 1
    return number


def _hung(child: int, used: float, started: float) -> bool:
    """On a busy machine the clock runs on while a process waits for its turn."""
    return _processor_time(child) - used > HANG or time.monotonic() - started > 10 * HANG


def _processor_time(child: int) -> float:
    words = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _failed(
    work: Path, number: int, seed: int, what: str, outcome: Outcome, keep: Path | None
) -> None:
    name = INPUTS[kind_of(number, seed)].name
    outcome.failures.append(f"{number} {name}: {what}")
    if keep is not None:
        target = keep / str(number) / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(damaged(work / "good", number, seed))


def damaged(good: Path, number: int, seed: int) -> bytes:
    """The bytes of file `number`."""
    source = good / INPUTS[kind_of(number, seed)].name
    rng = np.random.default_rng([seed, number, 1])
    below = {".h5": mutate_hdf5, ".tgz": mutate_gzip}.get(source.suffix, mutate)
    damage = below if rng.random() < 0.75 else mutate
    return damage(source.read_bytes(), rng)


def _child(work: Path, first: int, end: int, seed: int, pipe: int) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    warnings.simplefilter("ignore")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    for number in range(first, end):
        kind = INPUTS[kind_of(number, seed)]
        place = work / "bad"
        shutil.rmtree(place, ignore_errors=True)
        path = place / kind.name
        if path.parent == place:
            place.mkdir()
        else:  # its neighbours may be read too
            shutil.copytree((work / "good" / kind.name).parent, path.parent)
        path.write_bytes(damaged(work / "good", number, seed))
        started = time.monotonic()
        verdict = "read"
        try:
            kind.read(path)
        except InputError:
            verdict = "refused"
        except BaseException as error:  # whatever it is, it is what we are looking for
            where = traceback.extract_tb(error.__traceback__)
            ours = [f for f in where if "pointsdf_cli" in f.filename] or where
            verdict = f"{type(error).__name__}: {str(error)[:120]} at " + ", ".join(
                f"{Path(f.filename).name}:{f.lineno}" for f in ours[-2:]
            )
        with contextlib.suppress(BrokenPipeError):
            line = json.dumps([verdict, time.monotonic() - started]).encode() + b"\n"
            os.write(pipe, line)
