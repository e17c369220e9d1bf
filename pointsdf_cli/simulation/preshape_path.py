"""Path of the arm to a preshape: inverse kinematics, a collision-checked path, and a possible lift.

The path is home → retreat → preshape, straight in joint space to the retreat and straight in
Cartesian space from there, or through a point above the retreat. It is checked every few hundredths
of a radian against table, object and the robot itself. A motion planner would find more paths;
attempts without such a path are labelled.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.grasps import NO_CONFIGURATION, NO_MOTION
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.cartesian_path import FollowConfig, follow, straight
from pointsdf_cli.robot.inverse_kinematics import (
    POSITION_TOLERANCE,
    ROTATION_TOLERANCE,
    InverseKinematics,
)
from pointsdf_cli.robot.lift import LIFT_HEIGHT
from pointsdf_cli.simulation.world import World

CANDIDATES = 6
"""Number of arm configurations tried for a palm pose, the nearest to home first."""
RETREAT = 0.12
"""Length of the straight last stretch along the palm's normal [m]."""
OVER = 0.2
"""Height [m] above the retreat of the point to pass if the direct path is blocked."""
RESOLUTION = 0.05
"""Largest motion of a revolute joint between two checked configurations [rad]."""
SLIDING = 0.01
"""Largest motion of a prismatic joint between them [m]."""
WAYPOINTS = 8
"""Number of waypoints of the straight stretches."""
FOLLOW = FollowConfig(
    POSITION_TOLERANCE, ROTATION_TOLERANCE, jump=0.5, longest=0.2, turn_weight=0.3, damping=1e-4
)
"""Waypoints are far apart: joints may move by half a radian between two."""


@dataclass(frozen=True)
class PreshapePath:
    """A path to a preshape, or the reason why there is none.

    Attributes:
        label: 0 if the grasp may be executed or lies inside the object; else `NO_MOTION` or
            `NO_CONFIGURATION`.
        cause: Empty, or "no_ik", "start_in_table", "start_in_object", "start_in_self",
            "no_lift", "no_path", "no_plan".
        q: [J], the preshape; without a path, one that was tried; NaN for the arm without inverse
            kinematics.
        approach: [T, J], path from home to the preshape; empty without one, and for a planned one.
        lift: [K, A], arm joints along the lift; empty without one.
    """

    label: int
    cause: str
    q: Array
    approach: Array = field(default_factory=lambda: np.empty((0, 0)))
    lift: Array = field(default_factory=lambda: np.empty((0, 0)))


class PreshapePathFinder:
    """Path search in one world.

    Args:
        world: World with the scene for collision checks.
        solver: Inverse kinematics of the world's robot.
    """

    def __init__(self, world: World, solver: InverseKinematics) -> None:
        self._world = world
        self._solver = solver
        self._robot = world.robot
        self._resolution = np.where(self._robot.slides, SLIDING, RESOLUTION)

    def arms(self, T_world_palm: Array) -> Array:
        """Arm configurations [B, A] for the palm pose [4, 4], the nearest to home first.

        Needs no scene, which is then built only if there are any.
        """
        solutions = self._solver.solve(T_world_palm)
        arms = solutions.arm[0][solutions.reached[0]]
        home = self._robot.home[self._robot.arm]
        order = np.argsort(np.abs(arms - home).max(axis=1), kind="stable")
        return _different(arms[order])[:CANDIDATES]

    def __call__(
        self, T_world_palm: Array, joints: Array, arms: Array | None = None
    ) -> PreshapePath:
        """Find a path to a palm pose in the world's scene; moves the world's robot.

        Args:
            T_world_palm: [4, 4].
            joints: [K], preshape joints.
            arms: [B, A], result of `arms` for this pose; computed if None.
        """
        robot = self._robot
        arms = self.arms(T_world_palm) if arms is None else arms
        if not len(arms):
            q = robot.configuration(np.full(len(robot.arm_joints), np.nan), joints)
            return PreshapePath(NO_CONFIGURATION, "no_ik", q)
        tried = robot.configuration(arms, joints)
        causes = [start_cause(self._world.collisions(q)) for q in tried]
        free = arms[[not cause for cause in causes]]
        if not len(free):
            return PreshapePath(NO_CONFIGURATION, causes[-1], tried[-1])
        return self._way(T_world_palm, free, joints)

    @property
    def chain(self) -> ArmChain:
        """Kinematics of the arm."""
        return self._solver.chain

    def lift(self, q: Array, T_world_palm: Array) -> Array | None:
        """Arm joints [K, A] that lift the palm straight up from configuration q [J]; None if the
        arm has no room for it."""
        arm = q[None, self._robot.arm]
        paths, fine = self._straight(arm, T_world_palm, [[0, 0, LIFT_HEIGHT]])
        return paths[0] if fine[0] else None

    def _way(self, T_world_palm: Array, arms: Array, joints: Array) -> PreshapePath:
        """Path to the first of the arm configurations [B, A] that is reachable and can lift."""
        robot = self._robot
        back = -RETREAT * T_world_palm[:3, 0]
        # All at once: many paths take hardly longer than one.
        ways = np.repeat([[0, 0, LIFT_HEIGHT], back], len(arms), axis=0)
        paths, fine = self._straight(np.tile(arms, (2, 1)), T_world_palm, ways)
        (lifts, retreats), (can_lift, can_retreat) = np.split(paths, 2), np.split(fine, 2)
        cause = "no_lift"
        for k in np.flatnonzero(can_lift):
            cause = "no_path"
            if not can_retreat[k]:
                continue
            approach = self._approach(retreats[k], T_world_palm, back, joints)
            if approach is not None:
                q = robot.configuration(arms[k], joints)
                return PreshapePath(0, "", q, approach, lifts[k])
        return PreshapePath(NO_MOTION, cause, robot.configuration(arms[0], joints))

    def _approach(
        self, retreat: Array, T_world_palm: Array, back: Array, joints: Array
    ) -> Array | None:
        """Path [T, J] from home to the preshape through a retreat path [K, A], reversed."""
        robot = self._robot
        last = robot.configuration(retreat[::-1], joints)
        home = robot.configuration(robot.home[robot.arm], joints)
        if not self._free(last):
            return None
        direct = np.stack([home, last[0]])
        if self._free(direct):
            return np.concatenate([direct[:1], last])
        start = T_world_palm.copy()
        start[:3, 3] += back
        over, fine = self._straight(retreat[-1:], start, [[0, 0, OVER]])
        if not fine[0]:
            return None
        descent = robot.configuration(over[0][::-1], joints)
        if self._free(np.concatenate([home[None], descent])):
            return np.concatenate([home[None], descent, last])
        return None

    def _straight(
        self, arms: Array, T_world_palm: Array, ways: ArrayLike
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Paths [B, K + 1, A] from `arms` [B, A] that move the palm straight along `ways` [B, 3],
        and a mask [B] of those that the arm can follow."""
        poses = straight(T_world_palm, ways, WAYPOINTS)
        paths, reached = follow(self._solver.chain, arms, poses, FOLLOW)
        return paths, reached == WAYPOINTS

    def _free(self, path: Array) -> bool:
        """Whether straight lines between configurations [K, J] are free of collision.

        Checked at both ends and then at ever finer steps: most obstacles are wide.
        """
        dense = interpolate(path, self._resolution)
        return not any(self._world.collisions(dense[i]) for i in _coarse_first(len(dense)))


def start_cause(touched: set[str]) -> str:
    """Cause of a preshape in which the robot touches these; empty if it touches nothing."""
    order = ("object", "table", "self")
    return next((f"start_in_{kind}" for kind in order if kind in touched), "")


def interpolate(path: Array, resolution: Array) -> Array:
    """Interpolate configurations [T, J] linearly between those of `path` [K, J].

    No joint moves by more than its `resolution` [J] between two of them.
    """
    pieces = [path[:1]]
    for first, second in itertools.pairwise(path):
        count = max(1, int(np.ceil((np.abs(second - first) / resolution).max())))
        share = np.linspace(0, 1, count + 1)[1:, None]
        pieces.append(first + share * (second - first))
    return np.concatenate(pieces)


def _coarse_first(count: int) -> list[int]:
    """Indices below `count`, each once: the last first, then in strides that halve."""
    strides = [2**k for k in reversed(range(count.bit_length()))]
    every = (place for stride in strides for place in range(count - 1, -1, -stride))
    return list(dict.fromkeys(every))


def _different(arms: Array) -> Array:
    """Configurations [B', A] without those that repeat an earlier one."""
    kept: list[Array] = []
    for arm in arms:
        if all(np.abs(arm - other).max() > 0.1 for other in kept):
            kept.append(arm)
    return np.array(kept).reshape(-1, arms.shape[1])
