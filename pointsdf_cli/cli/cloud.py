"""`rgrasp cloud`: a depth image of a real camera, or of a ROS 2 bag, as a point cloud."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pointsdf_cli.choices import first_given
from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.camera.bag_cloud import BagOptions
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.io.clouds import Cloud


def cloud(
    depth: Annotated[
        Path,
        typer.Argument(
            help="16-bit PNG, TIFF or PGM, or NPY: depth along z; or a ROS 2 bag (folder, .mcap, "
            ".db3)."
        ),
    ],
    intrinsics: Annotated[
        str | None,
        typer.Option(
            metavar="K.json",
            help="K matrix, ROS camera_info, RealSense or Open3D intrinsics (JSON or YAML), or "
            "kinect2; a bag has camera_info.",
        ),
    ] = None,
    camera_pose: common.CameraPose = None,
    color: Annotated[
        Path | None, typer.Option(help="Colour image registered to the depth image.")
    ] = None,
    depth_scale: common.DepthScale = None,
    near: Annotated[float, typer.Option(help="Smallest depth to keep [m].")] = 0.1,
    far: Annotated[float, typer.Option(help="Largest depth to keep [m].")] = 2.5,
    mask: common.Mask = None,
    no_clean: common.NoClean = False,
    out: Annotated[Path | None, typer.Option(help="Output cloud [default: cloud.ply].")] = None,
    topic: Annotated[
        str | None,
        typer.Option(
            help='Bag: topic of the depth images [default: the only one with "depth" in its name].'
        ),
    ] = None,
    world_frame: Annotated[
        str | None, typer.Option(help="Bag: world frame of the camera pose, such as base_link.")
    ] = None,
    index: Annotated[int, typer.Option(help="Bag: number of the image; -1 is the last.")] = 0,
    time: Annotated[
        float | None, typer.Option(help="Bag: first image this many seconds after the beginning.")
    ] = None,
    frames: Annotated[
        int, typer.Option(help="Bag: number of images to take the median of, against noise.")
    ] = 1,
    info_topic: Annotated[
        str | None, typer.Option(help="Bag: topic of camera_info [default: beside the images].")
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Turn a depth image into a cloud that mesh and plan read.

    Example: rgrasp cloud depth.png --intrinsics K.json --camera-pose T.json --out cloud.ply

    Example: rgrasp cloud bag/ --topic /camera/depth/image_rect_raw --world-frame base_link
    """
    import numpy as np

    from pointsdf_cli.camera.bag_cloud import BagOptions
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_place
    from pointsdf_cli.io.clouds import write_cloud
    from pointsdf_cli.io.rosbag import is_bag

    out = out or Path("cloud.ply")
    require_apart([out], [depth, intrinsics, camera_pose, color, mask])
    require_place(out, force)
    if out.suffix.lower() != ".ply":
        raise InputError(f"{out.suffix!r} is not written", where="--out", allowed=".ply")
    bag = BagOptions(topic, info_topic, world_frame, index, time, frames)
    options = SceneFileOptions(intrinsics, depth_scale, near, far, color, mask)
    reporter, cleaned = common.Reporter(quiet, as_json), not no_clean
    if is_bag(depth):
        if option := first_given({"--color": color, "--mask": mask}):
            raise InputError(f"{option} with a bag", where=depth, hint="leave it out")
        made, about, source, notes = _cloud_of_bag(depth, bag, options, camera_pose, cleaned)
    else:
        if bag != BagOptions():
            of_bags = asdict(bag).items() - asdict(BagOptions()).items()
            given = sorted(f"--{name.replace('_', '-')}" for name, _ in of_bags)
            what = f"is not a bag, and {', '.join(given)} are for bags"
            raise InputError(what, where=depth, hint="leave them out")
        _require_depth_image(depth, intrinsics)
        made, about, source, notes = _cloud_of_image(
            depth, options, camera_pose, cleaned, reporter.say
        )
    write_cloud(out, replace(made, pixels=None, image=None))
    count, middle = len(made.points), float(np.median(made.points[:, 2]))
    posed = made.T_world_camera is not None
    values = {"out": out, "points": count, "median_depth": middle, "has_pose": posed}
    line = f"{out}: {count} points in the camera frame, median depth {middle:.3f} m{source}"
    reporter.result({**values, **about}, [line, *notes])


def _require_depth_image(path: Path, intrinsics: str | None) -> None:
    from pointsdf_cli.io.cloud_text import holds_points
    from pointsdf_cli.io.depth_images import DEPTH_SUFFIXES

    if intrinsics is None:
        hint = "add --intrinsics K.json"
        raise InputError("a depth image needs its intrinsics", where=path, hint=hint)
    if path.suffix.lower() not in DEPTH_SUFFIXES:
        allowed = ", ".join(DEPTH_SUFFIXES)
        raise InputError(f"{path.suffix!r} is not a depth image", where=path, allowed=allowed)
    if path.suffix.lower() == ".npy" and holds_points(path):
        hint = "it is a cloud already: rgrasp mesh and plan read it"
        raise InputError("holds points, no depth image", where=path, hint=hint)


def _cloud_of_image(
    depth: Path,
    options: SceneFileOptions,
    pose: str | None,
    cleaned: bool,
    say: Callable[[str], None],
) -> tuple[Cloud, dict[str, object], str, list[str]]:
    """Cloud of a depth image.

    Returns:
        The cloud, the values of it for the result, the words on its source that end the first line,
        and further lines.
    """
    from pointsdf_cli.planning.scene_input import depth_view

    made, pixels, unseen = depth_view(depth, options, pose, cleaned, say)
    near, far = options.near, options.far
    source = f"; {unseen} pixels without a depth between {near:g} and {far:g} m dropped"
    notes = []
    if made.T_world_camera is None:
        notes.append(
            "no --camera-pose: rgrasp mesh needs none, rgrasp plan will ask for --camera-pose"
        )
    dropped = pixels - len(made.points)
    about: dict[str, object] = {"dropped": dropped, "has_colours": made.colours is not None}
    return made, about, source, notes


def _cloud_of_bag(
    path: Path, bag: BagOptions, options: SceneFileOptions, pose: str | None, cleaned: bool
) -> tuple[Cloud, dict[str, object], str, list[str]]:
    """Cloud of a bag's depth images, and what `_cloud_of_image` tells of it."""
    from pointsdf_cli.camera.bag_cloud import cloud_of_bag
    from pointsdf_cli.camera.scene_file import cleaned_view
    from pointsdf_cli.io.poses import camera_pose, table_place
    from pointsdf_cli.planning.scene_input import stand_on_table, table_note

    place = None if pose is None else table_place(pose)
    fixed = None if pose is None or place is not None else camera_pose(pose)
    if pose is not None and bag.world_frame is not None:
        what = "two poses: --world-frame and --camera-pose"
        raise InputError(what, where=path, hint="leave one out")
    given = options.intrinsics, options.near, options.far, options.depth_scale
    made, frames, said = cloud_of_bag(path, bag, *given)
    said += made.notes
    if cleaned:
        made, report = cleaned_view(made, whole_scene=True)
        said += [report] if report else []
    if fixed is not None:
        made = replace(made, T_world_camera=fixed)
    elif place is not None:
        made, _ = stand_on_table(made, str(path), place, cleaned=cleaned)
        said.append(table_note(made, place))
    elif made.T_world_camera is None:
        said.append("rgrasp mesh needs no pose, rgrasp plan will ask for --camera-pose")
    images = f"image {frames.number}" if frames.number >= 0 else f"the image at {bag.time:g} s"
    if bag.frames > 1:
        images = f"{bag.frames} images from {images}"
    about = {"topic": frames.topic, "frame_id": frames.frame, "stamps": frames.stamps}
    source = f", from {images} on {frames.topic} ({frames.frame})"
    return made, {**about, "said": said}, source, said
