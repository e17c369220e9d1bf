"""Plausibility of a scene, checked before any grasp is searched.

A wrong camera pose, option or cloud gives an impossible scene: a camera that looks up through the
table, an object in the air. The planner would plan for it without complaint.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from pointsdf_cli.camera.segmentation import clusters, find_table
from pointsdf_cli.camera.support_plane import largest_plane
from pointsdf_cli.camera.table_objects import OUTSIDE
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.planning.labelled_view import LabelledView
from pointsdf_cli.planning.object_choice import Reach

ABOVE = 0.08
"""Height [m] above the table from which an object's lowest seen point suggests that it floats."""
BELOW = 0.01
"""Depth [m] below the table from which a camera is taken to look up through it."""
STEEP = np.deg2rad(60)
"""Steepest view at which the foot of an object should be seen."""
APART = 0.05
"""Gap [m] between observed points that never splits an object; twice this always does."""
PART, FEWEST = 0.1, 50
"""Smallest share of a cloud's points, and smallest number, that count as a part."""
ROUND = 0.03
"""Largest typical distance of points from a fitted sphere, as a share of its radius."""
STEEPEST_TABLE, TILTED = np.deg2rad(20), np.deg2rad(3.5)
"""Largest tilt at which a plane near z = 0 counts as a table, and above which the pose is wrong."""
OFF = 0.04
"""Largest distance [m] of the table from z = 0: calibrations by hand err by less."""
UNEVEN = 0.005
"""Distance [m] of the table from z = 0 above which a warning is given."""
MUCH, MOST_BELOW = 0.1, 0.5
"""Share of the points below the table above which the pose is doubted, and is wrong."""
SLOPE_POINTS, SLOPE_SHARE, SLOPE_REACH = 1000, 0.3, 0.1
"""Fewest points of a view whose slope is judged; least share of them on a plane; and its least
extent [m] across, as a standard deviation."""
WALL, AT_WALL = np.deg2rad(80), 0.01
"""Steepest tilt at which a plane is no wall, and share of the points near z = 0 from which a wall
stands behind a scene."""
THROUGH, MUCH_THROUGH = 0.03, 0.15
"""Distance [m] behind a point to which a camera must see for its ray to have missed the object, and
share of such points above which the views disagree."""
OTHER_TABLE = 0.6
"""Height [m] around z = 0 within which a table is searched if none is seen at z = 0."""
HANGING = (0.05, 1.0)
"""Heights [m] at which something outside the workspace could be in the arm's way."""
BASE = 0.2
"""Level distance [m] from the robot's base up to which points are taken for its own."""
MANY = 100
"""Number of thinned points outside the workspace from which they are something."""


def require_table_at_zero(
    worlds: Sequence[Array],
    names: Sequence[str],
    without_table: str = "--environment with `table: false`",
) -> None:
    """Refuse views of a table that is far from z = 0.

    Args:
        worlds: Points [N, 3] of each view in the world, m.
        names: Names of the views, for messages.
        without_table: Advice for scenes without a table.

    Raises:
        InputError: A view shows a table that is tilted or at another height, or almost all of it
            lies below z = 0.
    """
    for world, name in zip(worlds, names, strict=True):
        wrong = _wrong_table(world)
        if wrong:
            raise InputError(
                f"{wrong}: the camera's pose, its intrinsics or the depth scale is wrong",
                where=name,
                allowed="a level table at z = 0",
                hint="check --frame, --depth-scale, --intrinsics, then --camera-pose; if only the "
                f"pose is unknown: --camera-pose table. If there is no table: {without_table}",
            )


def _wrong_table(world: Array) -> str:
    """Reason why points [N, 3] of a view do not show a level table at z = 0; empty if they may."""
    few = world[:: max(1, len(world) // 20_000)]
    plane = find_table(few, tilt=STEEPEST_TABLE)
    if plane is None:
        height = table_elsewhere(world)
        if height is not None:
            return f"a table is seen at z = {1000 * height:.0f} mm"
        slope = _slope(few)
        if slope is not None:
            return f"a large plane is seen tilted by {np.rad2deg(slope):.0f}°, and no level table"
        below = float((few[:, 2] < -BELOW).mean())
        return f"{below:.0%} of the points lie below z = 0" if below > MOST_BELOW else ""
    tilt = float(np.arccos(min(plane[2], 1.0)))
    if tilt > TILTED:
        return f"the table is seen tilted by {np.rad2deg(tilt):.0f}°"
    middle = np.median(few[np.abs(few @ plane[:3] - plane[3]) < BELOW], axis=0)
    return f"a table is seen at z = {1000 * middle[2]:.0f} mm" if abs(middle[2]) > OFF else ""


def _slope(world: Array) -> float | None:
    """Tilt [rad] of the plane that most of the points [N, 3] of a view lie on; None if it is level,
    too small for a table, or a wall behind what stands on z = 0."""
    if len(world) < SLOPE_POINTS:
        return None
    plane, on_plane = largest_plane(world)
    tilt = float(np.arccos(min(abs(plane[2]), 1.0)))
    reach = np.sqrt(np.linalg.eigvalsh(np.cov(world[on_plane].T))[1])
    if on_plane.mean() < SLOPE_SHARE or reach < SLOPE_REACH or tilt < STEEPEST_TABLE:
        return None
    at_zero = float((np.abs(world[:, 2]) < OFF).mean())
    return None if tilt > WALL and at_zero > AT_WALL else tilt


def table_warning(height: float | None, worlds: Sequence[Array]) -> str:
    """Warning that the camera's pose may be wrong; empty if the table is where it should be.

    Args:
        height: Height of the observed table [m]; None without one.
        worlds: Points [N, 3] of each view in the world, m.
    """
    if height is not None and abs(height) > UNEVEN:
        return (
            f"the table is seen at z = {height * 1000:.0f} mm, not 0: it is uneven, or the "
            "camera's pose is wrong" + ("; the robot keeps above it" if height > 0 else "")
        )
    if height is not None:
        return ""
    heights = np.concatenate(worlds)[:, 2]
    below = float((heights < -BELOW).mean())
    if below > MUCH:
        return (
            f"no table is seen at z = 0, and {below:.0%} of the points lie below it: check the "
            "camera's pose"
        )
    nothing = not (np.abs(heights) < BELOW).any()
    return "nothing is seen at z = 0, the table: check the camera's pose" if nothing else ""


def table_elsewhere(world: Array) -> float | None:
    """Height [m] of a table seen away from z = 0; None without one, or if one is near z = 0."""
    world = world[:: max(1, len(world) // 20_000)]
    near = np.abs(world[:, 2]) < OTHER_TABLE
    if not near.any() or find_table(world) is not None:
        return None
    counts, edges = np.histogram(world[near, 2], np.arange(-OTHER_TABLE, OTHER_TABLE, 0.01))
    for k in np.argsort(-counts)[:5]:
        middle = (edges[k] + edges[k + 1]) / 2
        # Most points near a table lie on it; of those near an object's side, few lie in a level
        # plane.
        plane = find_table(world - [0, 0, middle], share=0.6)
        if plane is not None and not _is_top_of_a_body(world, float(middle + plane[3])):
            return float(middle + plane[3])
    return None


def _is_top_of_a_body(world: Array, height: float) -> bool:
    """Whether sides are seen right below a level plane: below a table nothing is seen."""
    above = world[:, 2] - height
    level = world[np.abs(above) < 0.01]
    if not len(level):
        return True
    low, high = level[:, :2].min(axis=0) - 0.02, level[:, :2].max(axis=0) + 0.02
    beneath = (above < -0.03) & ((world[:, :2] > low) & (world[:, :2] < high)).all(axis=1)
    return bool(beneath.sum() > 0.1 * len(level))


def outside_workspace(labelled: Sequence[LabelledView], reach: Reach) -> str:
    """Warning that something was seen within the arm's reach but outside the workspace, where
    nothing becomes an obstacle; empty if not.

    Args:
        labelled: Each camera's view.
        reach: The robot's reach.
    """
    # In a pose made from the table it is not known where the robot will stand.
    views = [view for view in labelled if not view.cloud.over_table]
    worlds = [view.world[view.objects.label == OUTSIDE] for view in views]
    points = np.concatenate([*worlds, np.zeros((0, 3))])
    level = np.linalg.norm(points[:, :2] - reach.base, axis=1)
    near = (level > BASE) & (level < reach.far)
    near &= (points[:, 2] > HANGING[0]) & (points[:, 2] < HANGING[1])
    if near.sum() < MANY:
        return ""
    x, y, z = np.median(points[near], axis=0)
    return (
        f"something around {x:.2f},{y:.2f},{z:.2f} m is within the arm's reach but outside the "
        "workspace, so it is no obstacle: name it with --environment, or widen --workspace"
    )


def scene_warnings(views: Sequence[View], table: float | None = 0.0) -> list[str]:
    """Warnings about implausible views of one object.

    Args:
        views: The object as each camera saw it.
        table: Height of its table [m]; None without one.
    """
    said = []
    world = np.concatenate([view.in_world for view in views])
    if table is not None:
        said += [below_table(view, table) for view in views]
        said.append(in_the_air(views, table))
    said += [from_inside(view) for view in views]
    said.append(in_parts(world))
    said.append(seen_through(views))
    return list(dict.fromkeys(sentence for sentence in said if sentence))


def below_table(view: View, table: float) -> str:
    """Warning that the camera stands below the table; empty if it does not."""
    height = float(view.T_world_camera[2, 3]) - table
    if height > -BELOW:
        return ""
    return (
        f"the camera stands {-100 * height:.0f} cm below the table and looks up through it: check "
        "its pose (--camera-pose is the camera in the world, not the world in the camera)"
    )


def in_the_air(views: Sequence[View], table: float) -> str:
    """Warning that nothing is seen between the object and the table; else empty."""
    world = np.concatenate([view.in_world for view in views])
    gap = float(np.percentile(world[:, 2], 1)) - table
    centre = world.mean(axis=0)
    ways = [view.T_world_camera[:3, 3] - centre for view in views]
    level = [way for way in ways if np.arctan2(way[2], np.linalg.norm(way[:2])) < STEEP]
    if gap < ABOVE or not level:
        return ""
    return (
        f"the object's lowest seen point is {100 * gap:.0f} cm above the table: does it float, "
        "does something hide its foot, or is the camera's pose wrong?"
    )


def from_inside(view: View) -> str:
    """Warning that the camera sees the inside of a round object, or stands in it; else empty."""
    points = view.points
    centre = points.mean(axis=0)
    if np.linalg.norm(centre) < np.ptp(points, axis=0).max() / 2:
        return "the camera stands within the object: check the cloud's frame and the camera's pose"
    ball = _fit_sphere(points)
    if ball is None:
        return ""
    middle, radius = ball
    cap = ((points - middle) / radius).mean(axis=0)
    # Near 1 for a flat patch, half for a hemisphere; a bowl that stands is open upward.
    size = float(np.linalg.norm(cap))
    opens_up = float(-cap @ view.T_world_camera[2, :3]) / max(size, 1e-9)
    if size > 0.8 or cap @ centre < 0 or opens_up > 0.5:
        return ""
    return (
        "the seen points bulge away from the camera: this is the inside of something hollow that "
        "lies on its side, or the cloud or its pose is wrong"
    )


def seen_through(views: Sequence[View]) -> str:
    """Warning that one camera saw past the place where another saw the object; else empty."""
    worst = 0.0
    for one, other in permutations(views, 2):
        image = None if one.evidence is None else one.evidence.visibility
        if image is None:
            continue
        points = apply_transform(invert_transform(one.T_world_camera), other.in_world)
        points = points[points[:, 2] > 0]
        left, top, width, height = image.window
        place = (points[:, :2] / points[:, 2:] - (left, top)) / (width, height)
        cell = np.floor(place * len(image.seen)).astype(np.int64)
        inside = ((cell >= 0) & (cell < len(image.seen))).all(axis=1)
        if inside.any():
            column, row = cell[inside].T
            free = image.free[row, column] > points[inside, 2] + THROUGH
            past = free & ~image.seen[row, column]
            worst = max(worst, float(past.sum()) / len(other.in_world))
    if worst < MUCH_THROUGH:
        return ""
    return (
        f"{worst:.0%} of the points that one camera sees on the object lie where another saw past "
        "it: is a pose wrong, are the poses in the order of the images, has the object moved?"
    )


def in_parts(world: Array) -> str:
    """Warning that the points of one object are in separate places; else empty."""
    label, counts = clusters(world, APART)
    large = np.flatnonzero(counts >= max(FEWEST, PART * len(world)))
    if len(large) < 2:
        return ""
    centres = np.stack([world[label == k].mean(axis=0) for k in large])
    away = max(float(np.linalg.norm(a - b)) for a in centres for b in centres)
    return (
        f"the object's points lie in {len(large)} parts up to {100 * away:.0f} cm apart: with "
        "--segment none they are taken for one object; --segment auto takes one of them"
    )


def _fit_sphere(points: Array) -> tuple[Array, float] | None:
    """Centre and radius of a sphere through the points; None if none fits."""
    origin = points.mean(axis=0)
    away = points - origin
    system = np.column_stack([2 * away, np.ones(len(away))])
    solution, _, rank, _ = np.linalg.lstsq(system, (away**2).sum(axis=1), rcond=None)
    squared = solution[3] + solution[:3] @ solution[:3]
    if rank < 4 or squared <= 0:
        return None
    radius = float(np.sqrt(squared))
    off = np.abs(np.linalg.norm(away - solution[:3], axis=1) - radius)
    if radius > 0.5 or float(np.percentile(off, 90)) > ROUND * radius:
        return None
    return origin + solution[:3], radius
