"""Arm configurations that put the palm where it is wanted, many palm poses at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import rotation_vector
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.urdf import Joint

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IkConfig:
    """How hard to try.

    Attributes:
        starts: Start configurations for each palm pose; a redundant arm ends in as many elbow
            positions.
        iterations: Levenberg-Marquardt steps.
        position_tolerance: [m].
        rotation_tolerance: [rad].
        pool: Random configurations among which starts near the goal are looked up.
    """

    starts: int = 12
    iterations: int = 25
    position_tolerance: float = 1e-4
    rotation_tolerance: float = 1e-3
    pool: int = 20_000

    def __post_init__(self) -> None:
        for name in ("starts", "iterations", "pool"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}", allowed="1 or more")
        if self.starts > self.pool:
            raise InputError(f"{self.starts} starts from {self.pool}", allowed="fewer starts")


@dataclass(frozen=True)
class IkSolutions:
    """Solutions of B palm poses from S starts.

    Attributes:
        arm: [B, S, A], joint positions within the planning limits.
        reached: bool [B, S], within both tolerances.
    """

    arm: Array
    reached: NDArray[np.bool_]

    @property
    def any(self) -> NDArray[np.bool_]:
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
        config: How hard to try.
        seed: Of the pool.
    """

    def __init__(
        self, robot: RobotDescription, config: IkConfig | None = None, seed: int = 0
    ) -> None:
        self.config = config or IkConfig()
        self._lower, self._upper = robot.lower[robot.arm], robot.upper[robot.arm]
        self._chain = _palm_chain(robot)
        self._columns = [
            robot.arm_joints.index(j.name) if j.name in robot.arm_joints else None
            for j in self._chain
        ]
        moving = [k for k, column in enumerate(self._columns) if column is not None]
        self._moving = [column for column in self._columns if column is not None]
        self._sliding = np.array([self._chain[k].kind == "prismatic" for k in moving])
        self._cross = np.stack([_cross_matrix(self._chain[k].axis) for k in moving])
        self._base, self._palm = robot.T_world_base, robot.T_link_palm
        rng = np.random.default_rng(seed)
        self._pool = rng.uniform(
            self._lower, self._upper, (self.config.pool, len(robot.arm_joints))
        )
        rotation, position, _ = self.palm(self._pool, with_jacobian=False)
        # One radian of turn weighs like this many metres of way.
        self._turn_weight = 0.3
        self._tree = cKDTree(self._features(rotation, position))

    def solve(self, T_world_palm: Array) -> IkSolutions:
        """Solve B palm poses [B, 4, 4] (or one [4, 4], as B = 1) from `starts` starts each."""
        goals = np.asarray(T_world_palm, dtype=np.float64).reshape(-1, 4, 4)
        count, starts = len(goals), self.config.starts
        features = self._features(goals[:, :3, :3], goals[:, :3, 3])
        _, nearest = self._tree.query(features, k=starts)
        q = self._pool[np.asarray(nearest).reshape(count * starts)]
        goal_rotation = np.repeat(goals[:, :3, :3], starts, axis=0)
        goal_position = np.repeat(goals[:, :3, 3], starts, axis=0)
        reached = np.zeros(len(q), dtype=bool)
        active = np.arange(len(q))
        for _ in range(self.config.iterations):
            error, jacobian, done = self._error(q[active], goal_rotation, goal_position, active)
            reached[active[done]] = True
            active, error, jacobian = active[~done], error[~done], jacobian[~done]
            if not len(active):
                break
            q[active] = self._step(q[active], error, jacobian)
        else:
            _, _, done = self._error(q[active], goal_rotation, goal_position, active)
            reached[active[done]] = True
        return IkSolutions(q.reshape(count, starts, -1), reached.reshape(count, starts))

    def track(self, arm: Array, poses: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Follow palm poses one after the other without changing the elbow's branch.

        Args:
            arm: [B, A], where the paths begin.
            poses: [B, K, 4, 4], T_world_palm along each path, each near the one before.

        Returns:
            Paths [B, K, A], and bool [B]: every pose of the path was reached.
        """
        q = np.array(arm, dtype=np.float64)
        path = np.empty((len(q), poses.shape[1], q.shape[1]))
        fine = np.ones(len(q), dtype=bool)
        everyone = np.arange(len(q))
        for k in range(poses.shape[1]):
            reached = np.zeros(len(q), dtype=bool)
            for _ in range(8):
                error, jacobian, reached = self._error(
                    q, poses[:, k, :3, :3], poses[:, k, :3, 3], everyone
                )
                if reached.all():
                    break
                moved = self._step(q, error, jacobian)
                q = np.where(reached[:, None], q, moved)
            fine &= reached
            path[:, k] = q
        # A path that jumps is no path, even if every pose is reached.
        steps = np.abs(np.diff(path, axis=1, prepend=arm[:, None])).max(axis=(1, 2))
        return path, fine & (steps < 0.5)

    def palm(self, q: Array, with_jacobian: bool = True) -> tuple[Array, Array, Array]:
        """Palm rotation [B, 3, 3], position [B, 3] and Jacobian [B, 6, A] of arm joints [B, A].

        The Jacobian's first three rows are velocity, the others angular velocity, in the world.
        """
        count = len(q)
        rotation = np.broadcast_to(self._base[:3, :3], (count, 3, 3))
        position = np.broadcast_to(self._base[:3, 3], (count, 3))
        axes, origins = np.empty((2, len(self._moving), count, 3))
        turns = self._turns(q[:, self._moving])
        at = 0
        for joint, column in zip(self._chain, self._columns, strict=True):
            position = position + rotation @ joint.T_parent_joint[:3, 3]
            rotation = rotation @ joint.T_parent_joint[:3, :3]
            if column is None:
                continue
            axes[at], origins[at] = rotation @ joint.axis, position
            if self._sliding[at]:
                position = position + axes[at] * q[:, column, None]
            else:
                rotation = rotation @ turns[at]
            at += 1
        position = position + rotation @ self._palm[:3, 3]
        rotation = rotation @ self._palm[:3, :3]
        jacobian = np.zeros((count, 6, q.shape[1]))
        if with_jacobian:
            slides = self._sliding[:, None, None]
            along = np.where(slides, axes, _cross(axes, position - origins))
            jacobian[:, :3, self._moving] = along.transpose(1, 2, 0)
            jacobian[:, 3:, self._moving] = np.where(slides, 0.0, axes).transpose(1, 2, 0)
        return rotation, position, jacobian

    def _turns(self, q: Array) -> Array:
        """Rotations [M, B, 3, 3] of the moving joints about their axes by [B, M] (Rodrigues)."""
        angles = q.T[:, :, None, None]
        cross = self._cross[:, None]
        turned: Array = np.eye(3) + np.sin(angles) * cross + (1 - np.cos(angles)) * (cross @ cross)
        return turned

    def _error(
        self, q: Array, goal_rotation: Array, goal_position: Array, active: NDArray[np.int64]
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        rotation, position, jacobian = self.palm(q)
        turn = rotation_vector(goal_rotation[active] @ np.swapaxes(rotation, 1, 2))
        way = goal_position[active] - position
        done = (np.linalg.norm(way, axis=1) < self.config.position_tolerance) & (
            np.linalg.norm(turn, axis=1) < self.config.rotation_tolerance
        )
        weight = self._turn_weight
        jacobian[:, 3:] *= weight
        return np.concatenate([way, weight * turn], axis=1), jacobian, done

    def _step(self, q: Array, error: Array, jacobian: Array) -> Array:
        """One step; joints that press against a limit take no part in it."""
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


def _palm_chain(robot: RobotDescription) -> list[Joint]:
    """The joints from the root to the palm's link."""
    by_child = {joint.child: joint for joint in robot.tree.joints}
    chain = []
    link = robot.palm_link
    while link in by_child:
        chain.append(by_child[link])
        link = by_child[link].parent
    unused = set(robot.arm_joints) - {joint.name for joint in chain}
    if unused:
        raise InputError(
            f"the arm joint {min(unused)!r} does not move the palm",
            where=robot.name,
            allowed="arm joints between the root and the palm's link",
        )
    return chain[::-1]


def _cross_matrix(axis: Array) -> Array:
    """[3, 3], whose product with a vector is the axis × the vector."""
    x, y, z = axis
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _cross(a: Array, b: Array) -> Array:
    """Cross products [..., 3]; np.cross spends ten times as long on finding its axes."""
    product = np.empty_like(a)
    product[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    product[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    product[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
