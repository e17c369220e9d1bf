"""Forward kinematics and Jacobian of the arm's chain from base to palm, in numpy.

`kinematics.py` computes all links of the robot, with gradients; for the palm alone, at a few
configurations, this takes a tenth of the time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import cross_matrix, rotation_vector, transform
from pointsdf_cli.robot.description import RobotDescription

CHUNK = 1024
"""Configurations per batch: small enough for intermediate arrays to stay in the processor's
cache."""


class ArmChain:
    """The joints of the arm between the robot's base and its palm.

    Args:
        robot: The robot; joints on the way that are not the arm's stay at zero.

    Attributes:
        robot: The robot.

    Raises:
        InputError: A joint of the arm does not move the palm.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self._base = robot.T_world_base
        self._columns, (*self._before, self._palm) = _moving_joints(robot)
        self._sliding = robot.slides[self._columns]
        self._axes = np.stack([robot.joints[column].axis for column in self._columns])
        # A joint's rotation is a constant, a part with the sine and one with the cosine of its
        # angle (Rodrigues).
        fixed = np.stack([pose[:3, :3] for pose in self._before])
        cross = cross_matrix(self._axes)
        cross[self._sliding] = 0.0
        turning = (fixed @ (np.eye(3) + cross @ cross), fixed @ cross, -fixed @ cross @ cross)
        self._constant, self._with_sine, self._with_cosine = (m[:, None] for m in turning)

    def palm(self, q: ArrayLike) -> Array:
        """T_world_palm [..., 4, 4] of configurations [..., J] of the whole robot."""
        q = np.asarray(q, dtype=np.float64)
        arms = q[..., self.robot.arm].reshape(-1, len(self.robot.arm_joints))
        rotation, position, _, _ = self._along(arms)
        return transform(rotation, position).reshape(*q.shape[:-1], 4, 4)

    def palms(self, arm: Array) -> tuple[Array, Array]:
        """Palm rotation [B, 3, 3] and position [B, 3] of arm joints [B, A]."""
        starts = range(0, max(1, len(arm)), CHUNK)
        chunks = (self._along(arm[k : k + CHUNK]) for k in starts)
        rotations, positions, *_ = zip(*chunks, strict=True)
        return np.concatenate(rotations), np.concatenate(positions)

    def palm_and_jacobian(self, arm: Array) -> tuple[Array, Array, Array]:
        """Palm rotation [B, 3, 3], position [B, 3] and Jacobian [B, 6, A] of arm joints [B, A].

        The Jacobian's first three rows are velocity, the others angular velocity, in the world.
        """
        rotation, position, rotations, origins = self._along(arm)
        axes = np.matmul(rotations, self._axes[:, None, :, None])[..., 0]
        slides = self._sliding[:, None, None]
        along = np.where(slides, axes, _cross(axes, position - origins))
        jacobian = np.zeros((len(arm), 6, arm.shape[1]))
        jacobian[:, :3, self._columns] = along.transpose(1, 2, 0)
        jacobian[:, 3:, self._columns] = np.where(slides, 0.0, axes).transpose(1, 2, 0)
        return rotation, position, jacobian

    def pose_error(self, arm: Array, goals: Array) -> tuple[Array, Array]:
        """Translation [m] and rotation vector [rad] from the palm to T_world_palm `goals`
        [B, 4, 4], as [B, 6], and the Jacobian [B, 6, A], at arm joints [B, A]; all in the world."""
        rotation, position, jacobian = self.palm_and_jacobian(arm)
        turn = rotation_vector(goals[:, :3, :3] @ np.swapaxes(rotation, 1, 2))
        return np.concatenate([goals[:, :3, 3] - position, turn], axis=1), jacobian

    def _along(self, arm: Array) -> tuple[Array, Array, Array, Array]:
        """The palm's rotation [B, 3, 3] and position [B, 3]; and of the M joints on the way the
        rotations [M, B, 3, 3] behind each and the places [M, B, 3] of each."""
        count = len(arm)
        rotation = np.broadcast_to(self._base[:3, :3], (count, 3, 3))
        position = np.broadcast_to(self._base[:3, 3], (count, 3))
        rotations = np.empty((len(self._before), count, 3, 3))
        origins = np.empty((len(self._before), count, 3))
        angles = arm.T[self._columns, :, None, None]
        turns = self._constant + np.sin(angles) * self._with_sine
        turns += np.cos(angles) * self._with_cosine
        for k, before in enumerate(self._before):
            position = position + rotation @ before[:3, 3]
            origins[k] = position
            rotation = np.matmul(rotation, turns[k], out=rotations[k])
            if self._sliding[k]:
                position = position + rotation @ self._axes[k] * arm[:, self._columns[k], None]
        position = position + rotation @ self._palm[:3, 3]
        return rotation @ self._palm[:3, :3], position, rotations, origins


def _moving_joints(robot: RobotDescription) -> tuple[list[int], list[Array]]:
    """Columns in q of the arm's joints, from the base to the palm, and poses [4, 4].

    The poses are of these joints, then of the palm, each in the frame of the joint before.
    """
    chain = robot.tree.joints_to_root(robot.palm_link)
    unused = set(robot.arm_joints) - {joint.name for joint in chain}
    if unused:
        raise InputError(
            f"the arm joint {min(unused)!r} does not move the palm",
            where=robot.name,
            allowed="arm joints between the root and the palm's link",
        )
    columns, poses = [], [np.eye(4)]
    for joint in reversed(chain):
        poses[-1] = poses[-1] @ joint.T_parent_joint
        if joint.name in robot.arm_joints:
            columns.append(robot.arm_joints.index(joint.name))
            poses.append(np.eye(4))
    poses[-1] = poses[-1] @ robot.T_link_palm
    return columns, poses


def _cross(a: Array, b: Array) -> Array:
    """Cross products [..., 3]; np.cross spends ten times as long on finding its axes."""
    product = np.empty_like(a)
    product[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    product[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    product[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
