"""Scenes that cannot be: what a person would say about them at a glance."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_planning_table_top import POSE, TABLE, THINGS, cloud, sheet

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.geometry.visibility import ViewEvidence, visibility_image
from pointsdf_cli.io.clouds import read_cloud, write_cloud
from pointsdf_cli.planning.object_choice import reach_of
from pointsdf_cli.planning.plausibility import (
    below_table,
    from_inside,
    in_parts,
    in_the_air,
    outside_workspace,
    require_table_at_zero,
    scene_warnings,
    seen_through,
    table_elsewhere,
)
from pointsdf_cli.planning.table_top import label_table, look_at_table
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.shading import look_at
from tests import scenes

BOX = sheet((0.6, 0.0, 0.05), (0.04, 0.04, 0.05))


def view(world: np.ndarray, T_world_camera: np.ndarray = POSE) -> View:
    return View(apply_transform(invert_transform(T_world_camera), world), T_world_camera)


def ball(centre: np.ndarray, radius: float, eye: np.ndarray, inner: bool) -> np.ndarray:
    """The half of a sphere that is turned to the eye, or the half behind it, seen from inside."""
    k = np.arange(2000) + 0.5
    polar, turn = np.arccos(1 - k / 1000), np.pi * (1 + 5**0.5) * k
    normals = np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )
    towards = normals @ (eye - centre) > 0
    return centre + radius * normals[towards != inner]


def test_a_usual_scene_is_believed() -> None:
    assert scene_warnings([view(BOX)]) == []
    assert table_elsewhere(np.concatenate([TABLE, THINGS])) is None
    assert table_elsewhere(BOX) is None  # a cloud that was cut out
    chest = sheet((0.75, 0.0, 0.2), (0.175, 0.25, 0.2))  # its top is as wide as a table
    assert table_elsewhere(chest[chest[:, 2] > 0.001]) is None
    require_table_at_zero([np.concatenate([TABLE, THINGS])], ["a"])


def test_a_camera_below_the_table_is_doubted() -> None:
    up = look_at((1.2, 0.0, -0.5), (0.6, 0.0, 0.05))
    said = below_table(view(BOX, up), 0.0)
    assert "50 cm below the table" in said
    assert said in scene_warnings([view(BOX), view(BOX, up)])
    assert (
        scene_warnings([view(BOX, up)], table=None) == []
    )  # without a table there is none to be below
    assert below_table(view(BOX), 0.0) == ""


def test_an_object_in_the_air_is_doubted() -> None:
    assert "40 cm above the table" in in_the_air([view(BOX + [0, 0, 0.4])], 0.0)
    assert in_the_air([view(BOX + [0, 0, 0.4])], 0.4) == ""
    # Of a tall thing a camera straight above sees the top alone.
    top = BOX[BOX[:, 2] > 0.099] + [0, 0, 0.2]
    overhead = look_at((0.6, 0.001, 1.2), (0.6, 0.0, 0.0))
    assert in_the_air([view(top, overhead)], 0.0) == ""
    assert in_the_air([view(top), view(top, overhead)], 0.0) != ""


def test_warnings_begin_at_their_bounds() -> None:
    for off, doubted in ((0.007, False), (0.013, True)):
        up = look_at((1.2, 0.0, -off), (0.6, 0.0, 0.05))
        assert bool(below_table(view(BOX, up), 0.0)) == doubted
    for off, doubted in ((0.07, False), (0.09, True)):
        assert bool(in_the_air([view(BOX + [0, 0, off])], 0.0)) == doubted
    for gap, doubted in ((0.04, False), (0.11, True)):
        pair = np.concatenate([BOX, BOX + [0, 0.08 + gap, 0]])
        assert bool(in_parts(pair)) == doubted


def test_the_inside_of_a_ball_is_doubted_and_its_outside_is_not() -> None:
    centre, eye = np.array([0.6, 0.0, 0.05]), POSE[:3, 3]
    assert from_inside(view(ball(centre, 0.05, eye, inner=False))) == ""
    level = look_at((1.5, 0.0, 0.1), centre)
    inside = ball(centre, 0.05, level[:3, 3], inner=True)
    assert "bulge away from the camera" in from_inside(view(inside, level))
    # The same shape seen from above is a bowl.
    above = look_at((0.65, 0.0, 0.9), centre)
    assert from_inside(view(ball(centre, 0.05, above[:3, 3], inner=True), above)) == ""
    assert from_inside(view(BOX)) == ""
    within = look_at(centre, centre + [0.1, 0, 0])
    half = ball(centre, 0.05, centre + [1.0, 0, 0], inner=False)
    assert "stands within the object" in from_inside(view(half, within))


def test_three_things_are_not_one_object() -> None:
    three = np.concatenate([BOX + [0, y, 0] for y in (-0.25, 0.0, 0.25)])
    assert "3 parts up to 50 cm apart" in in_parts(three)
    assert "--segment auto" in in_parts(three)
    assert in_parts(BOX) == ""
    handle = BOX[:60] + [0, 0.1, 0]  # as large as a speck: nothing to speak of
    assert in_parts(np.concatenate([np.repeat(BOX, 3, axis=0), handle])) == ""


@pytest.mark.parametrize("height", [-0.3, 0.1, 0.4])
def test_a_table_at_another_height_names_the_pose(height: float) -> None:
    scene = np.concatenate([TABLE, THINGS]) + [0.0, 0.0, height]
    assert table_elsewhere(scene) == pytest.approx(height, abs=0.002)
    with pytest.raises(InputError, match=f"z = {1000 * height:.0f} mm(.|\n)*--camera-pose"):
        require_table_at_zero([scene], ["a"])


@pytest.mark.parametrize(("shift", "doubted"), [(0.0, False), (0.05, True)])
def test_cameras_that_do_not_see_the_same_are_doubted(shift: float, doubted: bool) -> None:
    left, right = (
        look_at((1.0, -0.5, 0.6), (0.6, 0, 0.05)),
        look_at((1.0, 0.5, 0.6), (0.6, 0, 0.05)),
    )
    views = []
    for pose, off in ((left, 0.0), (right, shift)):
        depth = scenes.seen(scenes.table(), scenes.box((0.06, 0.08, 0.1), (0.6, off)), pose=pose)
        seen = look_at_table([scenes.cloud(depth, pose)], ["a"], load_robot(), load_robot().home)
        views += seen.views
    assert bool(seen_through(views)) == doubted
    assert bool([one for one in scene_warnings(views) if "saw past" in one]) == doubted


def test_points_beside_the_other_cameras_window_were_not_seen_past() -> None:
    rng = np.random.default_rng(0)
    patch = np.column_stack([rng.uniform(-0.02, 0.02, (500, 2)), np.full(500, 1.0)])
    side = np.linspace(-0.2, 0.2, 400)
    wall = np.stack(np.meshgrid(side, side, [2.0]), axis=-1).reshape(-1, 3)
    wall = wall[(np.abs(wall[:, :2]) > 0.05).any(axis=1)]
    image = visibility_image(patch, wall, None, 1 / 500)
    one = View(patch, np.eye(4), ViewEvidence(image))
    left, top, wide, high = image.window
    within = np.tile([left + 0.02 * wide, top + 0.5 * high, 1.0], (30, 1))
    beside = np.tile([left - 0.5, 0.0, 1.0], (970, 1))
    assert seen_through([one, View(np.concatenate([within, beside]), np.eye(4))]) == ""
    assert "100%" in seen_through([one, View(within, np.eye(4))])


def test_a_large_plane_that_is_no_table_is_refused() -> None:
    scene = np.concatenate([TABLE, THINGS])
    in_camera = apply_transform(invert_transform(POSE), scene)  # called --frame world
    steep = look_at((1.2, 0.0, 0.9), (0.6, 0.0, 0.0))
    rolled = apply_transform(steep, apply_transform(invert_transform(steep), scene) * [-1, -1, 1])
    for world in (in_camera, rolled):
        with pytest.raises(InputError, match=r"(?s)tilted by \d+°, and no level table.*--frame"):
            require_table_at_zero([world], ["a"])
    wall = sheet((1.2, 0.0, 0.5), (0.0, 0.6, 0.45))
    table = sheet((0.9, 0.0, 0.0), (0.1, 0.1, 0.0))  # too little of it to be found
    require_table_at_zero([np.concatenate([wall, table, BOX + [0.3, 0, 0]])], ["a"])
    require_table_at_zero([BOX], ["a"])


@pytest.mark.parametrize(
    ("tilt", "off", "said"),
    [
        (2.0, 0.0, ""),
        (5.0, 0.0, "tilted by 5°"),
        (10.0, 0.0, "tilted by 10°"),
        (0.0, 0.03, ""),
        (0.0, 0.05, "z = 50 mm"),
        (0.0, -3.0, "below z = 0"),
    ],
)
def test_a_tilted_or_missing_table_is_refused(tilt: float, off: float, said: str) -> None:
    angle = np.deg2rad(tilt)
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    world = np.concatenate([TABLE, THINGS]) @ turn.T + [0.0, 0.0, off]
    if not said:
        require_table_at_zero([world], ["a"])
        return
    with pytest.raises(InputError, match=said):
        require_table_at_zero([world], ["a"])


def test_a_table_at_another_height_is_said_before_the_planning(
    cli: Callable[..., Any], tmp_path: Path
) -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]) + [0.0, 0.0, 0.1])
    write_cloud(tmp_path / "a.ply", scene)
    began = time.process_time()
    run = cli("plan", tmp_path / "a.ply", "--out", tmp_path / "p.h5", "--no-picture")
    assert run.code == 2
    assert "a table is seen at z = 100 mm" in run.err
    assert time.process_time() - began < 10
    assert not (tmp_path / "p.h5").exists()
    for command, without in ((["segment"], "nothing to list"), (["mesh"], "--segment none")):
        out = [] if command == ["segment"] else ["--segment", "auto", "--out", tmp_path / "a.obj"]
        run = cli(*command, tmp_path / "a.ply", *out)
        assert run.code == 2
        assert "a table is seen at z = 100 mm" in run.err
        assert without in run.err


def test_what_hangs_outside_the_workspace_is_told() -> None:
    """A shelf of 70 × 100 cm, 2 cm above the workspace, and one beyond the arm's reach."""
    scene, robot = read_cloud(asset_path("clouds/table.ply")), load_robot()
    points, _ = scene.in_camera_frame()
    x, y = np.meshgrid(np.linspace(0, 0.7, 150), np.linspace(-0.5, 0.5, 150))
    shelf = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.62)], axis=1)

    def told(more: np.ndarray) -> str:
        assert scene.T_world_camera is not None
        added = apply_transform(invert_transform(scene.T_world_camera), more)
        seen = np.concatenate([points, added])
        view = label_table(replace(scene, points=seen, frame="camera"), "it", robot, robot.home)
        return outside_workspace([view], reach_of(robot))

    assert told(np.zeros((0, 3))) == ""
    assert "0.62 m is within the arm's reach" in told(shelf + [0.2, 0, 0])
    assert told(shelf + [0.2, 1.6, 0]) == ""
