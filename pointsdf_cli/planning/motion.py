"""Motion from the start to the grasp: preshape, free path, straight approach.

The paper: up to three attempts at a collision-free joint-space path. Here the straight joint-space
way is tried first, then the way over a place above the approach, then OMPL's RRT-Connect. All paths
are checked along their whole length (`path_check.py`), by one validator for planning, shortcutting
and the result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.approach import retreat, with_arm
from pointsdf_cli.planning.cancellation import is_cancelled, stop_if_cancelled
from pointsdf_cli.planning.option_checks import SPEED, check_speed
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.planning.timing import Trajectory, time_path
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.robot.lift import lift_path

ABOVE = (0.1, 0.2, 0.3)
"""Heights [m] of a place above the beginning of the approach, tried in turn. A way over such a
place is nearly always free, and found in a third of a search's time (docs/notebook.md)."""
LONGEST_EDGE = 0.8
"""Longest edge of the tree [rad]: longer ones are seldom free."""
SHORTCUTS = 30
"""Rounds of shortcutting: more shorten the path no further."""


@dataclass(frozen=True)
class MotionConfig:
    """Effort of the search.

    Attributes:
        attempts: Searches with another seed each (the paper: three).
        checks: Largest number of configurations that a search checks. A limit in seconds, even of
            processor time, would make plans depend on the machine and on what else runs there.
        speed: Share of the joints' speed limits.
    """

    attempts: int = 3
    checks: int = 8000
    speed: float = SPEED

    def __post_init__(self) -> None:
        check_speed(self.speed)


@dataclass(frozen=True)
class Motion:
    """A motion, or the reason why there is none.

    Attributes:
        trajectory: None if there is none.
        corners: [T, J], the path before it was timed; empty if there is none.
        failure: Empty, or what could not be done.
        attempts: Searches made.
        checked: Number of configurations checked.
        lift: [K, J], the way up from the goal; None if there is none, or none was looked for.
    """

    trajectory: Trajectory | None
    corners: Array
    failure: str
    attempts: int
    checked: int = 0
    lift: Array | None = None


def plan_motion(
    checker: PathChecker,
    kinematics: InverseKinematics,
    start: Array,
    goal: Array,
    seed: int = 0,
    config: MotionConfig | None = None,
) -> Motion:
    """Plan from start to goal [J].

    Equal seeds give equal motions.

    Raises:
        InputError: The start is not within the joint limits.
    """
    begun = checker.checked
    found = _plan_motion(checker, kinematics, start, goal, seed, config or MotionConfig())
    return replace(found, checked=checker.checked - begun)


def _plan_motion(
    checker: PathChecker,
    kinematics: InverseKinematics,
    start: Array,
    goal: Array,
    seed: int,
    config: MotionConfig,
) -> Motion:
    robot = checker.kinematics.robot
    if not ((start >= robot.hard_lower - 1e-6) & (start <= robot.hard_upper + 1e-6)).all():
        raise InputError("the start is outside of the joint limits", where="--start")
    if checker.slack(start[None])[0] < 0:
        return _failed("the robot touches something where it starts", 0)
    back = retreat(checker, kinematics.chain, goal)
    if back is None:
        return _failed("no straight retreat from the grasp is free", 0)
    shaped = goal.copy()
    shaped[robot.arm] = start[robot.arm]
    if not checker.is_free(np.stack([start, shaped])):
        return _failed("the hand cannot take its preshape where the robot starts", 0)
    simple = _simple_path(checker, kinematics.chain, shaped, back[-1])
    for attempt in range(config.attempts):
        stop_if_cancelled()
        middle = simple
        if middle is None:
            middle = _connect(checker, shaped, back[-1], 1 + seed + 7919 * attempt, config)
        if middle is None:
            continue
        corners = np.concatenate([start[None], middle, back[::-1][1:]])
        return Motion(time_path(corners, robot.velocity, config.speed), corners, "", attempt + 1)
    return _failed("no free way was found to where the approach begins", config.attempts)


def _failed(why: str, attempts: int) -> Motion:
    return Motion(None, np.zeros((0, 0)), why, attempts)


def _simple_path(checker: PathChecker, chain: ArmChain, start: Array, goal: Array) -> Array | None:
    """A free arm path [T, J] between two configurations with the same hand: the straight one, or
    one over a place above the goal; None if neither is free."""
    straight = np.stack([start, goal])
    if checker.is_free(straight):
        return straight
    for height in ABOVE:
        rise = lift_path(chain, goal, height)
        if rise is None:
            continue
        down = with_arm(chain.robot, goal, rise[::-1])
        if not checker.is_free(np.stack([start, down[0]])):
            continue
        for way in (down[[0, -1]], down):
            if checker.is_free(way):
                return np.concatenate([start[None], way])
    return None


def _connect(
    checker: PathChecker, start: Array, goal: Array, seed: int, config: MotionConfig
) -> Array | None:
    """A free arm path [T, J] between two configurations with the same hand, by search and
    shortened."""
    robot = checker.kinematics.robot
    arm = np.arange(len(start))[robot.arm]
    ou.setLogLevel(ou.LogLevel.LOG_NONE)  # it writes to stdout, which belongs to --json
    ou.RNG.setSeed(seed)  # 0 would become 1
    space = ob.RealVectorStateSpace(len(arm))
    bounds = ob.RealVectorBounds(len(arm))
    # The start may be nearer to a hard stop than plans go.
    for j, column in enumerate(arm):
        bounds.setLow(j, float(min(robot.lower[column], start[column])))
        bounds.setHigh(j, float(max(robot.upper[column], start[column])))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)

    def whole(state: ob.State) -> Array:
        q = goal.copy()
        q[arm] = [state[j] for j in range(len(arm))]
        return q

    moving = np.zeros(len(start), dtype=bool)
    moving[arm] = True
    information.setStateValidityChecker(
        lambda state: bool(checker.slack(whole(state)[None], moving)[0] >= 0)
    )
    information.setMotionValidator(_Validator(information, checker, whole))
    information.setup()
    problem = ob.ProblemDefinition(information)
    first, last = space.allocState(), space.allocState()
    for j, column in enumerate(arm):
        first[j], last[j] = float(start[column]), float(goal[column])
    problem.setStartAndGoalStates(first, last)
    planner = og.RRTConnect(information)
    planner.setRange(LONGEST_EDGE)
    planner.setProblemDefinition(problem)
    planner.setup()
    most = checker.checked + config.checks
    ends = ob.PlannerTerminationCondition(lambda: checker.checked > most or is_cancelled())
    solved = planner.solve(ends)
    stop_if_cancelled()
    if not solved:
        return None
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    simplifier = og.PathSimplifier(information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS, 0.33, 0.005)
    corners = np.array([whole(path.getState(i)) for i in range(path.getStateCount())])
    corners[0], corners[-1] = start, goal
    return corners if checker.is_free(corners) else None


class _Validator(ob.MotionValidator):
    """A whole edge at once, proven free or not."""

    def __init__(self, information: ob.SpaceInformation, checker: PathChecker, whole) -> None:  # type: ignore[no-untyped-def]
        super().__init__(information)
        self._checker, self._whole = checker, whole

    def checkMotion(self, first: ob.State, second: ob.State, last: object = None) -> bool:
        ways = np.stack([self._whole(first), self._whole(second)])
        return bool(self._checker.is_free(ways))
