"""`plan --each` and `mesh --each`: many inputs, one file each, resumable."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import run_cli
from test_cli_mesh import POINTS, constant_network

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import Cloud, read_cloud, write_cloud
from pointsdf_cli.io.plans import read_plan
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.mesh_choices import MeshChoices
from pointsdf_cli.planning.object_view import MeshSettings
from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest
from pointsdf_cli.service.each_mesh import MeshTask
from pointsdf_cli.service.each_plan import PlanTask
from pointsdf_cli.service.identity import PlannerFiles
from pointsdf_cli.service.plan_settings import PlanSettings

MUG = asset_path("clouds/mug.ply")


def far_scene(path: Path) -> Path:
    """The mug half a metre beyond the arm's reach."""
    mug = read_cloud(MUG)
    assert mug.T_world_camera is not None
    pose = mug.T_world_camera.copy()
    pose[0, 3] += 0.8
    write_cloud(path, Cloud(mug.in_camera_frame()[0], frame="camera", T_world_camera=pose))
    return path


def test_every_scene_is_planned_by_itself_and_kept(tmp_path: Path) -> None:
    scenes, plans = tmp_path / "scenes", tmp_path / "plans"
    scenes.mkdir()
    shutil.copy(MUG, scenes / "near.ply")
    far_scene(scenes / "far.ply")
    (scenes / "none.ply").write_text("not a cloud")
    words = ["--each", "--out", plans, "--jobs", "1", "--no-picture"]
    run = run_cli("plan", *sorted(scenes.glob("*.ply")), *words)
    assert run.code == 2  # one input cannot be used; the others are done
    assert "none.ply" in run.err
    assert sorted(path.name for path in plans.iterdir()) == ["far.h5", "near.h5"]
    near, far = read_plan(plans / "near.h5"), read_plan(plans / "far.h5")
    assert near.status == "ok"
    assert (far.status, far.reason) == ("no_plan", "inverse_kinematics")
    written = {path: path.stat().st_mtime_ns for path in plans.iterdir()}

    (scenes / "none.ply").unlink()
    again = run_cli("plan", *sorted(scenes.glob("*.ply")), *words, "--json")
    assert again.code == 3  # as a run that was never interrupted
    told = json.loads(again.out)
    assert (told["made"], told["kept"]) == (0, 2)
    assert told["plans"]["near"]["success_probability"] == near.success_probability
    assert {path: path.stat().st_mtime_ns for path in plans.iterdir()} == written
    assert run_cli("plan", *scenes.glob("*.ply"), *words, "--skip-bad").code == 0
    other = run_cli("plan", *scenes.glob("*.ply"), *words, "--margin", "0.002")
    assert other.code == 2
    assert "margin: 0.004 there, 0.002 now" in other.err

    alone = tmp_path / "alone.h5"
    assert run_cli("plan", scenes / "near.ply", "--out", alone, "--no-picture").code == 0
    np.testing.assert_array_equal(read_plan(alone).trajectory, near.trajectory)


def test_each_option_and_file_of_a_plan_is_part_of_its_record(tmp_path: Path) -> None:
    """What a plan depends on must change its record: else a rerun keeps the old plan."""
    pose, camera, mask = (tmp_path / name for name in ("pose.json", "K.json", "mask.png"))
    for file in (pose, camera, mask):
        file.write_text("first")
    files = SceneFileOptions(intrinsics=str(camera), mask=f"{mask}:7")
    settings = PlanSettings(PlanRequest(), None, PlannerFiles())
    task = PlanTask(MUG, files, str(pose), tmp_path / "out.h5", None, settings)
    mesh = MeshTask(MUG, files, str(pose), tmp_path / "out.ply", MeshSettings(MeshChoices()))
    others: dict[str, object] = {
        "choices": PlanChoices(margin=0.003),
        "environment": Environment(table=False),
        "start": np.zeros(23),
        "seed": 1,
        "segment": "none",
        "others": False,
        "workspace": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        "cleaned": False,
        "obstacles": "hull",
    }
    # Clouds, names and target come from the scene's own files, which are there by content.
    assert others.keys() | {"clouds", "names", "target"} == vars(PlanRequest()).keys()
    for name, value in others.items():
        request = replace(PlanRequest(), **{name: value})
        other = replace(task, settings=replace(settings, request=request))
        assert other.config() != task.config(), name
    started = MeshSettings(MeshChoices(), start=np.zeros(23))
    assert replace(mesh, settings=started).config() != mesh.config()
    for file in (pose, camera, mask):
        before = task.config(), mesh.config()
        file.write_text("second")
        assert task.config() != before[0], file
        assert mesh.config() != before[1], file


@pytest.mark.parametrize(
    "words",
    [
        ["plan", MUG, "--each", "--trajectory", "motion.json"],
        ["plan", MUG, "--each", "--picture", "plan.png"],
        ["plan", MUG, "--each", "--server", "http://127.0.0.1:1"],
        ["plan", MUG, "{}/mug.ply", "--each"],
        ["plan", MUG, "--each", "--camera-pose", "table", "--camera-pose", "table"],
        ["mesh", MUG, "--each", "--picture", "mesh.png"],
        ["mesh", MUG, "{}/mug.ply", "--each"],
        ["mesh", MUG, "{}/mug.ply"],
        ["mesh", MUG, "--each", "--format", "doc"],
    ],
)
def test_what_names_one_file_does_not_go_with_many(words: list[object], tmp_path: Path) -> None:
    shutil.copy(MUG, tmp_path / "mug.ply")
    typed = [str(word).format(tmp_path) for word in words]
    run = run_cli(*typed, "--out", tmp_path / "out")
    assert run.code == 2, run.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["plan", "mesh"])
@pytest.mark.parametrize("words", [["--jobs", "0"], ["-j", "2"], ["--skip-bad"]])
def test_what_is_for_many_does_not_go_with_one(
    command: str, words: list[str], tmp_path: Path
) -> None:
    run = run_cli(command, MUG, *words, "--out", tmp_path / "one.ply")
    assert run.code == 2
    assert "without --each" in run.err
    assert not [*tmp_path.iterdir()]


def test_a_start_that_cannot_be_used_is_said_once_and_its_file_is_kept(tmp_path: Path) -> None:
    for name in ("a", "b"):
        shutil.copy(asset_path("clouds/table.ply"), tmp_path / f"{name}.ply")
    clouds, out = sorted(tmp_path.glob("*.ply")), tmp_path / "meshes"
    words = ["--each", "--segment", "auto", "--jobs", "1", "--start"]
    run = run_cli("mesh", *clouds, "--out", out, *words, "0,9")
    assert run.code == 2
    assert run.err.count("--start") == 1
    assert not out.exists()
    start = tmp_path / "a.json"  # where the record of a.stl would be
    start.write_text("[0, 0, 0, 0, 0, 0, 0]")
    run = run_cli("mesh", clouds[0], "--out", tmp_path, "--format", "stl", *words, start)
    assert run.code == 2
    assert start.read_text() == "[0, 0, 0, 0, 0, 0, 0]"


def test_every_cloud_is_meshed_by_itself_and_kept(tmp_path: Path) -> None:
    network = constant_network(tmp_path / "inside", -0.2)
    for k in range(3):
        shift = np.eye(4)
        shift[:3, 3] = 0.02 * k, 0.0, 0.0
        write_cloud(tmp_path / f"cloud{k}.ply", Cloud(apply_transform(shift, POINTS)))
    clouds, out = sorted(tmp_path.glob("cloud*.ply")), tmp_path / "meshes"
    options = ["--checkpoint", network, "--resolution", "32", "--format", "stl"]
    words = ["--each", "--out", out, *options]
    first = run_cli("mesh", *clouds[:2], *words, "--jobs", "1")
    assert first.code == 0, first.err
    before = (out / "cloud0.stl").stat().st_mtime_ns
    second = run_cli("mesh", *clouds, *words, "--jobs", "2", "--json")
    told = json.loads(second.out)
    assert (told["made"], told["kept"]) == (1, 2)
    assert (out / "cloud0.stl").stat().st_mtime_ns == before
    alone = tmp_path / "alone.stl"
    assert run_cli("mesh", clouds[2], *options, "--out", alone).code == 0
    assert alone.read_bytes() == (out / "cloud2.stl").read_bytes()

    other = run_cli("mesh", *clouds, *words, "--smooth", "3")
    assert other.code == 2
    assert "smooth" in other.err
    (out / "cloud0.json").unlink()  # nothing says how it was made
    assert run_cli("mesh", *clouds, *words).code == 2
    assert run_cli("mesh", *clouds, *words, "--force", "--jobs", "1").code == 0
    assert json.loads((out / "cloud0.json").read_text())["config"]["smooth"] == 25

    whole = (out / "cloud0.stl").read_bytes()
    (out / "cloud0.stl").write_bytes(whole[:-100])
    damaged = run_cli("mesh", *clouds, *words, "--jobs", "1")
    assert damaged.code == 2
    assert "cloud0.stl: is not as it was written" in damaged.err
    assert run_cli("mesh", *clouds, *words, "--jobs", "1", "--force").code == 0
    assert (out / "cloud0.stl").read_bytes() == whole
