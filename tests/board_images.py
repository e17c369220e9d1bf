"""Images of a flat board seen by a pinhole camera, for tests of calibration."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pointsdf_cli.camera.charuco import CharucoBoard, draw_board
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform, transform
from pointsdf_cli.viz.shading import look_at

HD = Camera(1280, 720, 912.0, 911.0, 641.3, 358.9)
FINER = 3
PER_SQUARE = 120


def render_board(
    board: CharucoBoard,
    camera: Camera,
    T_camera_board: Array,
    rng: np.random.Generator | None = None,
    noise: float = 2.0,
) -> NDArray[np.uint8]:
    """A grey image [height, width]: the board's plane warped `FINER` times too fine, then averaged,
    with Gaussian noise of `noise` grey levels."""
    margin = PER_SQUARE // 2
    texture = draw_board(board, PER_SQUARE, margin)
    # Texture pixels to metres on the board: the first square's corner lies between two pixels.
    scale = board.square / PER_SQUARE
    shift = (0.5 - margin) * scale
    to_board = np.array([[scale, 0, shift], [0, scale, shift], [0, 0, 1]])
    to_image = camera.K @ T_camera_board[:3, [0, 1, 3]] @ to_board
    to_fine = np.array([[FINER, 0, (FINER - 1) / 2], [0, FINER, (FINER - 1) / 2], [0, 0, 1.0]])
    fine = cv2.warpPerspective(
        texture, to_fine @ to_image, (camera.width * FINER, camera.height * FINER),
        flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110,
    )  # fmt: skip
    seen = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    grey = 20.0 + 0.8 * seen
    if rng is not None:
        grey += rng.normal(0.0, noise, grey.shape)
    return np.rint(grey.clip(0, 255)).astype(np.uint8)


def boards_in_view(
    board: CharucoBoard, camera: Camera, count: int, rng: np.random.Generator, tilt: float = 35.0
) -> list[Array]:
    """T_camera_board of boards tilted by up to `tilt` degrees about each axis, all in the image."""
    corners = np.array([[x, y, 0] for x in (0, board.columns) for y in (0, board.rows)])
    corners = corners * board.square
    found: list[Array] = []
    while len(found) < count:
        angles = rng.uniform(-tilt, tilt, 2)
        spin = rng.uniform(-180, 180)
        rotation = Rotation.from_euler("XYZ", [*angles, spin], degrees=True).as_matrix()
        middle = np.array([*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.6, 0.9)])
        T = transform(rotation, middle - rotation @ corners.mean(axis=0))
        pixels = camera.project(corners @ T[:3, :3].T + T[:3, 3])
        if (pixels > 10).all() and (pixels < [camera.width - 10, camera.height - 10]).all():
            found.append(T)
    return found


T_GRIPPER_BOARD = transform(
    Rotation.from_euler("xyz", [172, 8, 41], degrees=True).as_matrix(), [0.06, -0.11, 0.04]
)
T_GRIPPER_CAMERA = transform(
    Rotation.from_euler("xyz", [4, -7, 88], degrees=True).as_matrix(), [0.05, -0.03, 0.07]
)
T_WORLD_CAMERA = look_at((1.3, 0.2, 0.8), (0.5, 0.0, 0.2))
T_WORLD_BOARD = transform(
    Rotation.from_euler("xyz", [2, -3, 60], degrees=True).as_matrix(), [0.5, 0.1, 0.01]
)


def robot_poses(T_camera_board: list[Array], eye_in_hand: bool) -> list[Array]:
    """T_world_gripper at which the camera sees the board so."""
    if eye_in_hand:
        T_camera_gripper = invert_transform(T_GRIPPER_CAMERA)
        return [T_WORLD_BOARD @ invert_transform(T) @ T_camera_gripper for T in T_camera_board]
    return [T_WORLD_CAMERA @ T @ invert_transform(T_GRIPPER_BOARD) for T in T_camera_board]
