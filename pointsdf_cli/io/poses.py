"""Camera poses, places and lists of numbers as a user types or stores them."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError, require_near
from pointsdf_cli.geometry.frames import is_rigid, rotation_from_wxyz, transform
from pointsdf_cli.io.atomic import write_text_atomic
from pointsdf_cli.io.input_files import read_input
from pointsdf_cli.io.strict_json import to_json
from pointsdf_cli.io.untrusted import read_json, read_npy_array

ALLOWED = (
    "X,Y,Z,QW,QX,QY,QZ (m, quaternion scalar first), or 16 numbers of a 4×4 matrix by rows, typed "
    "or in a text, JSON or NPY file; the camera in the world, OpenCV axes"
)


TABLE_PLACE = (0.6, 0.0)
"""Default place of the object for `--camera-pose table` [m]: ahead of the robot, within its
reach."""


UNIT = 0.02
"""Largest deviation of a quaternion's length from 1: two decimals are enough."""
FARTHEST = 50.0
"""Largest distance [m] of a camera from the world's origin."""


def camera_pose(
    text: str, option: str = "--camera-pose", whose: str = "the camera", metres: float = 1.0
) -> NDArray[np.float64]:
    """T_world_camera [4, 4] from `option`: numbers, or a file that holds them.

    Args:
        text: As typed.
        option: Name of the option, for messages.
        whose: The thing with this pose, for messages.
        metres: Length of the unit of its translation [m].

    Raises:
        InputError: Neither, or no rotation and translation.
    """
    numbers = numbers_in(text, option, ALLOWED)
    matrix = numbers.reshape(4, 4) if len(numbers) == 16 else np.zeros((4, 4))
    length = float(np.linalg.norm(numbers[3:])) if len(numbers) == 7 else 1.0
    if length > 1e-6 and abs(length - 1.0) > UNIT:
        what = f"the quaternion {numbers[3:].tolist()} has length {length:.3g}, not 1"
        raise InputError(what, where=option, allowed=ALLOWED)
    if len(numbers) == 7 and length > 1e-6:
        matrix = transform(rotation_from_wxyz(numbers[3:]), numbers[:3])
    if not is_rigid(matrix):
        held = f"{text[:60]} holds " if os.path.exists(text) else ""
        what = f"{held}{len(numbers)} numbers, which are not a pose{_not_a_pose(numbers)}"
        raise InputError(what, where=option, allowed=ALLOWED)
    matrix[:3, 3] *= metres
    away = float(np.linalg.norm(matrix[:3, 3]))
    require_near(away, FARTHEST, f"{whose} is", option, "are these millimetres?")
    return matrix


def _not_a_pose(numbers: NDArray[np.float64]) -> str:
    """Likely mistake behind numbers [N] that are no pose; empty if none is known."""
    likely = {
        9: ": are they intrinsics?",
        7: ": the quaternion is 0",
        16: ": the 3×3 block is not a rotation, or the last row is not 0, 0, 0, 1",
    }
    return likely.get(len(numbers), "")


def write_pose(path: Path, pose: NDArray[np.float64]) -> None:
    """Write a pose [4, 4] as JSON, a row a line, as `camera_pose` reads it.

    Raises:
        InputError: The folder cannot be written.
    """
    rows = ",\n ".join(to_json(row) for row in pose)
    write_text_atomic(path, f"[{rows}]\n")


def target_numbers(text: str) -> NDArray[np.float64]:
    """An object's number [1] (from 1), a pixel [2] (u, v) or a place [3] in the world, m.

    Raises:
        InputError: None of these.
    """
    allowed = "an object's number from 1, a pixel U,V, a place X,Y,Z in the world (m), or any"
    numbers = numbers_in(text, "--target", allowed)
    whole_number = len(numbers) == 1 and numbers[0] >= 1 and numbers[0] % 1 == 0
    if not (whole_number or len(numbers) in (2, 3)):
        raise InputError(f"{text[:60]!r} is not a target", where="--target", allowed=allowed)
    return numbers


def table_place(text: str) -> tuple[float, float] | None:
    """Place of the object in the world [m] for `table` or `table:X,Y`; None for another pose.

    Raises:
        InputError: `table:` with something else than two numbers, or far away.
    """
    word, _, rest = text.partition(":")
    if word != "table":
        return None
    if not rest:
        return TABLE_PLACE
    allowed = "table, or table:X,Y with the object's place in the world, m"
    x, y = _exactly(2, rest, "--camera-pose", allowed)
    away, hint = float(np.hypot(x, y)), "are these millimetres?"
    require_near(away, FARTHEST, "the object's place is", "--camera-pose", hint)
    return float(x), float(y)


def box(text: str, where: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The lower and the upper corner of a box of the world, m, as a user types them.

    Raises:
        InputError: Not six finite numbers, or the corners are the other way round.
    """
    allowed = "X0,Y0,Z0,X1,Y1,Z1 in the world, m, the lower corner first"
    low, high = _exactly(6, text, where, allowed).reshape(2, 3)
    if (low >= high).any():
        raise InputError(f"a box of no size, {text}", where=where, allowed=allowed)
    return tuple(low.tolist()), tuple(high.tolist())


def _exactly(count: int, text: str, where: str, allowed: str) -> NDArray[np.float64]:
    numbers = numbers_in(text, where, allowed)
    if len(numbers) != count:
        raise InputError(f"{len(numbers)} numbers", where=where, allowed=allowed)
    return numbers


_NUMBERS = re.compile(r"[-+0-9.eE,;\s]+")


def numbers_in(text: str, where: str, allowed: str) -> NDArray[np.float64]:
    """Numbers [N] typed with commas or spaces between, or those of a text, JSON or NPY file.

    Args:
        text: The numbers, or a path.
        where, allowed: The option and what it takes, for messages.

    Raises:
        InputError: Neither numbers nor a file of them, or not all finite.
    """
    path = Path(text)
    try:
        if _NUMBERS.fullmatch(text):  # a folder may have such a name, too
            numbers = _of_text(text)
        elif os.path.exists(text):  # unlike Path's, it takes names of any length
            numbers = _of_file(path)
        elif re.fullmatch(r"[^,]*\.[A-Za-z]\w*", text):
            raise InputError("no such file", where=f"{where} {text[:200]}", allowed=allowed)
        else:
            numbers = _of_text(text)
    except (ValueError, TypeError, OverflowError, OSError) as error:
        raise InputError(
            f"{text[:60]!r} is neither numbers nor a file of them", where=where, allowed=allowed
        ) from error
    if not np.isfinite(numbers).all():
        raise InputError("holds NaN or infinity", where=where, allowed=allowed)
    return numbers


def _of_file(path: Path) -> NDArray[np.float64]:
    if path.suffix.lower() == ".npy":
        return read_npy_array(path).astype(np.float64).ravel()
    if path.suffix.lower() == ".json":
        return np.asarray(read_json(path), dtype=np.float64).ravel()
    return _of_text(read_input(path, "text").decode("utf-8-sig"))


def _of_text(text: str) -> NDArray[np.float64]:
    words = text.replace(",", " ").replace(";", " ").split()
    return np.array([float(word) for word in words])
