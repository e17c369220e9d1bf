"""Poses of a robot's gripper from JSON or CSV, one an image."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pointsdf_cli.choices import Unit, require_choice
from pointsdf_cli.errors import InputError, require_near
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import is_rigid, rotation_from_wxyz, transform
from pointsdf_cli.io.input_files import read_input
from pointsdf_cli.io.meshes import UNITS
from pointsdf_cli.io.untrusted import read_json

FORMS = (
    "JSON: a list of poses, or {image name: pose}; a pose is a 4×4 matrix, 16 numbers by rows, "
    "x, y, z, qw, qx, qy, qz, or ROS's {position: {x, y, z}, orientation: {x, y, z, w}}. CSV: a "
    "header with x, y, z, qw, qx, qy, qz in any order and perhaps image, or no header and 7 or 16 "
    "numbers a line"
)
FARTHEST = 20.0
"""A gripper farther away [m] is in another unit."""
_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
_NAMES = ("image", "name", "file", "filename")
_PARTS = (("position", "orientation"), ("translation", "rotation"))


class RobotPoses(NamedTuple):
    """Poses T_base_gripper [N, 4, 4] in m, and the images' names; None if they are in order."""

    T_base_gripper: Array
    names: tuple[str, ...] | None


def read_robot_poses(path: Path, unit: str = "m") -> RobotPoses:
    """The poses in a JSON or CSV file.

    Args:
        path: The file, in one of `FORMS`.
        unit: Unit of its translations, a key of `UNITS`.

    Raises:
        InputError: No such file or form, a pose is not a rotation and translation, or the unit is
            wrong.
    """
    require_choice(unit, Unit, "--pose-unit")
    if not path.is_file():
        raise InputError("no such file of robot poses", where=path, allowed=FORMS)
    names, values = _of_csv(path) if path.suffix.lower() in (".csv", ".txt") else _of_json(path)
    if not values:
        raise InputError("holds no poses", where=path, allowed=FORMS)
    poses = []
    for index, value in enumerate(values):
        pose = _pose(value)
        if pose is None:
            which = f"pose {index}" if names is None else f"the pose of {names[index]}"
            what = f"{which} is not a rotation and translation: {str(value)[:80]}"
            raise InputError(what, where=path, allowed=FORMS)
        pose[:3, 3] *= UNITS[unit]
        poses.append(pose)
    found = np.stack(poses)
    farthest = float(np.abs(found[:, :3, 3]).max())
    hint = "if these are millimetres, add --pose-unit mm"
    require_near(farthest, FARTHEST, "the gripper is", path, hint)
    return RobotPoses(found, None if names is None else tuple(names))


def _of_json(path: Path) -> tuple[list[str] | None, list[Any]]:
    data = read_json(path)
    if isinstance(data, Mapping) and len(data) == 1:
        (inner,) = data.values()
        if isinstance(inner, list | Mapping) and _pose(inner) is None:
            data = inner  # {"poses": …}
    if isinstance(data, Mapping):
        return list(data), list(data.values())
    if not isinstance(data, list):
        raise InputError("holds no list of poses", where=path, allowed=FORMS)
    named = [label for label in map(_label, data) if label is not None]
    return (named if len(named) == len(data) else None), data


def _label(item: Any) -> str | None:
    if not isinstance(item, Mapping):
        return None
    return next((str(item[key]) for key in _NAMES if key in item), None)


def _of_csv(path: Path) -> tuple[list[str] | None, list[Any]]:
    try:
        text = read_input(path, "text").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("is not readable text", where=path, allowed=FORMS) from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    try:
        rows = [[word.strip() for word in row] for row in csv.reader(lines)]
    except csv.Error as error:
        raise InputError(f"is no CSV: {error}", where=path, allowed=FORMS) from error
    for row in rows:  # a spreadsheet may end its rows, and itself, in commas
        while row and not row[-1]:
            row.pop()
    rows = [row for row in rows if row]
    if not rows:
        return None, []
    if len(rows[0]) == 1:  # blanks in place of commas
        rows = [line.split() for line in lines]
    head = [word.lower() for word in rows[0]]
    if set(_COLUMNS) <= set(head):
        return _with_header(head, rows[1:], path)
    if _number(head[0]) is None:
        return [row[0] for row in rows], [row[1:] for row in rows]
    return None, list(rows)


def _with_header(
    head: Sequence[str], rows: Sequence[Sequence[str]], path: Path
) -> tuple[list[str] | None, list[Any]]:
    rows = [[*row, *[""] * (len(head) - len(row))] for row in rows]
    for number, row in enumerate(rows):
        if len(row) != len(head):
            raise InputError(
                f"line {number + 2} has {len(row)} columns and the header {len(head)}", where=path
            )
    at = [head.index(column) for column in _COLUMNS]
    name = next((head.index(key) for key in _NAMES if key in head), None)
    values = [[row[k] for k in at] for row in rows]
    return (None if name is None else [row[name] for row in rows]), values


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _pose(value: Any) -> Array | None:
    """Pose [4, 4]; None if the numbers are no pose."""
    try:
        if isinstance(value, Mapping):
            inner = next((value[k] for k in ("pose", "transform", "matrix") if k in value), None)
            if inner is not None:
                return _pose(inner)
            for place, turn in _PARTS:
                if place in value and turn in value:
                    shift = [float(value[place][k]) for k in "xyz"]
                    wxyz = [float(value[turn][k]) for k in "wxyz"]
                    return _pose([*shift, *wxyz])
            return None
        numbers = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError, KeyError, OverflowError):
        return None
    if len(numbers) == 7 and np.isfinite(numbers).all():
        length = float(np.linalg.norm(numbers[3:]))
        if abs(length - 1) > 0.01:
            return None
        return transform(rotation_from_wxyz(numbers[3:]), numbers[:3])
    if len(numbers) == 16 and is_rigid(numbers.reshape(4, 4), 1e-3):
        return numbers.reshape(4, 4).copy()
    return None
