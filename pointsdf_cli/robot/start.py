"""Start configuration of the robot, as a user types it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.poses import numbers_in
from pointsdf_cli.robot.description import RobotDescription


def start_configuration(text: str | None, robot: RobotDescription) -> NDArray[np.float64]:
    """A configuration [J] from `--start`: all joints, or the arm's with the hand as at home.

    Args:
        text: Numbers [rad] or a file of them; the robot's home if None.
        robot: The robot.

    Raises:
        InputError: Another number of joints, or beyond a joint's hard limit.
    """
    if text is None:
        return robot.home.copy()
    arm, joints = len(robot.arm_joints), len(robot.joint_names)
    allowed = f"{arm} arm joints or all {joints} [rad]: " + ", ".join(robot.joint_names)
    numbers = numbers_in(text, "--start", allowed)
    if len(numbers) not in (arm, joints):
        raise InputError(f"{len(numbers)} joint positions", where="--start", allowed=allowed)
    q = robot.home.copy()
    q[: len(numbers)] = numbers
    outside = np.flatnonzero((q < robot.hard_lower - 1e-6) | (q > robot.hard_upper + 1e-6))
    if len(outside):
        j = int(outside[0])
        raise InputError(
            f"{robot.joint_names[j]} at {q[j]:.4g} rad is beyond its limit",
            where="--start",
            allowed=f"{robot.hard_lower[j]:.4g} to {robot.hard_upper[j]:.4g} rad",
        )
    return q
