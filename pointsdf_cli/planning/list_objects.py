"""List of the objects on a table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.cloud_checks import in_world, require_pose
from pointsdf_cli.planning.labelled_view import LabelledView
from pointsdf_cli.planning.object_choice import ListedObject, NoObjectError
from pointsdf_cli.planning.plausibility import require_table_at_zero, table_warning
from pointsdf_cli.planning.scene_input import read_scene
from pointsdf_cli.planning.table_top import chosen_object, label_table, table_height, workspace_of
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.start import start_configuration


@dataclass(frozen=True)
class Listing:
    """List of the objects on a table.

    Attributes:
        view: View with a label for each point.
        objects: The objects, best to grasp first.
        points: Number of the file's points on each object, by its number.
        notes: Sentences for the user.
    """

    view: LabelledView
    objects: tuple[ListedObject, ...]
    points: dict[int, int]
    notes: tuple[str, ...]


def list_objects(
    path: Path,
    files: SceneFileOptions,
    pose: str | None,
    workspace: tuple[tuple[float, ...], tuple[float, ...]] | None = None,
    robot: Path | None = None,
    cleaned: bool = True,
    start: str | Array | None = None,
) -> Listing:
    """Find the objects on the table of one view.

    Args:
        path, files: The view and how it is read.
        pose: Pose as typed; see `scene_input.read_scene`.
        workspace: Corners [m] of the workspace; the default ones if None.
        robot: YAML file of the robot; the bundled one if None.
        cleaned: Drop flying pixels and outliers.
        start: Its configuration, as typed or [J]; its home if None.

    Raises:
        InputError: The view cannot be read, or has no pose.
        NoObjectError: Nothing stands there.
    """
    around = workspace_of(workspace)
    described = load_robot(robot)
    q = start_configuration(start, described)
    given = read_scene([path], [] if pose is None else [pose], [files], None, around, cleaned)
    (cloud,) = given.clouds
    require_pose(cloud, str(path))
    require_table_at_zero([in_world(cloud)], [str(path)], "there is nothing to list")
    # Where a robot will stand over a table depends on the chosen object, and numbers must not.
    there = None if cloud.over_table else described
    view = label_table(cloud, str(path), there, q, around, cleaned)
    first = chosen_object(view, None, around)
    objects = tuple(item for item in view.listed if item.stands)
    if view.cloud.mask is not None:
        objects = (first,)
    if not objects:
        raise NoObjectError("nothing stands on the table", where=path)
    counts = {item.number: int((view.label == item.label).sum()) for item in objects}
    height = table_height([(view, first.label)])
    doubt = "" if cloud.over_table else table_warning(height, [in_world(cloud)])
    said = [f"warning: {doubt}"] * bool(doubt)
    for item in objects:
        if item.label in view.objects.cut:
            beyond = "goes on outside of the workspace, unseen: widen --workspace"
            said.append(f"warning: object {item.number} {beyond}")
    notes = (*given.notes, *said)
    return Listing(view, objects, counts, notes)
