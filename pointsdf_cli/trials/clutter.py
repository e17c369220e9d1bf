"""Clutter in trials: placement of other objects around the target, and their disturbance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import strictly_inside
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.geometry.stable_poses import STANDING
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.io.trials import TrialRow
from pointsdf_cli.planning.object_choice import NoObjectError, TargetChoice
from pointsdf_cli.planning.table_top import TableTop, label_table, look_at_table
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.observe import Observer
from pointsdf_cli.simulation.settle import placed
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.protocol import Trial, TrialObject
from pointsdf_cli.trials.scenes import at_rest, random_poses

Standing = tuple[SimObject, Array]
"""An object and its T_world_object [4, 4]."""

PLACE_TRIES = 2000
OUTLINE_STEP = 0.004
"""Spacing of the points at which outlines are compared [m]."""


GAP = (0.03, 0.12)
"""Range of the horizontal distance between the outlines of target and neighbour [m]; two neighbours
keep the lower bound."""
LOW, HIGH = (0.32, -0.5), (1.0, 0.5)
"""Corners of their region on the table [m]."""
MOVED = 0.02
"""Largest allowed displacement of a centre of mass [m]."""
TILTED = float(np.pi / 4)
"""Largest allowed tilt [rad]."""


class Disturbance(NamedTuple):
    """Movement of the other objects.

    Attributes:
        disturbed: Whether one moved or tilted by more than is allowed.
        largest_move: Largest displacement of a centre of mass [m].
    """

    disturbed: bool
    largest_move: float


def place_neighbours(
    world: World, target: Standing, trial: Trial, load: Callable[[TrialObject], SimObject]
) -> list[Standing]:
    """The neighbours of a trial, at rest: the same for all views and variants of a scene.

    Raises:
        InputError: One cannot be used, never rests, or finds no free place.
    """
    if not trial.others:
        return []
    rng = trial.rng("clutter")
    outlines = [along(level_corners(*target))]
    found: list[Standing] = []
    for other in trial.others:
        item = load(other)
        item, resting = at_rest(world, item, other.name, random_poses(item, STANDING, rng))
        corners = level_corners(item, resting)
        reach = GAP[1] + float(np.linalg.norm(np.ptp(corners, axis=0))) / 2
        low = np.maximum(LOW, outlines[0].min(axis=0) - reach)
        high = np.minimum(HIGH, outlines[0].max(axis=0) + reach)
        for _ in range(PLACE_TRIES):
            yaw, place = float(rng.uniform(0, 2 * np.pi)), rng.uniform(low, high)
            mine = along(turned(corners, yaw, place))
            to_target, *to_others = (level_gap(mine, there) for there in outlines)
            near = GAP[0] <= to_target <= GAP[1]
            if near and min(to_others, default=np.inf) >= GAP[0]:
                found.append((item, placed(resting, item, yaw, place)))
                outlines.append(mine)
                break
        else:
            raise InputError(
                "no free place beside the target", where=other.name, hint="lower --clutter"
            )
    return found


def level_corners(item: SimObject, T_world_object: Array) -> Array:
    """Corners [C, 2] of the convex outline of an object seen from above, in order, m."""
    level = apply_transform(T_world_object, item.mesh.vertices)[:, :2]
    return level[ConvexHull(level).vertices]


def turned(corners: Array, yaw: float, place: Array) -> Array:
    """Corners [C, 2] rotated about the vertical, with the centre of their box at `place` [2], as in
    `placed`."""
    c, s = np.cos(yaw), np.sin(yaw)
    level = corners @ np.array([[c, s], [-s, c]])
    return level + place - (level.min(axis=0) + level.max(axis=0)) / 2


def along(corners: Array) -> Array:
    """Points [N, 2], `OUTLINE_STEP` apart, along the polygon of corners [C, 2]."""
    sides = np.roll(corners, -1, axis=0) - corners
    parts = []
    for corner, side in zip(corners, sides, strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(side) / OUTLINE_STEP)))
        parts.append(corner + np.arange(count)[:, None] / count * side)
    return np.concatenate(parts)


def level_gap(one: Array, other: Array) -> float:
    """Distance [m] between two outlines [N, 2] and [M, 2]; 0 if they overlap."""
    for inner, outer in ((one, other), (other, one)):
        sides = ConvexHull(outer).equations
        if (inner @ sides[:, :2].T + sides[:, 2] <= 0).all(axis=1).any():
            return 0.0
    return float(cKDTree(one).query(other)[0].min())


def look(
    observer: Observer,
    robot: RobotDescription,
    standing: Sequence[Standing],
    T_world_camera: Array,
    rng: np.random.Generator,
    cleaned: bool = True,
) -> tuple[View, TableTop | None]:
    """View of the target, empty if it is not seen, and the table top around it.

    The scene is segmented as by `rgrasp plan`. If the target is the only object, no number is given
    to the segmentation, which must find it.

    Args:
        observer: The camera.
        robot: The robot, at home.
        standing: The true objects, the target first.
        T_world_camera: [4, 4].
        rng: Random generator of the sensor's errors.
        cleaned: Drop flying pixels, outliers and specks.
    """
    nothing = View(np.zeros((0, 3)), T_world_camera)
    try:
        depth = observer.depth(standing, T_world_camera, rng)
        cloud = cloud_of_depth(depth, observer.placement.camera, T_world_camera)
        wanted = None
        if len(standing) > 1:
            number = target_number(cloud, standing, robot, cleaned)
            if number is None:
                return nothing, None
            wanted = TargetChoice(number=number)
        seen = look_at_table(
            [cloud], ["the view"], robot, robot.home, target=wanted, cleaned=cleaned
        )
    except (InputError, NoObjectError):
        return nothing, None
    return seen.views[0], seen


def target_number(
    cloud: Cloud, standing: Sequence[Standing], robot: RobotDescription, cleaned: bool = True
) -> int | None:
    """The target's number in the list of `rgrasp segment`; None if it is not seen.

    It is the listed object with most of the points nearest to the true target.

    Args:
        cloud: The camera's cloud.
        standing: The true objects, the target first.
        robot: The robot, at home.
        cleaned: Drop flying pixels, outliers and specks, as in the view that the number is for.
    """
    scene = label_table(cloud, "the view", robot, robot.home, cleaned=cleaned)
    label = scene.objects.label
    objects = label >= 0
    if not objects.any():
        return None
    points = scene.world[objects]
    away = np.stack([_away(points, one) for one in standing])
    mine = label[objects][(away.argmin(axis=0) == 0) & np.isfinite(away[0])]
    if not len(mine):
        return None
    chosen = int(np.bincount(mine).argmax())
    return next((one.number for one in scene.listed if one.label == chosen), None)


def _away(points: Array, standing: Standing) -> Array:
    """Distances [N] m of points to an object's surface; inf far from its box."""
    item, pose = standing
    vertices = apply_transform(pose, item.mesh.vertices)
    away = np.full(len(points), np.inf)
    low, high = vertices.min(axis=0) - 0.05, vertices.max(axis=0) + 0.05
    near = strictly_inside(points, low, high)
    if near.any():
        distance = SignedDistance(vertices, item.mesh.faces, threads=1)(points[near])
        away[near] = np.abs(distance)
    return away


def disturbance(before: Sequence[Standing], after: Sequence[Array]) -> Disturbance:
    """Measure the movement of the neighbours.

    Args:
        before: The neighbours as placed.
        after: T_world_object [4, 4] of each at the end.
    """
    moves, tilts = [0.0], [0.0]
    for (item, was), now in zip(before, after, strict=True):
        centre = item.T_mesh_body[:3, 3]
        shift = apply_transform(now, centre[None]) - apply_transform(was, centre[None])
        moves.append(float(np.linalg.norm(shift)))
        tilts.append(float(np.arccos(np.clip(was[2, :3] @ now[2, :3], -1.0, 1.0))))
    largest = max(moves)
    return Disturbance(largest > MOVED or max(tilts) > TILTED, largest)


def with_others(row: TrialRow, before: Sequence[Standing], after: Sequence[Array]) -> TrialRow:
    """A trial's row with the movement of the other objects; `after` is empty without an
    execution."""
    row = replace(row, clutter=len(before))
    if not after:
        return row
    found = disturbance(before, after)
    return replace(row, disturbed=found.disturbed, largest_move=found.largest_move)
