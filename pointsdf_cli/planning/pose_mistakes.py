"""Common mistakes in a camera pose, found by the table that the camera sees.

A pose that does not put the table level at z = 0 may be right in another convention. Each
convention is tried; if one puts the table level at z = 0, the error names it. Points in the world
do not depend on the pose: there, a camera that looks away from its points tells its inverse.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pointsdf_cli.camera.segmentation import find_table
from pointsdf_cli.camera.support_plane import find_support_plane
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    rotation_from_wxyz,
    transform,
    wxyz_from_rotation,
)
from pointsdf_cli.io.clouds import Cloud

SAMPLE = 20_000
"""Number of points used."""
FEWEST, FARTHEST = 1000, 10.0
"""Fewest points that show a table, and its largest depth [m]."""
LEVEL = np.deg2rad(6.0)
"""Largest tilt [rad] of a table that counts as level."""
WIDE = np.tan(np.deg2rad(60.0))
"""Largest tangent of the angle between the axis of a camera and an edge of its image."""
LOWEST = 0.1
"""Least height [m] of a camera above z = 0."""
AT_ZERO = 0.03
"""Largest distance [m] of the table from z = 0 for a pose that counts as right."""
TILTED = np.deg2rad(15.0)
"""A table that a pose tilts by more than this [rad] shows that the pose is wrong."""

BODY_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""OpenCV axes (x right, y down, z forward) in those of a ROS camera body (x forward, z up)."""
GRAPHICS_AXES = np.diag([1.0, -1.0, -1.0])
"""OpenCV axes in those of computer graphics (y up, z backward)."""

ROLLED = np.diag([-1.0, -1.0, 1.0])
"""The axes of a camera mounted upside down."""
INVERSE = "it is the world in the camera"
"""The mistake in an inverted pose."""


def require_no_mistaken_pose(cloud: Cloud, name: str) -> None:
    """Refuse a pose that is wrong as given but right in another convention.

    Clouds without a table, and poses that no other convention explains, pass.

    Args:
        cloud: A view with its pose.
        name: Its name, for the message.

    Raises:
        InputError: Another convention puts the table level at z = 0, or the inverse faces a cloud
            in the world. The message names it and gives the numbers to type.
    """
    if cloud.T_world_camera is None:
        return
    pose = np.asarray(cloud.T_world_camera)
    if cloud.frame == "world":
        _require_facing(cloud.points, pose, name)
        return
    with as_input_error(name, or_named=True):
        points, _ = cloud.in_camera_frame()
    points = points[:: max(1, len(points) // SAMPLE)]
    if len(points) < FEWEST or float(np.median(points[:, 2])) > FARTHEST:
        return  # too few points for a table, or another unit: told by the checks that follow
    if find_table(apply_transform(pose, points)) is not None:
        return
    try:
        plane = find_support_plane(points)
    except InputError:
        return
    tilt, _ = _table(plane, pose)
    if tilt < TILTED:
        return
    for mistake, right in _corrections(pose):
        corrected_tilt, corrected_height = _table(plane, right)
        if corrected_tilt < LEVEL and abs(corrected_height) < AT_ZERO:
            tilted = f"the camera's pose tilts the table that it sees by {np.rad2deg(tilt):.0f}°"
            raise _mistaken(f"{tilted}; {mistake}", name, right)


def _require_facing(world: Array, pose: Array, name: str) -> None:
    """Refuse a pose that looks away from points [N, 3] of the world, if its inverse, above the
    table, faces them.

    Raises:
        InputError: It does.
    """
    few, inverse = world[:: max(1, len(world) // SAMPLE)], invert_transform(pose)
    if np.percentile(_off_axis(few, pose), 95) < WIDE or inverse[2, 3] < LOWEST:
        return
    edge = np.percentile(_off_axis(few, inverse), 95)
    # With its rotation transposed alone, the eye is right: that changes little.
    transposed = transform(pose[:3, :3].T, pose[:3, 3])
    if edge < min(WIDE, np.percentile(_off_axis(few, transposed), 95)):
        away = "the camera's pose looks away from the points"
        raise _mistaken(f"{away}; its inverse faces them: {INVERSE}", name, inverse)


def _off_axis(world: Array, pose: Array) -> Array:
    """Tangents [N] at which a camera at a pose sees points [N, 3] of the world beside its axis; 1e9
    behind it."""
    points = apply_transform(invert_transform(pose), world)
    beside = np.abs(points[:, :2]).max(axis=1) / np.maximum(points[:, 2], 1e-9)
    return np.where(points[:, 2] > 0, np.minimum(beside, 1e9), 1e9)


def _mistaken(what: str, name: str, right: Array) -> InputError:
    """The error about a mistaken pose, with the right one [4, 4] to type."""
    numbers = [*right[:3, 3], *wxyz_from_rotation(right[:3, :3])]
    hint = "--camera-pose " + ",".join(f"{number + 0.0:.6g}" for number in numbers)
    convention = "OpenCV axes (z forward, y down), quaternion scalar first"
    allowed = f"the camera in the world, {convention}, the table level at z = 0"
    return InputError(what, where=name, allowed=allowed, hint=hint)


def _table(plane: Array, pose: Array) -> tuple[float, float]:
    """Tilt [rad] and height [m] of a plane [4] of the camera frame, in the world."""
    normal = pose[:3, :3] @ plane[:3]
    height = (pose[:3, :3] @ (plane[3] * plane[:3]) + pose[:3, 3]) @ normal
    return float(np.arccos(np.clip(normal[2], -1.0, 1.0))), float(height)


def _corrections(pose: Array) -> Iterator[tuple[str, Array]]:
    """Possible mistakes, each with the pose [4, 4] that was then meant."""
    rotation, place = pose[:3, :3], pose[:3, 3]
    # The user may have typed q or −q; reordered, both give the same rotation.
    w, x, y, z = wxyz_from_rotation(rotation)
    reordered = transform(rotation_from_wxyz([z, w, x, y]), place)
    yield "with its quaternion read as x,y,z,w (as ROS prints it) the table is level", reordered
    yield f"its inverse puts the table level: {INVERSE}", invert_transform(pose)
    for axes, whose in (
        (BODY_AXES, "the camera's body (x forward, z up)"),
        (GRAPHICS_AXES, "computer graphics (y up, z backward)"),
    ):
        turned = transform(rotation @ axes, place)
        yield f"with the axes of {whose} the table is level", turned
        both = transform(reordered[:3, :3] @ axes, place)
        yield f"with x,y,z,w and the axes of {whose} the table is level", both
    rolled = transform(rotation @ ROLLED, place)
    yield "turned by 180° about the view, as is an image upside down, the table is level", rolled
    yield "with its rotation transposed the table is level", transform(rotation.T, place)
