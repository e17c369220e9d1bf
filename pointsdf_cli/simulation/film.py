"""Recording of an attempt as a list of moments, to draw or to play."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.simulation.world import World


@dataclass(frozen=True)
class Moment:
    """The scene at one time.

    Attributes:
        phase: "approach", "close", "grip", "lift", "settle", "shake", "hold", or a push
            ("push +x").
        time: Time since the world was built [s]; in a trial this includes the approach.
        q: [J], configuration of the robot.
        T_world_object: [4, 4].
        T_world_others: [N, 4, 4], poses of the other objects.
    """

    phase: str
    time: float
    q: NDArray[np.float64]
    T_world_object: NDArray[np.float64]
    T_world_others: NDArray[np.float64]


def moment_of(world: World, phase: str) -> Moment:
    """Record the present scene."""
    others = np.array([other.pose() for other in world.others]).reshape(-1, 4, 4)
    return Moment(phase, world.time, world.configuration(), world.object.pose(), others)


@dataclass
class Recorder:
    """Recorder for an executor's `watch`; keeps `rate` moments a second of simulated time."""

    rate: float = 20.0
    moments: list[Moment] = field(default_factory=list)

    def __call__(self, world: World, phase: str) -> None:
        """Record this step if one is due."""
        last = self.moments[-1] if self.moments else None
        if last is not None and last.phase == phase and world.time - last.time < 1 / self.rate:
            return
        self.moments.append(moment_of(world, phase))
