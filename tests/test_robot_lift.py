"""Lifts of the palm: straight up, or outwards where the arm cannot reach; none out of reach."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from trial_worlds import can_grasp

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.robot import lift as lift_module
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.lift import lift_path


@pytest.fixture(scope="module")
def grasp() -> NDArray[np.float64]:
    return can_grasp()


def test_the_lift_is_straight_and_keeps_the_palm(grasp: NDArray[np.float64]) -> None:
    robot = load_robot()
    chain = ArmChain(robot)
    path = lift_path(chain, grasp, 0.15)
    assert path is not None
    rotation, position, _ = chain.palm_and_jacobian(path)
    np.testing.assert_allclose(
        position[:, :2], position[0, :2] + np.zeros((len(path), 2)), atol=3e-3
    )
    np.testing.assert_allclose(position[-1, 2] - position[0, 2], 0.15, atol=3e-3)
    np.testing.assert_allclose(rotation[-1], rotation[0], atol=0.01)
    assert np.abs(np.diff(path, axis=0)).max() < 0.3
    assert (path >= robot.lower[robot.arm] - 1e-9).all()
    assert (path <= robot.upper[robot.arm] + 1e-9).all()


def test_near_the_robot_the_palm_moves_outwards_as_it_rises() -> None:
    robot = load_robot()
    chain = ArmChain(robot)
    path = lift_path(chain, can_grasp(shift=(-0.08, 0.0, 0.0)), 0.15)
    assert path is not None
    rotation, position, _ = chain.palm_and_jacobian(path)
    np.testing.assert_allclose(position[-1, 2] - position[0, 2], 0.15, atol=3e-3)
    assert 0.04 < position[-1, 0] - position[0, 0] < 0.11
    np.testing.assert_allclose(rotation[-1], rotation[0], atol=0.01)


def test_there_is_no_lift_out_of_reach(grasp: NDArray[np.float64]) -> None:
    robot = load_robot()
    assert lift_path(ArmChain(robot), grasp, 3.0) is None


def test_a_lift_leads_away_from_where_the_robot_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    ways: list[NDArray[np.float64]] = []

    def nowhere(chain: object, arm: object, poses: NDArray[np.float64], config: object) -> object:
        ways.append(poses[0, -1, :3, 3] - palm[:3, 3])
        return np.zeros((1, 16, 1)), np.array([0])

    monkeypatch.setattr(lift_module, "follow", nowhere)
    palm, base = transform(np.eye(3), [0.6, 0, 0.3]), transform(np.eye(3), [1.2, 0, 0])
    robot = SimpleNamespace(arm=slice(0, 1), T_world_base=base)
    chain = SimpleNamespace(robot=robot, palm=lambda q: palm)
    assert lift_path(chain, np.zeros(1)) is None  # type: ignore[arg-type]
    # Straight up first, then outwards: the robot stands on the far side.
    np.testing.assert_allclose(ways[0], [0, 0, 0.15], atol=1e-12)
    np.testing.assert_allclose(ways[1], [-0.05, 0, 0.15], atol=1e-12)
