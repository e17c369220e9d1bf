"""Readers of camera intrinsics in common formats."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.untrusted import read_json, read_yaml

FORMS = (
    "a 3×3 matrix K; {K: …, width, height}; ROS camera_info (k or K, d or D, width, height; also "
    "the calibration file with camera_matrix); RealSense (fx, fy, ppx, ppy, coeffs, width, "
    "height); Open3D (intrinsic_matrix by columns); or the name of a camera: " + ", ".join(CAMERAS)
)
_FOCAL = {"fx": ("fx",), "fy": ("fy",), "cx": ("cx", "ppx"), "cy": ("cy", "ppy")}
_MATRIX = ("K", "k", "camera_matrix", "intrinsic_matrix", "intrinsics", "matrix")
_NESTED = ("depth", "depth_intrinsics", "intrinsics", "intrinsic", "camera")
_DISTORTION = (
    *("D", "d", "coeffs", "distortion_coefficients", "distortion", "distortion_coeffs"),
    *("dist_coeffs", "dist_coeff", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"),
)
_WIDTH, _HEIGHT = ("width", "image_width"), ("height", "image_height")
_NAMED = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_OPENCV_MODELS = ("plumb_bob", "rational_polynomial", "brown_conrady", "radtan", "opencv")
SMALLEST_DISTORTION = 1e-6
LENSES = (
    "OpenCV's k1, k2, p1, p2, then none, k3, or k3, k4, k5, k6 (models "
    + ", ".join(_OPENCV_MODELS)
    + ")"
)


def read_intrinsics(
    name: str, width: int | None = None, height: int | None = None, image: str = "the depth image"
) -> Camera:
    """Read the camera of an image of `width` × `height` pixels.

    Args:
        name: A file in one of `FORMS` (JSON or YAML), or a camera's name.
        width, height: Size of the image; a file that gives another one is refused. If None, the
            camera's size is the file's, or twice the principal point.
        image: Name of the image, for messages.

    Raises:
        InputError: The file or its form is unknown, its image size differs, or it has distortion.
    """
    camera, data = _read(name, width, height, image)
    _check_distortion(data, Path(name))
    return camera


def read_lens(name: str, width: int, height: int) -> tuple[Camera, tuple[float, ...]]:
    """Read the camera of an image of `width` × `height` pixels and its distortion.

    Args:
        name: A file in one of `FORMS` (JSON or YAML), or a camera's name.
        width, height: Size of the image; a file that gives another one is refused.

    Returns:
        The camera, and OpenCV's coefficients k1, k2, p1, p2[, k3[, k4, k5, k6]]; none for a pinhole
        camera.

    Raises:
        InputError: The file or its form is unknown, its image size differs, or its distortion model
            is not supported.
    """
    camera, data = _read(name, width, height, "the image")
    return camera, _coefficients(data, Path(name))


def _read(
    name: str, width: int | None, height: int | None, image: str
) -> tuple[Camera, Mapping[str, Any]]:
    """The camera without its distortion, and the other contents of its file."""
    if name in CAMERAS:
        camera = CAMERAS[name]
        size = (width or camera.width, height or camera.height)
        _check_size(camera.width, camera.height, *size, name, image)
        return camera, {}
    data, path = _load(name), Path(name)
    # A single dimension, or the names of ROS calibration, also tell another image size.
    mine, mine_high = (
        next((_whole(data[name], path) for name in names if data.get(name) is not None), own)
        for names, own in ((_WIDTH, width), (_HEIGHT, height))
    )
    width, height = width or mine, height or mine_high
    if width and height:
        _check_size(mine or width, mine_high or height, width, height, path, image)
    fx, fy, cx, cy = _numbers(data, path)
    if not np.isfinite([fx, fy, cx, cy]).all():
        raise InputError("fx, fy and the principal point are not finite", where=path, allowed=FORMS)
    width, height = width or max(1, round(2 * cx)), height or max(1, round(2 * cy))
    with as_input_error(path):
        camera = Camera(width, height, fx, fy, cx, cy)
    if not (0 <= cx < width and 0 <= cy < height):
        raise InputError(
            f"has its principal point ({cx:g}, {cy:g}) outside the image of {width} × {height}",
            where=path,
            allowed="intrinsics of this image: those of its own size and crop, in pixels",
        )
    return camera, data


def _load(name: str) -> Mapping[str, Any]:
    """Contents of a file; nested settings are merged, and inner ones win. A matrix alone is K."""
    path = Path(name)
    if not os.path.isfile(name):  # unlike Path's, it takes a matrix that was typed
        raise InputError("no such intrinsics", where=name[:200], allowed=FORMS)
    if path.suffix.lower() == ".json":
        data = read_json(path)
    else:
        # `ros2 topic echo` ends each message by `---`, and YAML begins another document there.
        data = read_yaml(path, first_document=True)
    if not isinstance(data, Mapping):
        if _entries(data) is None:
            raise InputError("holds no 3×3 matrix", where=path, allowed=FORMS)
        return {"K": data}
    if not _has_intrinsics(data):
        inner = [data[key] for key in _NESTED if isinstance(data.get(key), Mapping)]
        if len(inner) == 1:
            return {**data, **inner[0]}
    return data


def _has_intrinsics(data: Mapping[str, Any]) -> bool:
    has_matrix = any(_entries(data.get(key)) is not None for key in _MATRIX)
    return has_matrix or all(any(n in data for n in names) for names in _FOCAL.values())


def _numbers(data: Mapping[str, Any], path: Path) -> tuple[float, float, float, float]:
    if all(any(name in data for name in names) for names in _FOCAL.values()):
        found = [next(data[n] for n in names if n in data) for names in _FOCAL.values()]
        try:
            fx, fy, cx, cy = (float(value) for value in found)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                "fx, fy and the principal point are not numbers", where=path, allowed=FORMS
            ) from error
        return fx, fy, cx, cy
    for key in _MATRIX:
        entries = _entries(data.get(key))
        if entries is not None:
            # Open3D alone writes columns first.
            return _of_matrix(entries.reshape(3, 3), key == "intrinsic_matrix", path)
    what = f"has no intrinsics, only {', '.join(map(str, data)) or 'nothing'}"
    raise InputError(what, where=path, allowed=FORMS)


def _entries(value: Any) -> np.ndarray | None:
    """The 9 numbers of a matrix in any nesting; None if it is not a matrix."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        matrix = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return None
    return matrix if matrix.size == 9 else None


def _of_matrix(matrix: Array, by_columns: bool, path: Path) -> tuple[float, float, float, float]:
    if by_columns and np.abs(matrix[:2, 2]).max() == 0:
        matrix = matrix.T
    rest = matrix.copy()
    rest[[0, 1, 0, 1, 2], [0, 1, 2, 2, 2]] -= [*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], 1.0]
    if not np.isfinite(matrix).all() or np.abs(rest).max() > 1e-9:
        raise InputError(
            "has skew or is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", where=path, allowed=FORMS
        )
    return tuple(float(v) for v in matrix[[0, 1, 0, 1], [0, 1, 2, 2]])  # type: ignore[return-value]


def _is_numeric(value: Any) -> bool:
    """Whether a value is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_distortion(data: Mapping[str, Any], path: Path) -> None:
    for key in _DISTORTION:
        value = data.get(key)
        if isinstance(value, Mapping):
            value = value.get("data", [each for each in value.values() if _is_numeric(each)])
        if value is None:
            continue
        try:
            largest = float(np.abs(np.asarray(value, dtype=np.float64)).max(initial=0.0))
        except (TypeError, ValueError, OverflowError):
            continue  # a name of a model, not its numbers
        if not largest <= SMALLEST_DISTORTION:
            raise InputError(
                f"`{key}` gives the camera distortion (up to {largest:g}), but a pinhole camera is "
                "needed",
                where=path,
                allowed="all distortion coefficients 0",
                hint="rectify the depth image first (ROS: depth_image_proc or image_proc; OpenCV: "
                "initUndistortRectifyMap with nearest-neighbour remap) and give the rectified K. "
                "RealSense depth images are rectified already: their own coefficients are 0",
            )


def _coefficients(data: Mapping[str, Any], path: Path) -> tuple[float, ...]:
    """OpenCV's distortion coefficients; none if all are zero."""
    try:
        if any(name in data for name in _NAMED):
            found = np.array([float(data.get(name, 0.0)) for name in _NAMED])
        else:
            given = next((data[key] for key in _DISTORTION if data.get(key) is not None), ())
            given = given.get("data") if isinstance(given, Mapping) else given
            found = np.asarray(given, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            "has distortion coefficients that are not numbers", where=path, allowed=LENSES
        ) from error
    if np.abs(found).max(initial=0.0) <= SMALLEST_DISTORTION:
        return ()
    model = data.get("distortion_model") or data.get("model") or "plumb_bob"
    known = str(model).lower().removeprefix("distortion.") in _OPENCV_MODELS
    if not known or len(found) not in (4, 5, 8) or not np.isfinite(found).all():
        raise InputError(
            f"has {len(found)} distortion coefficients of the model {model}",
            where=path,
            allowed=LENSES,
            hint="rectify the images first, and give the rectified K",
        )
    return tuple(found.tolist())


def _whole(value: Any, path: Path) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value % 1 != 0:
        raise InputError(f"has a width or height of {value!r}", where=path, allowed="whole numbers")
    return int(value)


def _check_size(mine: int, my_height: int, width: int, height: int, where: Any, image: str) -> None:
    if (mine, my_height) != (width, height):
        raise InputError(
            f"is for images of {mine} × {my_height}, and {image} has {width} × {height}",
            where=where,
            allowed=f"intrinsics of {image} itself (not of another camera, or of another "
            "resolution)",
        )
