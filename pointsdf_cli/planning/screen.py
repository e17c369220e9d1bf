"""Screening of sampled grasps by the hand alone, before any inverse kinematics.

Sampling from the prior is cheap; inverse kinematics and solving are not. So many grasps are
sampled, those with the open hand in the table are raised above it, and those with the best score
and the least penetration of the object are passed on.
"""

from __future__ import annotations

import numpy as np
import torch

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import horizontal_width
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.frames import invert_transform
from pointsdf_cli.robot.jaws import jaws_of
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

SPACING = 0.015
"""Spacing of the hand's samples [m]: coarse, as this only ranks."""


class HandOutline:
    """The hand's surface for any preshape.

    Args:
        kinematics: Kinematics of the robot.

    Attributes:
        span: Largest side of the opened hand's bounding box, or the opening of its jaws [m]:
            objects wider than this in every direction cannot be grasped.
        jaws: Its jaws; None where it has none.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        robot = self._robot = kinematics.robot
        self._kinematics = kinematics
        surface = robot_surface(robot, SPACING)
        links = [link for link in robot.hand_links if link in surface]
        self._links = [(link, torch.tensor(surface[link])) for link in links]
        ranges = robot.preshape_ranges
        opened = self(np.stack([ranges[:, 0], ranges.mean(axis=1), ranges[:, 1]]))
        jaws = self.jaws = jaws_of(robot)
        self.span = float(np.ptp(opened, axis=1).max()) if jaws is None else jaws.opening

    def __call__(self, preshape: Array) -> Array:
        """Points [N, P, 3] in the palm's frame, m, of preshapes [N, K]."""
        home = self._robot.home[self._robot.arm]
        arm = np.broadcast_to(home, (len(preshape), len(home)))
        q = self._robot.configuration(arm, preshape)
        points = np.concatenate(self._kinematics.points(q, self._links), axis=1)
        T_palm_world = invert_transform(self._kinematics.palm(q[0]))
        return np.asarray(points @ T_palm_world[:3, :3].T + T_palm_world[:3, 3])


def lifted(outline: Array, palm: Array, gap: float) -> Array:
    """Palms [N, 4, 4], raised until the hand's points [N, P, 3] (palm frame) clear the table.

    Args:
        outline: Outline of each hand.
        palm: T_world_palm of each.
        gap: Distance between hand and table [m].
    """
    raised = palm.copy()
    raised[:, 2, 3] += np.maximum(0.0, gap - lowest(outline, palm))
    return raised


def lowest(outline: Array, palm: Array) -> Array:
    """Height [N] of the lowest of each hand's points [N, P, 3] at its palm [N, 4, 4], m."""
    heights = (outline @ palm[:, 2, :3, None])[..., 0] + palm[:, 2, 3, None]
    return np.asarray(heights.min(axis=1))


def depth_in(field: Field, outline: Array, palm: Array) -> Array:
    """Penetration [N] of each hand [N, P, 3] at its palm into the object [m]; 0 if none."""
    count, points = outline.shape[:2]
    world = outline @ palm[:, :3, :3].transpose(0, 2, 1) + palm[:, None, :3, 3]
    values = field(world.reshape(-1, 3)).reshape(count, points)
    return np.asarray(np.maximum(0.0, -values.min(axis=1)))


def narrowest(points: Array) -> float:
    """Least width [m] of points [N, 3] over all horizontal directions, or their height if that is
    less."""
    return min(horizontal_width(points), float(np.ptp(points[:, 2])))
