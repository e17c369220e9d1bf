"""Points of one object from a file: a cloud of it alone, a masked image, or a view of a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pointsdf_cli.camera.scene_file import SceneFileOptions, is_depth_image, masked, read_view
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.visibility import ViewEvidence, visibility_image
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, frame_comments
from pointsdf_cli.io.poses import box, camera_pose, table_place
from pointsdf_cli.planning.cloud_checks import in_world, require_pose

if TYPE_CHECKING:
    from pointsdf_cli.camera.segmentation import SegmentationConfig
    from pointsdf_cli.camera.view import View
    from pointsdf_cli.planning.mesh_choices import MeshChoices
    from pointsdf_cli.planning.object_choice import TargetChoice
    from pointsdf_cli.robot.description import RobotDescription


FLAT, LEAST_ABOVE = 0.03, 0.5
"""Height [m] and share. A lower object with a smaller share of the mask's points above the table,
such as a fork, keeps all points under the mask."""


@dataclass(frozen=True)
class ObjectView:
    """One object as seen in one view.

    Attributes:
        points: [N, 3], camera frame, m.
        T_frame_camera: [4, 4], the camera in the file's frame.
        frame: Frame of the file: "camera" or "world".
        notes: Sentences about the points kept.
        alone: Whether the file held nothing else.
        evidence: Observed space around the object; None for an object alone.
        T_world_camera: [4, 4], the camera in the world; None where it is not known.
    """

    points: Array
    T_frame_camera: Array
    frame: str
    notes: tuple[str, ...] = ()
    alone: bool = False
    evidence: ViewEvidence | None = None
    T_world_camera: Array | None = None

    @property
    def comments(self) -> dict[str, str]:
        """Header comments of its mesh: where it lies."""
        there = self.T_frame_camera if self.frame == "world" else self.T_world_camera
        return frame_comments(self.frame, there)


def is_scene(path: Path, files: SceneFileOptions, pose: str | None) -> bool:
    """Whether a file is taken for a view of a table by default: a depth image with a pose or
    without a mask, or any file with the pose `table`."""
    if pose is not None and table_place(pose) is not None:
        return True
    return is_depth_image(path, files.intrinsics) and (pose is not None or files.mask is None)


@dataclass(frozen=True)
class MeshSettings:
    """Settings of meshes, apart from a cloud's own files.

    Attributes:
        choices: Meshing options.
        segment: --segment as typed; chosen by `is_scene` if None.
        target, workspace: As typed.
        cleaned: Whether flying pixels, outliers and specks are dropped.
        robot, checkpoint: Files; the bundled ones if None.
        device: Device of the network.
        start: Configuration [J] of the robot; its home if None.
    """

    choices: MeshChoices
    segment: str | None = None
    target: str | None = None
    workspace: str | None = None
    cleaned: bool = True
    robot: Path | None = None
    checkpoint: Path | None = None
    device: str = "cpu"
    start: Array | None = None

    def view(self, path: Path, files: SceneFileOptions, pose: str | None) -> ObjectView:
        """Points of the object, from a cloud of it alone or from a view of a table.

        Args:
            path, files, pose: As in `segmented_view`.

        Raises:
            InputError: There is no object or no pose, or an option is invalid.
        """
        segment = self.segment
        if segment is None:
            segment = "auto" if is_scene(path, files, pose) else "none"
        if segment == "none":
            for option in ("target", "robot", "start", "workspace"):
                if getattr(self, option) is not None:
                    wrong = f"--{option} without --segment auto"
                    raise InputError(wrong, hint="add --segment auto")
            return bare_view(path, files, pose, self.cleaned)
        corners = None if self.workspace is None else box(self.workspace, "--workspace")
        # The object is wanted in the camera's frame: where the robot is does not matter.
        over_table = pose is None and is_depth_image(path, files.intrinsics)
        pose = "table" if over_table else pose
        seen = segmented_view(
            path,
            files,
            pose,
            target=self.target,
            robot=self.robot,
            workspace=corners,
            cleaned=self.cleaned,
            start=self.start,
        )
        if not over_table:
            return seen
        from pointsdf_cli.planning.scene_input import FROM_TABLE

        notes = tuple(one for one in seen.notes if FROM_TABLE not in one)
        return replace(seen, notes=notes, T_world_camera=None)


def bare_view(
    path: Path, files: SceneFileOptions, pose: str | None, cleaned: bool = True
) -> ObjectView:
    """A cloud of an object alone, or the masked part of a view.

    Raises:
        InputError: The file cannot be read, or is not a cloud of an object.
    """
    view = read_view(path, files, None if pose is None else camera_pose(pose))
    return bare_cloud(view, str(path), cleaned)


def bare_cloud(view: Cloud, name: str, cleaned: bool = True) -> ObjectView:
    """Make the view of `bare_view` from a cloud; `name` is for messages.

    Raises:
        InputError: It is not a cloud of an object.
    """
    from pointsdf_cli.planning.table_top import bare_object

    alone = masked(view)
    with as_input_error(name):
        points, T_frame_camera = alone.in_camera_frame()
    seen, note, around = None, "", None
    if view.mask is None:  # what a mask takes in by mistake may be far away
        check_object_cloud(alone, name)
    else:
        seen, note = _on_its_table(view, len(points), name, cleaned)
    if seen is not None:
        points, around, said = seen.points, seen.evidence, ""
    else:
        points, said = bare_object(alone, cleaned)
    if view.mask is not None:
        check_object_cloud(Cloud(points), f"{name}, under its mask")
        around = around or _around_mask(view, points)
    notes = tuple(f"{name}: {each}" for each in (*view.notes, said, note) if each)
    there = T_frame_camera, view.frame
    return ObjectView(points, *there, notes, True, around, view.T_world_camera)


def _on_its_table(
    view: Cloud, under_mask: int, name: str, cleaned: bool
) -> tuple[View | None, str]:
    """The object under a view's mask as it is seen with a pose, and a note on it; without a table
    under it, or where the mask shows only the table, None and a warning (which may be empty).

    The table is looked for in the view. Where it is known, a mask that is too small can grow, and
    the table's rays are known to miss the object.

    Args:
        view: A view with a mask.
        under_mask: Number of points under the mask.
        name, cleaned: As in `bare_cloud`.
    """
    from pointsdf_cli.camera.support_plane import find_support_plane, pose_over_plane
    from pointsdf_cli.planning.labelled_view import ANYWHERE, describe, label_view, sighting
    from pointsdf_cli.planning.object_choice import NoObjectError
    from pointsdf_cli.planning.table_top import chosen_object, view_of

    points, _ = view.in_camera_frame()
    try:
        above = pose_over_plane(find_support_plane(points))
        posed = replace(view, points=points, frame="camera", T_world_camera=above, over_table=True)
    except InputError:
        return None, ""
    try:
        labelled = label_view(posed, name, ANYWHERE, cleaned=cleaned)
        item = chosen_object(labelled, None, ANYWHERE)
    except (InputError, NoObjectError) as error:
        return None, f"warning: {error.what}"
    if not item.stands:
        return None, ""
    found = sighting(labelled, item, cleaned)
    if item.size[2] < FLAT and len(found.object_points) < LEAST_ABOVE * under_mask:
        return None, ""
    return view_of(labelled, found, item.label), describe(labelled, item, found, place=False)


def _around_mask(view: Cloud, points: Array) -> ViewEvidence:
    """Evidence of a view besides the points [N, 3] (camera frame, m) under its mask."""
    everything, _ = view.in_camera_frame()
    assert view.mask is not None
    pitch = None if view.image is None else 1.0 / float(view.image.K[0, 0])
    image = visibility_image(points, everything[~view.mask], None, pitch, view.mask_rays)
    return ViewEvidence(image)


def segmented_view(
    path: Path,
    files: SceneFileOptions,
    pose: str | None,
    target: str | None,
    robot: Path | None,
    workspace: tuple[tuple[float, ...], tuple[float, ...]] | None,
    cleaned: bool = True,
    start: str | Array | None = None,
) -> ObjectView:
    """The object segmented from a view of a table.

    Args:
        path, files: The view and its reading options.
        pose, target: As typed; see `scene_input.read_scene`.
        robot: YAML file of the robot; the bundled one if None.
        workspace: Corners [m] of the workspace; the default ones if None.
        cleaned: Drop flying pixels, outliers and specks.
        start: The robot's configuration, as typed or [J]; its home if None.

    Raises:
        InputError: The view cannot be read, has no pose, or does not show the object.
    """
    from pointsdf_cli.planning.object_choice import NoObjectError
    from pointsdf_cli.planning.scene_input import read_scene
    from pointsdf_cli.planning.table_top import workspace_of
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.robot.start import start_configuration

    around = workspace_of(workspace)
    described = load_robot(robot)
    q = start_configuration(start, described)
    with as_input_error(kind=NoObjectError):
        given = read_scene([path], [] if pose is None else [pose], [files], target, around, cleaned)
    cut = segmented_cloud(given.clouds[0], str(path), described, given.target, around, cleaned, q)
    notes, back = (*given.notes, *cut.notes), given.T_frame_camera
    return replace(cut, notes=notes, frame=given.frame, T_frame_camera=back)


def segmented_cloud(
    cloud: Cloud,
    name: str,
    robot: RobotDescription,
    target: TargetChoice | None,
    workspace: SegmentationConfig,
    cleaned: bool = True,
    q: Array | None = None,
) -> ObjectView:
    """Make the view of `segmented_view` from a cloud and the robot's configuration q [J], home if
    None; `name` is for messages.

    Raises:
        InputError: The cloud has no pose, or does not show the object.
    """
    from pointsdf_cli.planning.object_choice import NoObjectError
    from pointsdf_cli.planning.plausibility import require_table_at_zero
    from pointsdf_cli.planning.table_top import look_at_table

    require_pose(cloud, name)
    require_table_at_zero([in_world(cloud)], [name], "--segment none")
    there = None if cloud.over_table else robot  # where it will stand does not matter here
    q = robot.home if q is None else q
    with as_input_error(kind=NoObjectError):
        found = look_at_table([cloud], [name], there, q, "auto", target, workspace, cleaned)
    view = found.views[0]
    _, pose = cloud.in_camera_frame()
    known = found.report, False, view.evidence, cloud.T_world_camera
    return ObjectView(view.points, pose, cloud.frame, *known)
