"""`rgrasp segment`: numbered list of the objects on a table."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError, as_input_error


def segment(
    scene: Annotated[
        Path,
        typer.Argument(
            help="A depth image (16-bit PNG, TIFF or PGM, or NPY) or a cloud (PLY, PCD, XYZ, TXT, "
            "CSV or NPY)."
        ),
    ],
    camera_pose: common.CameraPose = None,
    intrinsics: common.Intrinsics = None,
    depth_scale: common.DepthScale = None,
    color: Annotated[
        Path | None, typer.Option(help="Colour image to draw on, registered to the depth image.")
    ] = None,
    mask: common.Mask = None,
    frame: common.Frame = None,
    unit: common.Unit = "m",
    drop_invalid: common.DropInvalid = False,
    workspace: common.Workspace = None,
    robot: common.RobotInScene = None,
    start: common.Start = None,
    no_clean: common.NoClean = False,
    picture: Annotated[Path, typer.Option(help="Output picture of the numbered objects.")] = Path(
        "segment.png"
    ),
    labels: Annotated[
        Path | None,
        typer.Option(
            help="Output image of labels (PNG) of a depth image: the object number of each pixel. "
            "Correct it in an image editor; --mask LABELS.png:2 takes object 2."
        ),
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """List the objects on a table: number, centre, size, points; and draw them with their numbers.

    `rgrasp mesh` and `rgrasp plan` take a number as --target; without it they take 1.

    Example: rgrasp segment depth.png --intrinsics K.json --camera-pose T.json
    """
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.poses import box

    reporter = common.Reporter(quiet, as_json)
    outputs = [picture, labels]
    require_apart(outputs, [scene, camera_pose, intrinsics, color, mask, robot, start])
    for path in outputs:
        common.check_picture(path, force)
    if labels is not None and os.path.realpath(labels) == os.path.realpath(picture):
        raise InputError("is the name of the picture, too", where=f"--labels {labels}")
    corners = None if workspace is None else box(workspace, "--workspace")
    files = SceneFileOptions(
        intrinsics, depth_scale, colour=color, mask=mask,
        unit=unit, frame=frame, drop_invalid=drop_invalid,
    )  # fmt: skip

    from pointsdf_cli.planning.list_objects import list_objects
    from pointsdf_cli.planning.object_choice import NoObjectError

    with as_input_error(kind=NoObjectError):
        listing = list_objects(scene, files, camera_pose, corners, robot, not no_clean, start)
    reporter.say(*listing.notes)
    from pointsdf_cli.service.objects_picture import draw_labels, draw_numbers

    if labels is not None:
        draw_labels(labels, listing)
    draw_numbers(picture, listing, color)
    objects = []
    lines = [f"{'number':>6}  {'centre [m]':^20}  {'size [cm]':^18}  points"]
    for item in listing.objects:
        points = listing.points[item.number]
        place = {"number": item.number, "centre": item.centre, "size": item.size}
        objects.append({**place, "points": points, "may_be_several": item.unsplit})
        centre = ", ".join(f"{value:6.3f}" for value in item.centre)
        size = " × ".join(f"{100 * value:4.1f}" for value in item.size)
        doubt = "  several in touch?" if item.unsplit else ""
        lines.append(f"{item.number:>6}  {centre}  {size}  {points}{doubt}")
    lines.append(f"{picture}: the picture")
    if labels is not None:
        lines.append(f"{labels}: the labels")
    reporter.result({"picture": picture, "labels": labels, "objects": objects}, lines)
