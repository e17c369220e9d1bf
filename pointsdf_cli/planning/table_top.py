"""From clouds as cameras give them to the object that is to be grasped, and to what is in the way.

A cloud of the whole table is segmented (camera/segmentation.py); what else stands there becomes
obstacles; points on the robot itself are neither. A cloud that was cut out already goes through
unchanged, as nothing but its largest part is left to keep.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import QhullError, cKDTree

from pointsdf_cli.camera.segmentation import (
    Segmentation,
    SegmentationConfig,
    clusters,
    segment_object,
)
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.visibility import ViewEvidence, visibility_image
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.planning.choices import check_segment
from pointsdf_cli.planning.environment import Obstacle
from pointsdf_cli.planning.scene_inputs import check_scene_inputs
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.own_points import off_robot, robot_points

Array = NDArray[np.float64]

WORKSPACE = SegmentationConfig(low=(0.2, -0.9, -0.05), high=(1.6, 0.9, 0.6))
"""What is looked at, unless another is named. Wider than what the bundled arm reaches: what stands
beyond is seen, and said to be out of reach."""


def workspace_of(corners: tuple[tuple[float, ...], tuple[float, ...]] | None) -> SegmentationConfig:
    """What is looked at: the box between two corners [3] of the world, m; the usual if None."""
    if corners is None:
        return WORKSPACE
    (x0, y0, z0), (x1, y1, z1) = corners
    return replace(WORKSPACE, low=(x0, y0, z0), high=(x1, y1, z1))


TARGET_REACH = 0.1
"""--target names the object whose nearest seen point is no farther than this [m]."""


SAME_THING = 0.03
"""What another camera sees of the object is no farther [m] from what the first one saw of it."""


class NoObjectError(RgraspError):
    """The clouds show nothing that could be grasped."""

    exit_code = 3


@dataclass(frozen=True)
class TableTop:
    """What clouds say about the object and its surroundings.

    Attributes:
        views: The object from each camera.
        others: [N, 3], points on other things above the table, world, m.
        report: One sentence a cloud: what was kept and what dropped.
        table_height: Of the plane that was seen [m], None where none was.
    """

    views: tuple[View, ...]
    others: Array
    report: tuple[str, ...]
    table_height: float | None


def look_at_table(
    clouds: Sequence[Cloud],
    names: Sequence[str],
    robot: RobotDescription,
    start: Array,
    segment: str = "auto",
    target: Array | None = None,
    workspace: SegmentationConfig = WORKSPACE,
) -> TableTop:
    """Find the object in each cloud.

    Args:
        clouds: One a camera, each with its pose.
        names: Of the clouds, for messages.
        robot: The robot.
        start: [J], where it is: points on it are left out.
        segment: "auto", or "none" where the clouds hold the object alone.
        target: [3], a place in the world: the object there is taken instead of the largest.
        workspace: What is looked at of the world.

    Raises:
        InputError: No pose, or no cloud of an object.
        NoObjectError: No cloud shows an object; the first one's reason.
    """
    check_segment(segment, target is not None, workspace is not WORKSPACE)
    check_scene_inputs(clouds, names, segment)
    views, others, report, heights = [], [], [], []
    problem: NoObjectError | None = None
    first: tuple[Array, Array] | None = None
    own = robot_points(robot, start)
    for cloud, name in zip(clouds, names, strict=True):
        assert cloud.T_world_camera is not None  # checked above
        points, _ = cloud.in_camera_frame()
        if segment == "none":
            views.append(View(points, cloud.T_world_camera))
            report.append(f"{name}: all {len(points)} points are the object's")
            continue
        world = apply_transform(cloud.T_world_camera, points)
        free = off_robot(world, own)
        points, world = points[free], world[free]
        try:
            found = _segment(world, name, target, workspace)
            if first is not None:
                _require_same(world[found.kept], first, name)
        except NoObjectError as error:
            problem = problem or error
            report.append(f"{name}: the object is not seen")
            # What else it saw stands there all the same.
            with suppress(InputError):
                around = segment_object(world, workspace)
                others.append(world[around.kept | around.other])
            continue
        sentence = found.report()
        if not free.all():
            sentence += f", {int((~free).sum())} on the robot"
        report.append(f"{name}: {sentence}")
        evidence = _evidence(points, found, cloud.T_world_camera)
        views.append(View(points[found.kept], cloud.T_world_camera, evidence))
        others.append(world[found.other])
        if found.plane is not None:
            heights.append(float(found.plane[3]))
        if target is None:
            # The other cameras are asked for what the first one chose.
            target = np.median(world[found.kept], axis=0)
        if first is None:
            first = world[found.kept], world[found.other]
    if problem is not None and not views:
        raise problem
    rest = np.concatenate(others) if others else np.zeros((0, 3))
    height = float(np.median(heights)) if heights else None
    return TableTop(tuple(views), rest, tuple(report), height)


def _evidence(points: Array, found: Segmentation, T_world_camera: Array) -> ViewEvidence:
    """What a view [N, 3] (camera frame, m) knows of the space around the object in it."""
    plane = None
    if found.plane is not None:
        normal = T_world_camera[:3, :3].T @ found.plane[:3]
        plane = np.array([*normal, found.plane[3] - found.plane[:3] @ T_world_camera[:3, 3]])
    image = visibility_image(points[found.kept], points[~found.kept], plane)
    return ViewEvidence(image, plane)


def clutter(points: Array, taken: Collection[str] = ()) -> tuple[Obstacle, ...]:
    """Other things as obstacles: the hull of each cluster's points, down to the table.

    Args:
        points: [N, 3], world, m; what one camera saw, or several.
        taken: Names that other obstacles have.
    """
    names = (name for k in count(1) if (name := f"seen_{k}") not in taken)
    obstacles: list[Obstacle] = []
    if not len(points):
        return ()
    label, counts = clusters(points, WORKSPACE.gap)
    for k in np.flatnonzero(counts >= WORKSPACE.fewest):  # fewer are noise
        cluster = points[label == k]
        foot = cluster * [1.0, 1.0, 0.0]
        try:
            hull = trimesh.convex.convex_hull(np.concatenate([cluster, foot]))
        except QhullError:  # a sheet on edge, seen as a line
            continue
        faces = np.asarray(hull.faces, dtype=np.int32)
        obstacles.append(
            Obstacle(
                next(names), "mesh", (), np.eye(4), np.asarray(hull.vertices, dtype=float), faces
            )
        )
    return tuple(obstacles)


def _require_same(points: Array, first: tuple[Array, Array], name: str) -> None:
    """A neighbour that stands before the object is not the object.

    Args:
        points: [N, 3], what this camera takes for the object, world, m.
        first: What the first camera saw of the object, [M, 3], and of other things, [K, 3].
        name: Of the cloud.

    Raises:
        NoObjectError: It is another thing.
    """
    to_object, to_others = (
        float(cKDTree(seen).query(points)[0].min()) if len(seen) else np.inf for seen in first
    )
    if to_object > min(SAME_THING, to_others):
        raise NoObjectError(
            f"what is nearest to the object is {to_object:.2f} m away from it", where=name
        )


def _segment(
    world: Array, name: str, target: Array | None, workspace: SegmentationConfig
) -> Segmentation:
    try:
        found = segment_object(world, workspace, target)
    except InputError as error:
        raise NoObjectError(
            error.what, where=name, allowed=error.allowed, hint=f"{error.hint}, or --workspace"
        ) from error
    if target is not None:
        away = float(np.linalg.norm(world[found.kept] - target, axis=1).min())
        if away > TARGET_REACH:
            raise NoObjectError(
                f"the object nearest to --target is {away:.2f} m away from it",
                where=name,
                allowed=f"a place within {TARGET_REACH:g} m of an object, world, m",
            )
    return found
