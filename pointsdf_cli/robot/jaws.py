"""Jaws: what a hand that pinches along its palm's z can hold, read off its description.

Fingers that come together along z from both sides hold only what is narrower than the gap between
them, and only where their pads are. Hands that close otherwise, towards the palm, have no jaws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.closing import closing_of, fingertips
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

ALONG = 0.9
"""Fingertips whose way has at least this share along z close as jaws."""
SPACE = 0.003
"""Gap between each open jaw and the object [m]."""
PAD_DEPTH = 0.003
"""Surface [m] behind a fingertip's innermost point that still counts as its pad."""


@dataclass(frozen=True)
class Jaws:
    """The space between open jaws, palm frame.

    Attributes:
        opening: Width of what fits between them, along z [m].
        pads: [2], where their pads begin and end in front of the palm, along x [m].
        home_z: [3], direction of the palm's z at home, world: of two equivalent grasps with
            opposite z, the one nearer to it is used.
        preshape: [K], preshape joints of the open jaws.
    """

    opening: float
    pads: tuple[float, float]
    home_z: Array
    preshape: Array

    @property
    def room(self) -> float:
        """Width of what fits with a little space at each jaw [m]."""
        return self.opening - 2 * SPACE

    @property
    def middle(self) -> float:
        """Distance from the palm to the middle of the pads [m]."""
        return sum(self.pads) / 2


def jaws_of(robot: RobotDescription) -> Jaws | None:
    """The jaws of a robot's hand, opened as wide as its preshapes allow; None where it has none."""
    closing = closing_of(robot)
    ways = closing.paths[-1] - closing.paths[0]
    lengths = np.linalg.norm(ways, axis=1)
    if len(ways) < 2 or (lengths < 1e-3).any():
        return None
    along = ways[:, 2] / lengths
    if not ((np.abs(along) >= ALONG).all() and along.min() < 0 < along.max()):
        return None
    low, high, pads = -np.inf, np.inf, []
    preshape = _open_preshape(robot)
    for points, way in zip(_tips_at(robot, preshape), along, strict=True):
        ahead = points[:, 2] * np.sign(way)
        pads.append(points[ahead > ahead.max() - PAD_DEPTH, 0])
        if way > 0:
            low = max(low, float(ahead.max()))
        else:
            high = min(high, -float(ahead.max()))
    begin, end = max(float(x.min()) for x in pads), min(float(x.max()) for x in pads)
    home_z = ArmChain(robot).palm(robot.home)[:3, 2].copy()
    return Jaws(high - low, (begin, end), home_z, preshape)


def _open_preshape(robot: RobotDescription) -> Array:
    """Preshape joints [K] with the jaws as far apart as preshapes have them."""
    speeds = dict(zip(robot.closing_joints, robot.closing_speeds, strict=True))
    upwards = np.array([speeds.get(name, 0.0) > 0 for name in robot.preshape_joints])
    return np.where(upwards, robot.preshape_ranges[:, 0], robot.preshape_ranges[:, 1])


def _tips_at(robot: RobotDescription, preshape: Array) -> list[Array]:
    """Surface points [P, 3] of each fingertip in the palm frame."""
    q = robot.configuration(robot.home[robot.arm], preshape)
    surface, kinematics = robot_surface(robot), Kinematics(robot)
    tips = [(tip, surface[tip]) for tip in fingertips(robot)]
    world = [points.numpy() for points in kinematics.points(q, tips)]
    palm = ArmChain(robot).palm(q)
    return [(points - palm[:3, 3]) @ palm[:3, :3] for points in world]
