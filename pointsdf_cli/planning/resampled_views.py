"""Resampled-view check: a grasp tested against reconstructions from other samples of the cloud.

A network reads some of the observed points and guesses the unseen parts; another sample gives
another guess. An optimiser tends to place the hand where its one guess is wrong; reconstructions
that it has not read are independent evidence. (In 142 trials four other samples contradict 3 of the
6 grasps that touched the object early, and none of the 136 others: docs/notebook.md, "Other
draws".)
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

MOST = 0.8
"""Largest share of a cloud's points in a sample: samples of all points would be the same."""
LOOKED_AT = 0.01
"""Distances of the robot to the object are exact up to this [m]."""


def redrawn(view: View, count: int, seed: Sequence[int]) -> View:
    """The view with an independent random sample of at most `count` of its points.

    Systematic samples of one cloud are too alike: they would repeat the first one's mistakes.
    """
    rng = np.random.default_rng(seed)
    total = len(view.points)
    chosen = rng.permutation(total)[: min(count, max(1, round(MOST * total)))]
    return replace(view, points=view.points[chosen])


class ResampledViewCheck:
    """Check of grasps against fields from other samples of the cloud.

    Args:
        geometry: Geometry of the robot.
        fields: Fields of the object, world frame, one for each sample.
    """

    def __init__(self, geometry: RobotGeometry, fields: tuple[Field, ...]) -> None:
        self._kinematics = geometry.kinematics
        self._distances = [ObjectDistances(geometry, field, LOOKED_AT) for field in fields]

    def contradicted(self, q: Array, clearance: float) -> NDArray[np.bool_]:
        """Whether, in any other sample's field, the robot is nearer to the object than a clearance.

        Args:
            q: [C, J], configurations.
            clearance: Clearance [m] with which they were planned.

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
