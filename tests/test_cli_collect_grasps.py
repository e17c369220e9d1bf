"""`rgrasp collect-grasps` as a user meets it."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from grasp_worlds import assert_same_grasps

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.grasps import HELD, LOST, read_grasps
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.replay import pick_attempts
from pointsdf_cli.training.gs_data import fold_grasps, read_grasp_data

pytest.importorskip("pybullet")


@pytest.fixture
def meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RGRASP_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "meshes"
    folder.mkdir()
    trimesh.creation.cylinder(0.03, 0.15).export(folder / "can.ply")
    trimesh.creation.box((0.3, 0.3, 0.3)).export(folder / "crate.ply")
    return folder


def test_collects_skips_and_resumes(cli: Callable[..., Any], meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "grasps"
    run = ("collect-grasps", "--meshes", meshes, "--out", out, "--count", 2, "--jobs", 1)
    run = (*run, "--push", 1)
    first = cli(*run, "--json", "--no-pictures")
    assert first.code == 0, first.err
    result = json.loads(first.out)
    assert result["executed"] == 2
    assert list(result["refused"]) == ["crate"]
    assert "too large" in result["refused"]["crate"]
    assert not (out / "crate.h5").exists()
    grasps, meta = read_grasps(out / "can.h5")
    assert grasps.executed.sum() == 2
    assert meta.split == "train"
    assert grasps.cloud.shape[1:] == (1000, 3)
    assert np.isfinite(grasps.lift_height[grasps.executed]).all()
    assert np.isnan(grasps.lift_height[~grasps.executed]).all()
    assert (grasps.unshaken[~grasps.executed] == -1).all()
    assert (grasps.unshaken[grasps.label == 0] == 0).all()
    assert (grasps.unshaken[grasps.label == 1] >= 0).all()
    assert result["unshaken"] == (grasps.unshaken == 1).sum()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "too large for the hand" in page
    # What learns from them must mean the same palm.
    robot = load_robot()
    assert read_grasp_data(out, robot).names == ["can"]
    moved = robot.T_link_palm.copy()
    moved[2, 3] += 0.03
    with pytest.raises(InputError, match="the palm is 30 mm off"):
        read_grasp_data(out, replace(robot, T_link_palm=moved))
    before = (out / "can.h5").read_bytes()
    assert cli(*run, "--quiet", "--no-pictures").code == 0
    assert (out / "can.h5").read_bytes() == before
    for change in (("--seed", 5), ("--push", 0)):
        other = cli(*run, *change, "--no-pictures")
        assert other.code == 2
        assert "other options" in other.err
    trimesh.creation.cylinder(0.03, 0.16).export(meshes / "can.ply")
    taller = cli(*run, "--no-pictures")
    assert taller.code == 2
    assert "other options" in taller.err
    assert (out / "can.h5").read_bytes() == before


def test_planned_preshapes_are_tried_and_taught_beside_heuristic_ones(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    (meshes / "crate.ply").unlink()
    trimesh.creation.box((0.05, 0.06, 0.16)).export(meshes / "carton.ply")
    both = tmp_path / "grasps"
    run = ("collect-grasps", "--meshes", meshes, "--count", 8, "--jobs", 1)
    planned = (*run, "--out", both / "planned", "--preshapes", "planned")  # with pictures: replays
    first = cli(*planned, "--json", "--quiet")
    assert first.code == 0, first.err
    assert json.loads(first.out)["held"] >= 4  # a can and a carton: easy for a planner
    assert cli(*run, "--out", both / "heuristic", "--quiet").code == 0
    data = read_grasp_data(both, load_robot())
    assert data.names == [f"{k}/{n}" for k in ("heuristic", "planned") for n in ("can", "carton")]
    assert len(data.held_out) == 2  # objects, of four files
    assert data.planned.tolist() == [False] * 8 + [True] * 8
    split = fold_grasps(data, 5, 0)
    assert split.folds is not None
    for number in (0, 1):  # one object validates one member, whoever chose its grasps
        assert len(set(split.folds[data.object_of == number])) == 1
    other = cli(*planned, "--grasp-checkpoint", "assets/weights/grasp_scratch")
    assert other.code == 2
    assert "--out" in other.err


def test_where_nothing_can_be_grasped_that_is_said(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    (meshes / "can.ply").unlink()
    run = cli("collect-grasps", "--meshes", meshes, "--out", tmp_path / "g", "--count", 2)
    assert run.code == 2
    assert "crate: is too large" in run.err


def test_one_grasp_of_many_meshes_is_one_of_those_that_give_it(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    (meshes / "crate.ply").rename(meshes / "a_crate.ply")  # the first to be asked
    run = ("collect-grasps", "--meshes", meshes, "--out", tmp_path / "g", "--jobs", 1)
    done = cli(*run, "--count", 1, "--no-pictures", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["executed"] == 1
    # Another run's grasps of objects that a smaller count does not reach are not counted with it.
    trimesh.creation.cylinder(0.03, 0.12).export(meshes / "a_can.ply")
    other = cli(*run, "--count", 1, "--no-pictures", "--seed", 5, "--force")
    assert other.code == 2
    assert "can.h5" in other.err
    assert "too small" in other.err


def test_a_shard_of_nothing_but_refused_meshes_is_done(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "g"
    run = ("collect-grasps", "--meshes", meshes, "--out", out, "--count", 2, "--jobs", 1)
    done = cli(*run, "--shard", "1/2", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert result["executed"] == 0
    assert list(result["refused"]) == ["crate"]


def test_too_few_grasps_are_said_even_when_quiet(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    for k in range(2):  # the can is the one that is held out
        trimesh.creation.box((0.3, 0.3, 0.3)).export(meshes / f"crate{k}.ply")
    run = ("collect-grasps", "--meshes", meshes, "--jobs", 1, "--no-pictures", "-q", "--json")
    done = cli(*run, "--out", tmp_path / "g", "--count", 5, "--seed", 0)
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert result["missing"] == {"train": 4, "test": 0}
    assert result["executed"] == 1
    assert done.err.count("\n") == 1
    assert "warning: --count is not met: executed grasps are missing, 4 for train" in done.err
    assert "3 meshes skipped, such as crate: is too large" in done.err


def test_a_shard_reports_on_all_grasps_and_films_stay(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    trimesh.creation.cylinder(0.03, 0.14).export(meshes / "tin.ply")
    (meshes / "crate.ply").unlink()
    out = tmp_path / "g"
    run = ("collect-grasps", "--meshes", meshes, "--out", out, "--count", 2, "--jobs", 1, "-q")
    run = (*run, "--no-pictures", "--json")
    assert cli(*run, "--record", 1).code == 0
    page, film = (out / "report.html").read_text(encoding="utf-8"), out / "film-00.gif"
    assert film.is_file()
    assert "<td>tin" in page
    shard = cli(*run, "--shard", "0/2")
    assert shard.code == 0, shard.err
    result = json.loads(shard.out)
    assert (result["objects"], result["executed"]) == (1, 1)  # its own
    assert (out / "report.html").read_text(encoding="utf-8") == page
    assert film.is_file()
    # Grasps of another run are not part of it, and films of grasps that are gone go.
    other = cli(*run, "--shard", "0/2", "--seed", 5, "--force")
    assert other.code == 0, other.err
    assert "<td>tin" not in (out / "report.html").read_text(encoding="utf-8")
    assert not film.exists()


def test_a_robot_that_the_simulator_cannot_load_is_said_first(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    robots = Path(__file__).parent / "robots"
    urdf = (robots / "gripper.urdf").read_text(encoding="utf-8")
    (tmp_path / "gripper.yaml").write_text((robots / "gripper.yaml").read_text(encoding="utf-8"))
    (tmp_path / "gripper.urdf").write_text(urdf.replace("<axis", "<dynamics/><axis", 1))
    for command in ("collect-grasps", "trial"):
        done = cli(
            command, "--meshes", meshes, "--out", tmp_path / command, "--robot",
            tmp_path / "gripper.yaml",
        )  # fmt: skip
        assert done.code == 2, done.err
        assert "PyBullet cannot load this URDF" in done.err
        assert "gripper.urdf" in done.err
        assert not list((tmp_path / "cache").rglob("*.npz"))  # no mesh was cut before


def test_killed_at_random_moments_nothing_is_lost_and_nothing_double(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    for k in range(3):
        trimesh.creation.box((0.05, 0.05, 0.12 + 0.01 * k)).export(meshes / f"box{k}.ply")
    run = ("collect-grasps", "--meshes", meshes, "--count", 4, "--jobs", 2, "--no-pictures", "-q")
    assert cli(*run, "--out", tmp_path / "whole").code == 0
    command = [sys.executable, "-m", "pointsdf_cli.cli.main", *map(str, run)]
    command += ["--out", str(tmp_path / "killed")]
    moments = random.Random(0)
    for finished, group in ((0, False), (1, True), (2, True)):
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        while process.poll() is None and len(list((tmp_path / "killed").glob("*.h5"))) < finished:
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 1.0))
        if process.poll() is None:
            if group:
                os.killpg(process.pid, signal.SIGKILL)
            else:  # its workers are left without a parent
                process.send_signal(signal.SIGKILL)
        process.wait()
    assert cli(*run, "--out", tmp_path / "killed").code == 0
    names = {path.name for path in (tmp_path / "whole").iterdir()}
    assert names == {"can.h5", "box0.h5", "box1.h5", "box2.h5", "report.html"}
    assert {path.name for path in (tmp_path / "killed").iterdir()} == names
    for name in sorted(names - {"report.html"}):
        one, kept = read_grasps(tmp_path / "whole" / name)
        two, kept_too = read_grasps(tmp_path / "killed" / name)
        assert kept == kept_too
        assert one.attempt.tolist() == list(range(len(one)))
        assert_same_grasps(one, two)
    first, second = ((tmp_path / n / "report.html").read_text() for n in ("whole", "killed"))
    assert first.replace("whole", "killed") == second


@pytest.mark.parametrize(
    "options",
    [
        ("--count", 0),
        ("--count", -3),
        ("--seed", -1),
        ("--jobs", -2),
        ("--shard", "2/2"),
        ("--robot", "no-such-robot.yaml"),
        ("--pattern", "*.stl"),
        ("--meshes", "no-such-folder"),
        ("--checkpoint", "assets/weights/pointsdf_ray"),  # the heuristic would not use it
        ("--preshapes", "guessed"),
    ],
    ids=lambda value: "=".join(map(str, value)),
)
def test_bad_options_are_refused_and_leave_nothing(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path, options: tuple[str, object]
) -> None:
    out = tmp_path / "grasps"
    result = cli("collect-grasps", "--meshes", meshes, "--out", out, *options)
    assert result.code == 2
    assert not list(out.rglob("*.h5")) if out.exists() else True


def test_as_many_attempts_are_drawn_as_there_are() -> None:
    label = np.array([HELD] * 7 + [LOST] * 5)
    grasps: Any = SimpleNamespace(simulated=np.ones(12, bool), label=label)
    meta: Any = None
    chosen = pick_attempts([("can", grasps, meta)], 6)
    assert len(set(chosen)) == len(chosen)
    assert sum(row < 7 for _, row in chosen) == 6
    assert sum(row >= 7 for _, row in chosen) == 5
