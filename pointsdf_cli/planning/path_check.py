"""Is a joint-space path free, all along, and not only where it was looked at?

Between two configurations no point of the robot moves farther than M = Σ_j |Δq_j| R_j, with R_j the
farthest that anything beyond joint j can be from its axis. Distances change no faster than points
move, so with rooms r_a, r_b at the ends the straight joint-space way between them is free if
r_a + r_b ≥ M. Otherwise it is halved, down to a resolution finer than the thinnest link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.contacts import WORLD, Array, ContactJacobian, link_poses
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.fields import Field
from pointsdf_cli.planning.grasp_problem import Clearances
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.shapes import bounding_box


@dataclass(frozen=True)
class PathCheckConfig:
    """How closely to look.

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
        kinematics: Of the robot.
        field: Of the object; its values may not exceed the true distance by more than the
            object's clearance.
        environment: What stands around.
        clearances: Least distances.
        config: How closely to look.

    Attributes:
        looked_at: Configurations evaluated so far.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        field: Field,
        environment: Environment | None = None,
        clearances: Clearances | None = None,
        config: PathCheckConfig | None = None,
    ) -> None:
        self.config = config or PathCheckConfig()
        self.kinematics = kinematics
        clearances = clearances or Clearances()
        self._object = ObjectDistances(kinematics, field)
        self._bodies = BodyDistances(kinematics, environment or Environment(), reach=0.03)
        links = set(kinematics.links)
        self._body_margin = np.array(
            [
                clearances.self if other in links else clearances.environment
                for _, other in self._bodies.names
            ]
        )
        self._object_margin = clearances.object
        self._moved = ContactJacobian(kinematics).moved
        self.radii = joint_radii(kinematics)
        self.looked_at = 0

    def room(self, q: Array, moving: NDArray[np.bool_] | None = None) -> Array:
        """Smallest distance less clearance [B] at configurations q [B, J].

        Args:
            moving: bool [J]; distances that these joints cannot change are left out.
        """
        wanted = np.ones(len(self._bodies.names), dtype=bool)
        patches = np.ones(len(self._object.names), dtype=bool)
        if moving is not None:
            moved = self._moved[:, moving]
            wanted = (moved[self._bodies.link] != moved[self._bodies.other_link]).any(axis=1)
            patches = (moved[self._object.link] != moved[WORLD]).any(axis=1)
        rooms = []
        for part in np.split(q, range(self.config.batch, len(q), self.config.batch)):
            poses = link_poses(self.kinematics, part)
            near = self._object(poses, gradients=False).distance - self._object_margin
            bodies = self._bodies(poses, wanted).distance - self._body_margin
            rooms.append(
                np.minimum(
                    near[:, patches].min(axis=1, initial=np.inf),
                    bodies[:, wanted].min(axis=1, initial=np.inf),
                )
            )
        self.looked_at += len(q)
        return np.concatenate(rooms) if rooms else np.zeros(0)

    def motion(self, a: Array, b: Array) -> Array:
        """M [...], no point of the robot moves farther between a and b [..., J] [m]."""
        bound: Array = np.abs(b - a) @ self.radii
        return bound

    def is_free(self, path: Array) -> bool:
        """Whether the polyline path [T, J] in joint space is free all along."""
        return self.least_room(path) >= 0

    def least_room(self, path: Array) -> float:
        """The smallest room met on the path [m]; the search stops at the first negative one.

        Between the configurations that were looked at it cannot be less than this by more than
        half the resolution, and never so little that anything touches unseen.
        """
        path = np.asarray(path, dtype=np.float64)
        if len(path) == 1:
            return float(self.room(path)[0])
        moving = np.ptp(path, axis=0) > 0
        rooms = self.room(path, moving)
        least = float(rooms.min())
        a, b, room_a, room_b = path[:-1], path[1:], rooms[:-1], rooms[1:]
        while least >= 0:
            motion = self.motion(a, b)
            open_ = (room_a + room_b < motion) & (motion > self.config.resolution)
            if not open_.any():
                break
            a, b, room_a, room_b = a[open_], b[open_], room_a[open_], room_b[open_]
            middle = (a + b) / 2
            room = self.room(middle, moving)
            least = min(least, float(room.min()))
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
            room_a, room_b = np.concatenate([room_a, room]), np.concatenate([room, room_b])
        return least


def joint_radii(kinematics: Kinematics) -> Array:
    """R_j [J]: how far anything beyond joint j can be from its axis [m]; 1 for sliding joints.

    By the triangle inequality along the chain: the offsets of the joints beyond, the travel of
    those that slide, and the farthest corner of a link's box.
    """
    robot = kinematics.robot
    tree = robot.tree
    columns = {name: j for j, name in enumerate(robot.joint_names)}
    reach: dict[str, float] = {}
    for link in reversed(tree.links):
        shapes = tree.shapes[link]
        farthest = 0.0
        if shapes:
            low, high = bounding_box(shapes)
            farthest = float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
        for joint in tree.joints:
            if joint.parent == link:
                travel = 0.0
                if joint.kind == "prismatic" and joint.name in columns:
                    travel = max(abs(joint.lower), abs(joint.upper))
                offset = float(np.linalg.norm(joint.T_parent_joint[:3, 3]))
                farthest = max(farthest, offset + travel + reach[joint.child])
        reach[link] = farthest
    radii = np.ones(len(columns))
    for joint in tree.joints:
        if joint.name in columns and joint.kind != "prismatic":
            radii[columns[joint.name]] = reach[joint.child]
    return radii
