"""From an object to the best configuration that may be taken: seeds, solver, check, up to 5 rounds.

The solver works on a quick field for all seeds at once. The best few are then polished with the
exact field, which costs little where only the points that come near ask it, and whatever is
returned has been judged by the exact problem.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.acceptance import (
    AcceptanceConfig,
    Candidate,
    judge,
)
from pointsdf_cli.planning.grasp_problem import GraspProblem
from pointsdf_cli.planning.nonlinear import Solutions, Solver
from pointsdf_cli.planning.reasons import Drawn, why_none
from pointsdf_cli.planning.seeds import GraspPrior, SeedConfig, draw_seeds
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics


@dataclass(frozen=True)
class SynthesisConfig:
    """How long to look.

    Attributes:
        rounds: Of seeds (METHOD section 6: up to five).
        polished: Solutions of a round that are solved again with the exact field.
        seeds: How seeds are drawn.
        acceptance: What is good enough.
        kinds: Kinds of grasp, one a round, over and over.
    """

    rounds: int = 5
    polished: int = 3
    seeds: SeedConfig = field(default_factory=SeedConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)
    kinds: tuple[str, ...] = ("side",)

    def __post_init__(self) -> None:
        if self.rounds < 1 or self.polished < 1 or not self.kinds:
            raise InputError(f"{self}", allowed="rounds ≥ 1, polished ≥ 1, at least one kind")


@dataclass(frozen=True)
class Synthesis:
    """What came out.

    Attributes:
        best: The accepted candidate with the smallest objective, None if there is none.
        accepted: All accepted candidates, best first; motion planning may need another.
        rejected: All others.
        reason: Empty, or why there is no plan.
        sentence: The same for a person.
        seeds_tried: Starts given to the solver.
        drawn: What became of the prior's grasps.
        timings: Seconds by stage.
    """

    best: Candidate | None
    accepted: list[Candidate]
    rejected: list[Candidate]
    reason: str
    sentence: str
    seeds_tried: int
    drawn: Drawn
    timings: dict[str, float]


Satisfied = Callable[[list[Candidate]], bool]
"""Told the candidates that a round has added: whether to look no further."""


@dataclass(frozen=True)
class Problems:
    """One planning problem at two prices.

    Attributes:
        quick: With a quick field and a little more clearance than was asked for.
        exact: With the exact field, as asked.
        polish: With the exact field and the quick one's clearances.
    """

    quick: GraspProblem
    exact: GraspProblem
    polish: GraspProblem


def synthesise(
    problems: Problems,
    prior: GraspPrior,
    kinematics: InverseKinematics,
    solver: Solver,
    rng: np.random.Generator,
    config: SynthesisConfig | None = None,
    satisfied: Satisfied | None = None,
) -> Synthesis:
    """Look for the best acceptable configuration; equal generators give equal results.

    Args:
        problems, prior, kinematics, solver: What is solved, where seeds come from, and how.
        rng: Of the seeds.
        config: How long to look.
        satisfied: Asked after every round that has added to the accepted candidates whether to
            stop; the first accepted one ends the search if None.
    """
    config = config or SynthesisConfig()
    timings = dict.fromkeys(("seeds", "solve", "polish", "check"), 0.0)
    accepted: list[Candidate] = []
    rejected: list[Candidate] = []
    tried, drawn = 0, Drawn()
    for turn in range(config.rounds):
        kind = config.kinds[turn % len(config.kinds)]
        start = time.perf_counter()
        seeds = draw_seeds(problems.quick, prior, kinematics, kind, rng, config.seeds)
        start = _lap(timings, "seeds", start)
        tried, drawn = tried + len(seeds.x), drawn + seeds.drawn
        if not len(seeds.x):
            continue
        found = solver.solve(problems.quick, seeds.x)
        start = _lap(timings, "solve", start)
        order = _ranked(found)
        top = found.x[order[: config.polished]]
        # The paper's solver asked the exact field already.
        done = problems.polish is problems.quick
        polished = top if done else solver.solve(problems.polish, top).x
        start = _lap(timings, "polish", start)
        candidates = judge(problems.exact, polished, config.acceptance, kind)
        others = found.x[order[config.polished :]]
        candidates += judge(problems.quick, others, config.acceptance, kind)
        _lap(timings, "check", start)
        new = [c for c in candidates[: len(top)] if not c.reason]
        accepted += new
        rejected += [c for c in candidates if c.reason]
        if new and (satisfied is None or satisfied(new)):
            break
    accepted.sort(key=lambda c: (c.objective, -c.success))
    reason = sentence = ""
    if not accepted:
        reason, sentence = why_none(drawn, rejected, tried, config.acceptance)
    return Synthesis(
        best=accepted[0] if accepted else None,
        accepted=accepted,
        rejected=rejected,
        reason=reason,
        sentence=sentence,
        seeds_tried=tried,
        drawn=drawn,
        timings=timings,
    )


def _ranked(found: Solutions) -> NDArray[np.intp]:
    """Indices of solutions: feasible ones by objective, then the others by violation."""
    violated = np.where(found.violation > 1e-3, found.violation, 0.0)
    return np.lexsort((found.objective, violated))


def _lap(timings: dict[str, float], stage: str, start: float) -> float:
    now = time.perf_counter()
    timings[stage] += now - start
    return now
