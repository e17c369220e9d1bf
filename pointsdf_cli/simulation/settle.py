"""Simulation of an object until it rests on the table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import transform
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


def settle(world: World, item: SimObject, pose: StablePose) -> NDArray[np.float64] | None:
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
