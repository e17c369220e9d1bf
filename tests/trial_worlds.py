"""A can on the table and a grasp of it that was made by hand, for the tests of trials."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics

CAN_AT = (0.68, 0.0)


def can_in_world(radius: float = 0.03, height: float = 0.15) -> trimesh.Trimesh:
    """An upright can on the table."""
    can = trimesh.creation.cylinder(radius, height)
    can.apply_translation([*CAN_AT, height / 2])
    return can


def can_grasp(shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """[J]: the open hand beside the can, palm towards it from the robot's right, thumb up."""
    robot = load_robot()
    palm = np.eye(4)
    palm[:3, :3] = np.stack([[0, 1, 0], [0, 0, 1], [1, 0, 0]], axis=1)
    palm[:3, 3] = np.array([*CAN_AT, 0.085]) + [-0.03, -0.06, 0.0]
    palm[:3, 3] += shift
    found = InverseKinematics(robot).solve(palm)
    arms = found.arm[0][found.reached[0]]
    assert len(arms), "the hand-made grasp is out of reach"
    nearest = np.abs(arms - robot.home[robot.arm]).max(axis=1).argmin()
    return robot.configuration(arms[nearest], robot.preshape_ranges.mean(axis=1))
