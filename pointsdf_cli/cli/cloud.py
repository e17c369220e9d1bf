"""`rgrasp cloud`: a depth image of a real camera as a point cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common


def cloud(
    depth: Annotated[Path, typer.Argument(help="16-bit PNG, TIFF or PGM, or NPY: depth along z.")],
    intrinsics: Annotated[
        str,
        typer.Option(
            metavar="K.json",
            help="K matrix, ROS camera_info, RealSense or Open3D intrinsics (JSON or YAML), or "
            "kinect2.",
        ),
    ],
    pose: Annotated[
        str | None,
        typer.Option(metavar="POSE", help="Camera in the world: X,Y,Z,QW,QX,QY,QZ, or a file."),
    ] = None,
    color: Annotated[
        Path | None, typer.Option(help="Colour image, registered to the depth image.")
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(
            help="Metres a unit [default: 0.001 for whole numbers, 1 for floats].",
            show_default=False,
        ),
    ] = None,
    near: Annotated[float, typer.Option(help="Nearer readings are dropped [m].")] = 0.1,
    far: Annotated[float, typer.Option(help="Farther readings are dropped [m].")] = 2.5,
    out: Annotated[
        Path | None, typer.Option(help="The cloud [default: cloud.ply, here].", show_default=False)
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Turn a depth image into a cloud that mesh and plan read.

    Example: rgrasp cloud depth.png --intrinsics K.json --pose T.json --out cloud.ply
    """
    import numpy as np

    from pointsdf_cli.camera.depth_cloud import cloud_of_depth
    from pointsdf_cli.camera.intrinsics import read_intrinsics
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.atomic import require_new
    from pointsdf_cli.io.clouds import write_cloud
    from pointsdf_cli.io.depth_images import read_colour, read_depth
    from pointsdf_cli.io.poses import camera_pose

    out = require_new(out or Path("cloud.ply"), force)
    if out.suffix.lower() != ".ply":
        raise InputError(f"{out.suffix!r} is not written", where="--out", allowed=".ply")
    image = read_depth(depth, depth_scale)
    height, width = image.shape
    camera = read_intrinsics(intrinsics, width, height)
    placed = None if pose is None else camera_pose(pose, "--pose")
    colours = None if color is None else read_colour(color)
    try:
        made = cloud_of_depth(image, camera, placed, colours, near, far)
    except InputError as error:
        where = error.where or depth
        raise InputError(error.what, where=where, allowed=error.allowed, hint=error.hint) from error
    write_cloud(out, made)
    dropped = image.size - len(made.points)
    middle = np.median(made.points[:, 2])
    lines = [
        f"{out}: {len(made.points)} points in the camera frame, median depth {middle:.3f} m; "
        f"{dropped} pixels without a depth between {near:g} and {far:g} m dropped"
    ]
    if placed is None:
        lines.append("no --pose: rgrasp mesh needs none, rgrasp plan will ask for --camera-pose")
    common.Reporter(quiet, as_json).result(
        {
            "out": out,
            "points": len(made.points),
            "dropped": dropped,
            "median_depth": float(middle),
            "has_pose": placed is not None,
            "has_colours": colours is not None,
        },
        lines,
    )
