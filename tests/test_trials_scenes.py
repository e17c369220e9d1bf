"""Scenes of trials: what stands in a shop stands on the table, where and how the protocol says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.protocol import (
    METHODS,
    PlannerVariant,
    TrialObject,
    choose_objects,
    clutter_pool,
    make_trials,
)
from pointsdf_cli.trials.scenes import (
    CAMERA_DISTANCE,
    LOOK_HEIGHT,
    load_object,
    place_camera,
    place_object,
)

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = World(load_robot())
    yield made
    made.close()


def test_between_the_wings_of_a_biplane_there_is_room(tmp_path: Path) -> None:
    wings = [trimesh.creation.box([0.2, 0.06, 0.008], transform([0, 0, z])) for z in (0.0, 0.06)]
    struts = [
        trimesh.creation.box([0.012, 0.012, 0.06], transform([x, 0, 0.03])) for x in (-0.06, 0.06)
    ]
    plane = trimesh.boolean.union([*wings, *struts], engine="manifold")
    plane.export(tmp_path / "biplane.ply")
    item = load_object(TrialObject("biplane", tmp_path / "biplane.ply"))
    # Where a finger goes: between the wings, beside the struts.
    finger = np.array([[x, y, 0.03] for x in (-0.09, 0.0, 0.09) for y in (-0.02, 0.0, 0.02)])
    inside = invert_transform(item.T_mesh_body)
    for corners, _ in item.pieces:
        assert (Delaunay(corners).find_simplex(apply_transform(inside, finger)) < 0).all()


def transform(place: list[float]) -> np.ndarray:
    made = np.eye(4)
    made[:3, 3] = place
    return made


@pytest.mark.parametrize(("name", "height"), [("pringles", 0.247), ("max_gel", 0.185)])
def test_what_can_stand_stands_in_every_yaw(world: World, name: str, height: float) -> None:
    trials = make_trials(choose_objects(None, name), [PlannerVariant(METHODS[0])])
    item = load_object(trials[0].object)
    yaws, axes = [], []
    for trial in trials:
        _, pose, yaw = place_object(world, item, trial)
        placed = apply_transform(pose, item.mesh.vertices)
        assert placed[:, 2].max() == pytest.approx(height, abs=0.003)
        assert placed[:, 2].min() == pytest.approx(0.0, abs=0.003)
        middle = (placed.min(axis=0) + placed.max(axis=0))[:2] / 2
        np.testing.assert_allclose(middle, [0.6, 0.0], atol=0.08)
        camera = place_camera(item, pose, trial)
        # It looks at the object, from beyond it.
        offset = np.array([*middle, LOOK_HEIGHT]) - camera[:3, 3]
        assert camera[:3, 2] @ offset / np.linalg.norm(offset) == pytest.approx(1.0, abs=1e-9)
        assert np.linalg.norm(offset[:2]) == pytest.approx(CAMERA_DISTANCE)
        yaws.append(yaw)
        axes.append(np.arctan2(pose[1, 0], pose[0, 0]))
    # High and low share a yaw; the three yaws are a third of a turn apart, and the mesh turns so.
    assert yaws[0::2] == yaws[1::2]
    np.testing.assert_allclose(np.mod(np.diff(yaws[0::2]), 2 * np.pi), 2 * np.pi / 3)
    np.testing.assert_allclose(np.mod(np.diff(axes[0::2]), 2 * np.pi), 2 * np.pi / 3, atol=1e-3)


def test_a_ball_is_no_larger_for_having_a_foot(world: World, tmp_path: Path) -> None:
    # A ball rests on any side; flattened for each of them it would grow by a tenth.
    ball = trimesh.creation.icosphere(4, 0.04)
    ball.export(tmp_path / "ball.ply")
    trial = make_trials([TrialObject("ball", tmp_path / "ball.ply")], [PlannerVariant(METHODS[0])])[
        0
    ]
    item = load_object(trial.object)
    standing, pose, _ = place_object(world, item, trial)
    corners = np.concatenate([corners for corners, _ in standing.pieces])
    assert np.linalg.norm(corners, axis=1).max() < 0.042
    volume = sum(trimesh.convex.convex_hull(corners).volume for corners, _ in standing.pieces)
    assert volume < 1.01 * ball.volume
    # It stands: the corners that carry it span its centre of mass.
    low = apply_transform(pose @ item.T_mesh_body, corners)
    low = low[low[:, 2] < low[:, 2].min() + 5e-4]
    middle = (pose @ item.T_mesh_body)[:2, 3]
    assert Delaunay(low[:, :2]).find_simplex(middle) >= 0


def test_meshes_in_millimetres_stand_as_large_as_in_metres(tmp_path: Path) -> None:
    trimesh.creation.cylinder(30, 150).export(tmp_path / "can.ply")
    (can,) = choose_objects(tmp_path, "all", unit="mm")
    assert np.ptp(load_object(can).mesh.vertices, axis=0) == pytest.approx([0.06, 0.06, 0.15])
    (beside,) = clutter_pool(tmp_path, unit="mm")
    assert beside.unit == "mm"


def test_a_can_whose_scanned_bottom_is_round_stands_upright(world: World, tmp_path: Path) -> None:
    can = trimesh.creation.cylinder(0.0375, 0.25, sections=64)
    # Its bottom bulges by 1.5 mm, as no can could stand that is so.
    middle = (np.hypot(can.vertices[:, 0], can.vertices[:, 1]) < 1e-6) & (can.vertices[:, 2] < 0)
    assert middle.sum() == 1
    can.vertices[middle, 2] -= 0.0015
    can.export(tmp_path / "can.ply")
    stands = TrialObject("pringles", tmp_path / "can.ply", upright=True)
    trials = make_trials([stands], [PlannerVariant(METHODS[0])])
    item = load_object(stands)
    for trial in trials[:2]:
        _, pose, _ = place_object(world, item, trial)
        assert pose[2, 2] > np.cos(np.radians(1))
