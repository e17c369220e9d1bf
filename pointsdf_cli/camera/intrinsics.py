"""Readers of camera intrinsics in common formats."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.untrusted import read_json, read_npy_array, read_yaml

FORMS = (
    "a 3×3 matrix K (JSON, YAML, text, NPY); {K: …, width, height}; ROS camera_info (k or K, d or "
    "D, width, height; also the calibration file with camera_matrix); RealSense (fx, fy, ppx, ppy, "
    "coeffs, width, height); Open3D (intrinsic_matrix by columns); or the name of a camera: "
    + ", ".join(CAMERAS)
)
_FOCAL = {"fx": ("fx",), "fy": ("fy",), "cx": ("cx", "ppx"), "cy": ("cy", "ppy")}
_MATRIX = ("K", "k", "camera_matrix", "intrinsic_matrix", "intrinsics", "matrix")
_NESTED = ("depth", "depth_intrinsics", "intrinsics", "intrinsic", "camera")
_WIDTH, _HEIGHT = ("width", "image_width"), ("height", "image_height")
_NAMED = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_DISTORTION = re.compile(r"d|dist(?!ance).*|coef.*")
"""Names of distortion, in lower case: the libraries of cameras write dist, distCoeffs, D, …"""
_BENT = re.compile(r"fish|equi|kannala|omni(?!vision)|\bmei\b|scaramuzza|double.?sphere|ftheta")
"""Lenses that bend the image also where all of their coefficients are 0."""
_STRAIGHT = re.compile(r"none|pinhole|plumb|rational|brown|rad|opencv|perspective|thin.?prism")
"""Distortion models that are a pinhole where all of their coefficients are 0."""
_OPENCV_MODELS = ("plumb_bob", "rational_polynomial", "brown_conrady", "radtan", "opencv")
SMALLEST_DISTORTION = 1e-6
SHORTEST = 3.0
"""Focal lengths below this [pixels] are not in pixels."""
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
            camera's size is the file's, or else the even one whose middle is next to the principal
            point: 640 for 319.5 and for 320.
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
    if 0 < min(fx, fy) < SHORTEST:
        raise InputError(
            f"has focal lengths of {fx:g} and {fy:g}: these look like shares of the image's size",
            where=path,
            allowed="focal lengths and principal point in pixels",
        )
    width = 2 * max(1, math.ceil(cx)) if width is None else width
    height = 2 * max(1, math.ceil(cy)) if height is None else height
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
    elif path.suffix.lower() == ".npy":
        data = read_npy_array(path)
    else:
        # `ros2 topic echo` ends each message by `---`, and YAML begins another document there.
        data = read_yaml(path, first_document=True)
    if not isinstance(data, Mapping):
        if isinstance(data, str):  # rows of numbers, as np.savetxt writes them
            data = data.replace(",", " ").split()
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
    if not np.isfinite(matrix).all():
        raise InputError("holds NaN or infinity", where=path, allowed=FORMS)
    if np.abs(rest).max() > 1e-9:
        raise InputError(
            "has skew or is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", where=path, allowed=FORMS
        )
    return tuple(float(v) for v in matrix[[0, 1, 0, 1], [0, 1, 2, 2]])  # type: ignore[return-value]


def _floats(value: Any) -> list[float]:
    """Numbers in any nesting of lists and mappings, in their order."""
    found, waiting = [], [value]
    while waiting:
        each = waiting.pop()
        if isinstance(each, Mapping):
            # OpenCV's and ROS's mappings of a matrix also have its size.
            inner = [value for key, value in each.items() if key not in ("rows", "cols")]
            waiting += [each["data"]] if "data" in each else inner[::-1]
        elif isinstance(each, list | tuple):
            waiting += each[::-1]
        elif isinstance(each, int | float | str) and not isinstance(each, bool):
            try:
                found.append(float(each))
            except OverflowError:
                found.append(np.inf)
            except ValueError:
                continue  # a name of a model
    return found


def _distortion(data: Mapping[str, Any]) -> dict[str, list[float]]:
    """Distortion coefficients by their name in the file; empty if all are 0."""
    found = {}
    for name, value in data.items():
        numbers, low = _floats(value), str(name).lower()
        # Stereo calibrations call whole matrices K1 and P1.
        named = low in _NAMED and len(numbers) == 1
        if (named or _DISTORTION.fullmatch(low)) and not (
            np.abs(numbers).max(initial=0.0) <= SMALLEST_DISTORTION
        ):
            found[str(name)] = numbers
    return found


def lens_model(data: Mapping[str, Any], path: Path) -> str:
    """The distortion model that a file names; "" for none.

    Raises:
        InputError: One that is no pinhole even where its coefficients are 0.
    """
    lens = data.get("distortion")
    inner = lens if isinstance(lens, Mapping) else {"model": lens}
    names = [data.get("distortion_model"), inner.get("model"), inner.get("type")]
    told = [str(each) for each in names if each and not _floats(each)]
    about = [str(data[key]) for key in ("model", "camera_model") if data.get(key)]
    for name in (*told, *about):
        # `model` may also name the camera itself.
        if _BENT.search(name.lower()) or (name in told and not _STRAIGHT.search(name.lower())):
            raise InputError(
                f"has the distortion model {name}, which is no pinhole",
                where=path,
                allowed="models " + ", ".join(("pinhole", *_OPENCV_MODELS)),
                hint="rectify the images first, and give the rectified K",
            )
    return next(iter(told or about), "")


def _check_distortion(data: Mapping[str, Any], path: Path) -> None:
    for key, values in _distortion(data).items():
        raise InputError(
            f"`{key}` gives the camera distortion (up to {np.abs(values).max():g}), but a pinhole "
            "camera is needed",
            where=path,
            allowed="all distortion coefficients 0",
            hint="rectify the depth image first (ROS: depth_image_proc or image_proc; OpenCV: "
            "initUndistortRectifyMap with nearest-neighbour remap) and give the rectified K. "
            "RealSense depth images are rectified already: their own coefficients are 0",
        )
    lens_model(data, path)


def _coefficients(data: Mapping[str, Any], path: Path) -> tuple[float, ...]:
    """OpenCV's distortion coefficients; none if all are zero."""
    model, given = lens_model(data, path), _distortion(data)
    if not given:
        return ()
    found = next(iter(given.values()))
    inner = [value for value in data.values() if isinstance(value, Mapping)]
    for mapping in (data, *inner):
        low = {str(name).lower(): value for name, value in mapping.items()}
        if any(name in low for name in _NAMED):
            found = [each for name in _NAMED for each in _floats(low.get(name, 0.0))]
            break
    known = (model or "plumb_bob").lower().removeprefix("distortion.") in _OPENCV_MODELS
    if not known or len(found) not in (4, 5, 8) or not np.isfinite(found).all():
        raise InputError(
            f"has {len(found)} distortion coefficients of the model {model or 'plumb_bob'}",
            where=path,
            allowed=LENSES,
            hint="rectify the images first, and give the rectified K",
        )
    return tuple(found)


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
