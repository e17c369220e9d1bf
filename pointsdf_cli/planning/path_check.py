"""Proof that a joint-space path is free along its whole length, not only at samples.

Between two configurations two bodies move by no more than M = Σ_j |Δq_j| R_j against each other:
the sum is over the joints between them, and R_j is the farthest that the outer body can be from
joint j's axis. Their distance changes no faster, so with slacks r_a, r_b at the ends, the straight
joint-space way between them is free for this pair if r_a + r_b ≥ M. Ways that are not shown free
for all pairs are halved, down to a resolution finer than the thinnest link.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.contacts import WORLD, ContactJacobian, Poses
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.grasp_problem import Clearances
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.robot_geometry import RobotGeometry

EXACT_TO = 0.02
"""Distances between bodies are exact up to here [m], and bounds beyond."""

KEPT = 512
"""Configurations whose distances are kept: those of the trees of one search; 14 kB each."""


RESOLUTION = 0.001
"""Ways on which nothing moves farther than this [m] are not halved any more."""
BATCH = 64
"""Configurations checked together."""


class PathChecker:
    """Checks configurations and ways between them for one object and environment.

    Args:
        geometry: Geometry of the robot.
        field: Field of the object; its values may not exceed the true distance by more than the
            object's clearance.
        environment: Obstacles and table.
        clearances: Least distances.
        bodies: Distances to this environment, where they are made already.

    Attributes:
        checked: Number of configurations checked so far.
    """

    def __init__(
        self,
        geometry: RobotGeometry,
        field: Field,
        environment: Environment | None = None,
        clearances: Clearances | None = None,
        bodies: BodyDistances | None = None,
    ) -> None:
        kinematics = self.kinematics = geometry.kinematics
        clearances = clearances or Clearances()
        self._object = ObjectDistances(geometry, field)
        bodies = bodies or BodyDistances(geometry, environment or Environment())
        self._bodies = bodies.exact_up_to(EXACT_TO)
        self._with_object, self._object_columns = True, len(self._object.names)
        moved = ContactJacobian(kinematics).moved
        reach = geometry.reach
        first = np.concatenate([self._object.link, self._bodies.link])
        second = np.concatenate([self._object.other_link, self._bodies.other_link])
        self._margin = clearances.of_bodies(second != WORLD)
        self._margin[: self._object_columns] = clearances.object
        # A joint that moves both bodies, or none, does not move one against the other.
        farthest = np.where(moved[first], reach[first], 0.0)
        farthest = np.maximum(farthest, np.where(moved[second], reach[second], 0.0))
        self._reach: Array = np.where(moved[first] != moved[second], farthest, 0.0)
        self.checked = 0
        self._kept: dict[tuple[bytes, bytes], Array] = {}

    def with_clearance(self, clearance: float) -> PathChecker:
        """A copy with another clearance to the object [m]."""
        other = copy(self)
        other._margin = self._margin.copy()
        other._margin[: self._object_columns] = clearance
        return other

    def without_object(self) -> PathChecker:
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

    def _columns(self, moving: NDArray[np.bool_] | None) -> Indices:
        """The pairs [K] that count and are moved against each other by some of these joints."""
        counts = np.ones(len(self._reach), dtype=bool)
        counts[: self._object_columns] = self._with_object
        # No joint moves the base: what stands beside it may touch it.
        reach = self._reach if moving is None else self._reach[:, moving]
        return np.flatnonzero(counts & (reach > 0).any(axis=1))

    def _slacks(self, q: Array, columns: Indices) -> Array:
        """Distances less clearances [B, K] of the columns [K] at q [B, J].

        Trees of configurations come back to the same ones again and again: those are kept.
        """
        asked = columns.tobytes()
        keys = [(row.tobytes(), asked) for row in np.ascontiguousarray(q)]
        new = {key: b for b, key in enumerate(keys) if key not in self._kept}
        fresh = list(new.values())
        for begin in range(0, len(fresh), BATCH):
            some = fresh[begin : begin + BATCH]
            rows = np.repeat(np.arange(len(some)), len(columns))
            poses = Poses(*self.kinematics.poses(q[some]))
            found = self._distances(poses, rows, np.tile(columns, len(some)))
            for b, distances in zip(some, found.reshape(len(some), -1), strict=True):
                self._kept[keys[b]] = distances
        self.checked += len(q)
        distances = np.stack([self._kept[key] for key in keys])
        for _ in range(len(self._kept) - KEPT):
            del self._kept[next(iter(self._kept))]
        return np.asarray(distances - self._margin[columns])

    def _distances(self, poses: Poses, rows: Indices, columns: Indices) -> Array:
        """Distances [K] of the pairs `columns` [K] at the configurations `rows` [K].

        Those to the object take longest. They are infinite, and not computed, where bodies are too
        near to each other already.
        """
        distances = np.full(len(rows), np.inf)
        bodies = np.flatnonzero(columns >= self._object_columns)
        near = np.zeros(len(poses.rotation), dtype=bool)
        if len(bodies):
            pair = columns[bodies]
            found = self._bodies.of(poses, rows[bodies], pair - self._object_columns)
            distances[bodies] = found
            near[rows[bodies][found < self._margin[pair]]] = True
        asked = np.flatnonzero((columns < self._object_columns) & ~near[rows])
        if len(asked):
            distances[asked] = self._object.of(poses, rows[asked], columns[asked])
        return distances

    def is_free(self, path: Array) -> bool:
        """Whether the polyline path [T, J] in joint space is free all along."""
        return self.least_slack(path) >= 0

    def least_slack(self, path: Array) -> float:
        """The smallest slack met on the path [m]; the search stops at the first negative one.

        Between the checked configurations of a free path the slack may be smaller, but is at least
        −RESOLUTION / 2. Midpoints are checked only for the pairs that the ends of their segment
        leave undecided.
        """
        path = np.asarray(path, dtype=np.float64)
        if len(path) == 1:
            return float(self.slack(path)[0])
        columns = self._columns(np.ptp(path, axis=0) > 0)
        slacks = self._slacks(path, columns)
        least = float(slacks.min(initial=np.inf))
        motion = self.motion(path[:-1], path[1:])[:, columns]
        way, place = np.nonzero(self._in_doubt(slacks[:-1], slacks[1:], motion))
        ends = slacks[way, place], slacks[way + 1, place]
        doubt = _Doubt(way, columns[place], *ends, motion[way, place])
        a, b = path[:-1], path[1:]
        while least >= 0 and len(doubt.way):
            ways, rows = np.unique(doubt.way, return_inverse=True)
            a, b = a[ways], b[ways]
            middle = (a + b) / 2
            poses = Poses(*self.kinematics.poses(middle))
            self.checked += len(middle)
            slack = self._distances(poses, rows, doubt.pair) - self._margin[doubt.pair]
            least = min(least, float(slack.min()))
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
            doubt = self._halved(doubt._replace(way=rows), len(ways), slack)
        return least

    def _in_doubt(self, a: Array, b: Array, motion: Array) -> NDArray[np.bool_]:
        """Mask of the pairs that slacks at both ends and the motion between do not prove free."""
        return np.asarray((a + b < motion) & (motion > RESOLUTION))

    def _halved(self, doubt: _Doubt, ways: int, slack: Array) -> _Doubt:
        """Pairs still unproven on the halves of the segments: first halves in rows below `ways`,
        second halves from there on.

        Args:
            doubt: Pairs before halving; rows 0 to `ways` − 1.
            ways: Number of segments.
            slack: [K], in the middles.
        """
        halves = _Doubt(
            np.concatenate([doubt.way, doubt.way + ways]),
            np.tile(doubt.pair, 2),
            np.concatenate([doubt.a, slack]),
            np.concatenate([slack, doubt.b]),
            np.tile(doubt.motion / 2, 2),
        )
        still = self._in_doubt(halves.a, halves.b, halves.motion)
        return _Doubt._make(part[still] for part in halves)


class _Doubt(NamedTuple):
    """K pairs on ways that are not proven free.

    Attributes:
        way: [K], row of the way.
        pair: [K], column of the pair.
        a, b: [K], slack at the way's ends [m].
        motion: [K], how far the pair moves on the way, at most [m].
    """

    way: Indices
    pair: Indices
    a: Array
    b: Array
    motion: Array
