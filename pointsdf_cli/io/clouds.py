"""Point clouds from depth cameras: PLY, PCD, XYZ and NPY in, PLY out.

Lengths are metres. Header comments say where a cloud lies (in XYZ files after a `#`):

    comment frame camera
    comment T_world_camera 1 0 0 0.1  0 1 0 0  0 0 1 0.5  0 0 0 1
    comment pose_from table

`frame` names the frame of the coordinates: `camera` (OpenCV: x right, y down, z forward) or
`world`; a file without it is taken to be in the camera's. `T_world_camera`, 16 numbers by rows, is
the camera in the world. `pose_from table` marks a pose that was made from the observed table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.choices import Frame, Unit, require_choice
from pointsdf_cli.errors import InputError, require_near
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, rigid
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.cloud_text import read_npy, read_xyz
from pointsdf_cli.io.input_files import check_input, require_suffix
from pointsdf_cli.io.meshes import UNITS
from pointsdf_cli.io.pcd import read_pcd
from pointsdf_cli.io.ply import read_ply, write_ply
from pointsdf_cli.io.poses import FARTHEST as FARTHEST_CAMERA
from pointsdf_cli.io.raw_cloud import finite_points, frame_of_header, pose_of_header, unit_normals

FEWEST_POINTS = 50
FARTHEST, ANOTHER_UNIT = 20.0, 100.0
"""Largest distance [m] of a cloud from its origin, as a camera sees some metres far, and the one
beyond which coordinates are of another unit."""
SMALLEST, LARGEST = 0.005, 2.0
"""Bounds [m] of the longest side of a partial view of something that a hand may grasp."""

POSE_FROM, TABLE = "pose_from", "table"
"""Header comment of a pose that was made from the observed table, and its value."""

_READERS = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npy": read_npy,
    ".xyz": read_xyz,
    ".txt": read_xyz,
    ".csv": read_xyz,
}
CLOUD_SUFFIXES = tuple(_READERS)


@dataclass(frozen=True)
class DepthImage:
    """A depth image with its intrinsics.

    Attributes:
        depth: f8 [height, width], m along z; 0 where nothing returned.
        K: f8 [3, 3], px.
    """

    depth: NDArray[np.float64]
    K: NDArray[np.float64]

    def beyond(self, depth: float) -> NDArray[np.float64]:
        """The points [N, 3] (camera frame, m) that are deeper than `depth` [m] and no farther than
        `FARTHEST`: they are too far for a cloud, but the rays to them are free."""
        v, u = np.nonzero((self.depth > depth) & (self.depth <= FARTHEST))
        pixels = np.stack([u, v, np.ones(len(u))], axis=1)
        return np.asarray(pixels @ np.linalg.inv(self.K).T * self.depth[v, u, None])


@dataclass(frozen=True)
class Cloud:
    """Points with their frame and camera pose, as far as known.

    Attributes:
        points: f8 [N, 3], m, in `frame`.
        normals: f8 [N, 3] of unit length, in `frame`; None where the file had none.
        colours: u1 [N, 3], red green blue; None where the file had none.
        frame: "camera" or "world".
        T_world_camera: f8 [4, 4], the camera in the world; None where it is not known.
        pixels: f8 [N, 2], (u, v) of each point in the image; None where no image is known.
        image: The depth image that the points are of; None where there was none.
        mask: bool [N], points of the object by the user's mask; None without one.
        mask_rays: f8 [K, 2], tangents (x/z, y/z) of the mask's pixels without depth, camera frame;
            None without a mask or an image.
        notes: Sentences for the user about the reading of the file.
        over_table: Whether the pose was made from the observed table; it is then unrelated to a
            robot.

    Raises:
        InputError: An unknown frame, or a pose that is not a rigid transform.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64] | None = None
    colours: NDArray[np.uint8] | None = None
    frame: str = "camera"
    T_world_camera: NDArray[np.float64] | None = None
    pixels: NDArray[np.float64] | None = None
    image: DepthImage | None = None
    mask: NDArray[np.bool_] | None = None
    mask_rays: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    over_table: bool = False

    def __post_init__(self) -> None:
        require_choice(self.frame, Frame, "frame")
        if self.T_world_camera is not None:
            pose = rigid(self.T_world_camera, "T_world_camera")
            object.__setattr__(self, "T_world_camera", pose)

    def in_camera_frame(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The points [N, 3] in the camera's frame, and T_frame_camera [4, 4] to go back.

        Raises:
            InputError: The cloud is in the world's frame and the camera's place is not known, or
                it is said to be in the camera's and lies behind it.
        """
        if self.frame == "camera":
            points, T_frame_camera = self.points, np.eye(4)
        elif self.T_world_camera is not None:
            T_frame_camera = self.T_world_camera
            points = apply_transform(invert_transform(T_frame_camera), self.points)
        else:
            raise InputError(
                f"the cloud is in frame {self.frame!r}, and the camera's pose in it is not known",
                allowed="--camera-pose, or `T_world_camera` in a PLY header",
                hint="add --camera-pose T.json, or --frame camera if it is in the camera's frame",
            )
        behind = np.count_nonzero(points[:, 2] <= 0)
        if behind and behind == np.count_nonzero(~self.points.any(axis=1)):
            raise InputError(
                f"{behind} of {len(points)} points are 0 0 0, which is how some cameras write that "
                "they saw nothing",
                hint="add --drop-invalid to leave those points out",
            )
        if behind:
            raise self._behind_camera(int(behind))
        return points, T_frame_camera

    def _behind_camera(self, behind: int) -> InputError:
        """The message for points that a camera at its stated place cannot see."""
        return InputError(
            f"{behind} of {len(self.points)} points lie behind the camera (z ≤ 0), so these are "
            "not the coordinates of a camera looking along +z",
            allowed="camera frame: x right, y down, z forward",
            hint="the cloud lies in front of a camera at its origin: add --frame camera"
            if self.frame == "world" and (self.points[:, 2] > 0).all()
            else "if the cloud is in the world's frame, add --frame world --camera-pose "
            f"X,Y,Z,QW,QX,QY,QZ (such as {_camera_before(self.points)}, which looks at it along "
            "the world's −x)",
        )


def read_cloud(
    path: Path | str,
    unit: str = "m",
    drop_invalid: bool = False,
    frame: str | None = None,
    T_world_camera: NDArray[np.float64] | None = None,
) -> Cloud:
    """Read a cloud of any size from any of the formats.

    Args:
        path: A file whose suffix is one of CLOUD_SUFFIXES.
        unit: Unit of its coordinates and of a PCD's viewpoint, a key of `UNITS`; a header's
            `T_world_camera` is always in metres, as is the result.
        drop_invalid: Leave out points that are NaN or infinite, instead of refusing them.
        frame: "camera" or "world", overrides the file's; None for the file's.
        T_world_camera: [4, 4], overrides the file's; None for the file's.

    Raises:
        InputError: No such file, another format, damaged or cut short, no points, or coordinates
            that are not finite.
    """
    path = Path(path)
    require_choice(unit, Unit, "--unit")
    if frame is not None:
        require_choice(frame, Frame, "--frame")
    check_input(path, "cloud")
    require_suffix(path, CLOUD_SUFFIXES, "cloud format")
    raw = _READERS[path.suffix.lower()](path)
    if len(raw.points) == 0:
        raise InputError("holds no points", where=path)
    raw = finite_points(raw, path, drop_invalid)
    pose = T_world_camera
    if pose is None:
        pose = pose_of_header(raw.comments, path)
        if pose is not None and path.suffix.lower() == ".pcd":
            pose[:3, 3] *= UNITS[unit]  # its header holds the viewpoint in the points' own unit
        if pose is not None:
            away, whose = float(np.linalg.norm(pose[:3, 3])), "the camera of the header is"
            require_near(away, FARTHEST_CAMERA, whose, path, "is T_world_camera in metres?")
    given = T_world_camera is not None
    cloud = Cloud(
        points=raw.points * UNITS[unit],
        normals=unit_normals(raw.normals),
        colours=raw.colours,
        frame=frame or frame_of_header(raw.comments, path),
        T_world_camera=pose,
        over_table=not given and pose is not None and raw.comments.get(POSE_FROM) == TABLE,
    )
    if path.suffix.lower() == ".pcd" and frame is None and not given:
        return _without_false_viewpoint(cloud)
    return cloud


def _without_false_viewpoint(cloud: Cloud) -> Cloud:
    """A PCD cloud, in the camera's frame if a camera at its VIEWPOINT would have it at its back.

    Some programs write a viewpoint and leave the points in the camera's frame.
    """
    if cloud.frame != "world" or cloud.T_world_camera is None:
        return cloud
    seen = apply_transform(invert_transform(cloud.T_world_camera), cloud.points)
    if (seen[:, 2] > 0).any() or not (cloud.points[:, 2] > 0).all():
        return cloud
    note = (
        "the header's VIEWPOINT has all points behind the camera; they are read as the camera's "
        "own coordinates, and the pose is not used (--frame camera; --frame world takes the header "
        "at its word)"
    )
    return replace(cloud, frame="camera", T_world_camera=None, notes=(*cloud.notes, note))


def _camera_before(points: NDArray[np.float64]) -> str:
    """Pose, as typed, of a camera that looks at points [N, 3] of the world along −x."""
    low, high = points.min(axis=0), points.max(axis=0)
    x, y, z = (low + high) / 2 + [0.5 + (high - low).max(), 0.0, 0.0]
    return f"{x:.3g},{y:.3g},{z:.3g},0.5,-0.5,-0.5,0.5"


def write_cloud(path: Path | str, cloud: Cloud) -> None:
    """Write a cloud as binary PLY, float32, in metres, as a whole or not at all.

    Raises:
        InputError: Another suffix than .ply, or colours that are no bytes.
    """
    if Path(path).suffix.lower() != ".ply":
        raise InputError("is not the name of a PLY file", where=path, allowed="NAME.ply")
    if cloud.colours is not None and np.asarray(cloud.colours).dtype != np.uint8:
        raise InputError("the cloud's colours are no bytes", where=path, allowed="uint8, 0 to 255")
    comments = frame_comments(cloud.frame, cloud.T_world_camera)
    if cloud.T_world_camera is not None and cloud.over_table:
        comments[POSE_FROM] = TABLE
    with atomic_path(path) as temporary:
        write_ply(temporary, cloud.points, cloud.normals, cloud.colours, comments)


def frame_comments(frame: str, T_world_camera: NDArray[np.float64] | None) -> dict[str, str]:
    """Header comments on where a cloud or its mesh lies: frame, and camera [4, 4] if known."""
    if T_world_camera is None:
        return {"frame": frame}
    pose = " ".join(repr(float(v)) for v in T_world_camera.ravel())
    return {"frame": frame, "T_world_camera": pose}


def check_object_cloud(cloud: Cloud, where: Any) -> Cloud:
    """Check that a cloud can be a partial view of one graspable object, and return it.

    Raises:
        InputError: Too few points, all of them equal or on a line, another unit, or a scene.
    """
    points = cloud.points
    _require_points(points, "a shape", " on the object", where)
    size = float(np.ptp(points, axis=0).max())
    if size == 0:
        raise InputError("all points are the same point", where=where)
    if not SMALLEST <= size <= LARGEST:
        raise _size_error(points, size, where)
    _require_nearby(points, where)
    spread = np.linalg.svd(np.cov(points.T), compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise InputError("all points lie on one line", where=where)
    return cloud


def check_scene_cloud(cloud: Cloud, where: Any) -> Cloud:
    """Check that a cloud can be a camera's view of a table, or of a part of it, and return it.

    Raises:
        InputError: Too few points, or another unit.
    """
    points = cloud.points
    _require_points(points, "anything", "", where)
    size = float(np.ptp(points, axis=0).max())
    # A camera's view of a room reaches metres far, its errors some more; another unit, thousands.
    if size < SMALLEST or _away(points) > FARTHEST:
        if cloud.image is not None:
            what = f"the depth image's points are {size:.3g} m across"
            hint = "check --depth-scale, and focal lengths and principal point, in pixels"
            raise InputError(what, where=where, allowed="a camera's view of a table", hint=hint)
        if size < SMALLEST or size > FARTHEST or _away(points) > ANOTHER_UNIT:
            raise _size_error(points, size, where)
        _require_nearby(points, where)
    return cloud


def _away(points: NDArray[np.float64]) -> float:
    """Distance [m] of points [N, 3] from the origin, along the axis where it is largest."""
    return float(np.abs(np.median(points, axis=0)).max())


def _require_nearby(points: NDArray[np.float64], where: Any) -> None:
    """Refuse points [N, 3], most of which lie far from the origin."""
    require_near(
        _away(points), FARTHEST, "the points lie", where, "check the cloud's unit and origin"
    )


def _require_points(points: NDArray[np.float64], seen: str, of: str, where: Any) -> None:
    """Refuse fewer points than `FEWEST_POINTS`, too few to see `seen` in."""
    if len(points) < FEWEST_POINTS:
        what = f"holds {len(points)} point{'s' * (len(points) != 1)}, too few to see {seen} in"
        raise InputError(what, where=where, allowed=f"at least {FEWEST_POINTS} points{of}")


def _size_error(points: NDArray[np.float64], size: float, where: Any) -> InputError:
    if size < SMALLEST:
        what = f"{size * 1000:.2g} mm across, too small for a graspable object"
        hint = "check the unit (--unit m, cm, mm, inch)"
    elif _away(points) > ANOTHER_UNIT or size > FARTHEST:
        what, hint = f"{size:.4g} m across: these look like millimetres", "add --unit mm"
    else:
        what = f"{size:.2g} m across: a whole scene, not one object"
        hint = "cut the object out first: rgrasp mesh and plan do so with --segment auto"
    return InputError(
        f"the cloud is {what}",
        where=where,
        allowed=f"one object, {SMALLEST * 1000:g} mm to {LARGEST:g} m across, in metres",
        hint=hint,
    )
