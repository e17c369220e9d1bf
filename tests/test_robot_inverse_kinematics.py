"""Inverse kinematics: what it returns is where it says, and what is reachable is found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.inverse_kinematics import IkConfig, InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics

GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


@pytest.mark.parametrize("path", [None, GRIPPER], ids=["lbr4_allegro", "gripper"])
def test_reachable_poses_are_reached_within_limits(path: Path | None) -> None:
    robot = load_robot(path)
    rng = np.random.default_rng(5)
    q = rng.uniform(robot.lower, robot.upper, (100, len(robot.joint_names)))
    kinematics = Kinematics(robot)
    goals = kinematics.palm(torch.from_numpy(q)).numpy()
    found = InverseKinematics(robot).solve(goals)
    assert found.any.mean() >= 0.98
    assert (found.arm >= robot.lower[robot.arm]).all()
    assert (found.arm <= robot.upper[robot.arm]).all()
    pose, start = np.nonzero(found.reached)
    full = np.zeros((len(pose), len(robot.joint_names)))
    full[:, robot.arm] = found.arm[pose, start]
    reached = kinematics.palm(torch.from_numpy(full)).numpy()
    assert np.abs(reached[:, :3, 3] - goals[pose, :3, 3]).max() < 1e-4 + 1e-9
    assert np.abs(reached[:, :3, :3] - goals[pose, :3, :3]).max() < 1.1e-3


def test_redundant_arm_finds_several_elbows() -> None:
    robot = load_robot()
    goal = Kinematics(robot).palm(torch.from_numpy(robot.home.copy())).numpy()
    found = InverseKinematics(robot).solve(goal)
    arms = found.arm[0][found.reached[0]]
    apart = np.abs(arms[:, None] - arms[None]).max(axis=-1)
    assert len(arms) >= 6
    assert apart.max() > 0.5


def test_out_of_reach_is_not_claimed() -> None:
    robot = load_robot()
    goal = np.eye(4)
    goal[:3, 3] = (2.0, 0.0, 0.5)
    found = InverseKinematics(robot, IkConfig(iterations=20)).solve(goal)
    assert not found.any[0]
    assert np.isfinite(found.arm).all()


def test_jacobian_agrees_with_finite_differences() -> None:
    robot = load_robot(GRIPPER)
    solver = InverseKinematics(robot)
    q = np.array([[0.3, 0.4, -0.2, 0.9]])
    rotation, position, jacobian = solver.chain.palm_and_jacobian(q)
    for column in range(q.shape[1]):
        step = np.zeros_like(q)
        step[0, column] = 1e-6
        turned, moved, _ = solver.chain.palm_and_jacobian(q + step)
        assert (moved - position)[0] / 1e-6 == pytest.approx(jacobian[0, :3, column], abs=1e-5)
        spin = (turned - rotation)[0] @ rotation[0].T / 1e-6
        vector = [spin[2, 1], spin[0, 2], spin[1, 0]]
        assert vector == pytest.approx(jacobian[0, 3:, column], abs=1e-5)


def test_equal_goals_give_equal_solutions() -> None:
    robot = load_robot()
    goal = Kinematics(robot).palm(torch.from_numpy(robot.home.copy())).numpy()
    first, second = (InverseKinematics(robot).solve(goal) for _ in range(2))
    assert np.array_equal(first.arm, second.arm)
