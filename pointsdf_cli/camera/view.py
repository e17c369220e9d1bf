"""View of an object: its points, the camera's pose, and the observed space around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, numbers
from pointsdf_cli.geometry.frames import apply_transform, rigid
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.clouds import LARGEST


@dataclass(frozen=True)
class View:
    """One camera's view of an object.

    Attributes:
        points: [N, 3], camera frame, m.
        T_world_camera: [4, 4].
        evidence: Observed space around the object; None for a bare cloud.

    Raises:
        InputError: The points are not in front of a camera, or not of one object in metres; or the
            pose is not a rigid transform.
    """

    points: Array
    T_world_camera: Array
    evidence: ViewEvidence | None = None

    def __post_init__(self) -> None:
        points = as_points(self.points, "View.points")
        require_in_front(points, "View.points")
        if len(points) and float(np.ptp(points, axis=0).max()) > LARGEST:
            raise InputError(
                f"the points extend over {np.ptp(points, axis=0).max():.4g} m",
                where="View.points",
                allowed=f"one object, at most {LARGEST:g} m across, in metres",
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "T_world_camera", rigid(self.T_world_camera, "T_world_camera"))

    @property
    def in_world(self) -> Array:
        """The points [N, 3] in the world."""
        return apply_transform(self.T_world_camera, self.points)


def as_points(points: ArrayLike, where: str) -> Array:
    """Points [N, 3] as an array of finite numbers.

    Raises:
        InputError: They are none.
    """
    array = numbers(points, where, "[N, 3], m")
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"a cloud of shape {array.shape}", where=where, allowed="[N, 3], m")
    if not np.isfinite(array).all():
        raise InputError("holds values that are NaN or infinite", where=where)
    return array


def require_in_front(points: Array, where: str) -> None:
    """Require points [N, 3] in a camera's frame to lie in front of it.

    Raises:
        InputError: One does not.
    """
    if not (points[:, 2] > 0).all():
        raise InputError(
            "the camera has points behind it",
            where=where,
            allowed="points in front of the camera (x right, y down, z forward), in its frame or "
            "with its pose in theirs",
        )
