"""Straight approach to a grasp, with the preshape kept, so that fingers slide past the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.robot.arm_chain import ArmChain


@dataclass(frozen=True)
class ApproachConfig:
    """Settings of the straight approach.

    Attributes:
        length: Length of the straight stretch [m].
        shortest: Least length of an approach [m].
        step: Spacing of the inverse kinematics solutions along it [m].
        deviation: Largest deviation of the palm from the straight line between them [m].
    """

    length: float = 0.08
    shortest: float = 0.03
    step: float = 0.01
    deviation: float = 0.001

    def __post_init__(self) -> None:
        if not 0 < self.step <= self.shortest <= self.length or self.deviation <= 0:
            raise InputError(f"{self}", allowed="0 < step ≤ shortest ≤ length, deviation > 0")


def retreat(
    checker: PathChecker,
    chain: ArmChain,
    q: Array,
    config: ApproachConfig | None = None,
) -> Array | None:
    """Straight retreat from a grasp: configurations [T, J], the grasp first.

    Directions are tried in turn until one is free for its full length: against the palm's normal,
    back along the fingers, between both, and upwards. Otherwise the longest free one is taken.

    Args:
        q: [J], the grasp.

    Returns:
        None if no direction is free for `config.shortest`.
    """
    config = config or ApproachConfig()
    robot = checker.kinematics.robot
    rotation, _, _ = chain.palm_and_jacobian(q[None, robot.arm])
    x, z = rotation[0, :, 0], rotation[0, :, 2]
    up = np.array([0.0, 0.0, 1.0])
    best: Array | None = None
    for way in (-x, -x - z, -z, up - x, up):
        length = np.linalg.norm(way)
        if length < 0.3:  # the terms cancel: another direction says the same
            continue
        path = _straight(checker, chain, q, way / length, config)
        if best is None or len(path) > len(best):
            best = path
        if len(path) > config.length / config.step:
            break
    if best is None or (len(best) - 1) * config.step < config.shortest - 1e-9:
        return None
    return best


def _straight(
    checker: PathChecker,
    chain: ArmChain,
    q: Array,
    way: Array,
    config: ApproachConfig,
) -> Array:
    """Collision-free beginning of a straight path [T, J], in steps of equal length."""
    robot = checker.kinematics.robot
    arm = q[robot.arm]
    rotation, position, _ = chain.palm_and_jacobian(arm[None])
    path = [arm]
    for k in range(1, round(config.length / config.step) + 1):
        goal = position[0] + k * config.step * way
        solved = _follow(chain, path[-1], rotation[0], goal)
        if (
            solved is None
            or ((solved < robot.lower[robot.arm]) | (solved > robot.upper[robot.arm])).any()
        ):
            break
        _, middle, _ = chain.palm_and_jacobian((path[-1] + solved)[None] / 2)
        if np.linalg.norm(middle[0] - (goal - config.step / 2 * way)) > config.deviation:
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
