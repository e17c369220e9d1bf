"""Execution of a planned motion and grasp in simulation, with contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.simulation.executor import Executor, ExecutorConfig
from pointsdf_cli.simulation.film import Moment, moment_of
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.verdict import Outcome
from pointsdf_cli.simulation.world import World

Watch = Callable[[World, str], None]

APPROACH = "approach"
NO_LIFT = "no_lift"
"""Cause of a trial in which the arm cannot lift from its grasp."""


@dataclass(frozen=True)
class Executed:
    """Course of an attempt.

    Attributes:
        outcome: Outcome of closing, lifting, holding and pushing; None if the arm could not lift
            from there.
        contact: Whether the robot touched the object before the hand closed.
        moved: Displacement of the object by then [m].
        lag: Largest position error of a joint when the hand closed [rad].
        moments: The last moment of each phase, in order.
    """

    outcome: Outcome | None
    contact: bool
    moved: float
    lag: float
    moments: list[Moment]


def execute_plan(
    world: World,
    item: SimObject,
    T_world_object: Array,
    trajectory: Array,
    times: Array,
    lift: Array,
    config: ExecutorConfig | None = None,
    watch: Watch | None = None,
    others: Sequence[tuple[SimObject, Array]] = (),
) -> Executed:
    """Follow a timed trajectory to a grasp, then close, grip, lift, hold, push and judge.

    The object is free throughout: contacts move it.

    Args:
        world: World to rebuild.
        item, T_world_object: The true object and its pose [4, 4].
        trajectory: [T, J], from home to the grasp.
        times: [T], time of each configuration, s.
        lift: [K, J], the plan's lift, empty if the plan has none.
        config: As in the collection of grasps.
        watch: Called after every step.
        others: Further free objects, each with its T_world_object [4, 4].

    Raises:
        InputError: There is no trajectory.
    """
    config = config or ExecutorConfig()
    if not len(trajectory) or trajectory.shape[0] != len(times):
        raise InputError(f"a trajectory of {len(trajectory)} points", allowed="one or more")
    q = trajectory[-1]
    last = _Last(watch)
    world.reset(item, T_world_object, trajectory[0], others=others)
    stood = world.object.centre()
    contact, lag = _follow(world, trajectory, times, last)
    moved = float(np.linalg.norm(world.object.centre() - stood))
    if not len(lift):
        return Executed(None, contact, moved, lag, last.moments)
    outcome = Executor(world, config, last).run(q, lift[:, world.robot.arm])
    return Executed(outcome, contact, moved, lag, last.moments)


def _follow(world: World, trajectory: Array, times: Array, last: _Last) -> tuple[bool, float]:
    """Drive all joints along the trajectory; returns whether the object was touched, and the final
    lag."""
    robot = world.robot
    columns = np.arange(len(robot.joint_names))
    steps = max(1, round(float(times[-1] - times[0]) / world.physics.step))
    touched = False
    before = trajectory[0]
    for k in range(steps + round(REST / world.physics.step)):
        at = times[0] + min(k + 1, steps) * world.physics.step
        q = np.array([np.interp(at, times, column) for column in trajectory.T])
        world.joints.drive_to(q, columns, robot.effort, (q - before) / world.physics.step)
        before = q
        world.step()
        touched = touched or world.robot_contact().links > 0
        last(world, APPROACH)
    lag = float(np.abs(world.configuration() - trajectory[-1]).max())
    return touched, lag


REST = 0.3
"""Time for the arm to come to rest before the hand closes [s]."""


class _Last:
    """Recorder of the last moment of every phase."""

    def __init__(self, watch: Watch | None) -> None:
        self._watch = watch
        self._steps = 0
        self.moments: list[Moment] = []

    def __call__(self, world: World, phase: str) -> None:
        self._steps += 1
        begun = bool(self.moments) and self.moments[-1].phase == phase
        if self._steps % 8 == 0 or not begun:
            if begun:
                self.moments.pop()
            self.moments.append(moment_of(world, phase))
        if self._watch:
            self._watch(world, phase)
