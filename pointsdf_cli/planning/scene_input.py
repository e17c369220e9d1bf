"""Files and options of a command to clouds with poses; a missing pose can be made from the
table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pointsdf_cli.camera.scene_file import SceneFileOptions, cleaned_view, masked, read_view
from pointsdf_cli.camera.segmentation import SegmentationConfig
from pointsdf_cli.camera.support_plane import find_support_plane, pose_over_plane
from pointsdf_cli.camera.table_objects import VOXEL
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import Cloud, check_scene_cloud
from pointsdf_cli.io.poses import camera_pose, table_place, target_numbers
from pointsdf_cli.planning.labelled_view import ANYWHERE, WORKSPACE, label_view
from pointsdf_cli.planning.object_choice import NoObjectError, TargetChoice
from pointsdf_cli.planning.pose_mistakes import require_no_mistaken_pose
from pointsdf_cli.planning.table_top import chosen_object

MANY = 400_000
"""Number of points from which a scene takes seconds and a note announces it."""

ANY = "any"
"""`--target` for the first object that can be grasped."""


FROM_TABLE = "camera pose from the table"
"""Beginning of the note on a pose that was made from the table."""


@dataclass(frozen=True)
class SceneInput:
    """Input of a command: clouds, target and notes.

    Attributes:
        clouds: Clouds, one for each camera.
        target: The user's choice of the object; None without one.
        notes: Sentences for the user.
        frame, T_frame_camera: Frame of the first file's coordinates, and the camera in it [4, 4];
            the pose `table` leaves the points in the camera's frame.
    """

    clouds: tuple[Cloud, ...]
    target: TargetChoice | None
    notes: tuple[str, ...]
    frame: str
    T_frame_camera: Array


def parse_target(text: str | None) -> TargetChoice | None:
    """The object that `--target` names: a number, a pixel U,V, a place X,Y,Z, or any.

    Raises:
        InputError: It is none of these.
    """
    if text is None:
        return None
    if text == ANY:
        return TargetChoice(any=True)
    numbers = target_numbers(text)
    if len(numbers) == 1:
        return TargetChoice(number=int(numbers[0]))
    if len(numbers) == 2:
        return TargetChoice(pixel=(float(numbers[0]), float(numbers[1])))
    return TargetChoice(place=numbers)


def read_scene(
    paths: Sequence[Path],
    poses: Sequence[str],
    options: Sequence[SceneFileOptions],
    target: str | None = None,
    workspace: SegmentationConfig = WORKSPACE,
    cleaned: bool = True,
) -> SceneInput:
    """Read views of one scene.

    Args:
        paths: Depth images or clouds, one a camera.
        poses: Camera poses as typed, one for each path, or none. `table` puts z = 0 on the observed
            table and the object in the robot's reach; `table:X,Y` puts it at X,Y.
        options: Reading options of each file.
        target: --target as typed.
        workspace, cleaned: As in `look_at_table`; used with the pose `table`.

    Raises:
        InputError: A file cannot be read, an option does not fit, no table is seen,
            or a pose is right only in another convention (`pose_mistakes.py`).
    """
    if poses and len(poses) != len(paths):
        given = f"{len(poses)} for {len(paths)} views"
        raise InputError(given, where="--camera-pose", allowed="one for each, in order")
    places = [table_place(text) for text in poses]
    if len(paths) > 1 and any(place is not None for place in places):
        one = "one camera: the table does not tell the poses of several to each other"
        raise InputError("table, with several cameras", where="--camera-pose", allowed=one)
    wanted = parse_target(target)
    clouds, notes = [], []
    frame, T_frame_camera = "camera", np.eye(4)
    for k, (path, option) in enumerate(zip(paths, options, strict=True)):
        place = places[k] if poses else None
        pose = camera_pose(poses[k]) if poses and place is None else None
        cloud = read_view(path, option, pose)
        if k == 0:
            _require_pixel_within(wanted, cloud)
            if cloud.frame == "world" and cloud.T_world_camera is not None:
                frame, T_frame_camera = "world", cloud.T_world_camera
        notes += [f"{path}: {note}" for note in cloud.notes]
        if len(cloud.points) > MANY:
            side = f"{VOXEL * 1000:g} mm"
            notes.append(f"{path}: {len(cloud.points)} points, thinned to voxels of {side}")
        if place is not None:
            cloud, wanted = stand_on_table(cloud, str(path), place, wanted, workspace, cleaned)
            notes.append(table_note(cloud, place))
        else:
            require_no_mistaken_pose(cloud, str(path))
        clouds.append(cloud)
    return SceneInput(tuple(clouds), wanted, tuple(notes), frame, T_frame_camera)


def _require_pixel_within(target: TargetChoice | None, cloud: Cloud) -> None:
    """Refuse a pixel that lies outside of the first view's image."""
    if target is None or target.pixel is None or cloud.image is None:
        return
    height, width = cloud.image.depth.shape
    u, v = target.pixel
    if not (0 <= u < width and 0 <= v < height):
        outside = f"the pixel {u:g},{v:g} is outside of the image"
        allowed = f"U from 0 to {width - 1}, V from 0 to {height - 1}"
        raise InputError(outside, where="--target", allowed=allowed)


def table_note(cloud: Cloud, place: tuple[float, float]) -> str:
    """Note on a pose that was made from the table."""
    assert cloud.T_world_camera is not None
    zero = f"z = 0 is the table ({cloud.T_world_camera[2, 3]:.2f} m below the camera)"
    there = f"the object at {place[0]:g},{place[1]:g}"
    return f"{FROM_TABLE}: {zero}, {there}. Only for trying out: do not send it to a robot"


def stand_on_table(
    cloud: Cloud,
    name: str,
    place: tuple[float, float],
    target: TargetChoice | None = None,
    workspace: SegmentationConfig = WORKSPACE,
    cleaned: bool = True,
) -> tuple[Cloud, TargetChoice | None]:
    """Give a cloud the pose in which z = 0 is its table and the object stands at `place`.

    Args:
        cloud: Cloud without a known pose.
        name: Name of the cloud, for messages.
        place: x and y [m] of the object.
        target: The user's choice: a number in the list of `segment`, or a pixel.
        workspace, cleaned: As in `look_at_table`.

    Returns:
        The cloud, and the object as a place in the world if one was chosen.

    Raises:
        InputError: No table is seen, or the target is a place in a world that is not known yet.
    """
    if target is not None and target.place is not None:
        unknown = "a place in the world, which is not known before --camera-pose table has made it"
        raise InputError(unknown, where="--target", allowed="an object's number, or a pixel U,V")
    with as_input_error(name):
        points, _ = check_scene_cloud(cloud, name).in_camera_frame()
        cloud = replace(cloud, points=points, frame="camera", T_world_camera=None)
        plane = find_support_plane(points)
    above = pose_over_plane(plane)
    cloud = replace(cloud, T_world_camera=above, over_table=True)
    try:
        # Put the first listed object at the place, so that the numbers match those of `segment`.
        cloud = _moved(cloud, _centre(cloud, name, None, ANYWHERE, cleaned), place)
    except NoObjectError:
        # A bare table: its own middle is put there.
        world = apply_transform(np.asarray(cloud.T_world_camera), points)
        return _moved(cloud, np.median(world, axis=0), place), target
    if target is None or target.any:
        return cloud, target
    try:
        chosen = _centre(cloud, name, target, workspace, cleaned)
    except NoObjectError:
        return cloud, target  # told where the object is looked for
    return _moved(cloud, chosen, place), TargetChoice(place=np.array([*place, chosen[2]]))


def _centre(
    cloud: Cloud,
    name: str,
    target: TargetChoice | None,
    workspace: SegmentationConfig,
    cleaned: bool,
) -> Array:
    """Centre [3] of the chosen object in the world of the cloud's pose."""
    scene = label_view(cloud, name, workspace, cleaned=cleaned)
    return chosen_object(scene, target, workspace).centre


def _moved(cloud: Cloud, centre: Array, place: tuple[float, float]) -> Cloud:
    assert cloud.T_world_camera is not None
    pose = cloud.T_world_camera.copy()
    pose[:2, 3] += np.asarray(place) - centre[:2]
    return replace(cloud, T_world_camera=pose)


def depth_view(
    path: Path,
    options: SceneFileOptions,
    pose: str | None,
    cleaned: bool,
    say: Callable[[str], None],
) -> tuple[Cloud, int, int]:
    """Cloud of the depth image of a scene, or of what its mask shows.

    Args:
        path, options: Image, and how to read it.
        pose: Camera pose as typed; None for none.
        cleaned: Drop flying pixels, and outliers and specks under a mask.
        say: Receives notes for the user.

    Returns:
        The cloud, the number of pixels, and that of the pixels without a valid depth.

    Raises:
        InputError: A file cannot be read, or no point is left.
    """
    place = None if pose is None else table_place(pose)
    known = None if pose is None or place is not None else camera_pose(pose)
    made = read_view(path, options, known)
    for note in made.notes:
        say(f"{path}: {note}")
    if place is not None:
        made, _ = stand_on_table(made, str(path), place, cleaned=cleaned)
        say(table_note(made, place))
    pixels = 0 if made.image is None else made.image.depth.size
    unseen = pixels - len(made.points)
    made = masked(made)
    if cleaned:
        made, said = cleaned_view(made, whole_scene=options.mask is None)
        if said:
            say(said)
        if not len(made.points):
            raise InputError("cleaning left no points", where=path, hint="add --no-clean")
    return made, pixels, unseen
