"""List of the objects on a table, and its picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.io.clouds import check_scene_cloud
from pointsdf_cli.io.depth_images import read_colour
from pointsdf_cli.planning.cloud_checks import in_world, require_pose
from pointsdf_cli.planning.object_choice import NoObjectError, Thing, reach_of
from pointsdf_cli.planning.plausibility import require_table_at_zero
from pointsdf_cli.planning.scene import Scene, sort_scene
from pointsdf_cli.planning.scene_input import read_scene
from pointsdf_cli.planning.table_top import chosen_thing, workspace_of
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.own_points import off_robot, robot_points
from pointsdf_cli.viz.segment_picture import segment_picture


@dataclass(frozen=True)
class Listing:
    """List of the objects on a table.

    Attributes:
        scene: View with a label for each point.
        things: The objects, best to grasp first.
        points: Number of the file's points on each object, by its number.
        notes: Sentences for the user.
    """

    scene: Scene
    things: tuple[Thing, ...]
    points: dict[int, int]
    notes: tuple[str, ...]


def list_things(
    path: Path,
    files: SceneFileOptions,
    pose: str | None,
    workspace: tuple[tuple[float, ...], tuple[float, ...]] | None = None,
    robot: Path | None = None,
    cleaned: bool = True,
) -> Listing:
    """Find the objects on the table of one view.

    Args:
        path, files: The view and how it is read.
        pose: Pose as typed; see `scene_input.read_scene`.
        workspace: Corners [m] of the workspace; the default ones if None.
        robot: YAML file of the robot; the bundled one if None.
        cleaned: Drop flying pixels and outliers.

    Raises:
        InputError: The view cannot be read, or has no pose.
        NoObjectError: Nothing stands there.
    """
    around = workspace_of(workspace)
    described = load_robot(robot)
    given = read_scene(
        [path], [] if pose is None else [pose], [files], None, around, cleaned, described
    )
    (cloud,) = given.clouds
    require_pose(cloud, str(path))
    require_table_at_zero([in_world(cloud)], [str(path)], "there is nothing to list")
    own = robot_points(described, described.home)
    scene = sort_scene(
        check_scene_cloud(cloud, path),
        str(path),
        around,
        lambda world: ~off_robot(world, own),
        reach_of(described),
        cleaned,
    )
    first = chosen_thing(scene, None, around)
    things = tuple(thing for thing in scene.listed if thing.stands)
    if scene.mask is not None:
        things = (first,)
    if not things:
        raise NoObjectError("nothing stands on the table", where=path)
    counts = {thing.number: int((scene.label == thing.label).sum()) for thing in things}
    return Listing(scene, things, counts, given.notes)


def draw_things(picture: Path, listing: Listing, colour: Path | None = None) -> None:
    """Draw the objects with their numbers, on a colour image if there is one."""
    scene = listing.scene
    number = np.zeros(scene.things.count, dtype=np.int64)
    for thing in listing.things:
        number[thing.label] = thing.number
    label = scene.label
    mine = np.where(label >= 0, number[np.maximum(label, 0)], 0) if len(number) else label * 0
    points = scene.all_points
    if scene.all_pixels is not None and scene.image is not None:
        pixels, size = scene.all_pixels, scene.image.depth.shape[::-1]
    else:
        pixels, size = points[:, :2] / points[:, 2:], None
    at = [
        (thing.number, tuple(np.median(pixels[mine == thing.number], axis=0)))
        for thing in listing.things
    ]
    background = None if colour is None or size is None else read_colour(colour)
    segment_picture(picture, pixels, points[:, 2], mine, at, size, background)
