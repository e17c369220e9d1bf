"""A cloud from a ROS 2 bag: depth images, their intrinsics and the camera's pose."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.intrinsics import SMALLEST_DISTORTION, lens_model, read_intrinsics
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.io.depth_images import check_scale
from pointsdf_cli.io.rosbag import GAP, MOST_FRAMES, Bag, DepthFrames, chain, open_bag, pose_at

STILL = 0.001
"""Largest motion [m, rad] of a camera that counts as standing still."""
MOST_PIXELS = 20_000
"""Number of pixels that the scatter of several images is taken from."""


@dataclass(frozen=True)
class BagOptions:
    """Selection of images from a bag.

    Attributes:
        topic: Topic of the depth images; None for the only one with "depth" in its name.
        info_topic: Topic of their camera_info; None for the one beside it.
        world_frame: World frame of the camera's pose; None for no pose.
        index: Number of the first image, from 0; negative ones count from the end.
        time: Time of the first image, in seconds after the bag's beginning; None uses `index`.
        frames: Number of images to take the median of.

    Raises:
        InputError: A number is out of its range.
    """

    topic: str | None = None
    info_topic: str | None = None
    world_frame: str | None = None
    index: int = 0
    time: float | None = None
    frames: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.frames <= MOST_FRAMES:
            what, allowed = f"{self.frames} images", f"1 to {MOST_FRAMES}"
            raise InputError(what, where="--frames", allowed=allowed)
        if self.time is not None and (self.index or not 0 <= self.time < 1e7):
            raise InputError(
                "--time with --index" if self.index else f"{self.time} s",
                where="--time",
                allowed="seconds after the bag's beginning, and no --index",
            )


def cloud_of_bag(
    path: Path,
    options: BagOptions,
    intrinsics: str | None = None,
    nearest: float = 0.1,
    farthest: float = 2.5,
    scale: float | None = None,
) -> tuple[Cloud, DepthFrames, list[str]]:
    """The cloud of one depth image, or of the median of several, in the camera's frame.

    Args:
        path: The bag.
        options: Selection of images.
        intrinsics: Intrinsics as for `read_intrinsics`; None takes camera_info.
        nearest, farthest: Range of valid depths [m].
        scale: Metres a unit; None takes what ROS defines: mm for whole numbers, m for floats.

    Returns:
        The cloud, its images, and notes for the user.

    Raises:
        InputError: The bag or topic does not exist, or camera_info or the transforms to the world
            frame are missing.
    """
    if intrinsics is not None and options.info_topic is not None:
        raise InputError(
            "--info-topic with --intrinsics", where=path, hint="leave one of the two out"
        )
    check_scale(scale)
    with open_bag(path) as bag:
        topic = bag.depth_topic(options.topic)
        frames = bag.depth_frames(topic, options.index, options.time, options.frames, scale)
        height, width = frames.depths.shape[1:]
        if intrinsics is None:
            camera = _camera(bag, frames, options.info_topic)
        else:
            camera = read_intrinsics(intrinsics, width, height)
        pose, said = _pose(bag, frames, options.world_frame)
    if options.frames == 1:
        depth = frames.depths[0].astype(np.float64)
    else:
        depth, spread = median_depth(frames.depths)
        lasted = (frames.stamps[-1] - frames.stamps[0]) / 1e9
        said.append(
            f"median of {options.frames} images in {lasted:.2f} s: readings scattered by "
            f"{1000 * spread:.2g} mm from image to image; steady errors stay"
        )
    cloud = cloud_of_depth(depth, camera, pose, None, nearest, farthest, scale)
    return cloud, frames, said


def median_depth(depths: NDArray[np.float32]) -> tuple[NDArray[np.float64], float]:
    """The median of depth images and their scatter from one to the next.

    Args:
        depths: [n, height, width], m; 0 where nothing was seen.

    Returns:
        [height, width], m, over the images that saw something; 0 where fewer than half did. And
        the standard deviation [m] of one image's readings, from the median absolute difference.
    """
    seen = depths > 0
    often = 2 * seen.sum(axis=0) >= len(depths)
    depth = np.zeros(depths.shape[1:])
    for row, some in enumerate(often):  # one at a time: many images would fill gigabytes
        values = np.sort(np.where(seen[:, row], depths[:, row], np.inf)[:, some], axis=0)
        number, column = seen[:, row, some].sum(axis=0), np.arange(some.sum())
        middle = values[[(number - 1) // 2, number // 2], column]
        depth[row, some] = middle.mean(axis=0, dtype=np.float64)
    rows = slice(None, None, 1 + often.size // MOST_PIXELS)
    values = np.where((seen & often)[:, rows], depths[:, rows], np.nan).astype(np.float64)
    # 1.4826: from the median absolute deviation to a Gaussian's standard deviation.
    steps = np.abs(np.diff(values, axis=0))
    spread = 1.4826 * float(np.nanmedian(steps)) / np.sqrt(2) if np.isfinite(steps).any() else 0.0
    return depth, spread


def _camera(bag: Bag, frames: DepthFrames, wanted: str | None) -> Camera:
    topic, info = bag.camera_info(frames, wanted)
    height, width = frames.depths.shape[1:]
    crop = np.eye(3)
    if (info.width, info.height) != (width, height):
        # ROS gives K of the whole image, then the part that is taken of it, then its binning.
        roi, bins = info.roi, np.maximum((info.binning_x, info.binning_y), 1)
        size = np.array((roi.width or info.width, roi.height or info.height)) // bins
        crop[:2] = np.diag(1 / bins) @ [[1, 0, -roi.x_offset], [0, 1, -roi.y_offset]]
        if (*size,) != (width, height):
            raise InputError(
                f"{topic} is of images of {size[0]} × {size[1]}, and those on "
                f"{frames.topic} have {width} × {height}",
                where=bag.path,
                allowed="the camera_info of the depth images themselves (--info-topic)",
            )
    # The matrix P belongs to the rectified image, the distortion to the image before rectification.
    named = re.search(r"(^|[/_])rect(ified)?($|[/_])", frames.topic)
    rectified = named is not None and info.p[0] > 0
    if not rectified and np.abs(info.d).max(initial=0.0) > SMALLEST_DISTORTION:
        raise InputError(
            f"{topic} says that the images on {frames.topic} are distorted",
            where=bag.path,
            allowed="rectified depth images",
            hint="record the rectified topic (…/image_rect, from depth_image_proc or image_proc)",
        )
    if not rectified:
        lens_model({"distortion_model": info.distortion_model}, bag.path)
    K = crop @ (info.p.reshape(3, 4)[:, :3] if rectified else info.k.reshape(3, 3))
    try:
        return Camera(width, height, *(float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))))
    except InputError as error:
        raise InputError(f"{topic}: {error.what}", where=bag.path, allowed=error.allowed) from error


def _pose(bag: Bag, frames: DepthFrames, world: str | None) -> tuple[Array | None, list[str]]:
    """T_world_camera [4, 4], or None without a world frame; and notes for the user."""
    transforms = bag.transforms(int(frames.times.min()), int(frames.times.max()))
    known = sorted({name for edge in transforms for name in edge})
    if world is None:
        joined = [n for n in known if chain(transforms, n, frames.frame) is not None]
        joined = [n for n in joined if n != frames.frame]
        told = f"no --world-frame, so no pose; frames that lead to the camera: {', '.join(joined)}"
        return None, [told] if joined else ["no pose, and no transforms in the bag to find it"]
    world, stamps = world.lstrip("/"), frames.stamps.tolist()
    edges = chain(transforms, world, frames.frame)
    if edges is None:
        raise InputError(
            f"no transforms lead from {world} to the camera's frame {frames.frame}",
            where=bag.path,
            allowed=f"frames in the bag: {', '.join(known)}" if known else
            "a bag with /tf_static (none is in it)",
            hint="record /tf_static (and /tf, if the camera moves), or give --camera-pose",
        )  # fmt: skip
    doubtful = {t for e in edges for at in stamps for t in bag.doubtful(e, transforms[e], at)}
    pose, *others = (pose_at(transforms, edges, world, time) for time in (*stamps, *doubtful))
    moved = [np.abs(other - pose).max() > STILL for other in others]
    gap = f"no transforms at most {GAP / 1e9:g} s apart enclose the image's stamp"
    if any(moved):
        several = any(moved[: len(stamps) - 1])
        what = "while the images are taken" if several else f"and {gap}"
        hint = "--frames 1" if several else "another --index or --time; record /tf more often"
        raise InputError(f"the camera moves {what}", where=bag.path, hint=hint)
    said = f"the camera's pose in {world} from the bag's transforms"
    return pose, [said, f"{gap}: the pose holds if the camera stood still"][: 1 + bool(doubtful)]
