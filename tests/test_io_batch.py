"""Stages: the same results whoever runs them, bad inputs set apart, shards that make the whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import threadpoolctl

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.atomic import (
    UnwritableError,
    _builder,
    temporary_beside,
    write_text_atomic,
)
from pointsdf_cli.io.batch import run_stage, shard_of, task_seed


def draw(name: str) -> float:
    return float(task_seed(3, name).random())


def refuse_odd(number: int) -> int | None:
    if number % 2:
        raise InputError(f"{number} is odd")
    return None if number == 4 else number


def write_nowhere(_: int) -> int:
    write_text_atomic("/proc/rgrasp/file", "text")
    return 1


def die(_: int) -> int:
    os._exit(9)


NAMES = [(f"mesh{k}", f"mesh{k}") for k in range(6)]


def test_what_a_task_draws_does_not_depend_on_processes_or_order() -> None:
    alone = run_stage(NAMES, draw, jobs=1).made
    assert run_stage(NAMES[::-1], draw, jobs=2).made == alone
    assert len(set(alone.values())) == 6


@pytest.mark.parametrize("jobs", [1, 2])
def test_bad_inputs_are_set_apart_and_the_others_done(jobs: int) -> None:
    report = run_stage([(str(k), k) for k in range(6)], refuse_odd, jobs=jobs)
    assert report.made == {"0": 0, "2": 2}
    assert report.kept == ["4"]
    assert [name for name, _ in report.refused] == ["1", "3", "5"]
    with pytest.raises(InputError, match="3 of 6 inputs cannot be used"):
        report.raise_if_refused()


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_place_that_cannot_be_written_is_no_bad_input_to_skip(jobs: int) -> None:
    with pytest.raises(UnwritableError, match="/proc/rgrasp"):
        run_stage([(str(k), k) for k in range(3)], write_nowhere, jobs=jobs)


def test_a_worker_that_dies_ends_the_stage_with_one_message() -> None:
    with pytest.raises(RgraspError, match="worker process died"):
        run_stage([(str(k), k) for k in range(4)], die, jobs=2)


def kill(process: int) -> int:
    os.kill(process, signal.SIGKILL)
    while b") Z " not in Path(f"/proc/{process}/stat").read_bytes():
        time.sleep(0.01)
    return process


@pytest.mark.skipif(sys.platform != "linux", reason="zombies are told apart under Linux only")
@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_run_that_ends_meanwhile_was_building_is_removed(jobs: int, tmp_path: Path) -> None:
    mine = temporary_beside(tmp_path / "a.h5")
    with (
        subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as builder,
        subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as another,
    ):
        builders = [builder.pid, another.pid]
        me = _builder(os.getpid())
        theirs = [mine.name.replace(me, _builder(pid)) for pid in builders]
        for name in [mine.name, *theirs]:
            (tmp_path / name).write_bytes(b"x")
        run_stage([(str(pid), pid) for pid in builders], kill, jobs=jobs, folders=[tmp_path])
        assert list(tmp_path.iterdir()) == [mine]


def test_shards_are_disjoint_and_make_the_whole() -> None:
    tasks = list(range(11))
    shards = [shard_of(tasks, f"{k}/3") for k in range(3)]
    assert sorted(task for shard in shards for task in shard) == tasks


@pytest.mark.parametrize("text", ["3/3", "x/2", "1", "-1/2", "1/0", "1/2/3", ""])
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--shard"):
        shard_of([1, 2], text)


def test_errors_travel_between_processes_whole() -> None:
    import pickle

    error = InputError("what", where="here", allowed="that", hint="type this")
    again = pickle.loads(pickle.dumps(error))
    assert again.message == "here: what\n  allowed: that\n  try: type this"
    assert again.exit_code == 2


def _threads(_: int) -> list[int]:
    # Beside what is told, because an old threadpoolctl does not know every library.
    told = int(os.environ["OMP_NUM_THREADS"])
    return [told, *(pool["num_threads"] for pool in threadpoolctl.threadpool_info())]


def test_workers_have_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "2")
    report = run_stage([(str(k), k) for k in range(2)], _threads, jobs=2)
    assert all(set(counts) == {1} for counts in report.made.values())
    assert os.environ["OMP_NUM_THREADS"] == "2"
