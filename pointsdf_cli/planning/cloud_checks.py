"""Whether clouds can be planned in: each has its camera's pose and a size that makes sense."""

from __future__ import annotations

from collections.abc import Sequence

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, check_scene_cloud


def check_scene_inputs(clouds: Sequence[Cloud], names: Sequence[str], segment: str) -> None:
    """Refuse clouds that no grasp can be planned from.

    Args:
        clouds: Clouds, one for each camera.
        names: Names of the clouds, for messages.
        segment: "auto" of clouds of a whole table, "none" of clouds of the object alone.

    Raises:
        InputError: A cloud without a pose, or in another unit than metres, or of too few points.
    """
    for cloud, name in zip(clouds, names, strict=True):
        if cloud.T_world_camera is None:
            raise InputError(
                "nothing says where the camera stood",
                where=name,
                allowed="a header comment `T_world_camera` with 16 numbers, row by row",
                hint="add --camera-pose X,Y,Z,QW,QX,QY,QZ, or --camera-pose table to try it out",
            )
        check = check_object_cloud if segment == "none" else check_scene_cloud
        check(cloud, name)
