"""Camera calibration to a robot from files: images of a board, intrinsics, robot poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.charuco import (
    FEWEST_CORNERS,
    BoardView,
    CharucoBoard,
    find_board,
    why_not_found,
    without_distortion,
)
from pointsdf_cli.camera.hand_eye import FEWEST_IMAGES, HandEye, calibrate_hand_eye
from pointsdf_cli.camera.intrinsics import read_lens
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.io.board_images import list_images, match_poses, read_grey
from pointsdf_cli.io.robot_poses import read_robot_poses

MOST_EXPLAINED = 3
"""Number of images in which other boards are searched if this one is nowhere."""


@dataclass(frozen=True)
class Calibration:
    """A calibration and the images that it came from.

    Attributes:
        hand_eye: The poses and residuals of the images with a board.
        images: Names of these images.
        corners: Number of corners found in each.
        without_board: Names of the images in which no board was found.
        matched_by_name: Whether the poses carry the images' names.
    """

    hand_eye: HandEye
    images: list[str]
    corners: list[int]
    without_board: list[str]
    matched_by_name: bool

    @property
    def outliers(self) -> list[str]:
        """Names of the images that do not fit and were left out."""
        fitting = zip(self.images, self.hand_eye.used, strict=True)
        return [name for name, used in fitting if not used]


def calibrate_from_files(
    folder: Path,
    intrinsics: str,
    robot_poses: Path,
    board: CharucoBoard,
    eye_in_hand: bool,
    pose_unit: str = "m",
    on_image: Callable[[str], None] = lambda name: None,
) -> Calibration:
    """The camera's pose from a folder of images and a file of robot poses.

    Args:
        folder: Images, all of one size.
        intrinsics: As for `read_lens`.
        robot_poses: As for `read_robot_poses`.
        board: Board in the images.
        eye_in_hand: Camera on the gripper and board fixed; else the other way round.
        pose_unit: Unit of the robot's translations.
        on_image: Called with each image's name once it was looked at.

    Raises:
        InputError: Images, intrinsics, poses or board do not fit together.
    """
    paths = list_images(folder)
    given = read_robot_poses(robot_poses, pose_unit)
    order = match_poses(paths, given.names, len(given.T_base_gripper), robot_poses)
    camera, views, lost = _find_boards(paths, intrinsics, board, on_image)
    if camera is None or len(views) < FEWEST_IMAGES:
        raise _too_few(folder, [paths[i].name for i in views], len(paths), board, lost)
    poses = given.T_base_gripper[[order[i] for i in views]]
    with as_input_error(robot_poses, or_named=True):
        solved = calibrate_hand_eye(poses, list(views.values()), board.corners, camera, eye_in_hand)
    return Calibration(
        solved,
        [paths[i].name for i in views],
        [len(view.ids) for view in views.values()],
        [path.name for i, path in enumerate(paths) if i not in views],
        given.names is not None,
    )


def _find_boards(
    paths: list[Path], intrinsics: str, board: CharucoBoard, on_image: Callable[[str], None]
) -> tuple[Camera | None, dict[int, BoardView], list[NDArray[np.uint8]]]:
    """Camera, boards by the number of their image, and a few images without a board."""
    camera = None
    lost: list[NDArray[np.uint8]] = []
    views: dict[int, BoardView] = {}
    for index, path in enumerate(paths):
        image = read_grey(path)
        height, width = image.shape
        if camera is None:
            camera, lens = read_lens(intrinsics, width, height)
        elif (width, height) != (camera.width, camera.height):
            raise InputError(
                f"has {width} × {height} pixels, and {paths[0].name} {camera.width} × "
                f"{camera.height}",
                where=path,
                allowed="images of one camera, all of one size",
            )
        found = find_board(image, board)
        if found is not None:
            views[index] = without_distortion(found, camera, lens)
        elif len(lost) < MOST_EXPLAINED:
            lost.append(image)
        on_image(path.name)
    return camera, views, lost


def _too_few(
    folder: Path, found: list[str], count: int, board: CharucoBoard, lost: list[NDArray[np.uint8]]
) -> InputError:
    where = f" ({', '.join(found)})" if found else ""
    advice = why_not_found(lost, board)
    return InputError(
        f"a board of {board} was found in {len(found)} of {count} images{where}",
        where=folder,
        allowed=f"at least {FEWEST_IMAGES} images with {FEWEST_CORNERS} corners or more; about 15 "
        "with different rotations are good",
        hint=advice
        or "sharp images without glare, a flat board, and --squares, --square, --marker and "
        "--dictionary as printed",
    )
