"""Closed-form hand-eye calibration: AX = XB from robot poses and board poses.

Eye-in-hand, the camera rides on the gripper and the board stands still:

    T_base_gripper · X · T_camera_board = Z        X = T_gripper_camera, Z = T_base_board

Eye-to-hand, the camera stands still and the board rides on the gripper: the same equation with
T_gripper_base in place of T_base_gripper, X = T_base_camera and Z = T_gripper_board. Below,
`T_fixed_moving` is whichever of the two applies.

F. Park, B. Martin, "Robot Sensor Calibration: Solving AX = XB on the Euclidean Group", IEEE
Transactions on Robotics and Automation 10(5), 1994. (OpenCV's calibrateHandEye is missing from the
Python package of OpenCV 5.0.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform, rotation_vector, transform

LARGEST_TURN = np.radians(170)
"""Relative rotations beyond this are left out: the axis of half a turn has no sign."""


class HandEyePoses(NamedTuple):
    """The two unknown transforms, each [4, 4].

    `X` is T_gripper_camera (eye-in-hand) or T_base_camera (eye-to-hand); `Z` is T_base_board or
    T_gripper_board.
    """

    X: Array
    Z: Array


def solve_hand_eye(T_fixed_moving: Array, T_camera_board: Array) -> HandEyePoses:
    """X and Z of `T_fixed_moving · X · T_camera_board = Z`, by least squares over all pairs.

    Args:
        T_fixed_moving: [N, 4, 4], N ≥ 3, with rotations about at least two axes.
        T_camera_board: [N, 4, 4], of the same instants.
    """
    first, second = np.triu_indices(len(T_fixed_moving), 1)
    motion = invert_transform(T_fixed_moving[second]) @ T_fixed_moving[first]
    seen = T_camera_board[second] @ invert_transform(T_camera_board[first])
    a, b = rotation_vector(motion[:, :3, :3]), rotation_vector(seen[:, :3, :3])
    small = np.linalg.norm(a, axis=1) < LARGEST_TURN
    rotation = _nearest_rotation(a[small].T @ b[small])  # the least Σ |a - R b|² (Kabsch)
    # (R_motion - 1) t = R_X t_seen - t_motion
    left = (motion[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (seen[:, :3, 3] @ rotation.T - motion[:, :3, 3]).ravel()
    X = transform(rotation, np.linalg.lstsq(left, right, rcond=None)[0])
    mean = (T_fixed_moving @ X @ T_camera_board).mean(axis=0)
    return HandEyePoses(X, transform(_nearest_rotation(mean[:3, :3]), mean[:3, 3]))


def _nearest_rotation(matrix: Array) -> Array:
    """The rotation [3, 3] nearest to a matrix [3, 3]."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def rotation_spread(T: Array) -> Array:
    """Root-mean-square relative rotation [rad] about the three principal axes, the largest first.

    The second of them must be well above the noise: from rotations about parallel axes, the
    camera's place along that axis cannot be found.

    Args:
        T: Poses [N, 4, 4].
    """
    first, second = np.triu_indices(len(T), 1)
    turns = rotation_vector(np.swapaxes(T[first, :3, :3], -1, -2) @ T[second, :3, :3])
    return np.sqrt(np.linalg.eigvalsh(turns.T @ turns / max(len(turns), 1)).clip(0)[::-1])
