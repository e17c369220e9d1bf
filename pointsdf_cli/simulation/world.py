"""A table, the robot and objects in PyBullet, rebuilt for every attempt so that it replays."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.scratch import Scratch
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.bullet import Bullet
from pointsdf_cli.simulation.bullet_object import BulletObject, write_pieces
from pointsdf_cli.simulation.bullet_robot import BulletRobot, CarriedHand
from pointsdf_cli.simulation.bullet_urdf import bullet_urdf, hand_urdfs
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


class RobotContact(NamedTuple):
    """Contact of the robot with the object.

    Attributes:
        links: Number of the robot's links that touch the object.
        hand_links: Number of the hand's links that touch it.
        depth: Deepest overlap of any robot link with the object [m], 0 if none.
    """

    links: int
    hand_links: int
    depth: float


class World:
    """One physics client; not to be shared between processes.

    Args:
        robot: The robot.
        physics: Step, iterations, friction; all but its skin may be changed later.

    Attributes:
        chain: Kinematics of the robot's arm.
        joints: The simulated part of the robot, from a reset on.
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
        self._bullet = Bullet()
        self._end = weakref.finalize(self, self._bullet.disconnect)
        self._scratch = Scratch()
        self._folder = self._scratch.path
        self._whole = [bullet_urdf(robot, self._folder, self._skin)]
        self._written: dict[Path, Pieces] = {}
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
        b = self._bullet
        b.resetSimulation()
        b.setPhysicsEngineParameter(
            fixedTimeStep=self.physics.step,
            numSolverIterations=self.physics.iterations,
            erp=JOINT_RECOVERY * self.physics.step,
            contactERP=CONTACT_RECOVERY * self.physics.step,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
        )
        b.setGravity(0, 0, -GRAVITY)
        self._steps = 0
        self._shown = None
        self._add_table()
        self._object: BulletObject | None = None
        if robot != "none":
            self._add_robot(self.robot.home if q is None else np.asarray(q), robot == "hand")
        if item is not None:
            place = np.eye(4) if T_world_object is None else T_world_object
            self._object = self._added(item, place, self._folder / "object.obj")
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
            self.object.place(T_world_object)
        # Clear PyBullet's cached contacts of the former poses.
        self.collisions(self.robot.home)

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps."""
        for _ in range(count):
            self._bullet.stepSimulation()
        self._steps += count

    @property
    def time(self) -> float:
        """Simulated seconds since `reset`."""
        return self._steps * self.physics.step

    # --- the robot ---

    def configuration(self) -> Array:
        """Joint positions, [J]."""
        return self.joints.state()[0]

    def palm_pose(self) -> Array:
        """T_world_palm [4, 4] by the arm's joints."""
        return self.chain.palm(self.configuration())

    def collisions(self, q: ArrayLike, clearance: float = 0.0) -> set[str]:
        """Contacts of the robot at a configuration: any of "table", "object", "self".

        Args:
            q: [J], to which the robot is moved; parts that are not simulated have no contacts.
            clearance: Distances below this [m] count as contact.
        """
        b = self._bullet
        self.joints.place(q)
        b.performCollisionDetection()
        touched = set()
        for body in self.joints.bodies:
            for contact in b.getContactPoints(bodyA=body):
                if contact[8] >= clearance:
                    continue
                other = contact[2] if contact[1] == body else contact[1]
                if other == self._object_body:
                    touched.add("object")
                elif other == self._table:
                    touched.add("table")
                elif other in self.joints.bodies:
                    touched.add("self")
        return touched

    # --- the object ---

    @property
    def object(self) -> BulletObject:
        """The object to be grasped."""
        if self._object is None:
            raise RuntimeError("there is no object in the scene")
        return self._object

    @property
    def _object_body(self) -> int:
        return -1 if self._object is None else self._object.body

    def robot_contact(self) -> RobotContact:
        """Present contacts of the robot with the object."""
        points = [
            point
            for body in self.joints.bodies
            for point in self._bullet.getContactPoints(bodyA=body, bodyB=self._object_body)
        ]
        links = {(point[1], point[3]) for point in points if point[9] > 0.0 or point[8] < 0.0}
        depth = max([0.0, *(-point[8] for point in points)])
        return RobotContact(len(links), len(links & self._hand_links), depth)

    def rises_into_object(self, aside: float) -> bool:
        """Whether a link could meet the object on its way straight up.

        Conservative: uses upright boxes around links and object.

        Args:
            aside: Distance [m] below which they meet, on all sides and upwards.
        """
        low, high = self._bullet.getAABB(self.object.body, -1)
        for link, place in self.joints.links.items():
            if self.robot.tree.shapes.get(link):
                at, end = self._bullet.getAABB(*place)
                beside = (at[k] < high[k] + aside and end[k] > low[k] - aside for k in (0, 1))
                if at[2] < high[2] + aside and all(beside):
                    return True
        return False

    def object_on_table(self) -> bool:
        """Whether the object touches the table."""
        points = self._bullet.getContactPoints(bodyA=self._table, bodyB=self._object_body)
        return any(point[8] < 1e-3 for point in points)

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Change gravity [3] [m/s²]; shaking a frame is the same as shaking gravity in it."""
        self._bullet.setGravity(*np.asarray(gravity, float))

    # --- building ---

    @cached_property
    def _hand(self) -> list[Path]:
        return hand_urdfs(self.robot, self._folder, self._skin)

    def _add_table(self) -> None:
        b = self._bullet
        size = np.array([*np.subtract(TABLE_HIGH, TABLE_LOW), 0.1])
        shape = b.createCollisionShape(b.GEOM_BOX, halfExtents=(size / 2).tolist())
        centre = [*(np.add(TABLE_HIGH, TABLE_LOW) / 2), self.table_height - size[2] / 2]
        self._table = b.createMultiBody(0, shape, basePosition=centre)
        b.changeDynamics(self._table, -1, lateralFriction=TABLE_FRICTION)

    def _add_robot(self, q: Array, hand_alone: bool) -> None:
        b, robot, step = self._bullet, self.robot, self.physics.step
        self.joints: BulletRobot
        if hand_alone:
            self.joints = CarriedHand(b, robot, self._hand, step, self.chain, q)
        else:
            self.joints = BulletRobot(b, robot, self._whole, robot.T_world_base, step)
        links = self.joints.links
        for link in sorted(robot.links_on_table & set(links)):
            body, number = links[link]
            b.setCollisionFilterPair(body, self._table, number, -1, 0)
        # In a fixed order: it determines the order of PyBullet's pairs, and so of contacts.
        self.joints.ignore_contacts(sorted(map(sorted, robot.may_touch | robot.tree.neighbours())))
        self._hand_links = {links[link] for link in robot.hand_links}
        for body, number in sorted(self._hand_links):
            b.changeDynamics(body, number, lateralFriction=HAND_FRICTION)
        self.joints.place(q)
        self.joints.drive_to(q, np.arange(len(robot.joint_names)), robot.effort)

    def _added(self, item: SimObject, T_world_object: Array, path: Path) -> BulletObject:
        # Compared by identity: changed pieces are another list.
        if self._written.get(path) is not item.pieces:
            write_pieces(item.pieces, path, self._skin)
            self._written[path] = item.pieces
        return BulletObject(self._bullet, item, path, T_world_object, self.physics)


def try_robot(robot: RobotDescription) -> None:
    """Build the whole robot once, as for trials, and its hand alone once, as for collection.

    Raises:
        InputError: PyBullet cannot load it, or a joint of the arm does not move the palm.
        RgraspError: PyBullet is not installed.
    """
    with World(robot) as world:
        world.reset()
        world.reset(robot="hand")
