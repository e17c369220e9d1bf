"""Proof that a joint-space path is free along its whole length, not only at samples.

Between two configurations two bodies move by no more than M = Σ_j |Δq_j| R_j against each other:
the sum is over the joints between them, and R_j is the farthest that the outer body can be from
joint j's axis. Their distance changes no faster, so with slacks r_a, r_b at the ends, the straight
joint-space way between them is free for this pair if r_a + r_b ≥ M. Ways that are not shown free
for all pairs are halved, down to a resolution finer than the thinnest link.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.contacts import WORLD, ContactJacobian, link_poses
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.grasp_problem import Clearances
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.robot_geometry import RobotGeometry


@dataclass(frozen=True)
class PathCheckConfig:
    """Resolution of the check.

    Attributes:
        resolution: Ways on which nothing moves farther than this [m] are not halved any more.
        batch: Configurations looked at together.
    """

    resolution: float = 0.001
    batch: int = 64

    def __post_init__(self) -> None:
        if not 0 < self.resolution <= 0.01 or self.batch < 1:
            raise InputError(f"{self}", allowed="resolution above 0 and at most 0.01 m, batch ≥ 1")


class PathChecker:
    """Checks configurations and ways between them for one object and environment.

    Args:
        geometry: Geometry of the robot.
        field: Field of the object; its values may not exceed the true distance by more than the
            object's clearance.
        environment: Obstacles and table.
        clearances: Least distances.
        config: Resolution.

    Attributes:
        looked_at: Configurations evaluated so far.
    """

    def __init__(
        self,
        geometry: RobotGeometry,
        field: Field,
        environment: Environment | None = None,
        clearances: Clearances | None = None,
        config: PathCheckConfig | None = None,
    ) -> None:
        self.config = config or PathCheckConfig()
        kinematics = self.kinematics = geometry.kinematics
        clearances = clearances or Clearances()
        self._object = ObjectDistances(geometry, field)
        self._bodies = BodyDistances(geometry, environment or Environment(), reach=0.02)
        self._body_margin = np.where(
            self._bodies.other_link != WORLD, clearances.self, clearances.environment
        )
        self._object_margin, self._with_object = clearances.object, True
        self._object_columns = len(self._object.names)
        moved = ContactJacobian(kinematics).moved
        reach = geometry.reach
        first = np.concatenate([self._object.link, self._bodies.link])
        none = np.full(self._object_columns, WORLD)
        second = np.concatenate([none, self._bodies.other_link])
        # A joint that moves both bodies, or none, does not move one against the other.
        farthest = np.where(moved[first], reach[first], 0.0)
        farthest = np.maximum(farthest, np.where(moved[second], reach[second], 0.0))
        self._reach: Array = np.where(moved[first] != moved[second], farthest, 0.0)
        self.looked_at = 0

    def keeping(self, clearance: float) -> PathChecker:
        """A copy with another clearance to the object [m]."""
        other = copy(self)
        other._object_margin = clearance
        return other

    def beside_object(self) -> PathChecker:
        """A copy without the object: for motions in which the hand carries it."""
        other = copy(self)
        other._with_object = False
        return other

    def slack(self, q: Array, moving: NDArray[np.bool_] | None = None) -> Array:
        """Smallest distance less clearance [B] at configurations q [B, J].

        Args:
            moving: bool [J]; distances that these joints cannot change are left out.
        """
        slacks: Array = self._slacks(q, self._columns(moving)).min(axis=1, initial=np.inf)
        return slacks

    def motion(self, a: Array, b: Array) -> Array:
        """Bounds M [..., C] on the relative motion of the bodies of each pair [m]."""
        bound: Array = np.abs(b - a) @ self._reach.T
        return bound

    def _columns(self, moving: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Mask of the pairs that count and are moved against each other by some of these joints:
        bool [C]."""
        counts = np.ones(len(self._reach), dtype=bool)
        counts[: self._object_columns] = self._with_object
        if moving is not None:
            counts &= (self._reach[:, moving] > 0).any(axis=1)
        return counts

    def _slacks(self, q: Array, columns: NDArray[np.bool_]) -> Array:
        """Distances less clearances [B, C]; infinity in the columns that are not wanted."""
        slacks = np.full((len(q), len(columns)), np.inf)
        patches, pairs = columns[: self._object_columns], columns[self._object_columns :]
        for begin in range(0, len(q), self.config.batch):
            rows = slice(begin, begin + self.config.batch)
            poses = link_poses(self.kinematics, q[rows])
            if patches.any():
                near = self._object(poses, gradients=False).distance - self._object_margin
                slacks[rows, : len(patches)] = np.where(patches, near, np.inf)
            bodies = self._bodies(poses, pairs).distance - self._body_margin
            slacks[rows, len(patches) :] = np.where(pairs, bodies, np.inf)
        self.looked_at += len(q)
        return slacks

    def is_free(self, path: Array) -> bool:
        """Whether the polyline path [T, J] in joint space is free all along."""
        return self.least_slack(path) >= 0

    def least_slack(self, path: Array) -> float:
        """The smallest slack met on the path [m]; the search stops at the first negative one.

        Between the configurations that were looked at there may be less, but never so little that
        anything touches unseen.
        """
        path = np.asarray(path, dtype=np.float64)
        if len(path) == 1:
            return float(self.slack(path)[0])
        columns = self._columns(np.ptp(path, axis=0) > 0)
        slacks = self._slacks(path, columns)
        least = float(slacks.min(initial=np.inf))
        a, b, slack_a, slack_b = path[:-1], path[1:], slacks[:-1], slacks[1:]
        while least >= 0:
            motion = self.motion(a, b)
            in_doubt = (slack_a + slack_b < motion) & (motion > self.config.resolution)
            open_ = in_doubt.any(axis=1)
            if not open_.any():
                break
            a, b, slack_a, slack_b = a[open_], b[open_], slack_a[open_], slack_b[open_]
            middle = (a + b) / 2
            slack = self._slacks(middle, columns)
            least = min(least, float(slack.min()))
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
            slack_a, slack_b = np.concatenate([slack_a, slack]), np.concatenate([slack, slack_b])
        return least
