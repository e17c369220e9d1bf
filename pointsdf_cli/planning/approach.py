"""Straight approach to a grasp, with the preshape kept, so that fingers slide past the object."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.robot.arm_chain import ArmChain

LENGTH = 0.08
"""Length of the straight stretch [m]: fingers then start outside of most objects."""
SHORTEST = 0.03
"""Least length of an approach [m]."""
STEP = 0.01
"""Spacing of the inverse kinematics solutions along it [m]."""
DEVIATION = 0.001
"""Largest deviation of the palm from the straight line between them [m]."""


def retreat(checker: PathChecker, chain: ArmChain, q: Array) -> Array | None:
    """Straight retreat from a grasp: configurations [T, J], the grasp first.

    Directions are tried in turn until one is free for its full length: against the palm's normal,
    back along the fingers, between both, and upwards. Otherwise the longest free one is taken.

    Args:
        q: [J], the grasp.

    Returns:
        None if no direction is free for `SHORTEST`.
    """
    robot = checker.kinematics.robot
    rotation, _, _ = chain.palm_and_jacobian(q[None, robot.arm])
    x, z = rotation[0, :, 0], rotation[0, :, 2]
    up = np.array([0.0, 0.0, 1.0])
    best: Array | None = None
    for way in (-x, -x - z, -z, up - x, up):
        length = np.linalg.norm(way)
        if length < 0.3:  # the terms cancel: another direction says the same
            continue
        path = _straight(checker, chain, q, way / length)
        if best is None or len(path) > len(best):
            best = path
        if len(path) > LENGTH / STEP:
            break
    if best is None or (len(best) - 1) * STEP < SHORTEST - 1e-9:
        return None
    return best


def _straight(checker: PathChecker, chain: ArmChain, q: Array, way: Array) -> Array:
    """Collision-free beginning of a straight path [T, J], in steps of equal length."""
    robot = checker.kinematics.robot
    arm = q[robot.arm]
    rotation, position, _ = chain.palm_and_jacobian(arm[None])
    path = [arm]
    for k in range(1, round(LENGTH / STEP) + 1):
        goal = position[0] + k * STEP * way
        solved = _follow(chain, path[-1], rotation[0], goal)
        if (
            solved is None
            or ((solved < robot.lower[robot.arm]) | (solved > robot.upper[robot.arm])).any()
        ):
            break
        _, middle, _ = chain.palm_and_jacobian((path[-1] + solved)[None] / 2)
        if np.linalg.norm(middle[0] - (goal - STEP / 2 * way)) > DEVIATION:
            break
        path.append(solved)
    whole = np.tile(q, (len(path), 1))
    whole[:, robot.arm] = path
    free = 1
    while free < len(whole) and checker.is_free(whole[free - 1 : free + 1]):
        free += 1
    return whole[:free]


def _follow(chain: ArmChain, arm: Array, rotation: Array, position: Array) -> Array | None:
    """Arm configuration near `arm` with the palm at a pose, by Newton's method; None if none."""
    q = arm.copy()
    for _ in range(8):
        turned, at, jacobian = chain.palm_and_jacobian(q[None])
        relative = rotation @ turned[0].T
        skew = (relative - relative.T) / 2
        turn = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        error = np.concatenate([position - at[0], turn])
        if np.linalg.norm(error[:3]) < 1e-6 and np.linalg.norm(turn) < 1e-5:
            return q
        normal = jacobian[0] @ jacobian[0].T + 1e-8 * np.eye(6)
        q = q + jacobian[0].T @ np.linalg.solve(normal, error)
        if np.abs(q - arm).max() > 0.3:  # near a singularity: no small step leads there
            return None
    return None
