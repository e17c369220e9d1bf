"""Hand-made plans carried out with contacts: a good one holds, a sweeping one bumps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from trial_worlds import CAN_AT, can_grasp

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.lift import lift_path
from pointsdf_cli.simulation.sim_object import SimObject, prepare_object
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.execution import Executed, execute_plan

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = World(load_robot())
    yield made
    made.close()


@pytest.fixture(scope="module")
def can(tmp_path_factory: pytest.TempPathFactory) -> SimObject:
    mesh = trimesh.creation.cylinder(0.03, 0.15)
    loaded = LoadedMesh(
        "can", np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), "can", "none"
    )
    return prepare_object(loaded, tmp_path_factory.mktemp("cache"))


def execute(world: World, can: SimObject, trajectory: Array, seconds: float) -> Executed:
    pose = transform(np.eye(3), [*CAN_AT, 0.0752])
    times = np.linspace(0.0, seconds, len(trajectory))
    lift = lift_path(world.chain, trajectory[-1]) if len(trajectory) else trajectory
    assert lift is not None
    return execute_plan(world, can, pose, trajectory, times, lift)


def approach(*shifts: tuple[float, float, float]) -> Array:
    """Through hand-made places beside the can, each by the arm configuration next to the last."""
    path = [can_grasp(shift=shift) for shift in shifts]
    assert max(np.abs(np.diff(path, axis=0)).max(axis=1)) < 1.5
    return np.array(path)


def test_a_good_plan_holds_without_touching_before(world: World, can: SimObject) -> None:
    done = execute(world, can, approach((0, -0.06, 0), (0, -0.03, 0), (0, 0, 0)), 1.0)
    assert not done.contact
    assert done.moved < 1e-3
    assert done.lag < 0.02
    assert done.outcome is not None
    assert done.outcome.held
    assert done.outcome.lifted
    assert done.outcome.lost_in == ""
    assert done.outcome.lift_height == pytest.approx(0.15, abs=0.03)
    assert [moment.phase for moment in done.moments] == [
        "approach",
        "close",
        "grip",
        "lift",
        "settle",
    ]


def test_the_lift_is_the_plans_own(world: World, can: SimObject) -> None:
    """A lift that stays where it is raises nothing; a plan without a lift is not tried."""
    path = approach((0, -0.06, 0), (0, -0.03, 0), (0, 0, 0))
    pose = transform(np.eye(3), [*CAN_AT, 0.0752])
    times = np.linspace(0.0, 1.0, len(path))
    stays = execute_plan(world, can, pose, path, times, np.repeat(path[-1:], 3, axis=0))
    assert stays.outcome is not None
    assert stays.outcome.lift_height == pytest.approx(0.0, abs=0.01)
    assert not stays.outcome.lifted
    none = execute_plan(world, can, pose, path, times, np.zeros((0, path.shape[1])))
    assert none.outcome is None


def test_a_path_through_the_can_bumps_it(world: World, can: SimObject) -> None:
    done = execute(world, can, approach((0, -0.06, 0), (0, 0.12, 0), (0, 0.2, 0)), 1.0)
    # What is pushed ahead may be held in the end: it is the contact that is judged here.
    assert done.contact
    assert done.moved > 0.03


def test_equal_plans_end_equally(world: World, can: SimObject) -> None:
    path = approach((0, -0.03, 0), (0, 0.01, 0))
    first, second = (execute(world, can, path, 0.5) for _ in range(2))
    assert first.outcome == second.outcome
    assert first.moved == second.moved
    for one, two in zip(first.moments, second.moments, strict=True):
        np.testing.assert_array_equal(one.T_world_object, two.T_world_object)


def test_no_trajectory_is_no_plan(world: World, can: SimObject) -> None:
    with pytest.raises(InputError, match="0 points"):
        execute(world, can, np.zeros((0, 23)), 1.0)
