"""Simulation of an object until it rests on the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.geometry.stable_poses import StablePose
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.world import World


@dataclass(frozen=True)
class SettleConfig:
    """Criteria of rest.

    Attributes:
        drop: Height above the table from which the object is released [m].
        longest: Time limit [s].
        speed: Largest speed of an object at rest [m/s].
        turn_speed: Its largest angular speed [rad/s].
        rest_time: Time below both speeds until it counts as at rest [s].
    """

    drop: float = 0.002
    longest: float = 4.0
    speed: float = 0.004
    turn_speed: float = 0.05
    rest_time: float = 0.25


def settle(
    world: World, item: SimObject, pose: StablePose, config: SettleConfig
) -> NDArray[np.float64] | None:
    """Pose T_table_object [4, 4] in which an object comes to rest, even if it topples first; None
    if it does not."""
    place = transform(np.eye(3), [0.5, 0.0, config.drop])
    world.reset(item, place @ pose.T_table_object, robot="none")
    check = max(1, round(0.05 / world.physics.step))
    quiet = 0.0
    while world.time < config.longest:
        world.step(check)
        speed, turning = world.object_speed()
        still = speed < config.speed and turning < config.turn_speed
        quiet = quiet + check * world.physics.step if still else 0.0
        if quiet >= config.rest_time and world.object_on_table():
            return world.object_pose()
    return None
