"""Input clouds of a planner: points in the world, and a camera pose that must be known."""

from __future__ import annotations

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import Cloud


def in_world(cloud: Cloud) -> Array:
    """Points [N, 3] of a cloud in the world, m; unchanged if its pose is not known."""
    if cloud.frame == "world" or cloud.T_world_camera is None:
        return cloud.points
    return apply_transform(cloud.T_world_camera, cloud.points)


def require_pose(cloud: Cloud, name: str) -> None:
    """Refuse a cloud without a camera pose.

    Raises:
        InputError: The pose is not known.
    """
    if cloud.T_world_camera is None:
        allowed = "--camera-pose (the camera in the world), or `T_world_camera` in a PLY header"
        option = "add --camera-pose T.json (`rgrasp calibrate` makes one)"
        hint = f"{option}; to try things out without a robot: --camera-pose table"
        raise InputError("the camera's pose is not known", where=name, allowed=allowed, hint=hint)
