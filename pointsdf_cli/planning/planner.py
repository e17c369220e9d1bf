"""The whole planner: from an object's field, score and prior to a plan or the reason for none."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.plans import NO_PLAN, OK, Plan, RejectedSeeds
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.planning.acceptance import Candidate, explain
from pointsdf_cli.planning.contacts import Array
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.fields import Field, ReconstructionField, RefinedField
from pointsdf_cli.planning.grasp_problem import Clearances, GraspProblem
from pointsdf_cli.planning.grid import GridConfig, GridField, surface_box
from pointsdf_cli.planning.motion import Motion, MotionConfig, plan_motion
from pointsdf_cli.planning.nonlinear import Solver
from pointsdf_cli.planning.objective import GraspScore, ObjectiveConfig
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.seeds import GraspPrior
from pointsdf_cli.planning.slsqp import Slsqp
from pointsdf_cli.planning.sqp import Sqp
from pointsdf_cli.planning.synthesis import Problems, Synthesis, SynthesisConfig, synthesise
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics

SOLVERS = ("sqp", "slsqp")

SOLVER_MARGIN = 0.0005
"""What the solver keeps beyond the clearances asked for [m]: its own tolerances fit in twice."""


BOX_MARGIN = 0.01
"""Around a reconstruction's surface [m]: beyond, distances are bounded by the way to the box."""


@dataclass(frozen=True)
class PlannerConfig:
    """Everything that is decided before an object is seen.

    Attributes:
        solver: One of `SOLVERS`. `slsqp` asks the exact field throughout, as the paper does.
        clearances: Least distances.
        grid: How the object's field is kept for `sqp`.
        beyond: Where the kept field less its bound is below this [m], the exact one is asked.
        objective, synthesis, motion: Of the stages.
    """

    solver: str = "sqp"
    clearances: Clearances = field(default_factory=Clearances)
    grid: GridConfig = field(default_factory=lambda: GridConfig(step=0.01, levels=3, band=0.0))
    beyond: float = 0.004
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    synthesis: SynthesisConfig = field(default_factory=SynthesisConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(
                f"no solver {self.solver!r}", where="--solver", allowed=", ".join(SOLVERS)
            )
        if self.beyond <= self.clearances.object + SOLVER_MARGIN:
            raise InputError(
                f"a clearance of {self.clearances.object} m to the object",
                where="--clearance",
                allowed=f"less than {self.beyond - SOLVER_MARGIN:g} m, or a larger `beyond`",
            )


@dataclass(frozen=True)
class Target:
    """One object to be grasped.

    Attributes:
        field: Its signed distance field, world frame.
        low, high: [3], a box [m] around its surface.
        score: Of grasps of it.
        prior: Where seeds come from.
    """

    field: Field
    low: Array
    high: Array
    score: GraspScore
    prior: GraspPrior


def reconstruction_target(
    reconstruction: Reconstruction, score: GraspScore, prior: GraspPrior
) -> Target:
    """The target whose shape a network has completed from a cloud in the world's frame."""
    field = ReconstructionField(reconstruction)
    # The network was trained in a box of ±0.6 (METHOD section 1), its meshes reach to ±0.8.
    half = 0.75 / reconstruction.scale
    wide = reconstruction.centre - half, reconstruction.centre + half
    low, high = surface_box(field, *wide, step=0.15 / reconstruction.scale)
    return Target(field, low - BOX_MARGIN, high + BOX_MARGIN, score, prior)


class Planner:
    """Plans for one robot; what does not depend on the object is made once.

    Args:
        robot: The robot.
        config: Options.
    """

    def __init__(self, robot: RobotDescription, config: PlannerConfig | None = None) -> None:
        self.robot, self.config = robot, config or PlannerConfig()
        self.kinematics = Kinematics(robot)
        self.geometry = RobotGeometry(self.kinematics)
        self.inverse = InverseKinematics(robot)
        self.solver: Solver = Sqp() if self.config.solver == "sqp" else Slsqp()

    def problems(self, target: Target, environment: Environment) -> Problems:
        """The optimisation problem with the kept and with the exact field."""
        config, asked = self.config, self.config.clearances
        inside = Clearances(*(value + SOLVER_MARGIN for value in vars(asked).values()))
        quick, polish = target.field, target.field
        if config.solver == "sqp":
            grid = GridField(target.field, target.low, target.high, config.grid)
            quick, polish = grid, RefinedField(grid, target.field, config.beyond)

        def problem(which: Field, clearances: Clearances, reach: float) -> GraspProblem:
            return GraspProblem(
                self.geometry,
                target.score,
                which,
                environment,
                clearances,
                config.objective,
                reach=reach,
            )

        # Only what is too near decides; a network need not be asked about the rest.
        exact = problem(target.field, asked, asked.object + 0.005)
        return Problems(problem(quick, inside, 0.05), exact, problem(polish, inside, 0.02))

    def plan(
        self,
        target: Target,
        environment: Environment | None = None,
        start: Array | None = None,
        seed: int = 0,
    ) -> Plan:
        """Configuration and motion, or the reason why there is none.

        Args:
            target: The object.
            environment: What stands around; the table alone if None.
            start: [J], where the robot is; its home if None.
            seed: Equal seeds give equal plans.

        Raises:
            InputError: The start is no configuration within the joint limits.
        """
        environment = environment or Environment()
        start = self.robot.home if start is None else np.asarray(start, dtype=np.float64)
        if start.shape != self.robot.home.shape:
            raise InputError(
                f"{start.size} joint positions",
                where="--start",
                allowed=f"{len(self.robot.home)}: " + ", ".join(self.robot.joint_names),
            )
        began = time.perf_counter()
        problems = self.problems(target, environment)
        field_time = time.perf_counter() - began
        rng = np.random.default_rng(seed)
        found = synthesise(
            problems, target.prior, self.inverse, self.solver, rng, self.config.synthesis
        )
        timings = {"field": field_time, **found.timings}
        timings["configuration"] = time.perf_counter() - began
        began = time.perf_counter()
        checker = PathChecker(
            self.geometry,
            problems.polish.object.field,
            environment,
            self.config.clearances,
        )
        best, motion, found = self._with_motion(checker, problems, found, start, seed)
        timings["motion"] = time.perf_counter() - began
        return self._answer(problems.exact, found, best, motion, timings)

    def _with_motion(
        self,
        checker: PathChecker,
        problems: Problems,
        found: Synthesis,
        start: Array,
        seed: int,
    ) -> tuple[Candidate | None, Motion | None, Synthesis]:
        """The best accepted candidate that a motion leads to."""
        unreached: list[Candidate] = []
        for k, candidate in enumerate(found.accepted):
            goal = problems.exact.variables.configuration(candidate.x)
            motion = plan_motion(checker, self.inverse, start, goal, seed, self.config.motion)
            if motion.trajectory is not None:
                left, rejected = found.accepted[k:], found.rejected + unreached
                return candidate, motion, replace(found, accepted=left, rejected=rejected)
            unreached.append(replace(candidate, reason="motion"))
        if not unreached:
            return None, None, found
        sentence = explain("motion", unreached[0], found.seeds_tried) + f" ({motion.failure})"
        return (
            None,
            None,
            replace(
                found,
                best=None,
                accepted=[],
                rejected=found.rejected + unreached,
                reason="motion",
                sentence=sentence,
            ),
        )

    def _answer(
        self,
        problem: GraspProblem,
        found: Synthesis,
        best: Candidate | None,
        motion: Motion | None,
        timings: dict[str, float],
    ) -> Plan:
        joints = len(self.robot.joint_names)
        links = tuple(link for link in self.robot.tree.links if self.robot.tree.shapes[link])
        q, T_world_palm = np.full(joints, np.nan), np.full((4, 4), np.nan)
        to_object = to_table = np.full(len(links), np.nan)
        trajectory, times = np.zeros((0, joints)), np.zeros(0)
        if best is not None and motion is not None and motion.trajectory is not None:
            q = problem.variables.configuration(best.x)
            rotation, position, _ = self.inverse.palm(q[None, self.robot.arm])
            T_world_palm = np.eye(4)
            T_world_palm[:3, :3], T_world_palm[:3, 3] = rotation[0], position[0]
            to_object = link_clearance(problem, best.x, links, "object")
            to_table = link_clearance(problem, best.x, links, "table")
            trajectory, times = motion.trajectory.positions, motion.trajectory.times
        return Plan(
            status=OK if best is not None else NO_PLAN,
            reason=found.reason,
            sentence=found.sentence,
            joint_names=self.robot.joint_names,
            q=q,
            trajectory=trajectory,
            times=times,
            T_world_palm=T_world_palm,
            success_probability=best.success if best is not None else float("nan"),
            objective=best.objective if best is not None else float("nan"),
            seeds_tried=found.seeds_tried,
            timings=timings,
            link_names=links,
            link_clearance_object=to_object,
            link_clearance_table=to_table,
            rejected=_rejected(problem, found.rejected),
        )


def link_clearance(problem: GraspProblem, x: Array, links: tuple[str, ...], to: str) -> Array:
    """Smallest distance [L] of each link to "object", "table" or an obstacle [m]; infinite where
    it is not checked. Far distances are lower bounds."""
    _, contacts = problem.contacts(x[None], gradients=False)
    clearance = np.full(len(links), np.inf)
    place = {link: k for k, link in enumerate(links)}
    for m, (link, other) in enumerate(problem.names):
        if other == to:
            clearance[place[link]] = min(clearance[place[link]], contacts.distance[0, m])
    return clearance


def _rejected(problem: GraspProblem, candidates: list[Candidate]) -> RejectedSeeds:
    if not candidates:
        return RejectedSeeds.none(len(problem.kinematics.robot.joint_names))
    return RejectedSeeds(
        q=problem.variables.configuration(np.stack([c.x for c in candidates])),
        reasons=tuple(c.reason for c in candidates),
        success_probability=np.array([c.success for c in candidates]),
        objective=np.array([c.objective for c in candidates]),
        room=np.array(
            [[c.object_room, c.table_room, c.obstacle_room, c.self_room] for c in candidates]
        ),
    )
