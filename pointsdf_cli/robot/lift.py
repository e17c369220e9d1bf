"""Lift of a grasped object: upwards, straight if possible, and level if possible.

Near the robot an arm folds as the hand rises, until its elbow is at its limit. Then the hand must
move outwards while it rises, or turn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import rotation_vector
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription

LIFT_HEIGHT = 0.15
"""Height [m] of every lift, planned and executed: an object is then clear of what is beside it."""
STEPS = 15
"""Number of steps of the path."""
WAYS = ((0.0, 1.0), (0.05, 1.0), (0.1, 1.0), (0.0, 0.1), (0.05, 0.02), (0.1, 0.02))
"""Attempts in turn: outward motion of the palm on the way [m], and cost of a rotation by 1 rad in
metres off the line; at 1 the palm does not rotate."""
OFF_LINE = 0.003
"""Largest deviation [m] of a path's step from the line."""
MOST_TURN = 0.6
"""Largest turn [rad] of the palm on the way; more pours out the contents of the object."""


def lift_path(
    chain: ArmChain,
    robot: RobotDescription,
    q: Array,
    height: float = LIFT_HEIGHT,
    free: Callable[[Array], bool] | None = None,
) -> Array | None:
    """Arm joints [K + 1, A] from configuration q [J] to one with the palm `height` [m] above.

    Args:
        chain: Chain of the arm.
        robot: The robot.
        q: [J], start configuration.
        height: Height of the lift [m].
        free: Function that tells whether a path [K + 1, A] is free of collision; None for no check.

    Returns:
        None if no attempt succeeds.
    """
    for outwards, weight in WAYS:
        path = _follow(chain, robot, q[robot.arm], height, outwards, weight)
        if path is not None and (free is None or free(path)):
            return path
    return None


def _follow(
    chain: ArmChain,
    robot: RobotDescription,
    arm: Array,
    height: float,
    outwards: float,
    weight: float,
) -> Array | None:
    """Newton steps along the line, within the joint limits."""
    rotation, position, _ = chain.palm_and_jacobian(arm[None])
    low, high = robot.lower[robot.arm], robot.upper[robot.arm]
    # A plan may begin a little beyond the range that plans keep to.
    low, high = np.minimum(low, arm), np.maximum(high, arm)
    away = position[0] - robot.T_world_base[:3, 3]
    away[2] = 0.0
    way = outwards * away / max(float(np.linalg.norm(away)), 1e-6) + [0.0, 0.0, height]
    path = [arm]
    rows = np.diag([1.0, 1.0, 1.0, weight, weight, weight])
    for k in range(1, STEPS + 1):
        goal = position[0] + way * k / STEPS
        now = path[-1].copy()
        for _ in range(12):
            turned, at, jacobian = chain.palm_and_jacobian(now[None])
            error = np.concatenate([goal - at[0], rotation_vector(rotation[0] @ turned[0].T)])
            J = rows @ jacobian[0]
            free = np.ones(len(now), dtype=bool)
            step = _least_squares(J, rows @ error)
            for _ in range(len(now)):  # joints at their limits stay there, the others take over
                beyond = free & ((now + step < low) | (now + step > high))
                if not beyond.any():
                    break
                free &= ~beyond
                step = np.zeros(len(now))
                step[free] = _least_squares(J[:, free], rows @ error)
            now = np.clip(now + np.clip(step, -0.15, 0.15), low, high)
            if np.abs(step).max() < 1e-5:
                break
        turned, at, _ = chain.palm_and_jacobian(now[None])
        off = float(np.linalg.norm(at[0] - goal))
        turn = float(np.linalg.norm(rotation_vector(rotation[0] @ turned[0].T)))
        most = 0.005 if weight == 1.0 else MOST_TURN
        if off > OFF_LINE or turn > most or np.abs(now - path[-1]).max() > 0.3:
            return None
        path.append(now)
    return np.array(path)


def _least_squares(matrix: Array, right: Array) -> Array:
    """A slightly damped least-squares step."""
    normal = matrix @ matrix.T + 1e-6 * np.eye(len(matrix))
    step: Array = matrix.T @ np.linalg.solve(normal, right)
    return step
