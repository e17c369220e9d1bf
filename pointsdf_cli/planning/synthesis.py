"""Search for the best acceptable configuration: seeds, solver, check, in up to 5 rounds.

The solver works on a quick field for all seeds at once. All solutions are judged by the exact
problem; the best few that the quick field let come too near are solved again with the exact field,
which is cheap because only points near the object evaluate it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pointsdf_cli.models.processor import timed_stage
from pointsdf_cli.planning.acceptance import AcceptanceConfig, Candidate, judge
from pointsdf_cli.planning.cancellation import stop_if_cancelled
from pointsdf_cli.planning.closing_check import ClosingCheck
from pointsdf_cli.planning.grasp_problem import GraspProblem
from pointsdf_cli.planning.likeliest import ENOUGH, NEARBY, likeliest_first, probability_to_hold
from pointsdf_cli.planning.nearby_grasps import NearbySampler
from pointsdf_cli.planning.nonlinear import Solver
from pointsdf_cli.planning.reasons import SeedStatistics, is_hemmed_in, why_none
from pointsdf_cli.planning.seeds import GraspSampler, SeedConfig, Seeds, UnsolvedGrasps, draw_seeds
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics

SOLVER_MARGIN = 0.0005
"""Extra clearance kept by the solver [m]: five times its tolerance of violations (`FEASIBLE`)."""

WORTH = 0.05
"""Improvement over the best objective so far that makes a second solution worthwhile."""

MARGINS = (1.0, 0.5, 0.0)
"""Share of the margin to the object that is kept in each round."""

FALLBACKS = 4
"""Number of fallbacks kept: if none of these has a motion, none of the rest will."""

MOST_MOTIONS = 12
"""Largest number of grasps for which motions are searched. The first few are often near each other,
and without a motion for the same reason."""

NEARER = 0.005
"""Difference of distances of closing fingers to obstacles [m] that decides between fallbacks."""

STALLED = 0.8
"""Ratio of a round's best free cost to the best before, above which the round has gained little."""
LEAST_ROUNDS = 2
"""Rounds after which a search without an accepted grasp ends if a round gains little."""
POLISHED = 3
"""Largest number of solutions of a round that are solved again with the exact field."""
POLISH_ITERATIONS = 12
"""Iterations of that second solution, which starts near its end."""


@dataclass(frozen=True)
class SynthesisConfig:
    """Effort of the search.

    Attributes:
        rounds: Rounds of seeds (the paper: up to five).
        seeds: Sampling of seeds.
        acceptance: Thresholds of a good grasp.
        kinds: "side", "top" or "either", one a round, in turn.
    """

    rounds: int = 5
    seeds: SeedConfig = field(default_factory=SeedConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)
    kinds: tuple[str, ...] = ("side",)


@dataclass(frozen=True)
class Synthesis:
    """Result of the search.

    Attributes:
        best: The accepted candidate that is most likely to hold; None if there is none.
        accepted: The accepted candidates that are most likely to hold, best first: the best may
            have no motion.
        fallbacks: The likeliest few free candidates that were not accepted, used if none is.
        rejected: All other candidates.
        reason: Reason code if there is no plan; else empty.
        sentence: The reason in words.
        seeds_tried: Number of starts given to the solver.
        timings: Seconds by stage.
    """

    best: Candidate | None
    accepted: list[Candidate]
    rejected: list[Candidate]
    fallbacks: list[Candidate]
    reason: str
    sentence: str
    seeds_tried: int
    timings: dict[str, float]


@dataclass(frozen=True)
class Problems:
    """Planning problem in a quick and an exact version.

    Attributes:
        quick: Problem with the quick field and a little more clearance than requested.
        exact: Problem with the exact field and the requested clearances.
        polish: Problem with the exact field and the clearances of `quick`.
    """

    quick: GraspProblem
    exact: GraspProblem
    polish: GraspProblem

    def in_round(self, turn: int, least: float) -> Problems:
        """Problems of one round. The margin beyond `least` [m] shrinks from round to round: a grasp
        with less distance is better than none."""
        share = MARGINS[min(turn, len(MARGINS) - 1)]
        wanted = self.quick.clearances.object
        if share == 1 or wanted <= least:
            return self
        kept = least + share * (wanted - least)
        same = self.polish is self.quick
        quick = self.quick.with_clearance(kept)
        return Problems(quick, self.exact, quick if same else self.polish.with_clearance(kept))


def synthesise(
    whole: Problems,
    prior: GraspSampler,
    kinematics: InverseKinematics,
    solver: Solver,
    rng: np.random.Generator,
    config: SynthesisConfig | None = None,
    closing: ClosingCheck | None = None,
    unsolved: Sequence[UnsolvedGrasps] = (),
) -> Synthesis:
    """Search for the best acceptable configuration; equal generators give equal results.

    Args:
        whole: Problems of the first round.
        prior, kinematics, solver: Source of the seeds, and their solver.
        rng: Random generator of the seeds.
        config: Effort of the search.
        closing: Check of the closing motion; none if None.
        unsolved: Sources of grasps judged beside the solutions of each round.
    """
    config = config or SynthesisConfig()
    timings = dict.fromkeys(("seeds", "solve", "polish", "check"), 0.0)
    accepted: list[Candidate] = []
    rejected: list[Candidate] = []
    tried, statistics = 0, SeedStatistics()
    clearance = whole.exact.clearances.object
    for turn in range(config.rounds):
        stop_if_cancelled()
        kind = config.kinds[turn % len(config.kinds)]
        with timed_stage(timings, "seeds"):
            problems = whole.in_round(turn, clearance + SOLVER_MARGIN)
            seeds = draw_seeds(problems.quick, prior, kinematics, kind, rng, config.seeds)
        tried, statistics = tried + len(seeds.x), statistics + seeds.statistics
        stop_if_cancelled()
        candidates = _solved(problems, seeds, accepted, solver, config, timings)
        with timed_stage(timings, "check"):
            for source in [*unsolved, *_beside(accepted, whole.exact, kinematics)]:
                candidates += _judged(problems, source, kinematics, kind, rng, config)
            if closing is not None:
                candidates = closing.judged(candidates, config.acceptance)
        new = [c for c in candidates if not c.reason]
        accepted += new
        before = _best_fallback(rejected, config)
        rejected += [c for c in candidates if c.reason]
        after = _best_fallback(rejected, config)
        if any(probability_to_hold(one, clearance) >= ENOUGH for one in new):
            break
        if not accepted and turn + 1 >= LEAST_ROUNDS and after > STALLED * before:
            break
    best_first = likeliest_first(accepted, clearance)
    return _outcome(best_first, rejected, tried, statistics, config, timings, clearance)


def _solved(
    problems: Problems,
    seeds: Seeds,
    accepted: list[Candidate],
    solver: Solver,
    config: SynthesisConfig,
    timings: dict[str, float],
) -> list[Candidate]:
    """The solutions of a round, feasible ones by objective first.

    Args:
        problems: Problems of the round.
        seeds: Its seeds.
        accepted: Accepted candidates of the rounds before.
        solver, config, timings: As in `synthesise`.
    """
    if not len(seeds.x):
        return []
    with timed_stage(timings, "solve"):
        found = solver.solve(problems.quick, seeds.x)
        stop_if_cancelled()
    with timed_stage(timings, "check"):
        # Feasible ones by objective, then the others by violation.
        violated = np.where(found.violation > 1e-3, found.violation, 0.0)
        order = np.lexsort((found.objective, violated))
        kinds = [seeds.kinds[k] for k in order]
        candidates = judge(problems.exact, found.x[order], config.acceptance, kinds)
    good = [c for c in [*accepted, *candidates] if c.has_prior and not c.reason]
    best = min((c.objective for c in good), default=np.inf)
    _polish(problems, candidates, best, solver, config, timings)
    return candidates


def _beside(
    accepted: list[Candidate], problem: GraspProblem, kinematics: InverseKinematics
) -> list[UnsolvedGrasps]:
    """Source of grasps beside the accepted ones that are most likely to hold."""
    if not accepted:
        return []
    best = likeliest_first(accepted, problem.clearances.object)[:NEARBY]
    return [UnsolvedGrasps(NearbySampler(best, kinematics.chain), problem.objective.score)]


def _judged(
    problems: Problems,
    unsolved: UnsolvedGrasps,
    kinematics: InverseKinematics,
    kind: str,
    rng: np.random.Generator,
    config: SynthesisConfig,
) -> list[Candidate]:
    """The most promising of a round's unsolved grasps that touch nothing."""
    quick, exact = (p.with_score(unsolved.score) for p in (problems.quick, problems.exact))
    drawn = draw_seeds(quick, unsolved.sampler, kinematics, kind, rng, config.seeds)
    candidates = judge(exact, drawn.x, config.acceptance, drawn.kinds)
    has_prior = unsolved.score is problems.exact.objective.score
    return [replace(c, has_prior=has_prior) for c in candidates if c.worst_slack >= 0]


def _polish(
    problems: Problems,
    candidates: list[Candidate],
    best: float,
    solver: Solver,
    config: SynthesisConfig,
    timings: dict[str, float],
) -> None:
    """Solve once more, with the exact field, the solutions that are too near the object; in place.

    More distance to the object improves no objective: solutions that could not become better than
    `best`, the least objective so far, are skipped.
    """
    limit = min(best - WORTH, config.acceptance.objective)
    near = [k for k, c in enumerate(candidates) if c.object_slack < 0 and c.objective < limit]
    again = near[:POLISHED]
    if not again or problems.polish is problems.quick:
        return
    with timed_stage(timings, "polish"):
        starts = np.stack([candidates[k].x for k in again])
        polished = solver.solve(problems.polish, starts, POLISH_ITERATIONS).x
    with timed_stage(timings, "check"):
        kinds = [candidates[k].kind for k in again]
        better = judge(problems.exact, polished, config.acceptance, kinds)
    for k, candidate in zip(again, better, strict=True):
        candidates[k] = candidate


def _outcome(
    accepted: list[Candidate],
    rejected: list[Candidate],
    tried: int,
    statistics: SeedStatistics,
    config: SynthesisConfig,
    timings: dict[str, float],
    clearance: float,
) -> Synthesis:
    """Candidates of all rounds, best first, with the reason where none was accepted."""
    reason = sentence = ""
    if not accepted:
        reason, sentence = why_none(statistics, rejected, tried, config.acceptance)
    fallbacks = [c for c in rejected if c.is_fallback(config.acceptance)]
    fallbacks = likeliest_first(fallbacks, clearance)
    # First those whose fingers stay clear of obstacles.
    fallbacks.sort(key=lambda c: np.ceil(max(-c.closing_slack, 0.0) / NEARER))
    if is_hemmed_in(statistics):  # what is free there stands beside the object
        fallbacks = []
    left = [replace(c, reason="not_tried") for c in accepted[MOST_MOTIONS:]]
    return Synthesis(
        best=accepted[0] if accepted else None,
        accepted=accepted[:MOST_MOTIONS],
        rejected=rejected + left,
        fallbacks=fallbacks[:FALLBACKS],
        reason=reason,
        sentence=sentence,
        seeds_tried=tried,
        timings=timings,
    )


def _best_fallback(candidates: list[Candidate], config: SynthesisConfig) -> float:
    """Least objective of the fallbacks."""
    fallbacks = (c.objective for c in candidates if c.is_fallback(config.acceptance))
    return min(fallbacks, default=np.inf)
