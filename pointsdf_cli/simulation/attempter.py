"""Source of attempts: a scene, a view of it, a preshape, a path to it, and its execution.

Preshapes come from the paper's heuristic, or from a planner that has seen the same view.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Literal

import numpy as np

from pointsdf_cli.choices import SIDE
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.cloud_sampling import systematic_sample
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.stable_poses import STANDING, draw_pose
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.grasps import (
    CAUSES,
    LOST,
    NO_CONFIGURATION,
    NO_MOTION,
    SIMULATED,
    Grasps,
)
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.inverse_kinematics import IkConfig, InverseKinematics
from pointsdf_cli.robot.lift import lift_path
from pointsdf_cli.simulation.attempt import (
    SCENE_ATTEMPTS,
    Attempt,
    AttemptConfig,
    ObservedScene,
    PlannedPreshape,
    Propose,
)
from pointsdf_cli.simulation.executor import Executor
from pointsdf_cli.simulation.feet import nearest_pose, on_its_foot
from pointsdf_cli.simulation.heuristic import draw_preshape, hand_of
from pointsdf_cli.simulation.observe import Observer
from pointsdf_cli.simulation.preshape_path import PreshapePath, PreshapePathFinder, start_cause
from pointsdf_cli.simulation.settle import placed, settle, shows
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.verdict import Outcome
from pointsdf_cli.simulation.world import World

CLOUD_SIZE = 1000
SCENE_TRIES = 12


LOW, HIGH = (0.60, -0.15), (0.74, 0.15)
"""Corners of the region for the object on the table [m], where the arm reaches most preshapes."""
WIDEST = 0.14
"""Largest length of an object's shortest side that fits the hand [m]."""
INVERSE = IkConfig(iterations=12)
"""Inverse kinematics, with half the iterations of a plan: few more are reached later."""


class Attempter:
    """Source of attempts; attempt i of an object does not depend on the others or on their order.

    Args:
        robot: The robot.
        config: Settings that determine the outcome.
        seed: Random seed.
        propose: Source of preshapes; the heuristic if None.
    """

    def __init__(
        self,
        robot: RobotDescription,
        config: AttemptConfig | None = None,
        seed: int = 0,
        propose: Propose | None = None,
    ) -> None:
        self.robot = robot
        self.config = config or AttemptConfig()
        self.seed = seed
        self.world = World(robot, self.config.physics)
        # Never stepped, so it is not rebuilt for each attempt.
        self.checks = World(robot, self.config.physics)
        self._observer = Observer(robot, self.config.placement)
        self._path_to = PreshapePathFinder(self.checks, InverseKinematics(robot, INVERSE))
        self._hand = hand_of(robot)
        self._settled: dict[tuple[str, int], Array | None] = {}
        self._feet: tuple[SimObject, dict[int, SimObject]] | None = None
        self._last_scene: tuple[tuple[str, str, int], ObservedScene] | None = None
        self._propose = propose
        self._proposed: tuple[ObservedScene, list[PlannedPreshape]] | None = None

    def close(self) -> None:
        """Close the physics clients."""
        self.world.close()
        self.checks.close()

    def check(self, item: SimObject) -> None:
        """Refuse objects too large for the hand.

        Raises:
            InputError: The object is wider than the opened hand in every direction.
        """
        from trimesh.bounds import oriented_bounds

        _, sides = oriented_bounds(item.mesh.vertices)
        jaws = self._hand.jaws
        widest = WIDEST if jaws is None else min(WIDEST, jaws.room)
        if min(sides) > widest:
            what = f"is too large for the hand: {min(sides):.3f} m at its narrowest"
            raise InputError(what, where=item.mesh.name, allowed=f"one side below {widest:g} m")

    def attempt(self, item: SimObject, index: int) -> Attempt:
        """Make attempt `index` with an object.

        Raises:
            InputError: The object never comes to rest, or no view shows it.
        """
        scene = self.scene(item, index // SCENE_ATTEMPTS)
        rng = self._rng(item, 2, index)
        preshape = self._drawn if self._propose is None else self._planned
        kind, T_world_palm, reach = preshape(item, scene, index, rng)
        cloud = scene.cloud[systematic_sample(scene.cloud[:, :2], CLOUD_SIZE, rng)]
        outcome = None
        if not reach.cause:
            outcome = self.execute(item, scene.T_world_object, reach.q, reach.lift)
        return Attempt(index, scene, cloud.astype(np.float32), kind, T_world_palm, reach, outcome)

    def _drawn(
        self, item: SimObject, scene: ObservedScene, index: int, rng: np.random.Generator
    ) -> tuple[str, Array, PreshapePath]:
        """Kind and palm pose [4, 4] of a preshape of the heuristic, and the path to it."""
        points = apply_transform(scene.T_world_camera, scene.cloud)
        camera, base = scene.T_world_camera[:3, 3], self.robot.T_world_base[:3, 3]
        preshape = draw_preshape(points, camera, base, self._hand, self.config.heuristic, rng)
        arms = self._path_to.arms(preshape.T_world_palm)
        if len(arms):
            self.checks.show(self._standing(item, scene.T_world_object), scene.T_world_object)
        reach = self._path_to(preshape.T_world_palm, preshape.joints, arms)
        return preshape.kind, preshape.T_world_palm, reach

    def _planned(
        self, item: SimObject, scene: ObservedScene, index: int, rng: np.random.Generator
    ) -> tuple[str, Array, PreshapePath]:
        """Kind and palm pose [4, 4] of a preshape from the planner, and the lift from there.

        A motion is not looked for: `plan` searches one later. A preshape inside the true object
        counts as lost, since a plan cannot know it.
        """
        assert self._propose is not None
        if self._proposed is None or self._proposed[0] is not scene:
            stream = self._rng(item, 3, index // SCENE_ATTEMPTS)
            self._proposed = scene, self._propose(scene, stream)
        proposed, which = self._proposed[1], index % SCENE_ATTEMPTS
        chain, home = self._path_to.chain, self.robot.home
        if which >= len(proposed):
            return SIDE, chain.palm(home), PreshapePath(NO_CONFIGURATION, "no_plan", home)
        one = proposed[which]
        self.checks.show(self._standing(item, scene.T_world_object), scene.T_world_object)
        cause = start_cause(self.checks.collisions(one.q))
        if cause:
            label = LOST if cause == "start_in_object" else NO_CONFIGURATION
            reach = PreshapePath(label, cause, one.q)
        elif (lift := lift_path(chain, one.q)) is None:
            reach = PreshapePath(NO_MOTION, "no_lift", one.q)
        else:
            reach = PreshapePath(LOST, "", one.q, lift=lift)
        return one.kind, one.T_world_palm, reach

    def execute(
        self,
        item: SimObject,
        T_world_object: Array,
        q: Array,
        lift: Array,
        watch: Callable[[World, str], None] | None = None,
    ) -> Outcome:
        """Execute a grasp in a rebuilt world, so that equal inputs give equal outcomes."""
        there: Literal["hand", "whole"] = "hand" if self.config.hand_alone else "whole"
        self.world.reset(self._standing(item, T_world_object), T_world_object, q, there)
        return Executor(self.world, self.config.execution, watch).run(q, lift)

    def replay(
        self,
        item: SimObject,
        grasps: Grasps,
        row: int,
        watch: Callable[[World, str], None] | None = None,
        planned: bool = False,
    ) -> Outcome:
        """Execute a stored grasp again: same object, pose and preshape, same outcome.

        Args:
            item: The object.
            grasps: Its stored attempts.
            row: The attempt.
            watch: As in `Executor`.
            planned: A planner proposed the grasp.

        Raises:
            InputError: The attempt was never simulated, or the arm has no room to lift.
        """
        if not grasps.simulated[row]:
            what = f"attempt {row} was never executed ({CAUSES[grasps.cause[row]]})"
            allowed = "attempts that ended as " + ", ".join(SIMULATED)
            raise InputError(what, where=item.mesh.name, allowed=allowed)
        q = grasps.q[row]
        if planned:  # the lift that `plan` would take
            lift = lift_path(self._path_to.chain, q)
        else:
            lift = self._path_to.lift(q, grasps.T_world_palm[row])
        if lift is None:
            raise InputError("the arm has no room to lift from this configuration")
        return self.execute(item, grasps.T_world_object[row], q, lift, watch)

    def scene(self, item: SimObject, index: int) -> ObservedScene:
        """Make scene `index` of an object.

        Raises:
            InputError: The object never comes to rest, or no view shows it.
        """
        key = (item.mesh.name, item.mesh.identity, index)
        if self._last_scene is None or self._last_scene[0] != key:
            self._last_scene = key, self._draw_scene(item, self._rng(item, 1, index))
        return self._last_scene[1]

    def _draw_scene(self, item: SimObject, rng: np.random.Generator) -> ObservedScene:
        problem = "never comes to rest on a table"
        for _ in range(SCENE_TRIES):
            which, _ = draw_pose(item.poses, STANDING, rng)
            resting = self._resting(item, which)
            yaw, place = rng.uniform(-np.pi, np.pi), rng.uniform(LOW, HIGH)
            T_world_camera = self.config.placement.draw(np.array([*place, 0.08]), rng)
            if resting is None:
                continue
            pose = placed(resting, item, float(yaw), place)
            try:
                view = self._observer.object_view(item, pose, T_world_camera, rng)
            except InputError as error:
                problem = f"is not seen by the camera: {error.what}"
                continue
            if not shows(item, pose, apply_transform(T_world_camera, view.points)):
                problem = "is not what the segmentation finds on the table"
                continue
            return ObservedScene(pose, T_world_camera, view.points, view.evidence or ViewEvidence())
        raise InputError(problem, where=item.mesh.name)

    def _resting(self, item: SimObject, which: int) -> Array | None:
        """Settled pose of one stable pose, cached."""
        key = (item.mesh.identity, which)
        if key not in self._settled:
            if len(self._settled) > 256:
                self._settled.clear()  # objects come one after the other
            pose = item.poses[which]
            standing = self._standing(item, pose.T_table_object)
            self._settled[key] = settle(self.world, standing, pose)
        return self._settled[key]

    def _standing(self, item: SimObject, T_world_object: Array) -> SimObject:
        """The object with a flat foot for its nearest resting pose."""
        if self._feet is None or self._feet[0] is not item:
            self._feet = item, {}
        which, made = nearest_pose(item, T_world_object), self._feet[1]
        if which not in made:
            made[which] = on_its_foot(item, item.poses[which])
        return made[which]

    def _rng(self, item: SimObject, stream: int, index: int) -> np.random.Generator:
        name = zlib.crc32(item.mesh.name.encode())
        return np.random.default_rng([self.seed, name, stream, index])
