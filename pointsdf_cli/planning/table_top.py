"""From camera clouds to the object to be grasped, and its obstacles.

A cloud of the whole table is segmented (camera/segmentation.py); other objects become obstacles;
points on the robot itself are dropped. A cloud of the object alone stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.scene_file import masked
from pointsdf_cli.camera.segmentation import FEWEST, SegmentationConfig
from pointsdf_cli.camera.table_objects import VOXEL
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import horizontal_width
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.visibility import ViewEvidence, visibility_image
from pointsdf_cli.geometry.voxels import thin
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, check_scene_cloud
from pointsdf_cli.planning.cloud_checks import require_pose
from pointsdf_cli.planning.labelled_view import (
    WORKSPACE,
    LabelledView,
    Sighting,
    describe,
    label_view,
    sighting,
)
from pointsdf_cli.planning.object_choice import (
    ListedObject,
    NoObjectError,
    TargetChoice,
    choose,
    reach_of,
)
from pointsdf_cli.planning.option_checks import check_segment
from pointsdf_cli.planning.other_cameras import FirstView
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.own_points import off_robot, robot_points


def workspace_of(corners: tuple[tuple[float, ...], tuple[float, ...]] | None) -> SegmentationConfig:
    """Workspace: the box between two corners [3] of the world, m; the default if None.

    Raises:
        InputError: Not two corners.
    """
    if corners is None:
        return WORKSPACE
    try:
        (x0, y0, z0), (x1, y1, z1) = np.array(corners, dtype=np.float64).tolist()
    except (TypeError, ValueError) as error:
        allowed = "two corners (x, y, z) in the world [m]"
        raise InputError(f"{corners!r}", where="workspace", allowed=allowed) from error
    return replace(WORKSPACE, low=(x0, y0, z0), high=(x1, y1, z1))


DENSE = 100_000
"""Number of points from which a cloud of one object is thinned: more points only take longer."""

WIDEST = 0.6
"""Largest level extent [m] of an object that is considered."""


@dataclass(frozen=True)
class TableTop:
    """The object and its surroundings, as found in the clouds.

    Attributes:
        views: The object from each camera.
        others: [N, 3], points on other objects above the table, world, m.
        report: Sentences, one a cloud, about points kept and dropped.
        table_height: Height of the observed plane [m]; None without one.
        labelled: Each camera's labelled view, with the label of the object in it; -1 if the camera
            does not see it.
    """

    views: tuple[View, ...]
    others: Array
    report: tuple[str, ...]
    table_height: float | None
    labelled: tuple[tuple[LabelledView, int], ...] = ()


def label_table(
    cloud: Cloud,
    name: str,
    robot: RobotDescription | None,
    q: Array,
    workspace: SegmentationConfig = WORKSPACE,
    cleaned: bool = True,
) -> LabelledView:
    """The labelled view of a robot's table.

    Args:
        cloud: Cloud of the table.
        name: Name of the cloud, for messages.
        robot: The robot; None if it is not in the scene.
        q: [J], its configuration: points on it are dropped.
        workspace, cleaned: As in `look_at_table`.

    Raises:
        InputError: The cloud has no pose, or is none of a scene.
    """
    require_pose(cloud, name)
    usable = check_scene_cloud(cloud, name)
    if robot is None:
        return label_view(usable, name, workspace, cleaned=cleaned)
    own, reach = robot_points(robot, q), reach_of(robot)
    return label_view(usable, name, workspace, lambda world: ~off_robot(world, own), reach, cleaned)


def look_at_table(
    clouds: Sequence[Cloud],
    names: Sequence[str],
    robot: RobotDescription | None,
    start: Array,
    segment: str = "auto",
    target: TargetChoice | Array | None = None,
    workspace: SegmentationConfig = WORKSPACE,
    cleaned: bool = True,
) -> TableTop:
    """Find the object in each cloud.

    Args:
        clouds: Clouds, one for each camera, each with its pose.
        names: Names of the clouds, for messages.
        robot: The robot; None if it is not in the scene.
        start: [J], its configuration: points on it are dropped.
        segment: "auto", or "none" if the clouds hold the object alone.
        target: Choice of the object, or a place [3] of it in the world. Numbers and pixels refer to
            the first cloud. The best object to grasp if None.
        workspace: Part of the world to use.
        cleaned: Drop flying pixels, outliers and specks.

    Raises:
        InputError: A cloud has no pose or is not of an object, or the target does not exist.
        NoObjectError: No cloud shows an object, with the first one's reason.
    """
    check_segment(segment, target is not None, workspace is not WORKSPACE)
    if not (target is None or isinstance(target, TargetChoice)):
        target = TargetChoice(place=target)
    if segment == "none":
        return _bare_objects(clouds, names, cleaned)
    named = zip(clouds, names, strict=True)
    views = (label_table(*each, robot, start, workspace, cleaned) for each in named)
    return _look(views, target, workspace, cleaned)


def _look(
    views: Iterable[LabelledView],
    wanted: TargetChoice | None,
    workspace: SegmentationConfig,
    cleaned: bool,
) -> TableTop:
    """Find the object in each view: in the other cameras, the one that the first camera chose."""
    seen: list[View] = []
    others, report = [], []
    labelled: list[tuple[LabelledView, int]] = []
    problem: NoObjectError | None = None
    first: FirstView | None = None
    for view in views:
        try:
            item = chosen_object(view, wanted, workspace, first is not None)
            found = sighting(view, item, cleaned)
            if not len(found.object_points):
                raise NoObjectError("the mask shows another object", where=view.name)
            if view.cloud.mask is not None:
                check_object_cloud(Cloud(found.object_points), f"{view.name}, under its mask")
            in_world = apply_transform(view.T_world_camera, found.object_points)
            if first is None:
                _check_width(in_world, view.name)
            else:
                first.check(in_world, view.name)
        except NoObjectError as error:
            if first is None and wanted is not None and wanted.place is None:
                raise  # a number or a pixel says nothing about other cameras
            problem = problem or error
            # Objects that this camera saw remain obstacles.
            view = view if first is None else first.without_target(view)
            said, beside = "the object is not seen", view.world[view.objects.label >= 0]
            labelled.append((view, -1))
        else:
            said = describe(view, item, found, place=not view.cloud.over_table)
            beside = found.others_in_world
            labelled.append((view, item.label))
            seen.append(view_of(view, found, item.label))
            if first is None:
                objects = (view.objects.label >= 0) & (view.objects.label != item.label)
                first = FirstView(in_world, view.world[objects])
                if wanted is None or wanted.place is None:
                    wanted = TargetChoice(place=np.median(in_world, axis=0))
        report.append(f"{view.name}: {said}")
        others.append(beside)
    if problem is not None and not seen:
        raise problem
    height = table_height(labelled)
    return TableTop(tuple(seen), np.concatenate(others), tuple(report), height, tuple(labelled))


def _check_width(in_world: Array, name: str) -> None:
    """Require points [N, 3] (world, m) of an object that a hand may reach around.

    Raises:
        NoObjectError: It is too wide.
    """
    if (width := horizontal_width(in_world)) > WIDEST:
        wide = f"what is seen there is {width:.2f} m wide or more in every direction"
        hint = "--target names another object, --mask a part of it"
        raise NoObjectError(f"{wide}: no hand reaches around that", where=name, hint=hint)


def table_height(
    labelled: Sequence[tuple[LabelledView, int]], carried: bool = False
) -> float | None:
    """Height of the table below the object [m], in the views that show it; None without a table.

    Args:
        labelled: The views, with the label of the object in each; -1 where it is not seen.
        carried: Height of what carries the object, such as a tray, instead of the table's.
    """
    heights = []
    for view, label in labelled:
        plane = view.objects.plane_below(label) if carried else view.objects.plane
        if label >= 0 and plane is not None:
            middle = np.median(view.world[view.objects.label == label, :2], axis=0)
            heights.append(float((plane[3] - plane[:2] @ middle) / plane[2]))
    return float(np.median(heights)) if heights else None


def view_of(view: LabelledView, seen: Sighting, label: int) -> View:
    """The planner's view of what was seen of an object in a labelled view."""
    plane, depth = view.plane_in_camera(label), view.cloud.image
    pitch, others = None, seen.other_points
    if depth is not None:
        pitch = 1.0 / float(depth.K[0, 0])
        others = np.concatenate([others, depth.beyond(float(view.cloud.points[:, 2].max()))])
    image = visibility_image(seen.object_points, others, plane, pitch, seen.object_rays)
    return View(_thinned(seen.object_points), view.T_world_camera, ViewEvidence(image, plane))


def _thinned(points: Array) -> Array:
    """Points [N, 3] of one object, thinned if they are so many that planning would take minutes."""
    return points if len(points) <= DENSE else points[thin(points, VOXEL).first]


def _bare_objects(clouds: Sequence[Cloud], names: Sequence[str], cleaned: bool) -> TableTop:
    """Table top from clouds of the object alone."""
    views, report = [], []
    for cloud, name in zip(clouds, names, strict=True):
        require_pose(cloud, name)
        assert cloud.T_world_camera is not None
        points, said = bare_object(check_object_cloud(masked(cloud), name), cleaned)
        width = horizontal_width(apply_transform(cloud.T_world_camera, points))
        if width > WIDEST:
            wide = f"the cloud is {width:.2f} m wide or more in every direction"
            doubt = (
                "no hand reaches around that, and it is more often a whole table than one object"
            )
            allowed = f"one object, less than {WIDEST:g} m wide in some direction"
            hint = "leave --segment none out"
            raise InputError(f"{wide}: {doubt}", where=name, allowed=allowed, hint=hint)
        views.append(View(points, cloud.T_world_camera))
        report.append(f"{name}: {said or f'all {len(points)} points are the object'}")
    return TableTop(tuple(views), np.zeros((0, 3)), tuple(report), None)


def bare_object(cloud: Cloud, cleaned: bool = True) -> tuple[Array, str]:
    """The points [N, 3] (camera frame, m) of a cloud that holds one object alone.

    Returns:
        The points, and a sentence about dropped points; empty if none were.
    """
    points, _ = cloud.in_camera_frame()
    said = []
    if len(few := _thinned(points)) < len(points):
        said.append(f"{len(points)} points thinned to {len(few)}")
        points = few
    if cleaned:
        found = clean(points)
        points = points[found.kept]
        said += [found.report()] if found.dropped else []
    return points, "; ".join(said)


def chosen_object(
    view: LabelledView,
    wanted: TargetChoice | None,
    workspace: SegmentationConfig,
    again: bool = False,
) -> ListedObject:
    """The chosen object of a view.

    Args:
        view: The labelled view.
        wanted: The user's choice; the best object to grasp if None.
        workspace: Workspace of the segmentation, for messages.
        again: The target comes from another camera and overrides a mask.

    Raises:
        InputError: No object has this number, or both a mask and a target are given.
        NoObjectError: The view shows no object.
    """
    if view.cloud.mask is not None and not again:
        if wanted is not None:
            raise InputError("--target and --mask", hint="leave one of the two out")
        last = view.objects.count - 1
        return next(item for item in view.listed if item.label == last)
    if not view.listed:
        count = np.bincount(-np.minimum(view.label, 0), minlength=6)
        raise NoObjectError(
            f"no object in the cloud: of {len(view.label)} points {count[1]} are outside the "
            f"workspace, {count[2]} on the table, {count[3]} in groups too small, {count[4]} on "
            "the robot",
            where=view.name,
            allowed=f"at least {FEWEST} points of an object above the table, between "
            f"{workspace.low} and {workspace.high} m in the world",
            hint="check the camera's pose (--camera-pose), the cloud's unit, or --workspace",
        )
    return choose(view.listed, wanted, view.world, view.objects.label, view.pixels, view.name)
