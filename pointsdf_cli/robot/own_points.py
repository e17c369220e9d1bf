"""Removal of the robot's own points from a cloud, by its known configuration."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.box import strictly_inside
from pointsdf_cli.robot.description import RobotDescription

if TYPE_CHECKING:
    import torch

    from pointsdf_cli.robot.kinematics import Kinematics

ROBOT_MARGIN = 0.03
"""Distance [m] from the robot's surface within which points are its own."""


def robot_points(robot: RobotDescription, q: Array) -> Array:
    """Samples [N, 3] of the robot's surface at a configuration [J], 1 cm apart, world, m."""
    kinematics, surface = _surface_of(robot)
    return np.concatenate(kinematics.points(q, surface))


@functools.lru_cache(maxsize=8)
def _surface_of(robot: RobotDescription) -> tuple[Kinematics, list[tuple[str, torch.Tensor]]]:
    """Kinematics of a robot, and surface samples [P, 3] of its links in their frames, m."""
    import torch

    from pointsdf_cli.robot.kinematics import Kinematics
    from pointsdf_cli.robot.surface import robot_surface

    surface = [(link, torch.tensor(points)) for link, points in robot_surface(robot).items()]
    return Kinematics(robot), surface


def off_robot(points: Array, own: Array) -> Mask:
    """Mask of the points [N, 3] of a cloud that are not the robot's, given its samples [P, 3];
    world frame.

    True for points that are not finite.
    """
    off = np.ones(len(points), dtype=bool)
    low, high = own.min(axis=0) - ROBOT_MARGIN, own.max(axis=0) + ROBOT_MARGIN
    near = np.flatnonzero(strictly_inside(points, low, high))
    tree = scipy.spatial.KDTree(own)
    off[near] = tree.query(points[near], distance_upper_bound=ROBOT_MARGIN)[0] == np.inf
    return off
