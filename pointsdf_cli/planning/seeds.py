"""Where the solvers start: grasps drawn from the prior, reached by inverse kinematics.

METHOD section 6: sample q_g from the prior's side component, palm above the table. Beyond the
paper, many palms are drawn at once and every elbow position that reaches one is judged by the
whole problem, so that the solver starts where little or nothing is in the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.contacts import Array
from pointsdf_cli.planning.grasp_problem import GraspProblem
from pointsdf_cli.planning.reasons import Drawn
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics

KINDS = ("side", "top")


class GraspPrior(Protocol):
    """The prior over grasp configurations, for one object in the world."""

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Preshape joints [N, K] and T_world_palm [N, 4, 4], drawn from one component."""


@dataclass(frozen=True)
class SeedConfig:
    """How many.

    Attributes:
        palms: Grasps drawn from the prior in a round.
        seeds: Configurations handed to the solver.
        elbows: Elbow positions judged for each palm, at most.
        lowest_palm: Palms whose origin is lower above the table [m] are not tried.
        violation_weight: Cost per metre of violation when seeds are ranked.
    """

    palms: int = 32
    seeds: int = 8
    elbows: int = 3
    lowest_palm: float = 0.02
    violation_weight: float = 300.0

    def __post_init__(self) -> None:
        if min(self.palms, self.seeds, self.elbows) < 1 or self.violation_weight <= 0:
            raise InputError(f"{self}", allowed="counts ≥ 1, violation_weight > 0")


@dataclass(frozen=True)
class Seeds:
    """Starts for the solver, best first.

    Attributes:
        x: [S, n]; S may be 0.
        drawn: What became of all that was drawn.
    """

    x: Array
    drawn: Drawn


def draw_seeds(
    problem: GraspProblem,
    prior: GraspPrior,
    kinematics: InverseKinematics,
    kind: str,
    rng: np.random.Generator,
    config: SeedConfig | None = None,
) -> Seeds:
    """Draw, reach, judge and keep the best.

    Raises:
        InputError: `kind` is neither "side" nor "top".
    """
    config = config or SeedConfig()
    if kind not in KINDS:
        raise InputError(f"no kind of grasp {kind!r}", allowed=", ".join(KINDS))
    preshape, palm = prior.sample(kind, config.palms, rng)
    above = palm[:, 2, 3] >= config.lowest_palm
    preshape, palm = preshape[above], palm[above]
    n = problem.variables.count
    if not len(palm):
        return Seeds(np.zeros((0, n)), Drawn(config.palms))
    found = kinematics.solve(palm)
    rows, elbows = np.nonzero(found.reached)
    keep = np.zeros(len(rows), dtype=bool)
    for row in np.unique(rows):
        keep[np.flatnonzero(rows == row)[: config.elbows]] = True
    rows, elbows = rows[keep], elbows[keep]
    x = np.hstack([found.arm[rows, elbows], preshape[rows]])
    x = np.clip(x, problem.lower, problem.upper)
    if not len(x):
        return Seeds(x, Drawn(config.palms, int(above.sum())))
    room = np.minimum(0.0, np.stack(list(problem.residuals(x))))
    rank = problem.cost(x).value - config.violation_weight * room.sum(axis=0)
    # One seed a palm, while there are palms: two elbows of one palm end alike.
    order = np.argsort(rank, kind="stable")
    first = np.unique(rows[order], return_index=True)[1]
    others = np.setdiff1d(np.arange(len(order)), first)
    chosen = np.concatenate([order[np.sort(first)], order[others]])[: config.seeds]
    drawn = Drawn(config.palms, int(above.sum()), len(first), *_fate(rows, room))
    return Seeds(x[chosen], drawn)


def _fate(rows: NDArray[np.intp], room: Array) -> tuple[int, int, int, int, int]:
    """Palms that touch nothing in some elbow position; the others by what they enter deepest.

    Args:
        rows: [E], the palm of each configuration.
        room: [4, E], how deep each enters object, table, obstacles and the robot itself, ≤ 0.
    """
    free, met = 0, np.zeros(4, dtype=int)
    for row in np.unique(rows):
        depth = room[:, rows == row]
        freest = depth[:, depth.sum(axis=0).argmax()]
        if freest.min() >= 0:
            free += 1
        else:
            met[freest.argmin()] += 1
    return free, int(met[0]), int(met[1]), int(met[2]), int(met[3])
