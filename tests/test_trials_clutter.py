"""Trials in clutter: what stands around the target, and whether it still stands in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trial_rows import ROW
from trial_worlds import CAN_AT, can_grasp

from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.trials import read_trial, read_trials
from pointsdf_cli.planning.table_top import label_table
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.lift import lift_path
from pointsdf_cli.simulation.observe import Observer
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.clutter import (
    GAP,
    MOVED,
    Standing,
    along,
    disturbance,
    level_corners,
    level_gap,
    look,
    place_neighbours,
    target_number,
)
from pointsdf_cli.trials.execution import execute_plan
from pointsdf_cli.trials.protocol import (
    PlannerVariant,
    Trial,
    choose_objects,
    clutter_pool,
    make_trials,
)
from pointsdf_cli.trials.scenes import load_object, place_camera, place_object
from pointsdf_cli.trials.summary import summarise

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    trimesh.creation.cylinder(0.03, 0.15).export(folder / "can.ply")
    trimesh.creation.box((0.05, 0.07, 0.1)).export(folder / "box.ply")
    trimesh.creation.box((0.12, 0.04, 0.06)).export(folder / "brick.ply")
    trimesh.creation.cylinder(0.04, 0.05).export(folder / "tin.ply")
    return folder


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = World(load_robot())
    yield made
    made.close()


def trials(meshes: Path, clutter: int, seed: int = 0, yaws: int = 1) -> list[Trial]:
    return make_trials(
        choose_objects(meshes, "can"),
        [PlannerVariant("reconstruction"), PlannerVariant("partial-view")],
        yaws,
        seed=seed,
        clutter=clutter,
        pool=clutter_pool(meshes),
    )


def standing(world: World, trial: Trial) -> list[Standing]:
    """The target and its neighbours."""

    def load(item: Any) -> SimObject:
        return load_object(item)

    target = place_object(world, load(trial.object), trial)[:2]
    return [target, *place_neighbours(world, target, trial, load)]


def test_others_are_drawn_by_scene_and_are_never_the_target(meshes: Path) -> None:
    made = trials(meshes, 2, yaws=4)
    for trial in made:
        names = [other.name for other in trial.others]
        assert len(set(names)) == 2
        assert "can" not in names
    # Cameras and variants share a scene, yaws do not.
    scenes = {trial.scene_name: trial.others for trial in made}
    assert all(trial.others == scenes[trial.scene_name] for trial in made)
    assert len(set(scenes.values())) > 1
    with pytest.raises(InputError, match="--clutter"):
        trials(meshes, 4)


def test_neighbours_stand_near_the_target_and_apart_and_are_equal_by_seed(
    world: World, meshes: Path
) -> None:
    trial, other_seed = trials(meshes, 3)[0], trials(meshes, 3, seed=1)[0]
    made = standing(world, trial)
    outlines = [along(level_corners(*one)) for one in made]
    for k, one in enumerate(outlines):
        for other in outlines[:k]:
            assert level_gap(one, other) >= GAP[0]
    for one in outlines[1:]:
        assert level_gap(one, outlines[0]) <= GAP[1]
    for item, pose in made:
        low = (item.mesh.vertices @ pose[2, :3] + pose[2, 3]).min()
        assert low == pytest.approx(0.0, abs=0.002)
    for (_, first), (_, second) in zip(made, standing(world, trial), strict=True):
        np.testing.assert_array_equal(first, second)
    assert any(
        not np.allclose(first, second)
        for (_, first), (_, second) in zip(made[1:], standing(world, other_seed)[1:], strict=True)
    )


def test_gaps_of_outlines_are_those_of_the_bodies() -> None:
    square = np.array([[x, y] for x in (-0.02, 0.0, 0.02) for y in (-0.02, 0.0, 0.02)])
    assert level_gap(square, square + [0.1, 0.0]) == pytest.approx(0.06)
    assert level_gap(square, square + [0.03, 0.01]) == 0.0
    assert level_gap(square * 3, square) == 0.0  # one within the other


def test_the_target_is_numbered_as_it_is_listed(world: World, meshes: Path) -> None:
    trial = trials(meshes, 2)[0]
    made = standing(world, trial)
    robot = load_robot()
    observer = Observer(robot)
    pose = place_camera(*made[0], trial)
    depth = observer.depth(made, pose, np.random.default_rng(0))
    cloud = cloud_of_depth(depth, observer.placement.camera, pose)
    numbers = {target_number(cloud, made[k:] + made[:k], robot) for k in range(3)}
    assert numbers == {1, 2, 3}
    # What stands behind the camera is not seen.
    away = made[0][0], transform(np.eye(3), [3.0, 0.0, 0.075])
    assert target_number(cloud, [away, *made], robot) is None
    assert target_number(cloud, [away], robot) is None  # nor are objects that nobody placed


@pytest.mark.parametrize("cleaned", [True, False])
def test_the_target_is_numbered_in_the_view_that_it_is_looked_for_in(
    cleaned: bool, world: World, meshes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def label(*args: object, **options: object) -> object:
        asked.append(options["cleaned"])
        return label_table(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("pointsdf_cli.trials.clutter.label_table", label)
    trial = trials(meshes, 2)[0]
    made, robot = standing(world, trial), load_robot()
    pose = place_camera(*made[0], trial)
    view, _ = look(Observer(robot), robot, made, pose, np.random.default_rng(0), cleaned)
    assert asked == [cleaned]
    middle = np.median(view.in_world, axis=0)
    assert np.linalg.norm((middle - made[0][1][:3, 3])[:2]) < 0.05


def test_a_neighbour_in_the_way_is_disturbed_and_one_aside_is_not(
    world: World, meshes: Path
) -> None:
    can = load_object(choose_objects(meshes, "can")[0])
    there = transform(np.eye(3), [*CAN_AT, 0.0752])
    path = np.array([can_grasp(shift=(0, y, 0)) for y in (-0.06, -0.03, 0.0)])
    aside = can, transform(np.eye(3), [CAN_AT[0] + 0.2, 0.2, 0.0752])
    # The hand comes from there.
    in_the_way = can, transform(np.eye(3), [CAN_AT[0] - 0.02, -0.1, 0.0752])
    found = []
    for other in (aside, in_the_way):
        lift = lift_path(world.chain, path[-1])
        assert lift is not None
        times = np.linspace(0.0, 1.0, 3)
        done = execute_plan(world, can, there, path, times, lift, others=[other])
        found.append(disturbance([other], [one.pose() for one in world.others]))
        assert done.moments[-1].T_world_others.shape == (1, 4, 4)
    assert not found[0].disturbed
    assert found[0].largest_move < 0.002
    assert found[1].disturbed
    assert found[1].largest_move > MOVED


def test_what_tips_over_in_its_place_is_disturbed(meshes: Path) -> None:
    can = load_object(choose_objects(meshes, "can")[0])
    upright = transform(np.eye(3), [0.6, 0.0, 0.01])
    lying = transform([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [0.6, 0.0, 0.01])
    found = disturbance([(can, upright)], [lying])
    assert found.disturbed
    assert found.largest_move == pytest.approx(0.0, abs=1e-9)
    turned = transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.615, 0.0, 0.01])
    found = disturbance([(can, upright)], [turned])
    assert not found.disturbed
    assert found.largest_move == pytest.approx(0.015)


def test_a_trial_that_disturbs_is_no_success() -> None:
    rows = [replace(ROW, clutter=1), replace(ROW, yaw_index=1, clutter=1, disturbed=True)]
    (summary,) = summarise(rows)
    assert (summary.held.successes, summary.held.trials) == (2, 2)
    assert (summary.succeeded.successes, summary.succeeded.trials) == (1, 2)


def test_a_trial_in_clutter_from_the_folder_to_the_report(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "trials"
    run = (
        *("trial", "--meshes", meshes, "--objects", "can", "--out", out, "--clutter", 1),
        *("--method", "reconstruction", "--yaws", 1, "--cameras", "high"),
        *("--pictures", 1, "--jobs", 1, "--quiet"),
    )
    result = cli(*run)
    assert result.code == 0, result.err
    (row,) = read_trials(out / "trials.h5")
    assert row.clutter == 1
    assert row.succeeded == (row.held and not row.disturbed)
    (file,) = (out / "trials").glob("*.h5")
    again, evidence = read_trial(file)
    assert (again.status, again.largest_move) == (row.status, row.largest_move)
    assert evidence.T_world_others.shape == (len(evidence.q), 1, 4, 4)
    moved = evidence.T_world_others[[0, -1], 0, :3, 3]
    assert row.status != "ok" or np.linalg.norm(moved[1] - moved[0]) == pytest.approx(
        row.largest_move, abs=0.01
    )
    # The planner took the neighbour for something that stands where it does.
    believed = evidence.obstacle_vertices
    place = evidence.T_world_others[0, 0, :2, 3]
    assert len(believed)
    assert np.linalg.norm(believed[:, :2] - place, axis=1).min() < 0.06
    assert "In clutter" in (out / "report.md").read_text(encoding="utf-8")
    refused = cli(*run[:5], "--out", out, "--clutter", 9)
    assert refused.code == 2
    assert "--clutter" in refused.err
