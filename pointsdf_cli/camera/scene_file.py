"""A view of a scene from a file: a depth image with its intrinsics, or a cloud."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.camera.cleaning import Cleaning, clean, flying_pixels
from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.intrinsics import read_intrinsics
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import rigid
from pointsdf_cli.io.cloud_text import holds_points
from pointsdf_cli.io.clouds import CLOUD_SUFFIXES, Cloud, read_cloud
from pointsdf_cli.io.depth_images import (
    DEPTH_SUFFIXES,
    mask_file,
    read_colour,
    read_depth,
    read_mask,
)
from pointsdf_cli.io.input_files import require_suffix
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.rosbag import is_bag


@dataclass(frozen=True)
class SceneFileOptions:
    """Options for reading a depth image or a cloud; those of the other kind must keep their
    default.

    Attributes:
        intrinsics: A file or a camera's name: intrinsics of the depth image, or for a cloud of the
            image to which a mask or a pixel refers.
        depth_scale: Metres per unit of a depth image; None: 0.001 for integers, 1 for floats.
        near, far: Range of valid depths [m] of a depth image.
        colour: Colour image, registered to the depth image.
        mask: Image of the depth image's size, nonzero on the object; `FILE:NUMBER` uses the pixels
            of that value.
        unit: Unit of a cloud.
        frame: Frame of a cloud, "camera" or "world"; None for the file's own.
        drop_invalid: Leave out points of a cloud that are not finite.
    """

    intrinsics: str | None = None
    depth_scale: float | None = None
    near: float = 0.1
    far: float = 2.5
    colour: Path | None = None
    mask: str | None = None
    unit: str = "m"
    frame: str | None = None
    drop_invalid: bool = False

    def digests(self, pose: str | None) -> dict[str, str]:
        """SHA-256 of the contents of the named files, by option; names of cameras and typed numbers
        have none.

        Args:
            pose: Camera pose as typed, a file or numbers.

        Raises:
            InputError: One cannot be read.
        """
        mask = None if self.mask is None else mask_file(self.mask)[0]
        named = {"camera_pose": pose, "intrinsics": self.intrinsics, "mask": mask}
        return {
            f"{option}_sha256": file_sha256(file)
            for option, file in named.items()
            if file is not None and os.path.isfile(file)
        }


def options_of_views(
    count: int, intrinsics: Sequence[str] | None, masks: Sequence[str] | None, **same: Any
) -> list[SceneFileOptions]:
    """Reading options of each of `count` views.

    Args:
        count: Number of views.
        intrinsics: Intrinsics of each, one for all, or None.
        masks: Mask of each, or None.
        same: Options that all views share.

    Raises:
        InputError: Another number of intrinsics or of masks.
    """
    cameras: list[str | None] = [*intrinsics] if intrinsics else [None]
    if len(cameras) == 1:
        cameras = cameras * count
    on: list[str | None] = [*masks] if masks else [None] * count
    for option, given in (("--intrinsics", cameras), ("--mask", on)):
        if len(given) != count:
            raise InputError(
                f"{len(given)} for {count} views", where=option, allowed="one for each, in order"
            )
    pairs = zip(cameras, on, strict=True)
    return [SceneFileOptions(intrinsics=camera, mask=mask, **same) for camera, mask in pairs]


def is_depth_image(path: Path, intrinsics: str | None) -> bool:
    """Whether a file is read as a depth image: by its suffix; NPY files of one number a pixel if
    intrinsics are given."""
    suffix = path.suffix.lower()
    if suffix not in CLOUD_SUFFIXES:
        return suffix in DEPTH_SUFFIXES or suffix in (".jpg", ".jpeg", ".bmp")
    return suffix in DEPTH_SUFFIXES and intrinsics is not None and not holds_points(path)


def read_view(path: Path, options: SceneFileOptions, T_world_camera: Array | None = None) -> Cloud:
    """Read one view, with its image if there is one.

    Args:
        path: A depth image or a cloud.
        options: Options for reading.
        T_world_camera: [4, 4], overrides a cloud's own pose; None for that.

    Raises:
        InputError: The file cannot be read, or an option does not fit it.
    """
    if is_bag(path) and path.exists():
        what, hint = "is a folder" if path.is_dir() else "is a bag", "rgrasp cloud reads ROS 2 bags"
        raise InputError(what, where=path, allowed="a depth image or a cloud", hint=hint)
    if is_depth_image(path, options.intrinsics):
        return _read_depth_view(path, options, T_world_camera)
    if options.intrinsics is not None:
        known = dict.fromkeys((*DEPTH_SUFFIXES, *CLOUD_SUFFIXES))
        require_suffix(path, known, "format of depth images and clouds")
    of_images = {"--depth-scale": options.depth_scale, "--color": options.colour}
    for option, value in of_images.items():
        if value is not None:
            raise InputError(f"{option} with a cloud", where=path, allowed="a depth image")
    cloud = read_cloud(path, options.unit, options.drop_invalid, options.frame, T_world_camera)
    if options.intrinsics is None:
        if options.mask is not None:
            raise InputError(
                "a mask, but the cloud has no image",
                where="--mask",
                hint="add --intrinsics K.json of the mask's camera",
            )
        return cloud
    with as_input_error(path, or_named=True):
        return _projected(cloud, options)


def read_depth_image(
    path: Path | str,
    intrinsics: Path | str,
    T_world_camera: ArrayLike | None = None,
    depth_scale: float | None = None,
    mask: Path | str | None = None,
    near: float = 0.1,
    far: float = 2.5,
) -> Cloud:
    """Read a depth image as the cloud of a scene.

    Args:
        path: PNG, TIFF, PGM or NPY.
        intrinsics: A file of the camera's K, or a camera's name.
        T_world_camera: [4, 4], the camera (x right, y down, z forward) in the world, where z = 0 is
            the table; None if it is not known.
        depth_scale: Metres per unit; None: 0.001 for integers, 1 for floats.
        mask: Image of the same size, nonzero on the object; `FILE:NUMBER` uses the pixels of that
            value.
        near: Smallest depth [m]; nearer points are dropped.
        far: Largest depth [m]; farther points are dropped.

    Raises:
        InputError: A file cannot be read, or the pose is not rigid.
    """
    pose = None if T_world_camera is None else rigid(T_world_camera, "T_world_camera")
    mask_name = None if mask is None else str(mask)
    options = SceneFileOptions(str(intrinsics), depth_scale, near, far, mask=mask_name)
    return _read_depth_view(Path(path), options, pose)


def masked(cloud: Cloud) -> Cloud:
    """The points of a cloud under its mask; all without a mask."""
    return cloud if cloud.mask is None else replace(_kept(cloud, cloud.mask), mask=None)


def cleaned_view(cloud: Cloud, whole_scene: bool) -> tuple[Cloud, str]:
    """Clean a cloud; returns it, in its frame, with a report.

    Args:
        cloud: Any cloud; flying pixels of a whole scene are found in its depth image only.
        whole_scene: Drop only flying pixels; otherwise also outliers and specks.
    """
    if not whole_scene:
        found = clean(cloud.points)
    elif cloud.image is not None and cloud.pixels is not None:
        u, v = cloud.pixels.astype(np.int64).T
        flying = flying_pixels(cloud.image.depth, cloud.image.K[0, 0])[v, u]
        found = Cleaning(~flying, flying=int(flying.sum()))
    else:
        return cloud, ""
    return _kept(cloud, found.kept), found.report()


def _kept(cloud: Cloud, kept: NDArray[np.bool_]) -> Cloud:
    of_points = ("points", "normals", "colours", "pixels", "mask")
    every = {name: getattr(cloud, name) for name in of_points}
    chosen: dict[str, Any] = {k: None if v is None else v[kept] for k, v in every.items()}
    return replace(cloud, **chosen)


def _read_depth_view(path: Path, options: SceneFileOptions, T_world_camera: Array | None) -> Cloud:
    if options.intrinsics is None:
        raise InputError(
            "is read as a depth image, but its intrinsics are not given",
            where=path,
            allowed=f"a depth image with --intrinsics, or a cloud ({', '.join(CLOUD_SUFFIXES)})",
            hint="add --intrinsics K.json",
        )
    if options.frame == "world":
        raise InputError("--frame world with a depth image", where=path, allowed="--frame camera")
    if options.unit != "m":
        raise InputError(
            "--unit with a depth image", where=path, hint="use --depth-scale (metres per unit)"
        )
    depth, scale = read_depth(path, options.depth_scale)
    height, width = depth.shape
    camera = read_intrinsics(options.intrinsics, width, height)
    colours = None if options.colour is None else read_colour(options.colour)
    with as_input_error(path, or_named=True):
        limits = options.near, options.far
        cloud = cloud_of_depth(depth, camera, T_world_camera, colours, *limits, scale=scale)
    if options.mask is None:
        return cloud
    mask = read_mask(options.mask, (height, width))
    assert cloud.pixels is not None
    u, v = cloud.pixels.astype(np.int64).T
    masked_cloud = _with_mask(cloud, mask[v, u], options.mask)
    unmeasured = mask.copy()
    unmeasured[v, u] = False
    return replace(masked_cloud, mask_rays=camera.rays_of(unmeasured))


def _projected(cloud: Cloud, options: SceneFileOptions) -> Cloud:
    """A cloud with the pixel of each point, and its value in the mask."""
    points, _ = cloud.in_camera_frame()
    assert options.intrinsics is not None
    if options.mask is None:
        camera = read_intrinsics(options.intrinsics)
        return replace(cloud, pixels=camera.project(points))
    mask = read_mask(options.mask)
    height, width = mask.shape
    camera = read_intrinsics(options.intrinsics, width, height, "the mask")
    pixels = camera.project(points)
    u, v = np.floor(pixels + 0.5).astype(np.int64).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    on = np.zeros(len(points), dtype=bool)
    on[inside] = mask[v[inside], u[inside]]
    return _with_mask(replace(cloud, pixels=pixels), on, options.mask)


def _with_mask(cloud: Cloud, on: NDArray[np.bool_], mask: str) -> Cloud:
    if not on.any():
        raise InputError(
            "no measured point lies under the mask",
            where=mask,
            allowed="a mask that is not 0 where the object is, of the depth image's camera",
        )
    return replace(cloud, mask=on)
