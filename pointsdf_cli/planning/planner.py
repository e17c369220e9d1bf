"""The whole planner: from an object's field, score and prior to a plan or the reason for none."""

from __future__ import annotations

import time
from collections.abc import Container, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain

import numpy as np

from pointsdf_cli import choices
from pointsdf_cli.choices import require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.models.processor import one_thread, timed, timed_stage
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.antipodal import antipodal_grasps
from pointsdf_cli.planning.approach import with_arm
from pointsdf_cli.planning.closing_check import ClosingCheck
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.fields import RefinedField, cautious
from pointsdf_cli.planning.grasp_problem import Clearances, GraspProblem
from pointsdf_cli.planning.grid import GridField
from pointsdf_cli.planning.likeliest import PREFERRED_SLACK
from pointsdf_cli.planning.motion import Motion, MotionConfig, plan_motion
from pointsdf_cli.planning.nonlinear import Solver
from pointsdf_cli.planning.option_checks import MARGIN, check_distance
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.planning.plan_artifact import Outcome
from pointsdf_cli.planning.reasons import explain, warning
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.slsqp import Slsqp
from pointsdf_cli.planning.sqp import Sqp, SqpConfig
from pointsdf_cli.planning.synthesis import (
    SOLVER_MARGIN,
    Problems,
    Synthesis,
    SynthesisConfig,
    synthesise,
)
from pointsdf_cli.planning.target import KEPT_GRID, Target
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.lift import lift_path

SUCCESSIVE_HALVING = (6, 11)
"""Iterations of `sqp` after which the worse half of the seeds stops: seeds that cost three times as
much as the best after six iterations do not catch up."""

QUICK_CHECKS = 1000
"""Configurations checked at most by a brief motion search, with the margin and without: most
motions are found within a few hundred."""

MOST_CHECKS = 50_000
"""Configurations checked in all searches for a motion, after which no further one begins: 20 s."""

BRIEFLY = 3
"""Number of candidates that get a brief motion search before any gets a thorough one."""


PAIRS = 1
"""Number of the random stream of antipodal pairs, apart from that of the seeds."""

BEYOND = 0.0025
"""The exact field is evaluated wherever the sampled field minus its bound exceeds the clearance by
less than this [m]."""


@dataclass(frozen=True)
class PlannerConfig:
    """Options of a planner, independent of the object.

    Attributes:
        solver: One of `choices.Solver`. `slsqp` always evaluates the exact field, as in the
            paper.
        clearances: Least distances.
        margin: Preferred distance to the object [m] for solver and motion; distances down to the
            clearance are accepted.
        successive_halving: Iterations of `sqp` after which the worse half of the seeds stops.
        synthesis, motion: Options of the stages.
    """

    solver: str = "sqp"
    clearances: Clearances = field(default_factory=Clearances)
    margin: float = MARGIN
    successive_halving: tuple[int, ...] = SUCCESSIVE_HALVING
    synthesis: SynthesisConfig = field(default_factory=SynthesisConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)

    def __post_init__(self) -> None:
        require_choice(self.solver, choices.Solver, "--solver")
        for clearance in vars(self.clearances).values():
            check_distance("clearance", clearance)
        check_distance("margin", self.margin)


class Planner:
    """Planner for one robot; parts that do not depend on the object are made once.

    Args:
        robot: The robot.
        config: Options.
    """

    def __init__(self, robot: RobotDescription, config: PlannerConfig | None = None) -> None:
        self.robot, self.config = robot, config or PlannerConfig()
        self.kinematics = Kinematics(robot)
        self.geometry = RobotGeometry(self.kinematics)
        self.inverse = InverseKinematics(robot)
        sqp = Sqp(SqpConfig(successive_halving=self.config.successive_halving))
        self.solver: Solver = sqp if self.config.solver == "sqp" else Slsqp()

    def problems(self, target: Target, environment: Environment) -> Problems:
        """The optimisation problem with the field on a grid and with the exact field."""
        config, asked = self.config, self.config.clearances
        wanted = replace(asked, object=max(asked.object, config.margin))
        inside = Clearances(*(value + SOLVER_MARGIN for value in vars(wanted).values()))
        # Only distances below `reach` matter; the network need not be evaluated beyond it.
        reach = max(asked.object + 0.005, config.margin, PREFERRED_SLACK)
        quick = polish = judged = target.field
        if config.solver == "sqp":
            grid = target.kept or GridField(target.field, target.low, target.high, KEPT_GRID)
            quick = grid
            polish = RefinedField(grid, target.field, inside.object + BEYOND)
            judged = RefinedField(grid, target.field, reach)
        searched = GraspProblem(self.geometry, target.score, quick, environment, inside)
        exact = searched.with_field(judged, asked, reach)
        if polish is quick:
            return Problems(searched, exact, searched)
        return Problems(searched, exact, searched.with_field(polish, inside, 0.02))

    def solutions(
        self, target: Target, rng: np.random.Generator, search: SynthesisConfig
    ) -> Synthesis:
        """All solutions of a search on an empty table, without motions.

        Args:
            target: The object.
            rng: Random generator of the seeds.
            search: Effort and kind of the search.
        """
        return self._synthesised(self.problems(target, Environment()), target, rng, rng, search)

    def _synthesised(
        self,
        problems: Problems,
        target: Target,
        rng: np.random.Generator,
        pairs: np.random.Generator,
        search: SynthesisConfig,
    ) -> Synthesis:
        """All rounds of a search; `rng` draws the seeds, `pairs` antipodal grasps."""
        closing, quick = None, problems.quick
        if quick.environment.obstacles:
            least = self.config.clearances.environment
            closing = ClosingCheck(self.geometry, quick.object.field, quick.bodies, least)
        unsolved = antipodal_grasps(target, problems.exact, search.acceptance.success, pairs)
        source = target.prior, self.inverse, self.solver, rng
        return synthesise(problems, *source, search, closing, unsolved)

    def search(
        self,
        target: Target,
        environment: Environment | None = None,
        start: Array | None = None,
        seed: int = 0,
        search: SynthesisConfig | None = None,
    ) -> Outcome:
        """Configuration and motion, or the reason why there is none.

        Args:
            target: The object.
            environment: Obstacles and table; the table alone if None.
            start: [J], where the robot is; its home if None.
            seed: Equal seeds give equal plans.
            search: Effort and kind of the search; as configured if None.

        Raises:
            InputError: The start is no configuration within the joint limits.
        """
        environment = environment or Environment()
        start = self.robot.home if start is None else np.asarray(start, dtype=np.float64)
        if start.shape != self.robot.home.shape:
            allowed = f"{len(self.robot.home)}: " + ", ".join(self.robot.joint_names)
            raise InputError(f"{start.size} joint positions", where="--start", allowed=allowed)
        began = time.perf_counter()
        problems, field_time = timed(self.problems, target, environment)
        rng, pairs = np.random.default_rng(seed), np.random.default_rng((seed, PAIRS))
        asked = search or self.config.synthesis
        found = self._synthesised(problems, target, rng, pairs, asked)
        timings = {"field": field_time, **found.timings}
        timings["configuration"] = time.perf_counter() - began
        # A few configurations at a time: nothing to share out between threads.
        with timed_stage(timings, "motion"), one_thread():
            below, bodies = cautious(problems.polish.object.field), problems.polish.bodies
            clearances = self.config.clearances
            checker = PathChecker(self.geometry, below, environment, clearances, bodies)
            best, motion, found = self._with_motion(checker, found, start, seed)
        return Outcome(problems.polish, self.inverse.chain, found, best, motion, timings)

    def _searches(
        self, checker: PathChecker, best: list[Candidate], first: int = 0
    ) -> Iterator[tuple[int, PathChecker, MotionConfig]]:
        """Motion searches in turn: number of the candidate from `first` on, checker, effort.

        The best few get a brief search before any gets a thorough one: if the way to one is narrow,
        the next is hardly worse and often reached at once. The first brief search keeps the
        grasp's own distance to the object, at most the margin; the second keeps the clearance.
        """
        thorough, least = self.config.motion, self.config.clearances.object
        brief = replace(thorough, attempts=1, checks=QUICK_CHECKS)
        slack = [candidate.object_slack for candidate in best]
        kept = [min(self.config.margin, least + each) - SOLVER_MARGIN for each in slack]
        for k in range(len(best[:BRIEFLY])):
            yield first + k, checker.with_clearance(max(kept[k], least)), brief
            if kept[k] > least:
                yield first + k, checker, brief
        for k in range(len(best)):
            yield first + k, checker, thorough

    def _with_motion(
        self, checker: PathChecker, found: Synthesis, start: Array, seed: int
    ) -> tuple[Candidate | None, Motion | None, Synthesis]:
        """Choose the first accepted candidate with a motion, or failing that, a fallback.

        A candidate without a lift is chosen only if no other has a motion.
        """
        best = [*found.accepted, *found.fallbacks]
        lift = cache(lambda k: self._lift(checker, best[k]))
        failure, spent = "", 0
        for lifted in (True, False):
            wanted = self._searches(checker, found.accepted)
            others = self._searches(checker, found.fallbacks, first=len(found.accepted))
            for k, asked, effort in chain(wanted, others):
                if spent > MOST_CHECKS or (lift(k) is not None) != lifted:
                    continue
                motion = plan_motion(asked, self.inverse, start, best[k].q, seed, effort)
                spent += motion.checked
                failure = failure or motion.failure
                if motion.trajectory is not None:
                    stuck = {j for j in range(k) if lift(j) is None}
                    found = _taken(found, best, k, stuck)
                    if not lifted:
                        found = replace(found, sentence=f"{found.sentence} {STUCK}".strip())
                    return best[k], replace(motion, lift=lift(k)), found
        if not best:
            return None, None, found
        unreached = _passed(best, ())
        sentence = explain("motion", best[0], found.seeds_tried) + f" ({failure})"
        found = replace(found, best=None, accepted=[], rejected=found.rejected + unreached)
        return None, None, replace(found, reason="motion", sentence=sentence)

    def _lift(self, checker: PathChecker, candidate: Candidate) -> Array | None:
        """Joint path [K, J] by which the arm raises the hand from a grasp, touching nothing but the
        object; None if it cannot."""
        beside = checker.without_object()  # the object comes along
        q = candidate.q
        whole = partial(with_arm, self.robot, q)
        path = lift_path(self.inverse.chain, q, free=lambda path: beside.is_free(whole(path)))
        return None if path is None else whole(path)


STUCK = (
    "The robot has no room to lift the object from there: move it, the robot, or what stands above."
)


def _taken(found: Synthesis, best: list[Candidate], k: int, stuck: Container[int]) -> Synthesis:
    """The result with best[k] chosen, with a warning if it is poor, and those before rejected."""
    rejected = [one for one in found.rejected if one is not best[k]] + _passed(best[:k], stuck)
    sentence = warning(best[k], found.seeds_tried) if best[k].reason else ""
    found = replace(found, accepted=found.accepted[k:], rejected=rejected)
    return replace(found, best=best[k], reason="", sentence=sentence)


def _passed(candidates: list[Candidate], stuck: Container[int]) -> list[Candidate]:
    """Candidates without a motion or a lift; fallbacks are among the rejected already."""
    passed = [(k, one) for k, one in enumerate(candidates) if not one.reason]
    return [replace(one, reason="lift" if k in stuck else "motion") for k, one in passed]
