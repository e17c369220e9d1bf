"""Start configuration of the robot, as a user gives it."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.poses import numbers_in
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.mimic import require_together

TOLERANCE = 1e-6
"""Joint positions may exceed their limits by this [rad or m]."""


def start_configuration(given: str | Array | None, robot: RobotDescription) -> Array:
    """A configuration [J] from `--start`: all joints, or the arm's with the hand as at home.

    Args:
        given: Numbers [rad or m], as typed text, a file of them, or an array; home if None.
        robot: The robot.

    Raises:
        InputError: Another number of joints, beyond a joint's hard limit, or joints apart that the
            hardware moves together.
    """
    if given is None:
        return robot.home.copy()
    arm, joints = len(robot.arm_joints), len(robot.joint_names)
    names = ", ".join(robot.joint_names)
    allowed = f"{arm} arm joints or all {joints} [rad; m where they slide]: {names}"
    numbers = numbers_in(given, "--start", allowed) if isinstance(given, str) else given
    if len(numbers) not in (arm, joints):
        raise InputError(f"{len(numbers)} joint positions", where="--start", allowed=allowed)
    q = robot.home.copy()
    q[: len(numbers)] = numbers
    require_within_limits(q, robot, "--start")
    require_together(q, robot.joints, robot.followers, "--start")
    return q


def require_within_limits(q: Array, robot: RobotDescription, where: object) -> None:
    """Refuse a configuration [J] beyond a joint's hard limit, or NaN.

    Raises:
        InputError: A joint is, which is named.
    """
    inside = (q >= robot.hard_lower - TOLERANCE) & (q <= robot.hard_upper + TOLERANCE)
    for j in np.flatnonzero(~inside)[:1]:  # NaN, too
        unit = "m" if robot.slides[j] else "rad"
        what = f"{robot.joint_names[j]} at {q[j]:.4g} {unit} is beyond its limit"
        allowed = f"{robot.hard_lower[j]:.4g} to {robot.hard_upper[j]:.4g} {unit}"
        raise InputError(what, where=where, allowed=allowed)
