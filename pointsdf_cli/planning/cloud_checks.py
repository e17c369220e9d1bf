"""Checks of a planner's input clouds: known camera pose, plausible size."""

from __future__ import annotations

from collections.abc import Sequence

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, check_scene_cloud


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
        raise InputError(
            "the camera's pose is not known",
            where=name,
            allowed="--camera-pose (the camera in the world), or `T_world_camera` in a PLY header",
            hint="add --camera-pose T.json (`rgrasp calibrate` makes one); to try things out "
            "without a robot: --camera-pose table",
        )


def check_scene_inputs(clouds: Sequence[Cloud], names: Sequence[str], segment: str) -> None:
    """Refuse clouds from which no grasp can be planned.

    Args:
        clouds: Clouds, one for each camera.
        names: Names of the clouds, for messages.
        segment: "auto" for clouds of a whole table, "none" for clouds of the object alone.

    Raises:
        InputError: A cloud has no pose, another unit than metres, or too few points.
    """
    for cloud, name in zip(clouds, names, strict=True):
        require_pose(cloud, name)
        check = check_object_cloud if segment == "none" else check_scene_cloud
        check(cloud, name)
