"""Inverse kinematics: arm configurations for many palm poses at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription

STARTS = 12
"""Start configurations for each palm pose; a redundant arm ends in as many elbow positions."""
POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-4, 1e-3
"""Largest errors [m] and [rad] of a palm pose that counts as reached: below those of real arms."""


@dataclass(frozen=True)
class IkConfig:
    """Effort of the search.

    Attributes:
        iterations: Levenberg-Marquardt steps.
        pool: Random configurations among which starts near the goal are looked up.
    """

    iterations: int = 25
    pool: int = 20_000


@dataclass(frozen=True)
class IkSolutions:
    """Solutions of B palm poses from S starts.

    Attributes:
        arm: [B, S, A], joint positions within the planning limits.
        reached: bool [B, S], within both tolerances.
    """

    arm: Array
    reached: Mask

    @property
    def any(self) -> Mask:
        """bool [B]: the palm pose has a solution."""
        return np.asarray(self.reached.any(axis=1))


class InverseKinematics:
    """Damped least squares with joint limits from starts that already lie near the goal.

    The starts come from a pool of random configurations, by nearest palm pose; each ends at
    another elbow position, which is how the arm's redundancy is used. The damping follows the
    error (Sugihara 2011, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
    method"), so unreachable poses end near them instead of diverging.

    Args:
        robot: The robot; its planning limits are kept.
        config: Effort of the search.

    Attributes:
        chain: The arm.
    """

    def __init__(self, robot: RobotDescription, config: IkConfig | None = None) -> None:
        self.config = config or IkConfig()
        self._lower, self._upper = robot.lower[robot.arm], robot.upper[robot.arm]
        self.chain = ArmChain(robot)
        rng = np.random.default_rng(0)
        shape = (self.config.pool, len(robot.arm_joints))
        self._pool = rng.uniform(self._lower, self._upper, shape)
        rotation, position = self.chain.palms(self._pool)
        # One radian of turn weighs like this many metres of way.
        self._turn_weight = 0.3
        self._tree = scipy.spatial.cKDTree(self._features(rotation, position))

    def solve(self, T_world_palm: Array) -> IkSolutions:
        """Solve B palm poses [B, 4, 4] (or one [4, 4], as B = 1) from `STARTS` starts each."""
        goals = np.asarray(T_world_palm, dtype=np.float64).reshape(-1, 4, 4)
        count, starts = len(goals), STARTS
        features = self._features(goals[:, :3, :3], goals[:, :3, 3])
        _, nearest = self._tree.query(features, k=starts)
        q = self._pool[np.asarray(nearest).reshape(count * starts)]
        goals = np.repeat(goals, starts, axis=0)
        reached = np.zeros(len(q), dtype=bool)
        active = np.arange(len(q))
        for _ in range(self.config.iterations):
            error, jacobian, done = self._error(q[active], goals[active])
            reached[active[done]] = True
            active, error, jacobian = active[~done], error[~done], jacobian[~done]
            if not len(active):
                break
            q[active] = self._step(q[active], error, jacobian)
        else:
            _, _, done = self._error(q[active], goals[active])
            reached[active[done]] = True
        return IkSolutions(q.reshape(count, starts, -1), reached.reshape(count, starts))

    def _error(self, q: Array, goals: Array) -> tuple[Array, Array, Mask]:
        """Weighted pose errors [B, 6] and Jacobians [B, 6, A], and which poses are reached [B]."""
        error, jacobian = self.chain.pose_error(q, goals)
        way, turn = np.linalg.norm(error.reshape(-1, 2, 3), axis=2).T
        error[:, 3:] *= self._turn_weight
        jacobian[:, 3:] *= self._turn_weight
        return error, jacobian, (way < POSITION_TOLERANCE) & (turn < ROTATION_TOLERANCE)

    def _step(self, q: Array, error: Array, jacobian: Array) -> Array:
        """One Newton step; joints that press against a limit take no part in it."""
        transpose = np.swapaxes(jacobian, 1, 2)
        gradient = np.einsum("bij,bj->bi", transpose, error)
        stuck = ((q <= self._lower) & (gradient < 0)) | ((q >= self._upper) & (gradient > 0))
        transpose = np.where(stuck[..., None], 0.0, transpose)
        damping = 0.5 * (error**2).sum(axis=1) + 1e-6
        normal = transpose @ np.swapaxes(transpose, 1, 2)
        normal[:, np.arange(q.shape[1]), np.arange(q.shape[1])] += damping[:, None]
        right = np.where(stuck, 0.0, gradient)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, 0.8 / np.maximum(longest, 1e-12))
        return np.clip(q + step, self._lower, self._upper)

    def _features(self, rotation: Array, position: Array) -> Array:
        """Palm poses as vectors [B, 9] whose distance grows with way and turn."""
        columns = rotation[:, :, [0, 2]].reshape(len(rotation), 6)
        return np.concatenate([position, self._turn_weight * columns], axis=1)
