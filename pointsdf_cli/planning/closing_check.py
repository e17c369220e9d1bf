"""Distance of the closing fingers to obstacles.

The solver's constraints hold for the open hand alone. Here the hand closes step by step without
physics: all closing joints advance at their speeds, and a joint stops when a link that it moves
meets the object; coupled joints (a gripper's jaws) stop when all of them are stopped, since one
pushes the object to the other. The simulated hand also moves on where the object gives way
(`simulation/executor.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.acceptance import AcceptanceConfig, Candidate
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.contacts import WORLD, link_poses
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.robot.description import RobotDescription

STEPS = 20
"""Steps from the preshape to the end of the slowest joint: a fingertip moves about 2 cm in each."""
CONTACT = 0.0005
"""Distance to the object [m] at which a link counts as touching it."""


class ClosingCheck:
    """Check of the closing motion in one scene.

    Args:
        geometry: Geometry of the robot.
        field: Field of the object, world frame.
        bodies: Distances to the environment.
        clearance: Least distance to obstacles [m].
    """

    def __init__(
        self, geometry: RobotGeometry, field: Field, bodies: BodyDistances, clearance: float
    ) -> None:
        kinematics = self._kinematics = geometry.kinematics
        robot = self._robot = kinematics.robot
        self._object, self._bodies = ObjectDistances(geometry, field), bodies
        self._clearance = clearance
        beyond = [robot.tree.links_moved_by([joint]) for joint in robot.closing_joints]
        moved = [set(map(kinematics.index, links)) for links in beyond]
        links = sorted(set().union(*moved))
        self._patches = np.flatnonzero(np.isin(self._object.link, links))
        # [P, C], the closing joints that a touching patch stops.
        patch_links = self._object.link[self._patches]
        self._stops = np.array([[link in one for one in moved] for link in patch_links])
        self._coupled = _coupled(robot)
        obstacle = (bodies.other_link == WORLD) & ~bodies.is_table
        self._pairs = np.flatnonzero(obstacle & np.isin(bodies.link, links))

    def judged(self, candidates: list[Candidate], config: AcceptanceConfig) -> list[Candidate]:
        """The candidates, with `closing_slack` for accepted ones and fallbacks.

        Accepted ones whose closing fingers come too near to an obstacle get the reason "closing".
        """
        free = [k for k, one in enumerate(candidates) if not one.reason or one.is_fallback(config)]
        slacks = self.slack(np.array([candidates[k].q for k in free]))
        judged = list(candidates)
        for k, slack in zip(free, slacks, strict=True):
            reason = judged[k].reason or ("" if slack >= 0 else "closing")
            judged[k] = replace(judged[k], closing_slack=float(slack), reason=reason)
        return judged

    def slack(self, q: Array) -> Array:
        """Least distance less clearance [B] m to the obstacles while the hand closes from q [B, J];
        infinite without obstacles."""
        least = np.full(len(q), np.inf)
        if not len(self._pairs) or not len(q):
            return least
        robot, columns = self._robot, self._robot.closing_columns
        low, high = robot.hard_lower[columns], robot.hard_upper[columns]
        speeds = robot.closing_speeds
        q = np.array(q, dtype=np.float64)
        ends = np.where(speeds > 0, high, low)
        duration = ((ends - q[:, columns]) / speeds).max(axis=1, keepdims=True)
        step = duration / STEPS * speeds
        free = np.ones((len(q), len(columns)), dtype=bool)
        moving = free.copy()
        for _ in range(STEPS):
            q[:, columns] = np.clip(q[:, columns] + step * moving, low, high)
            poses = link_poses(self._kinematics, q)
            rows = np.repeat(np.arange(len(q)), len(self._pairs))
            found = self._bodies.of(poses, rows, np.tile(self._pairs, len(q)))
            least = np.minimum(least, found.reshape(len(q), -1).min(axis=1))
            rows = np.repeat(np.arange(len(q)), len(self._patches))
            near = self._object.of(poses, rows, np.tile(self._patches, len(q))) < CONTACT
            free &= ~(near.reshape(len(q), -1) @ self._stops)
            moving = free @ self._coupled
            if not moving.any():
                break
        return least - self._clearance


def _coupled(robot: RobotDescription) -> NDArray[np.bool_]:
    """[C, C], whether two closing joints move as one: the same joint, or coupled by <mimic>."""
    leader = {j.name: j.mimic[0] for j in robot.tree.joints if j.mimic}
    led_by = np.array(robot.closing_joints, dtype=object)
    for _ in leader:  # a chain of couplings ends at its first joint
        led_by = np.array([leader.get(name, name) for name in led_by], dtype=object)
    return np.asarray(led_by[:, None] == led_by)
