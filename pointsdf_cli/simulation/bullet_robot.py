"""A robot in PyBullet: links and joints by name, in one body or several."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform, rotation_vector
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.bullet import Bullet, bullet_place, silence
from pointsdf_cli.simulation.physics import JOINT_RECOVERY

GEAR_FORCE, GEAR_RECOVERY = 1000.0, 1.0
"""Coupling of joints: largest force [N or N m], share of an error that a step takes back."""


class BulletRobot:
    """The whole robot as one body, in one scene of a physics client.

    Args:
        bullet: The physics client.
        robot: The robot.
        files: URDFs of the robot's parts.
        T_world_root: [4, 4], pose of their roots.
        step: Step of the simulation [s].
    """

    def __init__(
        self,
        bullet: Bullet,
        robot: RobotDescription,
        files: Sequence[Path],
        T_world_root: Array,
        step: float,
    ) -> None:
        self._bullet, self.robot, self._step = bullet, robot, step
        self.bodies: list[int] = []
        self.links: dict[str, tuple[int, int]] = {}
        """Body and number of each link, by name."""
        by_name: dict[str, tuple[int, int]] = {}
        for file in files:
            body = self._load(file, T_world_root)
            for i in range(bullet.getNumJoints(body)):
                info = bullet.getJointInfo(body, i)
                by_name[info[1].decode()] = body, i
                self.links[info[12].decode()] = body, i
            root = bullet.getBodyInfo(body)[0].decode()
            self.links.setdefault(root, (body, -1))
            self.bodies.append(body)
        # Body of each joint, and its number there; -1 if it is absent.
        joints = np.array([by_name.get(name, (-1, -1)) for name in robot.joint_names])
        self._body, self._number = joints.T
        self._found: dict[tuple[int, ...], list[tuple[int, NDArray[np.intp], list[int]]]] = {}
        self._all = self._by_body(np.arange(len(joints)))
        self._couple(by_name)

    def _couple(self, by_name: dict[str, tuple[int, int]]) -> None:
        """Gears between coupled joints (<mimic>), such as a gripper's jaws."""
        b = self._bullet
        for joint in self.robot.tree.joints:
            if joint.mimic is None or not {joint.name, joint.mimic[0]} <= by_name.keys():
                continue
            leader, ratio = joint.mimic
            (first, first_number), (body, number) = by_name[leader], by_name[joint.name]
            gear = b.createConstraint(
                first,
                first_number,
                body,
                number,
                b.JOINT_GEAR,
                jointAxis=[1, 0, 0],
                parentFramePosition=[0, 0, 0],
                childFramePosition=[0, 0, 0],
            )
            b.changeConstraint(gear, gearRatio=-1 / ratio, erp=GEAR_RECOVERY, maxForce=GEAR_FORCE)

    def _load(self, file: Path, T_world_root: Array) -> int:
        b = self._bullet
        position, xyzw = bullet_place(T_world_root)
        flags = b.URDF_USE_SELF_COLLISION | b.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        flags |= b.URDF_IGNORE_VISUAL_SHAPES  # loading takes two thirds of the time
        try:
            with silence():
                return int(b.loadURDF(str(file), position, xyzw, useFixedBase=True, flags=flags))
        except b.error as error:
            raise InputError(
                "PyBullet cannot load this URDF",
                where=self.robot.urdf,
                allowed="a named <robot>; damping and friction in each <dynamics>, <mass> and "
                "<inertia> in each <inertial>, a <limit> for each moving joint",
            ) from error

    def ignore_contacts(self, pairs: Iterable[Iterable[str]]) -> None:
        """Disable collisions of these pairs of links."""
        for first, second in pairs:
            if first in self.links and second in self.links:
                (a, i), (b, j) = self.links[first], self.links[second]
                self._bullet.setCollisionFilterPair(a, b, i, j, 0)

    def place(self, q: ArrayLike) -> None:
        """Put the robot at a configuration [J] at rest, without physics."""
        for body, columns, numbers in self._all:
            values = [[float(value)] for value in np.asarray(q)[columns]]
            self._bullet.resetJointStatesMultiDof(body, numbers, values, [[0.0]] * len(values))

    def state(self) -> tuple[Array, Array]:
        """Joint positions and velocities, [J] each."""
        values = np.zeros((2, len(self._body)))
        for body, columns, numbers in self._all:
            states = self._bullet.getJointStates(body, numbers)
            values[:, columns] = np.array([state[:2] for state in states]).T
        return values[0], values[1]

    def drive_to(
        self, q: ArrayLike, columns: ArrayLike, forces: ArrayLike, speeds: ArrayLike | None = None
    ) -> None:
        """Set position targets for the joints at `columns` of q, with their largest efforts.

        Args:
            q: [J], target configuration.
            columns: [K], indices of the joints. Joints of an arm that is not simulated stay.
            forces: [K], largest efforts.
            speeds: [K], speeds of moving targets, so that joints do not lag behind; 0 if None.
        """
        columns = np.asarray(columns)
        speeds = np.zeros(len(columns)) if speeds is None else speeds
        q, forces, speeds = (np.asarray(values, float) for values in (q, forces, speeds))
        for body, places, numbers in self._by_body(columns):
            self._bullet.setJointMotorControlArray(
                body,
                numbers,
                self._bullet.POSITION_CONTROL,
                targetPositions=q[columns[places]].tolist(),
                targetVelocities=speeds[places].tolist(),
                positionGains=[JOINT_RECOVERY * self._step] * len(places),
                velocityGains=[1.0] * len(places),
                forces=forces[places].tolist(),
            )

    def drive_at(self, speeds: ArrayLike, columns: ArrayLike, forces: ArrayLike) -> None:
        """Set speed targets for the joints at `columns` of q, with their largest efforts."""
        forces, speeds = np.asarray(forces, float), np.asarray(speeds, float)
        for body, places, numbers in self._by_body(np.asarray(columns)):
            self._bullet.setJointMotorControlArray(
                body,
                numbers,
                self._bullet.VELOCITY_CONTROL,
                targetVelocities=speeds[places].tolist(),
                forces=forces[places].tolist(),
            )

    def follow(self, arm: Array) -> Iterator[None]:
        """Move the arm through configurations [K, A]; yields when the next step may be made."""
        columns = np.arange(arm.shape[1])
        q = np.zeros(len(self._body))
        for target in arm:
            q[columns] = target
            self.drive_to(q, columns, self.robot.effort[columns])
            yield

    def _by_body(self, columns: NDArray[np.intp]) -> list[tuple[int, NDArray[np.intp], list[int]]]:
        """Group joints (columns in q) by body: body, places in the list, numbers in the body."""
        key = tuple(columns.tolist())
        if key not in self._found:
            of, groups = self._body[columns], []
            for body in self.bodies:
                places = np.flatnonzero(of == body)
                if len(places):
                    groups.append((body, places, self._number[columns[places]].tolist()))
            self._found[key] = groups
        return self._found[key]


class CarriedHand(BulletRobot):
    """The hand alone, carried along the arm's path as by a rigid arm.

    The palm has the velocity that the arm's joints give it, so that contacts are right; the arm
    itself is left out. Further arguments as for `BulletRobot`.

    Args:
        chain: Kinematics of the robot's arm.
        q: [J], configuration of the robot.
    """

    def __init__(
        self,
        bullet: Bullet,
        robot: RobotDescription,
        files: Sequence[Path],
        step: float,
        chain: ArmChain,
        q: Array,
    ) -> None:
        self._chain = chain
        self._T_palm_link = invert_transform(robot.T_link_palm)
        self._q = np.array(q, dtype=float)
        super().__init__(bullet, robot, files, self._palm_link(self._q), step)
        self._absent = self._body < 0

    def place(self, q: ArrayLike) -> None:
        """Place the hand at its pose in this configuration [J], at rest."""
        self._q = np.array(q, dtype=float)
        position, xyzw = bullet_place(self._palm_link(self._q))
        for body in self.bodies:
            self._bullet.resetBasePositionAndOrientation(body, position, xyzw)
        super().place(q)

    def follow(self, arm: Array) -> Iterator[None]:
        """Carry the hand along the arm's configurations [K, A], one a step."""
        q = np.tile(self._q, (len(arm) + 1, 1))
        q[1:, self.robot.arm] = arm
        poses = self._palm_link(q)
        turns = poses[1:, :3, :3] @ poses[:-1, :3, :3].transpose(0, 2, 1)
        turning = rotation_vector(turns) / self._step
        try:
            for target, pose, turn in zip(arm, poses[1:], turning, strict=True):
                self._q[self.robot.arm] = target
                # From its actual pose: a step of a rotating body misses its target slightly.
                here, _ = self._bullet.getBasePositionAndOrientation(self.bodies[0])
                self._move((pose[:3, 3] - here) / self._step, turn)
                yield
        finally:
            self._move(np.zeros(3), np.zeros(3))

    def _move(self, speed: Array, turning: Array) -> None:
        # PyBullet moves a fixed base that has a velocity, and contacts take it into account.
        for body in self.bodies:
            self._bullet.resetBaseVelocity(body, speed.tolist(), turning.tolist())

    def _palm_link(self, q: Array) -> Array:
        """Poses [..., 4, 4] of the palm link at configurations [..., J]."""
        return self._chain.palm(q) @ self._T_palm_link

    def state(self) -> tuple[Array, Array]:
        q, speeds = super().state()
        q[self._absent] = self._q[self._absent]
        return q, speeds
