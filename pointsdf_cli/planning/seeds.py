"""Seeds of the solvers: grasps sampled from the prior, reached by inverse kinematics.

As in the paper: sample q_g from the prior's side component, palm above the table. Beyond the paper,
many palms are sampled at once and every elbow position that reaches one is evaluated on the whole
problem, so that the solver starts at configurations with few or no collisions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.grasp_problem import GraspProblem
from pointsdf_cli.planning.objective import GraspScore
from pointsdf_cli.planning.reasons import SeedStatistics
from pointsdf_cli.planning.screen import depth_in, lifted
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics

EITHER = "either"
"""Kind that samples half of the grasps from each kind and tries the better ones."""


class GraspSampler(Protocol):
    """The prior over grasp configurations, for one object in the world."""

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Sample preshape joints [N, K] and T_world_palm [N, 4, 4] from one component; N is 0 for a
        kind without a component."""


class ObjectGrasps(GraspScore, GraspSampler, Protocol):
    """Score and prior of the grasps of one object (models/grasp_score.py)."""


class SuccessModel(Protocol):
    """Protocol of a loaded success network."""

    def on(
        self, points: Array, T_world_camera: Array, field: Field | None = None, seed: int = 0
    ) -> ObjectGrasps:
        """The score of one object: points [N, 3] in the camera's frame, its pose in the world, and
        the object's field in the world for features of its geometry."""


@dataclass(frozen=True)
class UnsolvedGrasps:
    """Grasps that are judged as they are sampled: a solver would spoil what is good about them.

    Attributes:
        sampler: Their source.
        score: Score by which they are ranked and accepted.
    """

    sampler: GraspSampler
    score: GraspScore


SHARE = 0.75
"""Share of the palms chosen by the hand-only screening; the rest are random, so that the arm is
not asked for one place only."""
ELBOWS = 3
"""Largest number of elbow positions evaluated for each palm."""
LOWEST_PALM = 0.02
"""Least height of a palm's origin above the table [m]."""
VIOLATION_WEIGHT = 300.0
"""Cost per metre of violation when seeds are ranked."""


@dataclass(frozen=True)
class SeedConfig:
    """Numbers of samples.

    Attributes:
        drawn: Grasps drawn from the prior in a round.
        palms: Number of them handed to inverse kinematics.
        seeds: Number of configurations passed to the solver.
    """

    drawn: int = 192
    palms: int = 32
    seeds: int = 8


MANY_SEEDS = SeedConfig(palms=40, seeds=12)
"""For grasps to learn from: more in a round than in the paper."""


@dataclass(frozen=True)
class Seeds:
    """Starts for the solver, best first.

    Attributes:
        x: [S, n]; S may be 0.
        kinds: [S], "side" or "top".
        statistics: Counts of the samples by outcome.
    """

    x: Array
    kinds: tuple[str, ...]
    statistics: SeedStatistics


def draw_seeds(
    problem: GraspProblem,
    prior: GraspSampler,
    kinematics: InverseKinematics,
    kind: str,
    rng: np.random.Generator,
    config: SeedConfig | None = None,
) -> Seeds:
    """Sample grasps, reach them by inverse kinematics, evaluate them and keep the best.

    Raises:
        InputError: `kind` is neither "side" nor "top" nor "either".
    """
    config = config or SeedConfig()
    if kind not in (*GRASP_KINDS, EITHER):
        raise InputError(f"no kind of grasp {kind!r}", allowed=", ".join((*GRASP_KINDS, EITHER)))
    wanted = GRASP_KINDS if kind == EITHER else (kind,)
    each = max(config.drawn, config.palms) // len(wanted)
    draws = [prior.sample(one, each, rng) for one in wanted]
    preshape, palm = (np.concatenate(part) for part in zip(*draws, strict=True))
    kinds = np.repeat(wanted, [len(one) for one, _ in draws])
    around = problem.environment
    above = (palm[:, 2, 3] >= LOWEST_PALM + around.table_height) | (not around.table)
    preshape, palm, kinds = preshape[above], palm[above], kinds[above]
    n, preshape = problem.variables.count, problem.variables.coupled(preshape)
    if not len(palm):
        return Seeds(np.zeros((0, n)), (), SeedStatistics(len(above)))
    palm, chosen = _promising(problem, preshape, palm, rng, config)
    preshape, palm, kinds = preshape[chosen], palm[chosen], kinds[chosen]
    found = kinematics.solve(palm)
    rows, elbows = np.nonzero(found.reached & (found.reached.cumsum(axis=1) <= ELBOWS))
    x = np.hstack([found.arm[rows, elbows], preshape[rows][:, problem.variables.of_preshape]])
    x = np.clip(x, problem.lower, problem.upper)
    if not len(x):
        return Seeds(x, (), SeedStatistics(len(above), int(above.sum())))
    slack = problem.violations(x)
    rank = problem.cost(x).value - VIOLATION_WEIGHT * slack.sum(axis=0)
    # One seed a palm while there are palms: two elbows of one palm converge to similar solutions.
    order = np.argsort(rank, kind="stable")
    first = np.unique(rows[order], return_index=True)[1]
    others = np.setdiff1d(np.arange(len(order)), first)
    chosen = np.concatenate([order[np.sort(first)], order[others]])[: config.seeds]
    statistics = SeedStatistics(len(above), int(above.sum()), len(first), *_fate(rows, slack))
    return Seeds(x[chosen], tuple(str(kinds[row]) for row in rows[chosen]), statistics)


def _promising(
    problem: GraspProblem,
    preshape: Array,
    palm: Array,
    rng: np.random.Generator,
    config: SeedConfig,
) -> tuple[Array, NDArray[np.intp]]:
    """All palms, raised above the table, and indices of those to pass to inverse kinematics."""
    outline = problem.geometry.hand(preshape)
    if problem.environment.table:
        palm = lifted(outline, palm, problem.lowest)
    if len(palm) <= config.palms:
        return palm, np.arange(len(palm))
    depth = depth_in(problem.object.field, outline, palm)
    rank = problem.objective.of_palms(preshape, palm) + VIOLATION_WEIGHT * depth
    order = np.argsort(rank, kind="stable")
    best = round(SHARE * config.palms)
    others = rng.permutation(order[best:])[: config.palms - best]
    return palm, np.concatenate([order[:best], others])


def _fate(rows: NDArray[np.intp], slack: Array) -> tuple[int, int, int, int, int]:
    """Number of palms without collision in some elbow position, and numbers of the others by their
    deepest collision.

    Args:
        rows: [E], the palm of each configuration.
        slack: [4, E], ≤ 0, penetration of object, table, obstacles and the robot itself.
    """
    free, met = 0, np.zeros(4, dtype=int)
    for row in np.unique(rows):
        depth = slack[:, rows == row]
        freest = depth[:, depth.sum(axis=0).argmax()]
        if freest.min() >= 0:
            free += 1
        else:
            met[freest.argmin()] += 1
    return free, int(met[0]), int(met[1]), int(met[2]), int(met[3])
