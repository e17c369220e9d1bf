"""First checks of a file's points, normals and header, before they are a cloud."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.choices import Frame
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import is_rigid
from pointsdf_cli.io.ply import RawCloud

FRAMES = get_args(Frame)


def finite_points(raw: RawCloud, path: Path, drop: bool) -> RawCloud:
    """The cloud, if all its points are finite; with `drop`, without those that are not.

    `drop` also leaves out points at 0 0 0, which some drivers write where nothing was seen.

    Raises:
        InputError: Points are not finite and not to be dropped, or none is left.
    """
    finite: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(raw.points), axis=1)
    bad = len(finite) - int(np.count_nonzero(finite))
    if drop:
        finite &= raw.points.any(axis=1)
    if finite.all():
        return raw
    if bad and not drop:
        raise InputError(
            f"{bad} of {len(finite)} points are NaN or infinite",
            where=path,
            allowed="finite coordinates (depth cameras write NaN where they see nothing)",
            hint="add --drop-invalid to leave those points out" if bad < len(finite) else None,
        )
    if not finite.any():
        raise InputError(
            f"none of {len(finite)} points is finite and away from 0 0 0, where no camera sees "
            "anything",
            where=path,
            hint="was the camera covered, or too near?",
        )
    return replace(
        raw,
        points=raw.points[finite],
        normals=None if raw.normals is None else raw.normals[finite],
        colours=None if raw.colours is None else raw.colours[finite],
    )


def unit_normals(normals: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """Normals made unit length; None if some are missing (zero or NaN), as cameras leave them."""
    if normals is None:
        return None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not (np.isfinite(length).all() and (length > 0).all()):
        return None
    return normals / length


def frame_of_header(comments: dict[str, str], path: Path) -> str:
    """Frame of the coordinates as the header says; the camera's if it says nothing.

    Raises:
        InputError: Another name than those in `FRAMES`.
    """
    frame = comments.get("frame", "camera").strip()
    if frame not in FRAMES:
        raise InputError(
            f"unknown frame {frame!r} in the header",
            where=path,
            allowed=", ".join(FRAMES),
            hint="add --frame camera if the camera looks along +z there, or --frame world",
        )
    return frame


def pose_of_header(comments: dict[str, str], path: Path) -> NDArray[np.float64] | None:
    """T_world_camera [4, 4] of the header; None if it says nothing.

    Raises:
        InputError: It is no rigid transform.
    """
    text = comments.get("T_world_camera")
    if text is None:
        return None
    try:
        pose = np.array([float(word) for word in text.replace(",", " ").split()]).reshape(4, 4)
    except ValueError as error:
        raise InputError(
            "the header's T_world_camera is not 16 numbers", where=path, allowed="4×4, row by row"
        ) from error
    if not is_rigid(pose):
        raise InputError(
            "the header's T_world_camera is not a rotation and a translation",
            where=path,
            allowed="4×4, row by row: an orthonormal rotation, last row 0 0 0 1",
        )
    return pose
