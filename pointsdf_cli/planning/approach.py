"""Straight approach to a grasp, with the preshape kept, so that fingers slide past the object."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.cartesian_path import FollowConfig, follow, straight
from pointsdf_cli.robot.description import RobotDescription

LENGTH = 0.08
"""Length of the straight stretch [m]: fingers then start outside of most objects."""
SHORTEST = 0.03
"""Least length of an approach [m]."""
STEP = 0.01
"""Spacing of the inverse kinematics solutions along it [m]."""
DEVIATION = 0.001
"""Largest deviation of the palm from the straight line between them [m]."""
FOLLOW = FollowConfig(1e-6, 1e-5, jump=0.3, damping=1e-8, limits=False)
"""The palm keeps to the line; a path ends at the first joint limit."""


def retreat(checker: PathChecker, chain: ArmChain, q: Array) -> Array | None:
    """Straight retreat from a grasp: configurations [T, J], the grasp first.

    Directions are tried in turn until one is free for its full length: against the palm's normal,
    diagonally back, back along the fingers, diagonally up, upwards. Otherwise the longest free one
    is taken.

    Args:
        q: [J], the grasp.

    Returns:
        None if no direction is free for `SHORTEST`.
    """
    T_world_palm = chain.palm(q)
    x, z = T_world_palm[:3, 0], T_world_palm[:3, 2]
    up = np.array([0.0, 0.0, 1.0])
    best: Array | None = None
    for way in (-x, -x - z, -z, up - x, up):
        length = np.linalg.norm(way)
        if length < 0.3:  # the terms cancel: another direction says the same
            continue
        path = _straight(checker, chain, q, T_world_palm, way / length)
        if best is None or len(path) > len(best):
            best = path
        if len(path) > LENGTH / STEP:
            break
    if best is None or (len(best) - 1) * STEP < SHORTEST - 1e-9:
        return None
    return best


def _straight(
    checker: PathChecker, chain: ArmChain, q: Array, T_world_palm: Array, way: Array
) -> Array:
    """Collision-free beginning of a straight path [T, J], in steps of equal length."""
    robot = chain.robot
    poses = straight(T_world_palm, [LENGTH * way], round(LENGTH / STEP))
    (path,), (reached,) = follow(chain, q[None, robot.arm], poses, FOLLOW)
    path = path[: reached + 1]
    within = ((path[1:] >= robot.lower[robot.arm]) & (path[1:] <= robot.upper[robot.arm])).all(1)
    _, middle, _ = chain.palm_and_jacobian((path[:-1] + path[1:]) / 2)
    off = np.linalg.norm(middle - (poses[0, :reached, :3, 3] - STEP / 2 * way), axis=1)
    path = path[: 1 + np.logical_and.accumulate(within & (off <= DEVIATION)).sum()]
    whole = with_arm(robot, q, path)
    if checker.is_free(whole):
        return whole
    free = 1
    while free < len(whole) and checker.is_free(whole[free - 1 : free + 1]):
        free += 1
    return whole[:free]


def with_arm(robot: RobotDescription, q: Array, path: Array) -> Array:
    """Configurations [T, J]: q [J] with the arm at the points of a path [T, A]."""
    whole = np.tile(q, (len(path), 1))
    whole[:, robot.arm] = path
    return whole
