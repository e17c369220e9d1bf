"""From an object to the best configuration that may be taken: seeds, solver, check, up to 5 rounds.

The solver works on a quick field for all seeds at once. All solutions are judged by the exact
problem; the best few of those that the quick field let too near are solved again with the exact
one, which costs little where only the points that come near ask it.
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

WORTH = 0.05
"""A solution is solved again only if its objective is better than the best so far by this."""


@dataclass(frozen=True)
class SynthesisConfig:
    """How long to look.

    Attributes:
        rounds: Of seeds (METHOD section 6: up to five).
        enough: After so many rounds any accepted grasp ends the search; before, a good one does.
        polished: Solutions of a round that are solved again with the exact field, at most.
        polish_iterations: Of that; they start next to where they end.
        seeds: How seeds are drawn.
        acceptance: What is good enough.
        kinds: "side", "top" or "either", one a round, over and over.
    """

    rounds: int = 5
    enough: int = 2
    polished: int = 3
    polish_iterations: int = 12
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
            stop; if None, what the configuration says of good grasps and of enough rounds.
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
        kinds = [seeds.kinds[k] for k in order]
        candidates = judge(problems.exact, found.x[order], config.acceptance, kinds)
        start = _lap(timings, "check", start)
        # What the quick field let too near is solved again with the exact one.
        best = min((c.objective for c in [*accepted, *candidates] if not c.reason), default=np.inf)
        again = [
            k
            for k, candidate in enumerate(candidates)
            if candidate.object_room < 0 and candidate.objective < best - WORTH
        ][: config.polished]
        if again and problems.polish is not problems.quick:
            near = np.stack([candidates[k].x for k in again])
            polished = solver.solve(problems.polish, near, config.polish_iterations).x
            start = _lap(timings, "polish", start)
            better = judge(problems.exact, polished, config.acceptance, [kinds[k] for k in again])
            for k, candidate in zip(again, better, strict=True):
                candidates[k] = candidate
            _lap(timings, "check", start)
        new = [c for c in candidates if not c.reason]
        accepted += new
        rejected += [c for c in candidates if c.reason]
        if satisfied is not None:
            if new and satisfied(new):
                break
        elif accepted and (turn + 1 >= config.enough or _any_good(accepted, config)):
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


def _any_good(candidates: list[Candidate], config: SynthesisConfig) -> bool:
    return any(c.success > config.acceptance.success for c in candidates)


def _ranked(found: Solutions) -> NDArray[np.intp]:
    """Indices of solutions: feasible ones by objective, then the others by violation."""
    violated = np.where(found.violation > 1e-3, found.violation, 0.0)
    return np.lexsort((found.objective, violated))


def _lap(timings: dict[str, float], stage: str, start: float) -> float:
    now = time.perf_counter()
    timings[stage] += now - start
    return now
