"""The paper's problem (section IV): the best grasp that the whole arm and hand can reach.

    min_q  max(s − β, 0)²
    s.t.   q_min ≤ q ≤ q_max
           a_SDF(M_e, FK_l(q)) > 0     links l, table and obstacles e      (bodies.py)
           f_SDF(o, FK_l(q)) > 0       links l                             (object_distance.py)

Beyond the paper: the robot may not touch itself, and all distances keep a margin in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.contacts import WORLD, ContactJacobian, Contacts, Poses, join, link_poses
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.nonlinear import Evaluation
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.objective import Cost, GraspScore, Objective
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.variables import Variables

CRITICAL = 32
"""Number of constraints that `GraspProblem.evaluate` reports for each configuration."""


@dataclass(frozen=True)
class Clearances:
    """Least distances of a plan [m].

    Attributes:
        object: Between the hand or arm and the object.
        environment: To the table and the obstacles.
        self: Between the robot's own links.
    """

    object: float = 0.001
    environment: float = 0.002
    self: float = 0.001

    def __post_init__(self) -> None:
        if not all(0 <= each < np.inf for each in vars(self).values()):  # False for NaN
            raise InputError(f"{self}", where="--clearance", allowed="0 m or more")

    def of_bodies(self, is_self: NDArray[np.bool_]) -> Array:
        """Clearance [M] of distances between bodies, m; `is_self` [M] marks the robot's own."""
        return np.where(is_self, float(self.self), float(self.environment))


class Residuals(NamedTuple):
    """Slack at B configurations: smallest distance minus the clearance [m]; met if ≥ 0."""

    object: Array
    table: Array
    obstacles: Array
    self_collision: Array


class GraspProblem:
    """The problem for one object; implements `nonlinear.Problem`.

    Args:
        geometry: Geometry of the robot.
        score: Score of grasps of the object.
        field: Field of the object for the solver: the network, or a grid of it.
        environment: Obstacles and table.
        clearances: Margins.
    """

    def __init__(
        self,
        geometry: RobotGeometry,
        score: GraspScore,
        field: Field,
        environment: Environment | None = None,
        clearances: Clearances | None = None,
    ) -> None:
        kinematics = self.kinematics = geometry.kinematics
        self.variables = Variables(kinematics.robot)
        self.lower, self.upper = self.variables.lower, self.variables.upper
        self.clearances = clearances or Clearances()
        self.geometry, self.environment = geometry, environment or Environment()
        self.objective = Objective(kinematics, self.variables, score)
        self.bodies = BodyDistances(geometry, self.environment)
        self.object = ObjectDistances(geometry, field)
        self._jacobian = ContactJacobian(kinematics)
        self.names = self.object.names + self.bodies.names
        # By index, not by name: an obstacle may have any name.
        count = len(self.object.names)
        self.is_object = np.arange(len(self.names)) < count
        self._other = np.concatenate([self.object.other_link, self.bodies.other_link])
        self._is_self = self._other != WORLD
        self.is_table = np.concatenate([np.zeros(count, bool), self.bodies.is_table])
        self._margin = self._margins()
        self._relevant = self._movable()
        self._critical = min(CRITICAL, int(self._relevant.sum()))
        self._groups = self._make_groups()

    @property
    def lowest(self) -> float:
        """Least height of the hand above z = 0 [m]."""
        return self.environment.table_height + self.clearances.environment

    def with_field(self, field: Field, clearances: Clearances, exact_to: float) -> GraspProblem:
        """The same with another field, exact up to `exact_to` [m], and other margins."""
        other = copy(self)
        other.clearances = clearances
        other.object = self.object.with_field(field, exact_to)
        other._margin = other._margins()
        return other

    def with_clearance(self, clearance: float) -> GraspProblem:
        """A copy with another clearance to the object [m]."""
        other = copy(self)
        other.clearances = replace(self.clearances, object=clearance)
        other._margin = np.where(self.is_object, clearance, self._margin)
        return other

    def with_score(self, score: GraspScore) -> GraspProblem:
        """A copy with another score of the grasps."""
        other = copy(self)
        other.objective = Objective(self.kinematics, self.variables, score)
        return other

    def violations(self, x: Array) -> Array:
        """Negative part of the slack [4, B] of each kind of constraint at x [B, n], in the order of
        `Residuals`; cheaper than `residuals`, as only what is too near is measured exactly."""
        near, exact_to = copy(self), max(vars(self.clearances).values())
        near.object = self.object.exact_up_to(exact_to)
        near.bodies = self.bodies.exact_up_to(exact_to)
        return np.minimum(0.0, np.stack(near.residuals(x)))

    def clearances_by_link(self, x: Array, links: Sequence[str]) -> tuple[Array, Array]:
        """Distances [L] of these links to the object and to the table at x [n], however large; for
        reports, not for solvers. Infinite for links that are not measured."""
        poses = link_poses(self.kinematics, self.variables.configuration(x[None]))
        to_object = self.object.by_link(poses)[[self.kinematics.index(link) for link in links]]
        bodies = self.bodies.exact_up_to(np.inf)
        distance = bodies(poses, bodies.is_table).distance[0]
        to_table = np.full(len(links), np.inf)
        place = {link: k for k, link in enumerate(links)}
        for column in np.flatnonzero(bodies.is_table):
            link = place[bodies.names[column][0]]
            to_table[link] = min(to_table[link], distance[column])
        return to_object, to_table

    def cost(self, x: Array) -> Cost:
        """The objective at x [B, n]."""
        return self.objective(x)

    def residuals(self, x: Array) -> Residuals:
        """Slack of each kind of constraint at x [B, n]."""
        _, _, slack = self._measured(x, gradients=False)
        fixed = ~(self.is_object | self.is_table | self._is_self)
        kinds = (self.is_object, self.is_table, fixed, self._is_self)
        return Residuals(*(slack[:, kind].min(axis=1, initial=np.inf) for kind in kinds))

    def evaluate(self, x: Array) -> Evaluation:
        """Evaluate, for each point, its `critical` constraints of least slack."""
        poses, contacts, slack = self._measured(x)
        chosen = np.argpartition(slack, self._critical - 1, axis=1)[:, : self._critical]
        return self._evaluation(x, poses, contacts, slack, np.sort(chosen, axis=1))

    def evaluate_grouped(self, x: Array) -> Evaluation:
        """Evaluate the paper's constraints: each link's minimum distance to the object, to each
        obstacle and to the robot itself."""
        poses, contacts, slack = self._measured(x)
        chosen = np.stack([group[slack[:, group].argmin(axis=1)] for group in self._groups], axis=1)
        return self._evaluation(x, poses, contacts, slack, chosen)

    def _measured(self, x: Array, gradients: bool = True) -> tuple[Poses, Contacts, Array]:
        """All distances at x [B, n], in the order of `names`, and their slacks [B, M] m; infinite
        where the variables cannot change them."""
        poses = link_poses(self.kinematics, self.variables.configuration(x))
        contacts = join([self.object(poses, gradients), self.bodies(poses)])
        slack = np.where(self._relevant, contacts.distance - self._margin, np.inf)
        return poses, contacts, slack

    def _evaluation(
        self, x: Array, poses: Poses, contacts: Contacts, slack: Array, chosen: NDArray[np.int64]
    ) -> Evaluation:
        cost = self.objective(x)
        slope = cost.residual_gradient
        curvature = 2 * slope[:, :, None] * slope[:, None, :]
        least = np.take_along_axis(slack, chosen, axis=1)
        jacobian = self.variables.derivatives(self._jacobian(poses, contacts, chosen))
        return Evaluation(cost.value, cost.gradient, curvature, least, jacobian)

    def _margins(self) -> Array:
        """Clearance of each distance, m."""
        of_bodies = self.clearances.of_bodies(self._is_self)
        return np.where(self.is_object, self.clearances.object, of_bodies)

    def _movable(self) -> NDArray[np.bool_]:
        """Mask of the distances that the variables can change: a driven joint moves one of the
        two links without the other."""
        moved = self._jacobian.moved[:, self.variables.driven]
        link = np.concatenate([self.object.link, self.bodies.link])
        return np.asarray((moved[link] != moved[self._other]).any(axis=1))

    def _make_groups(self) -> list[NDArray[np.int64]]:
        """Columns by link and by the other body; the robot itself counts as one."""
        groups: dict[tuple[str, str], list[int]] = {}
        for m in np.flatnonzero(self._relevant):
            link, other = self.names[m]
            key = (link, "self" if self._is_self[m] else other)
            groups.setdefault(key, []).append(int(m))
        return [np.array(columns) for columns in groups.values()]
