"""A table, the robot and objects in PyBullet, rebuilt for every attempt so that it replays."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.scratch import Scratch
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.bullet import import_bullet
from pointsdf_cli.simulation.bullet_object import BulletObject, write_pieces
from pointsdf_cli.simulation.bullet_robot import BulletRobot, CarriedHand
from pointsdf_cli.simulation.bullet_urdf import bullet_urdf, hand_urdfs
from pointsdf_cli.simulation.contacts import RobotContact, any_below, contact_of
from pointsdf_cli.simulation.decomposition import Pieces
from pointsdf_cli.simulation.physics import (
    CONTACT_RECOVERY,
    GRAVITY,
    HAND_FRICTION,
    JOINT_RECOVERY,
    TABLE_FRICTION,
    PhysicsConfig,
)
from pointsdf_cli.simulation.sim_object import SimObject

TABLE_LOW, TABLE_HIGH = (-0.35, -0.75), (1.25, 0.75)
"""Corners of the table top in the world [m]."""


class World:
    """One physics client; not to be shared between processes.

    Args:
        robot: The robot.
        physics: Step, iterations, friction; all but its skin may be changed later.

    Attributes:
        chain: Kinematics of the robot's arm.
        table_height: Height of the table from the next reset on [m].
        others: Free objects beside the one to be grasped.

    Raises:
        RgraspError: PyBullet is not installed.
    """

    def __init__(self, robot: RobotDescription, physics: PhysicsConfig | None = None) -> None:
        self.robot = robot
        self.physics = physics or PhysicsConfig()
        self._skin = self.physics.skin  # of files, which are written once
        self.chain = ArmChain(robot)
        self.table_height = 0.0
        self._bullet = import_bullet()
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self._end = weakref.finalize(self, self._bullet.disconnect, self._client)
        self._scratch = Scratch()
        self._folder = self._scratch.path
        self._whole = [bullet_urdf(robot, self._folder, self._skin)]
        self._object_file: tuple[Pieces, Path] | None = None
        self._shown: Pieces | None = None
        self._steps = 0
        self.others: tuple[BulletObject, ...] = ()

    def close(self) -> None:
        """Disconnect and remove temporary files; so does the end of the world's own life."""
        self._end()
        self._scratch.close()

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def reset(
        self,
        item: SimObject | None = None,
        T_world_object: Array | None = None,
        q: ArrayLike | None = None,
        robot: Literal["whole", "hand", "none"] = "whole",
        others: Sequence[tuple[SimObject, Array]] = (),
    ) -> None:
        """Rebuild the scene, so that attempts do not depend on earlier ones.

        Args:
            item: The object; None for none.
            T_world_object: [4, 4], its mesh frame in the world.
            q: [J], the robot's configuration; home if None.
            robot: Simulated part of the robot: the whole; the hand on a rigid arm, several times as
                fast; or nothing.
            others: Further free objects, each with its T_world_object [4, 4].
        """
        b, c = self._bullet, self._client
        b.resetSimulation(physicsClientId=c)
        b.setPhysicsEngineParameter(
            fixedTimeStep=self.physics.step,
            numSolverIterations=self.physics.iterations,
            erp=JOINT_RECOVERY * self.physics.step,
            contactERP=CONTACT_RECOVERY * self.physics.step,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            physicsClientId=c,
        )
        b.setGravity(0, 0, -GRAVITY, physicsClientId=c)
        self._steps = 0
        self._shown = None
        self._add_table()
        self._object: BulletObject | None = None
        if robot != "none":
            self._add_robot(self.robot.home if q is None else np.asarray(q), robot == "hand")
        if item is not None:
            self._add_object(item, np.eye(4) if T_world_object is None else T_world_object)
        self.others = tuple(
            self._added(other, place, self._folder / f"other{k}.obj")
            for k, (other, place) in enumerate(others)
        )

    def show(self, item: SimObject, T_world_object: Array) -> None:
        """Show the whole robot at home and an object, to check collisions at rest.

        Same result as `reset`, but existing bodies are only moved.

        Args:
            item: The object.
            T_world_object: [4, 4], its mesh frame in the world.
        """
        if self._steps or self._shown is not item.pieces:
            self.reset(item, T_world_object)
            self._shown = item.pieces
        else:
            self._there.place(T_world_object)
        # Clear PyBullet's cached contacts of the former poses.
        self.collisions(self.robot.home)

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps."""
        for _ in range(count):
            self._bullet.stepSimulation(physicsClientId=self._client)
        self._steps += count

    @property
    def time(self) -> float:
        """Simulated seconds since `reset`."""
        return self._steps * self.physics.step

    # --- the robot ---

    def place(self, q: ArrayLike) -> None:
        """Put the robot at a configuration [J] at rest, without physics."""
        self._robot.place(q)

    def configuration(self) -> Array:
        """Joint positions, [J]."""
        return self._robot.state()[0]

    def joint_state(self) -> tuple[Array, Array]:
        """Joint positions and velocities, [J] each."""
        return self._robot.state()

    def palm_pose(self) -> Array:
        """T_world_palm [4, 4] by the arm's joints."""
        return self.chain.palm(self.configuration())

    def drive_to(
        self,
        q: ArrayLike,
        columns: ArrayLike,
        forces: ArrayLike,
        speeds: ArrayLike | None = None,
    ) -> None:
        """Set position targets for the joints at `columns` of q, with their largest efforts.

        Args:
            q: [J], target configuration.
            columns: [K], indices of the joints. Joints of an arm that is not simulated stay.
            forces: [K], largest efforts.
            speeds: [K], speeds of moving targets, so that joints do not lag behind; 0 if None.
        """
        speeds = np.zeros(len(np.asarray(columns))) if speeds is None else speeds
        self._robot.drive_to(q, columns, forces, speeds)

    def drive_at(self, speeds: ArrayLike, columns: ArrayLike, forces: ArrayLike) -> None:
        """Set speed targets for the joints at `columns` of q, with their largest efforts."""
        self._robot.drive_at(speeds, columns, forces)

    def follow(self, arm: Array) -> Iterator[None]:
        """Move the arm through configurations [K, A]; yields when the next step may be made."""
        yield from self._robot.follow(arm)

    def collisions(self, q: ArrayLike, clearance: float = 0.0) -> set[str]:
        """Contacts of the robot at a configuration: any of "table", "object", "self".

        Args:
            q: [J], to which the robot is moved; parts that are not simulated have no contacts.
            clearance: Distances below this [m] count as contact.
        """
        b, c = self._bullet, self._client
        self.place(q)
        b.performCollisionDetection(physicsClientId=c)
        touched = set()
        for body in self._robot.bodies:
            for contact in b.getContactPoints(bodyA=body, physicsClientId=c):
                if contact[8] >= clearance:
                    continue
                other = contact[2] if contact[1] == body else contact[1]
                if other == self._object_body:
                    touched.add("object")
                elif other == self._table:
                    touched.add("table")
                elif other in self._robot.bodies:
                    touched.add("self")
        return touched

    # --- the object ---

    @property
    def _there(self) -> BulletObject:
        if self._object is None:
            raise RuntimeError("there is no object in the scene")
        return self._object

    @property
    def _object_body(self) -> int:
        return -1 if self._object is None else self._object.body

    def object_pose(self) -> Array:
        """T_world_object [4, 4], the mesh frame in the world."""
        return self._there.pose()

    def object_centre(self) -> Array:
        """The object's centre of mass [3] in the world."""
        return self._there.centre()

    def object_speed(self) -> tuple[float, float]:
        """Speed of the object's centre of mass [m/s] and its angular speed [rad/s]."""
        return self._there.speed()

    def robot_contact(self) -> RobotContact:
        """Present contacts of the robot with the object."""
        return contact_of(
            self._bullet, self._client, self._robot.bodies, self._object_body, self._hand_links
        )

    def rises_into_object(self, aside: float) -> bool:
        """Whether a link could meet the object on its way straight up.

        Conservative: uses upright boxes around links and object.

        Args:
            aside: Lateral distance [m] below which they meet.
        """
        links = [
            place for link, place in self._robot.links.items() if self.robot.tree.shapes.get(link)
        ]
        return any_below(self._bullet, self._client, links, self._there.body, aside)

    def object_on_table(self) -> bool:
        """Whether the object touches the table."""
        points = self._bullet.getContactPoints(
            bodyA=self._table, bodyB=self._object_body, physicsClientId=self._client
        )
        return any(point[8] < 1e-3 for point in points)

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Change gravity [3] [m/s²]; shaking a frame is the same as shaking gravity in it."""
        self._bullet.setGravity(*np.asarray(gravity, float), physicsClientId=self._client)

    def push(self, force: Array) -> None:
        """Apply a force [3] [N] at the object's centre of mass during the next step."""
        self._there.push(force)

    # --- building ---

    @cached_property
    def _hand(self) -> list[Path]:
        return hand_urdfs(self.robot, self._folder, self._skin)

    def _add_table(self) -> None:
        b, c = self._bullet, self._client
        size = np.array([*np.subtract(TABLE_HIGH, TABLE_LOW), 0.1])
        shape = b.createCollisionShape(
            b.GEOM_BOX, halfExtents=(size / 2).tolist(), physicsClientId=c
        )
        centre = [*(np.add(TABLE_HIGH, TABLE_LOW) / 2), self.table_height - size[2] / 2]
        self._table = b.createMultiBody(0, shape, basePosition=centre, physicsClientId=c)
        b.changeDynamics(self._table, -1, lateralFriction=TABLE_FRICTION, physicsClientId=c)

    def _add_robot(self, q: Array, hand_alone: bool) -> None:
        b, c, robot = self._bullet, self._client, self.robot
        recovery = JOINT_RECOVERY * self.physics.step
        self._robot: BulletRobot
        if hand_alone:
            step = self.physics.step
            self._robot = CarriedHand(b, c, robot, self._hand, recovery, self.chain, q, step)
        else:
            self._robot = BulletRobot(b, c, robot, self._whole, robot.T_world_base, recovery)
        links = self._robot.links
        for link in sorted(robot.links_on_table & set(links)):
            body, number = links[link]
            b.setCollisionFilterPair(body, self._table, number, -1, 0, physicsClientId=c)
        # In a fixed order: it determines the order of PyBullet's pairs, and so of contacts.
        self._robot.ignore_contacts(sorted(map(sorted, robot.may_touch | robot.tree.neighbours())))
        self._hand_links = {links[link] for link in robot.hand_links}
        for body, number in sorted(self._hand_links):
            b.changeDynamics(body, number, lateralFriction=HAND_FRICTION, physicsClientId=c)
        self.place(q)
        self.drive_to(q, np.arange(len(robot.joint_names)), robot.effort)

    def _add_object(self, item: SimObject, T_world_object: Array) -> None:
        # Compared by identity: changed pieces are another list.
        if self._object_file is None or self._object_file[0] is not item.pieces:
            path = self._folder / "object.obj"
            write_pieces(item.pieces, path, self._skin)
            self._object_file = item.pieces, path
        path = self._object_file[1]
        self._object = BulletObject(
            self._bullet, self._client, item, path, T_world_object, self.physics
        )

    def _added(self, item: SimObject, T_world_object: Array, path: Path) -> BulletObject:
        write_pieces(item.pieces, path, self._skin)
        return BulletObject(self._bullet, self._client, item, path, T_world_object, self.physics)


def try_robot(robot: RobotDescription) -> None:
    """Build the whole robot once, as for trials, and its hand alone once, as for collection.

    Raises:
        InputError: PyBullet cannot load it, or a joint of the arm does not move the palm.
        RgraspError: PyBullet is not installed.
    """
    with World(robot) as world:
        world.reset()
        world.reset(robot="hand")
