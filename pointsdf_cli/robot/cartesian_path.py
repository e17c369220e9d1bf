"""Cartesian paths of the palm: arm configurations along given palm poses, by damped least squares.

Damping: Nakamura and Hanafusa 1986, "Inverse kinematic solutions with singularity robustness for
robot manipulator control". Joints that a step would take beyond a limit stay where they are, and
the others take over: Baerlocher and Boulic 2004, "An inverse kinematics architecture enforcing an
arbitrary number of strict priority levels", section on joint limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.geometry.arrays import Array, Indices, Mask
from pointsdf_cli.robot.arm_chain import ArmChain


@dataclass(frozen=True)
class FollowConfig:
    """Accuracy and effort along a path. Joints are in rad, or in m if they slide.

    Attributes:
        position, rotation: Largest errors [m] and [rad] of a palm pose that counts as reached.
        jump: Largest change of a joint from one pose to the next.
        iterations: Newton steps at most for each pose.
        settled: Size of the last Newton step below which a reached pose is left; any if infinite.
        longest: Largest change of a joint in one Newton step.
        turn_weight: Cost of a rotation by 1 rad in metres off the position.
        damping: Damping of the least squares.
        limits: Keep the joint limits of plans; a start beyond them may stay there.
    """

    position: float
    rotation: float
    jump: float
    iterations: int = 7
    settled: float = np.inf
    longest: float = np.inf
    turn_weight: float = 1.0
    damping: float = 1e-6
    limits: bool = True


def straight(T_world_palm: Array, ways: ArrayLike, count: int) -> Array:
    """Palm poses [B, count, 4, 4] in equal steps from the pose [4, 4] along `ways` [B, 3], in the
    world [m], without the pose itself."""
    ways = np.asarray(ways, dtype=np.float64)
    poses = np.tile(T_world_palm, (len(ways), count, 1, 1))
    poses[..., :3, 3] += np.linspace(0, 1, count + 1)[1:, None] * ways[:, None]
    return poses


def follow(
    chain: ArmChain, arm: Array, poses: Array, config: FollowConfig
) -> tuple[Array, Indices]:
    """Follow palm poses one after the other without changing the elbow's branch.

    Args:
        chain: The arm.
        arm: [B, A], where the paths begin.
        poses: [B, K, 4, 4], T_world_palm along each path, each near the one before.
        config: Accuracy and effort.

    Returns:
        Paths [B, K + 1, A] from `arm` on, and [B], the number of poses that each reaches before
        the first that it does not; the path stays at the last one reached.
    """
    low, high = np.full_like(arm, -np.inf), np.full_like(arm, np.inf)
    if config.limits:
        robot = chain.robot
        low = np.minimum(robot.lower[robot.arm], arm)
        high = np.maximum(robot.upper[robot.arm], arm)
    path = np.repeat(arm[:, None], poses.shape[1] + 1, axis=1)
    reached, on = np.zeros(len(arm), dtype=np.int64), np.arange(len(arm))
    for k in range(poses.shape[1]):
        q, fine = _newton(chain, path[on, k], poses[on, k], config, low[on], high[on])
        on = on[fine]
        if not len(on):
            break
        path[on, k + 1 :] = q[fine, None]
        reached[on] += 1
    return path, reached


def _newton(
    chain: ArmChain, arm: Array, goals: Array, config: FollowConfig, low: Array, high: Array
) -> tuple[Array, Mask]:
    """Configurations [B, A] near `arm` [B, A] with the palm at `goals` [B, 4, 4], within limits
    [B, A]; and which of them [B] are there without a jump."""
    q, size, near = arm, np.full(len(arm), np.inf), np.ones(len(arm), dtype=bool)
    for k in range(config.iterations + 1):
        error, jacobian = chain.pose_error(q, goals)
        way, turn = np.linalg.norm(error.reshape(-1, 2, 3), axis=2).T
        reached = (way < config.position) & (turn < config.rotation)
        near &= np.abs(q - arm).max(axis=1) <= config.jump
        moving = near & (~reached | (size > config.settled))
        if k == config.iterations or not moving.any():
            break
        error[:, 3:] *= config.turn_weight
        jacobian[:, 3:] *= config.turn_weight
        step = _step(q, error, jacobian, config.damping, low, high) * moving[:, None]
        size = np.abs(step).max(axis=1)
        q = np.clip(q + np.clip(step, -config.longest, config.longest), low, high)
    return q, reached & near


def _step(
    q: Array, error: Array, jacobian: Array, damping: float, low: Array, high: Array
) -> Array:
    """Damped least-squares step [B, A]; the joints that it would take beyond a limit stay."""
    while True:
        transpose = np.swapaxes(jacobian, 1, 2)
        normal = jacobian @ transpose + damping * np.eye(6)
        step: Array = (transpose @ np.linalg.solve(normal, error[..., None]))[..., 0]
        beyond = (q + step < low) | (q + step > high)
        if not beyond.any():
            return step
        jacobian = np.where(beyond[:, None], 0.0, jacobian)
