"""Acceptance of solutions, and the constraint that a rejected one fails (codes: reasons.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.grasp_problem import GraspProblem


@dataclass(frozen=True)
class AcceptanceConfig:
    """Thresholds of acceptance (the paper: h > 0.6 and the objective < 5).

    The paper's h was not calibrated; this one is, and not every object has grasps of which 6 in 10
    hold. So h > `least` is accepted, and the likeliest of several rounds is chosen (likeliest.py);
    h > `floor` is accepted with a warning if nothing exceeds `least` (docs/planning.md).

    Attributes:
        success: Success probability of a good grasp: with one, `--target any` tries no further
            object.
        least: Least success probability of an accepted grasp.
        objective: Largest objective of an accepted grasp.
        floor: Least success probability of a fallback, a collision-free grasp that is not accepted.
            Equal to `least`: fallbacks only of grasps rejected for their objective.
    """

    success: float = 0.6
    least: float = 0.1
    objective: float = 5.0
    floor: float = 0.03

    def __post_init__(self) -> None:
        if not (0 <= self.least <= self.success < 1 and 0 <= self.floor < 1):
            raise InputError(
                f"a probability of success of at least {self.least:g}, good above {self.success:g}",
                where="--min-success",
                allowed="0 ≤ least ≤ good < 1",
            )
        if not self.objective > 0:
            raise InputError(f"a largest objective of {self.objective:g}", allowed="above 0")


@dataclass(frozen=True)
class Candidate:
    """A solution and the values that decide whether it is accepted.

    Attributes:
        x: [n], decision variables.
        q: [J], their configuration.
        success: h.
        log_prior: log g.
        objective: max(s − β, 0)².
        object_slack, table_slack, obstacle_slack, self_slack: Smallest distance minus the clearance
            [m]; negative if too near, infinite without anything to touch.
        reason: One of `reasons.REASONS`; empty for an accepted solution.
        kind: Kind of its seed, "side" or "top".
        closing_slack: The same as `obstacle_slack` while the hand closes [m]; infinite if not
            checked.
        has_prior: Whether the objective includes the prior; only such objectives are comparable.
    """

    x: Array
    q: Array
    success: float
    log_prior: float
    objective: float
    object_slack: float
    table_slack: float
    obstacle_slack: float
    self_slack: float
    reason: str
    kind: str = ""
    closing_slack: float = np.inf
    has_prior: bool = True

    def is_fallback(self, config: AcceptanceConfig) -> bool:
        """Whether the open hand meets all constraints, and success probability, objective or the
        closing motion alone is the reason."""
        poor = self.reason in ("low_success_probability", "objective", "closing")
        return poor and self.success > min(config.floor, config.least)

    @property
    def worst_slack(self) -> float:
        """The smallest slack of all distances [m]."""
        return min(self.object_slack, self.table_slack, self.obstacle_slack, self.self_slack)


def judge(
    problem: GraspProblem,
    x: Array,
    config: AcceptanceConfig | None = None,
    kinds: Sequence[str] = (),
) -> list[Candidate]:
    """Check solutions x [B, n] against the exact problem, independently of the solver.

    Args:
        problem: Problem with the exact field and the requested clearances.
        x: The solutions.
        config: Thresholds.
        kinds: [B], kinds of their seeds, if known.
    """
    config = config or AcceptanceConfig()
    if not len(x):
        return []
    cost, slack = problem.cost(x), problem.residuals(x)
    limit = np.minimum(x - problem.lower, problem.upper - x).min(axis=1)
    candidates = []
    for b in range(len(x)):
        success = float(np.exp(cost.log_success[b]))
        distances = {
            "object_collision": float(slack.object[b]),
            "table_collision": float(min(slack.table[b], slack.obstacles[b])),
            "self_collision": float(slack.self_collision[b]),
        }
        worst = min(distances, key=lambda key: distances[key])
        reason = ""
        # Comparisons that NaN fails, too.
        if not limit[b] >= 0:
            reason = "solver"
        elif not distances[worst] >= 0:
            reason = worst
        elif not success > config.least:
            reason = "low_success_probability"
        elif not cost.value[b] < config.objective:
            reason = "objective"
        candidates.append(
            Candidate(
                x=x[b].copy(),
                q=problem.variables.configuration(x[b]),
                success=success,
                log_prior=float(cost.log_prior[b]),
                objective=float(cost.value[b]),
                object_slack=float(slack.object[b]),
                table_slack=float(slack.table[b]),
                obstacle_slack=float(slack.obstacles[b]),
                self_slack=float(slack.self_collision[b]),
                reason=reason,
                kind=kinds[b] if kinds else "",
            )
        )
    return candidates
