"""Scripts of pipelines/ and benchmarks/: what they refuse, and paths with spaces."""

from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from pointsdf_cli.io.checkpoints import read_checkpoint
from pointsdf_cli.io.labels import Labels, write_labels

ROOT = Path(__file__).parents[1]
PIPELINES, BENCHMARKS, WEIGHTS = ROOT / "pipelines", ROOT / "benchmarks", ROOT / "assets/weights"
RGRASP = """#!/usr/bin/env bash
printf '%s\\n' "$@" >>"$CALLS"
while [ $# -gt 0 ]; do
    [ "$1" != --out ] || mkdir -p "$2"
    shift
done
"""


def run_script(name: str, *arguments: Path, **environment: object) -> tuple[int, str, list[str]]:
    """Exit code of a shell script with an rgrasp that only makes --out, what it said, and the
    arguments of all calls of rgrasp."""
    stub = arguments[-1].parent / "bin" / "rgrasp"
    stub.parent.mkdir(exist_ok=True)
    stub.write_text(RGRASP)
    stub.chmod(0o755)
    calls = stub.with_name("calls")
    calls.write_text("")
    more = {name: str(value) for name, value in environment.items()}
    path = f"{stub.parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", PIPELINES / name, *arguments], capture_output=True, text=True, check=False,
        env=os.environ | more | {"PATH": path, "CALLS": str(calls)},
    )  # fmt: skip
    return done.returncode, done.stderr, calls.read_text().splitlines()


def refusal(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    script: Path,
    *words: object,
) -> str:
    """Message with which a Python script leaves, by exit code 2."""
    monkeypatch.setattr(sys, "argv", [script.name, *map(str, words)])
    monkeypatch.syspath_prepend(str(script.parent))
    capsys.readouterr()
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(script), run_name="__main__")
    assert left.value.code == 2
    return capsys.readouterr().err


def test_slurm_asks_for_gpus_by_the_rule_only() -> None:
    """The executor plugin refuses a job with --gpus in slurm_extra."""
    profile = yaml.safe_load((PIPELINES / "slurm" / "config.yaml").read_text())
    assert profile["set-resources"]["train_sdf"]["slurm_partition"] == "gpu"
    assert not any("slurm_extra" in each for each in profile["set-resources"].values())
    assert "gpu=GPUS" in (PIPELINES / "Snakefile").read_text()


def test_a_folder_of_data_may_have_a_space_in_its_name(tmp_path: Path) -> None:
    work = tmp_path / "my data"
    code, said, calls = run_script("train_sdf.sh", work)
    assert code == 0, said
    assert str(work / "colour.json") in calls
    assert calls.count("train-sdf") == 2


def test_a_success_network_of_another_reconstruction_is_trained_anew(tmp_path: Path) -> None:
    sdf, grasps, work = tmp_path / "sdf", tmp_path / "grasps", tmp_path / "work"
    sdf.mkdir()
    grasps.mkdir()
    asked = {"SDF": sdf, "VARIANTS": "geometry", "TABLE": "no"}
    for weights, trained in (("a", True), ("a", False), ("b", True)):
        (sdf / "model.safetensors").write_text(weights)
        code, said, calls = run_script("train_gs.sh", grasps, work, **asked)
        assert code == 0, said
        assert ("train-gs" in calls) == trained


def test_the_papers_script_refuses_test_meshes_that_are_not_there(tmp_path: Path) -> None:
    code, said, calls = run_script(
        "paper.sh", tmp_path / "work", TEST_MESHES=tmp_path / "ycv" / "x"
    )
    assert (code, calls) == (2, [])
    assert "ycv/x: no such folder" in said
    assert not (tmp_path / "work").exists()


def test_weights_are_checked_before_they_replace_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    good, success = tmp_path / "good", WEIGHTS / "panda_geometry"
    shutil.copytree(WEIGHTS / "pointsdf_real", good)
    export, mean = PIPELINES / "export_weights.py", PIPELINES / "average_weights.py"
    before = read_checkpoint(good).config
    assert "no architecture" in refusal(monkeypatch, capsys, export, success, good)
    assert "itself" in refusal(monkeypatch, capsys, export, good, good)
    for share in (1.5, "half"):
        assert "share" in refusal(monkeypatch, capsys, mean, good, good, share, good)
    new = tmp_path / "new"
    assert "other weights" in refusal(monkeypatch, capsys, mean, good, success, 0.5, new)
    assert "holds a checkpoint" in refusal(monkeypatch, capsys, mean, good, good, 0.5, good)
    assert read_checkpoint(good).config == before
    assert not new.exists()


def test_meshes_that_cannot_be_compared_are_no_leak(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = PIPELINES / "check_leaks.py"
    trimesh.creation.box((40, 60, 100)).export(tmp_path / "box.ply")
    folders = ["--train", tmp_path, "--test"]
    assert "no such folder" in refusal(monkeypatch, capsys, script, *folders, tmp_path / "tset")
    assert "--unit" in refusal(monkeypatch, capsys, script, *folders, tmp_path)
    monkeypatch.setattr(sys, "argv", [script.name, *map(str, folders), str(tmp_path), "--unit=mm"])
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(script), run_name="__main__")
    assert left.value.code == 1


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (BENCHMARKS / "table_views.py", "no such folder"),
        (BENCHMARKS / "real_depth.py", "holds no capture with truth.json"),
        (BENCHMARKS / "depth_errors.py", "holds no capture with truth.json"),
        (PIPELINES / "real_captures.py", "holds no capture"),
    ],
)
def test_a_missing_folder_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    script: Path, message: str,
) -> None:  # fmt: skip
    words = [tmp_path / "nowhere", *[tmp_path] * script.stem.count("depth")]
    assert message in refusal(monkeypatch, capsys, script, *words)


def test_distances_are_timed_of_meshes_in_folders(tmp_path: Path) -> None:
    meshes, labels = tmp_path / "meshes", tmp_path / "labels" / "cups" / "box.h5"
    (meshes / "cups").mkdir(parents=True)
    labels.parent.mkdir(parents=True)
    trimesh.creation.box((0.04, 0.06, 0.1)).export(meshes / "cups" / "box.ply")
    points = np.zeros((20, 3), np.float32)
    write_labels(labels, Labels(points, points[:, 0], "box.ply", "0" * 64), seed=0)
    timed = runpy.run_path(str(BENCHMARKS / "bench_render.py"))["bare_distances_per_second"]
    assert timed([meshes / "cups" / "box.ply"], meshes, tmp_path / "labels") > 0
