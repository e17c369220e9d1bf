"""Results of planning in the form of the plan artifact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.io.plans import NO_PLAN, OK, SLACKS, AcceptedGrasps, Plan, RejectedSeeds
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.grasp_problem import GraspProblem
from pointsdf_cli.planning.motion import Motion
from pointsdf_cli.planning.plan_request import as_sentences
from pointsdf_cli.planning.synthesis import Synthesis
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription


@dataclass(frozen=True)
class Outcome:
    """Result of a search with motions.

    Attributes:
        problem: Problem whose field is exact near the surface.
        chain: Kinematics of the arm, for the palm's pose.
        found: Result of the search.
        best, motion: Chosen grasp and its motion; both None without a plan.
        timings: Seconds by stage.
    """

    problem: GraspProblem
    chain: ArmChain
    found: Synthesis
    best: Candidate | None
    motion: Motion | None
    timings: Mapping[str, float] = field(default_factory=dict)


def plan_of(outcome: Outcome, warnings: Sequence[str] = (), surface: Surface | None = None) -> Plan:
    """Make the plan: the chosen grasp with its motion, or the reason for none.

    Args:
        outcome: Result of the search.
        warnings: Sentences to append to its sentence.
        surface: The object's surface, world frame; None for none.
    """
    problem, found, best, motion = outcome.problem, outcome.found, outcome.best, outcome.motion
    robot = problem.kinematics.robot
    joints = len(robot.joint_names)
    plan = replace(
        no_plan(robot, NO_PLAN, found.sentence, warnings, outcome.timings),
        status=NO_PLAN if best is None else OK,
        reason=found.reason,
        seeds_tried=found.seeds_tried,
        accepted=_accepted(joints, found.accepted),
        rejected=_rejected(joints, found.rejected),
        lift=np.zeros((0, joints)),
    )
    if surface is not None:
        vertices, faces = np.asarray(surface[0], np.float32), np.asarray(surface[1], np.int32)
        plan = replace(plan, object_vertices=vertices, object_faces=faces)
    if best is None:
        return plan
    plan = replace(plan, kind=best.kind, success_probability=best.success, objective=best.objective)
    if motion is None or motion.trajectory is None:
        return plan
    to_object, to_table = problem.clearances_by_link(best.x, plan.link_names)
    return replace(
        plan,
        q=best.q,
        T_world_palm=outcome.chain.palm(best.q),
        trajectory=motion.trajectory.positions,
        times=motion.trajectory.times,
        lift=plan.lift if motion.lift is None else motion.lift,
        link_clearance_object=to_object,
        link_clearance_table=to_table,
    )


def no_plan(
    robot: RobotDescription,
    reason: str,
    sentence: str,
    warnings: Sequence[str] = (),
    timings: Mapping[str, float] | None = None,
) -> Plan:
    """Make a plan artifact with a reason only: nothing could be tried."""
    joints = len(robot.joint_names)
    links = tuple(link for link in robot.tree.links if robot.tree.shapes[link])
    nothing = np.full(len(links), np.nan)
    return Plan(
        status=NO_PLAN,
        reason=reason,
        sentence=f"{sentence} {as_sentences(warnings)}".strip(),
        joint_names=robot.joint_names,
        q=np.full(joints, np.nan),
        trajectory=np.zeros((0, joints)),
        times=np.zeros(0),
        T_world_palm=np.full((4, 4), np.nan),
        success_probability=float("nan"),
        objective=float("nan"),
        seeds_tried=0,
        timings=timings or {},
        link_names=links,
        link_clearance_object=nothing,
        link_clearance_table=nothing,
        rejected=_rejected(joints, ()),
        accepted=_accepted(joints, ()),
    )


def _accepted(joints: int, candidates: Sequence[Candidate]) -> AcceptedGrasps:
    q, success, objective = _values(joints, candidates)
    return AcceptedGrasps(q, tuple(c.kind for c in candidates), success, objective)


def _rejected(joints: int, candidates: Sequence[Candidate]) -> RejectedSeeds:
    q, success, objective = _values(joints, candidates)
    slack = [[c.object_slack, c.table_slack, c.obstacle_slack, c.self_slack] for c in candidates]
    slacks, reasons = np.reshape(slack, (-1, len(SLACKS))), tuple(c.reason for c in candidates)
    return RejectedSeeds(q, reasons, success, objective, slacks)


def _values(joints: int, candidates: Sequence[Candidate]) -> tuple[Array, Array, Array]:
    """Configurations [C, J], success probabilities [C] and objectives [C] of C candidates."""
    q = np.array([c.q for c in candidates]).reshape(-1, joints)
    return q, np.array([c.success for c in candidates]), np.array([c.objective for c in candidates])
