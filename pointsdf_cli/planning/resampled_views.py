"""Resampled-view check: a grasp tested against reconstructions from other samples of the cloud.

A network reads 1000 of the points that were seen. Where something unseen may be is a guess, and
another thousand make another guess. A solver that looks for a place for a hand finds the places
where one guess is wrong; it has not seen the others, so they are independent witnesses. (Of 142
grasps of trials four other draws contradict 3 of the 6 with which the hand touched the object too
early, and none of the 136 others: docs/notebook.md, "Other draws".)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.contacts import link_poses
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.robot_geometry import RobotGeometry

LOOKED_AT = 0.01
"""Parts of the robot that are farther than this [m] from an object are not asked about closely."""


def redrawn(view: View, count: int, seed: Sequence[int]) -> View:
    """The view with an independent draw of `count` of its points.

    Systematic samples of one cloud resemble each other: they would agree where the first is wrong.
    """
    rng = np.random.default_rng(seed)
    chosen = rng.permutation(len(view.points))[:count]
    return replace(view, points=view.points[chosen])


class ResampledViewCheck:
    """Asks the other draws.

    Args:
        geometry: Geometry of the robot.
        fields: Fields of the object, world frame, one for each sample.
    """

    def __init__(self, geometry: RobotGeometry, fields: tuple[Field, ...]) -> None:
        self._kinematics = geometry.kinematics
        self._distances = [ObjectDistances(geometry, field, LOOKED_AT) for field in fields]

    def contradicted(self, q: Array, clearance: float) -> NDArray[np.bool_]:
        """Whether any draw has the robot nearer to the object than a clearance [m].

        Args:
            q: [C, J], configurations.
            clearance: Clearance that all of them keep in the sample that they were planned with.

        Returns:
            bool [C].
        """
        poses = link_poses(self._kinematics, q)
        nearest = np.full(len(q), np.inf)
        for distances in self._distances:
            contacts = distances(poses, gradients=False)
            nearest = np.minimum(nearest, contacts.distance.min(axis=1))
        found: NDArray[np.bool_] = nearest < clearance
        return found
