"""Faces of the upright bounding box of a partial cloud that a hand can come to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.choices import SIDE, TOP
from pointsdf_cli.geometry.arrays import Array


@dataclass(frozen=True)
class Face:
    """One face of the bounding box.

    Attributes:
        kind: "side" or "top".
        centre: [3], world.
        normal: [3], outwards, unit.
    """

    kind: str
    centre: Array
    normal: Array


@dataclass(frozen=True)
class Box:
    """An upright bounding box.

    Attributes:
        centre: [3], world.
        axes: [3, 3], rows are its two horizontal axes and the vertical.
        half: [3], half its extent along each.
    """

    centre: Array
    axes: Array
    half: Array


def upright_box(points: Array) -> Box:
    """The box along the principal axes of the cloud [N, 3] seen from above, upright.

    A full three-dimensional analysis would lean with the camera's view of the half that it sees;
    the object stands on a table, so one axis is the vertical.
    """
    level = points[:, :2]
    centred = level - level.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    return box_along(points, vectors[:, 1])


def box_along(points: Array, level: Array) -> Box:
    """The upright box of a cloud [N, 3] along a horizontal direction [2], unit."""
    first, up = np.array([*level, 0.0]), np.array([0.0, 0.0, 1.0])
    axes = np.stack([first, np.cross(up, first), up])
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    low[2] = min(low[2], 0.0) if low[2] < 0.02 else low[2]  # it stands on the table
    return Box(((low + high) / 2) @ axes, axes, (high - low) / 2)


def graspable_faces(box: Box, camera: Array, base: Array, low_object: float) -> list[Face]:
    """The top, and the sides without the one that faces away most from the camera, and from the
    robot.

    Args:
        box: Box of the partial cloud.
        camera, base: [3], places of the camera and of the robot's base in the world.
        low_object: Height [m] below which a box has no graspable sides.
    """
    up = box.axes[2]
    faces = [Face(TOP, box.centre + box.half[2] * up, up)]
    if 2 * box.half[2] < low_object:
        return faces
    sides = [
        Face(SIDE, box.centre + sign * box.half[k] * box.axes[k], sign * box.axes[k])
        for k in range(2)
        for sign in (1.0, -1.0)
    ]
    hidden = set()
    for place in (camera, base):
        toward = place - box.centre
        hidden.add(int(np.argmin([face.normal @ toward for face in sides])))
    return faces + [face for i, face in enumerate(sides) if i not in hidden]
