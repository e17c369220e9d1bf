"""When a solution is a plan, and if it is not, why, in words that a person can act on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.contacts import Array
from pointsdf_cli.planning.grasp_problem import GraspProblem

REASONS = (
    "inverse_kinematics",
    "table_collision",
    "object_collision",
    "self_collision",
    "low_success_probability",
    "objective",
    "motion",
    "solver",
)
"""Reason codes of the plan artifact."""


@dataclass(frozen=True)
class AcceptanceConfig:
    """METHOD section 6: h > 0.6 and the objective < 5.

    Attributes:
        success: The least predicted probability of success.
        objective: The largest objective.
    """

    success: float = 0.6
    objective: float = 5.0

    def __post_init__(self) -> None:
        if not (0 <= self.success < 1 and self.objective > 0):
            raise InputError(f"{self}", allowed="success in [0, 1), objective above 0")


@dataclass(frozen=True)
class Candidate:
    """A solution with everything that decides about it.

    Attributes:
        x: [n], decision variables.
        success: h.
        log_prior: log g.
        objective: max(s − β, 0)².
        object_room, table_room, obstacle_room, self_room: Smallest distances less the clearances
            [m]; negative is too near, infinite where there is nothing to touch.
        limit_room: Smallest distance to a joint limit; negative is beyond.
        reason: One of `REASONS`, or empty where the solution is accepted.
    """

    x: Array
    success: float
    log_prior: float
    objective: float
    object_room: float
    table_room: float
    obstacle_room: float
    self_room: float
    limit_room: float
    reason: str

    @property
    def worst_room(self) -> float:
        """The smallest room of all distances [m]."""
        return min(self.object_room, self.table_room, self.obstacle_room, self.self_room)


def judge(
    problem: GraspProblem, x: Array, config: AcceptanceConfig | None = None
) -> list[Candidate]:
    """Check solutions x [B, n] against the problem as it is, whatever the solver made of it.

    Args:
        problem: With the exact field and the clearances that were asked for.
    """
    config = config or AcceptanceConfig()
    if not len(x):
        return []
    cost, room = problem.cost(x), problem.residuals(x)
    limit = np.minimum(x - problem.lower, problem.upper - x).min(axis=1)
    candidates = []
    for b in range(len(x)):
        success = float(np.exp(cost.log_success[b]))
        distances = {
            "object_collision": float(room.object[b]),
            "table_collision": float(min(room.table[b], room.obstacles[b])),
            "self_collision": float(room.self_collision[b]),
        }
        worst = min(distances, key=lambda key: distances[key])
        reason = ""
        if limit[b] < 0:
            reason = "solver"
        elif distances[worst] < 0:
            reason = worst
        elif success <= config.success:
            reason = "low_success_probability"
        elif cost.value[b] >= config.objective:
            reason = "objective"
        candidates.append(
            Candidate(
                x=x[b].copy(),
                success=success,
                log_prior=float(cost.log_prior[b]),
                objective=float(cost.value[b]),
                object_room=float(room.object[b]),
                table_room=float(room.table[b]),
                obstacle_room=float(room.obstacles[b]),
                self_room=float(room.self_collision[b]),
                limit_room=float(limit[b]),
                reason=reason,
            )
        )
    return candidates


def nearest_miss(rejected: list[Candidate]) -> Candidate | None:
    """The rejected candidate that came closest: least violation first, then best objective."""
    if not rejected:
        return None
    return min(rejected, key=lambda c: (round(max(0.0, -c.worst_room), 4), -c.success, c.objective))


def explain(
    reason: str,
    best: Candidate | None,
    seeds_tried: int,
    config: AcceptanceConfig | None = None,
) -> str:
    """One sentence for a reason code, with the numbers of the nearest miss."""
    config = config or AcceptanceConfig()
    if reason not in REASONS:
        raise InputError(f"no reason {reason!r}", allowed=", ".join(REASONS))
    if reason == "inverse_kinematics" or best is None:
        return (
            "The arm reaches none of the grasps that were drawn: move the object nearer to the "
            "robot's middle reach, or away from its base."
        )
    depth = f"{max(0.0, -best.worst_room) * 1000:.1f} mm"
    if reason == "object_collision":
        return (
            f"All {seeds_tried} grasps that were tried meet the object (the best by {depth}): it "
            "may be larger than the open hand; try another side or --clearance 0."
        )
    if reason == "table_collision":
        what = "the table" if best.table_room <= best.obstacle_room else "an obstacle"
        return (
            f"All {seeds_tried} grasps that were tried meet {what} (the best by {depth}): clear "
            "the space around the object, or ask for top grasps if it is low."
        )
    if reason == "self_collision":
        return (
            f"All {seeds_tried} grasps that were tried fold the robot into itself (the best by "
            f"{depth}): move the object away from the robot's base."
        )
    if reason == "low_success_probability":
        return (
            f"The best of {seeds_tried} grasps is predicted to hold with probability "
            f"{best.success:.2f}, below {config.success:g}: turn the object, or look at it from "
            "another side."
        )
    if reason == "objective":
        return (
            f"The best of {seeds_tried} grasps has an objective of {best.objective:.2f}, not below "
            f"{config.objective:g}: it is unlike the grasps that the prior was learned from."
        )
    if reason == "motion":
        return (
            "A grasp was found, but no free path to it: start from another configuration, or clear "
            "the space between the robot and the object."
        )
    return f"The solver ended outside of the joint limits from all {seeds_tried} seeds."
