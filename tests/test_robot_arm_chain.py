"""The chain to the palm agrees with the kinematics of the whole robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pointsdf_cli.robot.arm_chain import CHUNK, ArmChain
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics

ROBOTS = Path(__file__).parent / "robots"


@pytest.mark.parametrize("path", [None, *sorted(ROBOTS.glob("*.yaml"))])
def test_palm_is_where_the_whole_robot_has_it(path: Path | None) -> None:
    robot = load_robot(path)
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (2, 3, len(robot.joint_names)))
    whole = Kinematics(robot).palm(torch.from_numpy(q)).numpy()
    palm = ArmChain(robot).palm(q)
    assert palm == pytest.approx(whole, abs=1e-12)
    assert ArmChain(robot).palm(q[0, 0]) == pytest.approx(whole[0, 0], abs=1e-12)


@pytest.mark.parametrize("count", [0, 1, CHUNK, 2 * CHUNK + 3])
def test_palms_of_many_arms_are_those_of_each(count: int) -> None:
    robot = load_robot(None)
    q = np.zeros((count, len(robot.joint_names)))
    q[:, robot.arm] = np.random.default_rng(1).uniform(-1.5, 1.5, (count, len(robot.arm_joints)))
    chain = ArmChain(robot)
    rotation, position = chain.palms(q[:, robot.arm])
    palm = chain.palm(q)
    assert np.array_equal(rotation, palm[:, :3, :3])
    assert np.array_equal(position, palm[:, :3, 3])
