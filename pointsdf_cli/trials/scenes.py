"""Pose of the object on the table, and of the two cameras.

The camera stands opposite the robot and looks at it, so the hand comes from the unseen side.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, transform
from pointsdf_cli.geometry.stable_poses import FIRM, StablePose, draw_pose
from pointsdf_cli.io.meshes import LoadedMesh, load_mesh
from pointsdf_cli.objects.stand_ins import make_stand_in
from pointsdf_cli.simulation.feet import on_its_foot
from pointsdf_cli.simulation.settle import placed, settle
from pointsdf_cli.simulation.sim_object import SimObject, prepare_object
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.protocol import CAMERAS, Trial, TrialObject
from pointsdf_cli.viz.shading import look_at

POSE_TRIES = 12
NEARLY_UPRIGHT = 0.09
"""Largest tilt [rad] of the model's z axis in an upright resting pose."""
PLACE = (0.60, 0.0)
"""Mean position of the object [m]."""
PLACE_SPREAD = 0.02
"""Standard deviation of its horizontal position [m]."""
CAMERA_DISTANCE = 0.95
"""Horizontal distance from the object to the camera [m]."""
AZIMUTH = 0.35
"""Largest angle of the camera from opposite the robot [rad]."""
LOOK_HEIGHT = 0.08
"""Height above the table of the point that it looks at [m]."""
LOWEST = 0.03
"""Height below which an upright object is laid on its side [m]."""
TARGET_STANDING = 1.0
"""Probability of a standing pose of the target, which always stands if it can; neighbours lie more
often (`clutter.py`)."""


def load_object(item: TrialObject) -> SimObject:
    """Load and prepare an object.

    Raises:
        InputError: Its mesh cannot be used.
    """
    return prepare_object(object_mesh(item), fine=True)


def object_mesh(item: TrialObject) -> LoadedMesh:
    """The object's mesh, or that of its stand-in.

    Raises:
        InputError: Its mesh cannot be used.
    """
    if item.mesh is not None:
        return load_mesh(item.mesh, item.unit)
    vertices, faces = make_stand_in(item.name)
    total = hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest()
    sha = f"stand-in {item.name} {total}"
    return LoadedMesh(item.name, vertices.astype(np.float64), faces, sha, "none")


def place_object(world: World, item: SimObject, trial: Trial) -> tuple[SimObject, Array, float]:
    """Place the object of a trial: the object with a foot, T_world_object [4, 4] and yaw [rad];
    equal for all views and variants.

    Yaws of one repeat are evenly spaced from a random offset.

    Raises:
        InputError: The object never comes to rest.
    """
    rng = trial.rng("pose")
    if trial.object.upright:
        poses: Iterable[StablePose] = [upright_pose(item)]
    else:
        poses = random_poses(item, TARGET_STANDING, rng)
    standing, resting = at_rest(world, item, trial.object.name, poses)
    yaw = float(rng.uniform(0, 2 * np.pi)) + 2 * np.pi * trial.yaw_index / trial.yaws
    yaw = float(np.mod(yaw, 2 * np.pi))
    shift = PLACE_SPREAD * trial.rng("scene").standard_normal(2)
    return standing, placed(resting, item, yaw, np.asarray(PLACE) + shift), yaw


def random_poses(
    item: SimObject, standing: float, rng: np.random.Generator
) -> Iterator[StablePose]:
    """`POSE_TRIES` random resting poses of an object, standing with the given probability."""
    for _ in range(POSE_TRIES):
        yield item.poses[draw_pose(item.poses, standing, rng)[0]]


def at_rest(
    world: World, item: SimObject, name: str, poses: Iterable[StablePose]
) -> tuple[SimObject, Array]:
    """The object with a foot, and T_table_object [4, 4], in the first of the poses in which it
    comes to rest.

    Raises:
        InputError: It never comes to rest.
    """
    for pose in poses:
        standing = on_its_foot(item, pose)
        resting = settle(world, standing, pose)
        if resting is not None:
            return standing, resting
    raise InputError("never comes to rest on a table", where=name)


def upright_pose(item: SimObject) -> StablePose:
    """The firm pose nearest to z up, or the tallest firm one if that is too low for a side
    grasp."""
    firm = [pose for pose in item.poses if pose.margin >= FIRM] or item.poses
    upright = max(firm, key=lambda pose: pose.T_table_object[2, 2])
    if upright.height < LOWEST:
        return max(firm, key=lambda pose: pose.height)
    if upright.T_table_object[2, 2] < np.cos(NEARLY_UPRIGHT):
        return upright
    # Upright on a flat foot: a scan's bottom is not flat, so its resting poses lean.
    middle = item.T_mesh_body[:3, 3]
    lowest = item.mesh.vertices[:, 2].min()
    return replace(upright, T_table_object=transform(np.eye(3), [-middle[0], -middle[1], -lowest]))


def place_camera(item: SimObject, T_world_object: Array, trial: Trial) -> Array:
    """T_world_camera [4, 4]: opposite the robot, at the camera's height."""
    azimuth = float(trial.rng("scene").uniform(-AZIMUTH, AZIMUTH))
    outline = apply_transform(T_world_object, item.mesh.vertices)[:, :2]
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    toward = np.array([np.cos(azimuth), np.sin(azimuth)])
    eye = np.array([*(middle + CAMERA_DISTANCE * toward), CAMERAS[trial.camera]])
    return look_at(eye, np.array([*middle, LOOK_HEIGHT]))
