"""Resting places of objects on the table: settled by simulation, turned and put in place."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.geometry.stable_poses import StablePose
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.world import World

DROP = 0.002
"""Height above the table from which the object is released [m]."""
LONGEST = 4.0
"""Time limit [s]."""
SPEED = 0.004
"""Largest speed of an object at rest [m/s]."""
TURN_SPEED = 0.05
"""Its largest angular speed [rad/s]."""
REST_TIME = 0.25
"""Time below both speeds until it counts as at rest [s]."""
NEAR = 0.02
"""Points farther from an object's box than this [m] are of something else."""


def settle(world: World, item: SimObject, pose: StablePose) -> Array | None:
    """Pose T_table_object [4, 4] in which an object comes to rest, even if it topples first; None
    if it does not."""
    place = transform(np.eye(3), [0.5, 0.0, DROP])
    world.reset(item, place @ pose.T_table_object, robot="none")
    check = max(1, round(0.05 / world.physics.step))
    quiet = 0.0
    while world.time < LONGEST:
        world.step(check)
        speed, turning = world.object.speed()
        still = speed < SPEED and turning < TURN_SPEED
        quiet = quiet + check * world.physics.step if still else 0.0
        if quiet >= REST_TIME and world.object_on_table():
            return world.object.pose()
    return None


def placed(resting: Array, item: SimObject, yaw: float, place: Array) -> Array:
    """A settled pose turned about the vertical, the middle of its outline at `place` [2]."""
    c, s = np.cos(yaw), np.sin(yaw)
    turned = transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], [0, 0, 0]) @ resting
    outline = apply_transform(turned, item.mesh.vertices)[:, :2]
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    turned[:2, 3] += place - middle
    return turned


def shows(item: SimObject, T_world_object: Array, points: Array) -> bool:
    """Whether most of the points [N, 3], world, lie on the object: segmentation may confuse a low
    object with a bump of the table."""
    local = apply_transform(invert_transform(T_world_object), points)
    low, high = item.mesh.vertices.min(axis=0) - NEAR, item.mesh.vertices.max(axis=0) + NEAR
    return bool(np.median(((local > low) & (local < high)).all(axis=1)) == 1)
