"""`rgrasp plan` as a user meets it: files, exit codes, reasons, with the bundled weights."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from safetensors.torch import load_file, save_file

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.cli.plan import plan as plan_command
from pointsdf_cli.cli.trial import trial as trial_command
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.io.clouds import Cloud, read_cloud, write_cloud
from pointsdf_cli.io.plans import plan_as_json, read_plan
from pointsdf_cli.planning.planner import MARGIN
from pointsdf_cli.viz.shading import look_at

TABLE = asset_path("clouds/table.ply")
MUG_AT = "0.62,0.28,0.05"
CARTON_AT = "0.6,-0.27,0.08"


def box_cloud(path: Path, size: tuple[float, float, float], x: float) -> Path:
    """A box standing at (x, 0) as a camera across the table sees it."""
    box = trimesh.creation.box(size)
    box.apply_translation((x, 0.0, size[2] / 2))
    T_world_camera = look_at((x + 0.9, 0.0, 0.6), (x, 0.0, size[2] / 2))
    camera = CAMERAS["kinect2"]
    vertices = np.asarray(box.vertices)
    patch = MeshCaster(vertices, box.faces, camera).cast(invert_transform(T_world_camera))
    points = camera.back_project(patch.u, patch.v, patch.depth)
    write_cloud(path, Cloud(points, frame="camera", T_world_camera=T_world_camera))
    return path


def reason_of(path: Path) -> str:
    plan = read_plan(path)
    assert plan.status == "no_plan"
    assert plan.sentence.endswith(".")
    assert not len(plan.trajectory)
    return plan.reason


def test_a_table_gets_a_plan_with_its_files(cli: Callable, tmp_path: Path) -> None:
    out, motion = tmp_path / "plan.h5", tmp_path / "motion.json"
    run = cli("plan", TABLE, "--out", out, "--trajectory", motion, "--json", "--target", CARTON_AT)
    assert run.code == 0, run.err
    plan = read_plan(out)
    told = json.loads(run.out)
    stored = json.loads(json.dumps(plan_as_json(plan)))
    assert {key: told[key] for key in stored} == stored
    assert told["report"]
    assert told["likely"] is True
    assert "kept" in run.err
    assert "begins at the robot's home" in run.err
    written = json.loads(motion.read_text())
    assert written["joint_names"] == list(plan.joint_names)
    assert len(written["points"]) == len(plan.times)
    np.testing.assert_allclose(written["points"][-1]["positions"], plan.q)
    assert Image.open(tmp_path / "plan.png").size[0] > 800
    # The hand is at the thing that was meant, not at the others half a metre away.
    where = [float(v) for v in CARTON_AT.split(",")]
    assert np.linalg.norm(plan.T_world_palm[:3, 3] - where) < 0.2
    # Nothing is overwritten unasked; equal seeds give equal plans.
    again = cli("plan", TABLE, "--out", out, "--no-picture", "--target", CARTON_AT)
    assert again.code == 2
    assert "--force" in again.err
    again = cli("plan", TABLE, "--out", out, "--no-picture", "--target", CARTON_AT, "--force")
    np.testing.assert_array_equal(read_plan(out).trajectory, plan.trajectory)


def test_any_object_is_the_one_that_can_be_taken_first(cli: Callable, tmp_path: Path) -> None:
    out = tmp_path / "plan.h5"
    run = cli("plan", TABLE, "--out", out, "--no-picture", "--target", "any")
    assert run.code in (0, 4), run.err
    tried = re.findall(r"object (\d) \(in reach, \d+% of the directions free\): (\w+)", run.err)
    (taken,) = re.findall(r"object (\d) is taken: the (first good grasp|best of all)", run.err)
    assert taken[0] in [number for number, _ in tried]
    # Another object that was given by its number gets the same plan.
    again = tmp_path / "again.h5"
    same = cli("plan", TABLE, "--out", again, "--no-picture", "--target", taken[0])
    assert same.code == run.code
    np.testing.assert_array_equal(read_plan(again).q, read_plan(out).q)


def test_another_target_is_another_plan(cli: Callable, tmp_path: Path) -> None:
    out = tmp_path / "plan.h5"
    run = cli("plan", TABLE, "--out", out, "--no-picture", "--target", MUG_AT)
    plan = read_plan(out)
    if run.code == 0:
        where = [float(v) for v in MUG_AT.split(",")]
        assert np.linalg.norm(plan.T_world_palm[:3, 3] - where) < 0.2
    else:
        assert (run.code, plan.reason) != (3, "no_object")


def test_a_bare_table_is_no_plan(cli: Callable, tmp_path: Path) -> None:
    whole = read_cloud(TABLE)
    assert whole.T_world_camera is not None
    world = apply_transform(whole.T_world_camera, whole.points)
    bare = replace(whole, points=whole.points[world[:, 2] < 0.004])
    write_cloud(tmp_path / "bare.ply", bare)
    out, motion = tmp_path / "plan.h5", tmp_path / "motion.json"
    motion.write_text("of yesterday")
    run = cli(
        "plan",
        tmp_path / "bare.ply",
        "--out",
        out,
        "--trajectory",
        motion,
        "--force",
        "--no-picture",
    )
    assert run.code == 3
    assert "no object" in run.err
    assert reason_of(out) == "no_object"
    assert not motion.exists()


def test_out_of_reach_is_said(cli: Callable, tmp_path: Path) -> None:
    path = box_cloud(tmp_path / "far.ply", (0.07, 0.07, 0.2), 1.5)
    run = cli("plan", path, "--out", tmp_path / "plan.h5", "--no-picture")
    assert run.code == 3
    assert reason_of(tmp_path / "plan.h5") == "inverse_kinematics"
    assert "nearer" in run.err
    # A plan that failed may be replaced, one that was found may not.
    near = box_cloud(tmp_path / "near.ply", (0.07, 0.07, 0.2), 0.6)
    again = ("plan", near, "--out", tmp_path / "plan.h5", "--no-picture")
    assert cli(*again).code == 0
    assert cli(*again).code == 2


def test_a_plan_that_failed_frees_no_other_files(cli: Callable, tmp_path: Path) -> None:
    path = box_cloud(tmp_path / "far.ply", (0.07, 0.07, 0.2), 1.5)
    words = ("plan", path, "--out", tmp_path / "plan.h5")
    assert cli(*words, "--no-picture").code == 3
    for option, name in (("--trajectory", "motion.json"), ("--picture", "other.png")):
        (tmp_path / name).write_text("of another plan")
        run = cli(*words, option, tmp_path / name)
        assert run.code == 2
        assert f"{name}: exists already" in run.err
        assert (tmp_path / name).read_text() == "of another plan"
    assert cli(*words).code == 3  # its own picture is new
    assert cli(*words).code == 3  # and replaced


def test_a_cloud_placed_on_its_table_has_no_motion(cli: Callable, tmp_path: Path) -> None:
    scene = read_cloud(TABLE)
    write_cloud(tmp_path / "scene.ply", replace(scene, over_table=True))
    out, motion = tmp_path / "plan.h5", tmp_path / "motion.json"
    run = cli("plan", tmp_path / "scene.ply", "--out", out, "--trajectory", motion)
    assert run.code == 2
    assert "would miss the object" in run.err
    assert not out.exists()


def test_a_folder_is_no_plan_with_a_picture(cli: Callable) -> None:
    run = cli("plan", TABLE, "--out", ".")
    assert run.code == 2
    assert "result.h5" in run.err


def test_larger_than_the_hand_is_said(cli: Callable, tmp_path: Path) -> None:
    path = box_cloud(tmp_path / "chest.ply", (0.35, 0.5, 0.4), 0.75)
    run = cli("plan", path, "--out", tmp_path / "plan.h5", "--no-picture")
    assert run.code == 3, run.out
    assert reason_of(tmp_path / "plan.h5") == "object_collision"
    assert "larger than the" in run.err


def test_under_a_shelf_is_said(cli: Callable, tmp_path: Path) -> None:
    path = box_cloud(tmp_path / "box.ply", (0.06, 0.06, 0.12), 0.6)
    shelf = tmp_path / "shelf.yaml"
    shelf.write_text(
        "obstacles:\n"
        "  - {name: board, box: [0.6, 1.2, 0.02], xyz: [0.62, 0, 0.14]}\n"
        "  - {name: front, box: [0.02, 1.2, 0.13], xyz: [0.45, 0, 0.066]}\n"
    )
    out = tmp_path / "plan.h5"
    run = cli("plan", path, "--out", out, "--no-picture", "--environment", shelf, "--json")
    assert run.code == 3
    assert reason_of(out) == "table_collision"
    assert "obstacle" in read_plan(out).sentence
    assert json.loads(run.out)["q"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--method", "guess"], "reconstruction, partial-view"),
        (["--solver", "newton"], "sqp, slsqp"),
        (["--kind", "below"], "auto, side, top"),
        (["--target", "1,2"], "X,Y,Z"),
        (["--start", "1,2,3"], "--start"),
        (["--clearance", "-1"], "--clearance"),
        (["--clearance", "0.5"], "at most"),
        (["--min-success", "2"], "--min-success"),
        (["--segment", "maybe"], "auto, none"),
        (["--obstacles", "boxes"], "reconstruction, hull"),
        (["--workspace", "1,2"], "X0,Y0,Z0,X1,Y1,Z1"),
        (["--workspace", "1,0,0,0,1,1"], "the lower corner first"),
        (["--workspace", "0,0,0,1,1,1", "--segment", "none"], "--segment auto"),
        (["--speed", "0"], "--speed"),
        (["--speed", "1.5"], "0.001 to 1"),
        (["--environment", "none.yaml"], "no such environment file"),
        (["--camera-pose", "1,2"], "--camera-pose"),
        (["--frame", "moon"], "camera, world"),
        (["--robot", "none.yaml"], "no such robot file"),
        (["--checkpoint", "nowhere"], "nowhere"),
        (["--out", "."], "result.h5"),
        (["--camera-pose", "table", "--trajectory", "m.json"], "would miss the object"),
    ],
)
def test_bad_options_are_refused(
    cli: Callable, tmp_path: Path, arguments: list[str], words: str
) -> None:
    run = cli("plan", TABLE, "--out", tmp_path / "plan.h5", "--no-picture", *arguments)
    assert run.code == 2, run.err
    assert words in run.err
    assert not (tmp_path / "plan.h5").exists()


def test_every_output_has_a_place_of_its_own(cli: Callable, tmp_path: Path) -> None:
    out, both = tmp_path / "plan.png", tmp_path / "p.h5"
    for arguments in (
        ["--picture", out, "--trajectory", out],
        ["--out", both, "--trajectory", both],
    ):
        run = cli("plan", TABLE, *arguments)
        assert run.code == 2
        assert "one path" in run.err
    run = cli("plan", TABLE, "--out", out)  # other commands would not know it for a plan
    assert run.code == 2
    assert "plan.h5" in run.err
    assert not list(tmp_path.iterdir())


def test_no_motion_of_another_plan_stays(cli: Callable, tmp_path: Path) -> None:
    out, motion, picture = (tmp_path / name for name in ("p.h5", "m.json", "p.png"))
    motion.write_text("another plan's")
    picture.write_text("another plan's")
    scene = read_cloud(TABLE)
    bare = replace(scene, points=scene.points[:60])
    write_cloud(tmp_path / "bare.ply", bare)
    run = cli("plan", tmp_path / "bare.ply", "--out", out, "--trajectory", motion, "--force")
    assert run.code == 3
    assert not motion.exists()
    assert not picture.exists() or picture.read_bytes()[:4] == b"\x89PNG"
    picture.write_text("another plan's")
    run = cli("plan", tmp_path / "bare.ply", "--out", out, "--force", "--no-picture")
    assert f"{picture} was there before and does not show this plan" in run.err
    assert picture.read_text() == "another plan's"
    # Where a link leads to, no other plan's motion stays either.
    stored = tmp_path / "stored.json"
    stored.write_text("another plan's")
    motion.symlink_to(stored)
    cli("plan", tmp_path / "bare.ply", "--out", out, "--trajectory", motion, "--force", "-q")
    assert motion.is_symlink()
    assert not stored.exists()


def test_a_cloud_without_a_pose_is_refused(cli: Callable, tmp_path: Path) -> None:
    cloud = read_cloud(TABLE)
    write_cloud(tmp_path / "lost.ply", Cloud(cloud.points, frame="camera"))
    run = cli("plan", tmp_path / "lost.ply", "--out", tmp_path / "plan.h5")
    assert run.code == 2
    assert "--camera-pose" in run.err


@pytest.mark.parametrize("command", [plan_command, trial_command])
def test_the_commands_margin_is_the_planners(command: Callable[..., object]) -> None:
    # Commands state it themselves: importing the planner would make --help slow.
    assert signature(command).parameters["margin"].default == MARGIN


def test_a_plan_that_is_not_likely_to_hold_has_a_code_of_its_own(
    cli: Callable, tmp_path: Path
) -> None:
    # The bundled success network, made as doubtful as one of a difficult object.
    doubtful = tmp_path / "doubtful"
    shutil.copytree(asset_path("weights/grasp_geometry"), doubtful)
    weights = load_file(doubtful / "model.safetensors")
    weights["network.calibration.shift"] = weights["network.calibration.shift"] - 5.5
    save_file(weights, doubtful / "model.safetensors")
    out = tmp_path / "plan.h5"
    words = ("plan", asset_path("clouds/mug.ply"), "--grasp-checkpoint", doubtful, "--out", out)
    words += ("--no-picture", "--force", "--threads", 1, "-q")
    codes = {}
    for more in ((), ("--accept-unlikely",)):
        run = cli(*words, *more)
        codes[more] = run.code
        if not more:
            assert "not likely to hold: probability 0.0" in run.err
            assert "--accept-unlikely" in run.err
            assert 0.03 < read_plan(out).success_probability < 0.1  # written all the same
    assert list(codes.values()) == [4, 0]
