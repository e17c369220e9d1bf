"""Hand-eye calibration from images of a board: closed form, then least reprojection error.

Each image i relates a robot pose, the camera and the board; X and Z are those of
`geometry/hand_eye.py`:

    T_camera_board_i = (T_fixed_moving_i · X)⁻¹ · Z

The closed form starts a least-squares fit of X and Z to the board's corners in all images. Images
that do not fit (a pose of another moment, a board that slipped) are found and left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.charuco import BoardView
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    rotation_vector,
    transform,
)
from pointsdf_cli.geometry.hand_eye import HandEyePoses, rotation_spread, solve_hand_eye

FEWEST_IMAGES = 5
SMALLEST_SPREAD = np.radians(5)
"""Least root-mean-square rotation about a second axis [rad]."""
LARGEST_ERROR = 10.0
"""Median reprojection error [px] beyond which the poses do not belong to the images."""
OUTLIER, OUTLIER_PIXELS = 4.0, 1.0
"""Factor over the median error, and error in pixels, above which an image is left out."""
SUBSETS = 60
"""Number of random triples of images tried as starts of the fit, against wrong poses."""


@dataclass(frozen=True)
class HandEye:
    """A calibration and its residuals.

    Attributes:
        X: T_base_camera [4, 4] (eye-to-hand) or T_gripper_camera (eye-in-hand).
        Z: T_gripper_board or T_base_board.
        error_px: [N] root-mean-square reprojection error of each image [px].
        error_mm: [N] distance between the board's centre by the robot's pose and by the image
            alone [mm].
        error_deg: [N] angle between these two poses of the board [°].
        used: [N] whether the image took part in the fit.
        sigma_mm, sigma_deg: Standard deviation of X's position and rotation, from the scatter
            between images.
    """

    X: Array
    Z: Array
    error_px: Array
    error_mm: Array
    error_deg: Array
    used: NDArray[np.bool_]
    sigma_mm: float
    sigma_deg: float


@dataclass(frozen=True)
class _Observations:
    """Poses, the camera, and the corners on the board [m] and in the images [px]."""

    T_fixed_moving: Array
    camera: Camera
    corners: list[Array]
    pixels: list[Array]

    def errors(self, poses: HandEyePoses, images: Sequence[int]) -> list[Array]:
        """Reprojection errors [n, 2] px of the images, the corners behind the camera made far."""
        found = []
        for i in images:
            T_camera_board = invert_transform(self.T_fixed_moving[i] @ poses.X) @ poses.Z
            seen = apply_transform(T_camera_board, self.corners[i])
            seen[:, 2] = np.maximum(seen[:, 2], 1e-3)
            found.append(self.camera.project(seen) - self.pixels[i])
        return found

    def rms(self, poses: HandEyePoses) -> Array:
        """Root-mean-square reprojection error [N] of each image, px."""
        errors = self.errors(poses, range(len(self.pixels)))
        return np.array([np.sqrt((e**2).sum(axis=1).mean()) for e in errors])


def calibrate_hand_eye(
    T_base_gripper: Array,
    views: Sequence[BoardView],
    corners: Array,
    camera: Camera,
    eye_in_hand: bool,
) -> HandEye:
    """Compute the camera's pose from views of a board and the robot's poses.

    Args:
        T_base_gripper: [N, 4, 4] in m, one an image, at least `FEWEST_IMAGES`.
        views: Corners found in each image, without distortion.
        corners: [M, 3] of the board, m.
        camera: Intrinsics.
        eye_in_hand: Camera on the gripper and board fixed; else camera fixed, board on the gripper.

    Raises:
        InputError: Rotations about fewer than two axes, or images and poses do not fit together.
    """
    spread = rotation_spread(T_base_gripper)
    if spread[1] < SMALLEST_SPREAD:
        first, second = np.degrees(spread[:2])
        raise InputError(
            f"the robot's poses differ by {first:.1f}° about one axis and by {second:.1f}° about "
            "all others: too little to determine the camera's position",
            allowed=f"rotations about two axes or more, at least {np.degrees(SMALLEST_SPREAD):g}° "
            "and better 30°",
            hint="tilt the gripper to all sides between the images",
        )
    alone = np.stack([board_pose(view, corners, camera) for view in views])
    fixed_moving = T_base_gripper if eye_in_hand else invert_transform(T_base_gripper)
    on_board, pixels = [corners[view.ids] for view in views], [view.pixels for view in views]
    seen = _Observations(fixed_moving, camera, on_board, pixels)
    poses, used = _fit(seen, alone)
    rms = seen.rms(poses)
    if np.median(rms) > LARGEST_ERROR or used.sum() < FEWEST_IMAGES:
        raise _does_not_fit(seen, alone, float(np.median(rms)), int(used.sum()))
    position, rotation = _standard_deviations(seen, poses, np.flatnonzero(used).tolist())
    placed = invert_transform(fixed_moving @ poses.X) @ poses.Z
    starts = zip(views, placed, strict=True)
    refined = np.stack([board_pose(view, corners, camera, T) for view, T in starts])
    middle = corners.mean(axis=0)[None]
    apart = apply_transform(placed, middle) - apply_transform(refined, middle)
    turned = rotation_vector(np.swapaxes(placed[:, :3, :3], -1, -2) @ refined[:, :3, :3])
    return HandEye(
        X=poses.X,
        Z=poses.Z,
        error_px=rms,
        error_mm=1000 * np.linalg.norm(apart[:, 0], axis=1),
        error_deg=np.degrees(np.linalg.norm(turned, axis=1)),
        used=used,
        sigma_mm=1000 * position,
        sigma_deg=float(np.degrees(rotation)),
    )


def board_pose(
    view: BoardView, corners: Array, camera: Camera, start: Array | None = None
) -> Array:
    """T_camera_board [4, 4] from one image.

    Args:
        view: Corners found, without distortion.
        corners: [M, 3] of the board, m.
        camera: Intrinsics.
        start: A pose near the answer. A flat board seen from afar has two poses that fit about
            equally well; the start decides, else the smaller error.
    """
    import cv2

    points, pixels = corners[view.ids], view.pixels
    if start is None:
        _, turn, shift = cv2.solvePnP(points, pixels, camera.K, None, flags=cv2.SOLVEPNP_IPPE)
    else:
        turn = scipy.spatial.transform.Rotation.from_matrix(start[:3, :3]).as_rotvec()[:, None]
        shift = start[:3, 3:].copy()
    turn, shift = cv2.solvePnPRefineLM(points, pixels, camera.K, None, turn, shift)
    rotation = scipy.spatial.transform.Rotation.from_rotvec(np.ravel(turn)).as_matrix()
    return transform(rotation, np.ravel(shift))


def _fit(seen: _Observations, alone: Array) -> tuple[HandEyePoses, NDArray[np.bool_]]:
    """X and Z, and which images they were fitted to."""
    poses = _start(seen, alone)
    used = _agreeing(seen.rms(poses), np.ones(len(alone), bool))
    for _ in range(4):
        poses = _refine(seen, poses, np.flatnonzero(used).tolist())
        now = _agreeing(seen.rms(poses), used)
        if (now == used).all():
            break
        used = now
    return poses, used


def _start(seen: _Observations, alone: Array) -> HandEyePoses:
    """The closed form of all images or of three, whichever has the least median error."""
    count, rng = len(alone), np.random.default_rng(0)
    subsets = [np.arange(count)] + [rng.choice(count, 3, replace=False) for _ in range(SUBSETS)]
    tried: list[tuple[float, int, HandEyePoses]] = []
    for subset in subsets:
        # All images were checked already; by their inverse poses, which spread a little otherwise.
        enough = rotation_spread(seen.T_fixed_moving[subset])[1] >= SMALLEST_SPREAD
        if enough or len(subset) == count:
            poses = solve_hand_eye(seen.T_fixed_moving[subset], alone[subset])
            tried.append((float(np.median(seen.rms(poses))), len(tried), poses))
    return min(tried)[2]


def _agreeing(rms: Array, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the images with an error close to that of the images in use; never fewer than
    half."""
    limit = max(OUTLIER * float(np.median(rms[used])), OUTLIER_PIXELS, float(np.median(rms)))
    return np.asarray(rms <= limit)


def _refine(seen: _Observations, poses: HandEyePoses, images: Sequence[int]) -> HandEyePoses:
    def residuals(change: Array) -> Array:
        return np.concatenate(seen.errors(_moved(poses, change), images)).ravel()

    solved = scipy.optimize.least_squares(residuals, np.zeros(12), x_scale=0.1, loss="soft_l1")
    return _moved(poses, solved.x)


def _moved(poses: HandEyePoses, change: Array) -> HandEyePoses:
    """X and Z after small rotations (rotation vectors) and translations [m] in their own frames."""
    turn, shift = np.hsplit(change.reshape(2, 6), [3])
    small = transform(scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix(), shift)
    return HandEyePoses(poses.X @ small[0], poses.Z @ small[1])


def _standard_deviations(
    seen: _Observations, poses: HandEyePoses, images: Sequence[int]
) -> tuple[float, float]:
    """Standard deviations of X's position [m] and rotation [rad], by a cluster-robust covariance:
    the errors of one image share a robot pose."""

    def residuals(change: Array, i: int) -> Array:
        return seen.errors(_moved(poses, change), [i])[0].ravel()

    information, scatter = np.zeros((12, 12)), np.zeros((12, 12))
    step = 1e-6
    for i in images:
        steps = step * np.eye(12)
        differences = [residuals(change, i) - residuals(-change, i) for change in steps]
        jacobian = np.stack(differences, axis=1) / (2 * step)
        gradient = jacobian.T @ residuals(np.zeros(12), i)
        information += jacobian.T @ jacobian
        scatter += np.outer(gradient, gradient)
    inverse = np.linalg.pinv(information)
    # Small-sample correction: 12 unknowns fitted, 6 numbers per image about the robot's pose.
    few = len(images) / max(len(images) - 2, 1)
    variance = np.diag(inverse @ scatter @ inverse) * few
    return float(np.sqrt(variance[3:6].sum())), float(np.sqrt(variance[:3].sum()))


def _does_not_fit(seen: _Observations, alone: Array, error: float, fitting: int) -> InputError:
    """Message for poses that do not belong to the images, with the matching pairing, if any."""
    inverted = replace(seen, T_fixed_moving=invert_transform(seen.T_fixed_moving))
    other = float(np.median(inverted.rms(_start(inverted, alone))))
    if other < min(LARGEST_ERROR, 0.2 * error):
        hint = (
            f"they do ({other:.2g} px) with the other arrangement (--eye-in-hand: camera on the "
            "wrist, board fixed; without it: camera fixed, board on the gripper), or if the poses "
            "are of the base in the gripper's frame: then invert them"
        )
    else:
        hint = (
            "check that image and pose n are of the same moment, the order of the quaternions, "
            "--pose-unit, and --square against the printed board"
        )
    return InputError(
        f"the robot's poses do not fit the images: a median reprojection error of {error:.3g} px, "
        f"{fitting} of {len(alone)} images agree",
        allowed=f"at most {LARGEST_ERROR:g} px",
        hint=hint,
    )
