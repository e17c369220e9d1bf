"""Camera poses as a user types or stores them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import is_rigid, rotation_from_wxyz, transform
from pointsdf_cli.io.untrusted import read_json, read_npy_array

ALLOWED = (
    "X,Y,Z,QW,QX,QY,QZ (m, quaternion scalar first), or 16 numbers of a 4×4 matrix by rows, typed "
    "or in a text, JSON or NPY file; the camera in the world, OpenCV axes"
)


def camera_pose(text: str) -> NDArray[np.float64]:
    """T_world_camera [4, 4] from `--camera-pose`: numbers, or a file that holds them.

    Raises:
        InputError: Neither, or no rotation and translation.
    """
    numbers = _numbers(text)
    if len(numbers) == 7 and np.linalg.norm(numbers[3:]) > 1e-6:
        return transform(rotation_from_wxyz(numbers[3:]), numbers[:3])
    matrix = numbers.reshape(4, 4) if len(numbers) == 16 else np.zeros((4, 4))
    if not is_rigid(matrix):
        raise InputError(
            f"{len(numbers)} numbers that are no pose", where="--camera-pose", allowed=ALLOWED
        )
    return matrix


def _numbers(text: str) -> NDArray[np.float64]:
    path = Path(text)
    try:
        if path.is_file():
            if path.suffix == ".npy":
                return read_npy_array(path).astype(np.float64).ravel()
            if path.suffix == ".json":
                return np.asarray(read_json(path), dtype=np.float64).ravel()
            text = path.read_text(encoding="utf-8")
        words = text.replace(",", " ").replace(";", " ").split()
        numbers = np.array([float(word) for word in words])
    except (ValueError, TypeError, OSError) as error:
        raise InputError(
            f"{text[:60]!r} is neither numbers nor a file of them",
            where="--camera-pose",
            allowed=ALLOWED,
        ) from error
    if not np.isfinite(numbers).all():
        raise InputError("holds NaN or infinity", where="--camera-pose", allowed=ALLOWED)
    return numbers
