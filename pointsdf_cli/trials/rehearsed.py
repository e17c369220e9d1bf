"""Planner that rehearses its grasps on the reconstructed object before it chooses one.

`GraspPlanner` stops at the first round of seeds with an accepted grasp. Here the accepted grasps of
a round are rehearsed; if none holds often enough, another round follows, and finally the best grasp
of all rounds is chosen.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.io.plans import Plan
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.answer import PerceivedObject
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.grasp_planner import (
    RECONSTRUCTION,
    Answer,
    GraspPlanner,
    PlanOptions,
    SuccessModel,
)
from pointsdf_cli.planning.planner import Rank
from pointsdf_cli.planning.resampled_views import ResampledViewCheck
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import StopCondition, SynthesisConfig
from pointsdf_cli.simulation.executor import ExecutorConfig
from pointsdf_cli.simulation.rehearsal import (
    UNTRIED,
    Rehearsal,
    RehearsalConfig,
    Rehearsed,
    best_first,
)
from pointsdf_cli.simulation.world import try_robot

Surface = tuple[Array, NDArray[np.int32]]
"""Vertices [V, 3] m and faces [F, 3]."""


@dataclass(frozen=True)
class RehearsedPlannerConfig:
    """Effort of the search.

    Attributes:
        count: Number of grasps of a round to rehearse, the best by the objective.
        enough: Share of rehearsals in which a grasp must hold to end the search.
        slack: Distance [m] to the object; of equally good grasps, those that keep it until the hand
            closes are rehearsed first, because the unseen side may be nearer than predicted.
        resampled_views: Number of further samples of the cloud for the resampled-view check. A
            grasp that violates the clearance in any of them never ends the search.
        most_motions: Largest number of grasps for which motions are searched.
        resolution: Cells along the network's box for the surface to rehearse on.
        rehearsal: Disturbances.
        execution: Execution of grasps; rehearsals use it without hold and pushes.
    """

    count: int = 12
    enough: float = 0.75
    slack: float = 0.006
    resampled_views: int = 3
    most_motions: int = 6
    resolution: int = 64
    rehearsal: RehearsalConfig = field(default_factory=RehearsalConfig)
    execution: ExecutorConfig = field(default_factory=ExecutorConfig)

    def as_dict(self) -> dict[str, Any]:
        """Settings for `config_json`."""
        return asdict(self)

    def __post_init__(self) -> None:
        if self.count < 1 or not 0 <= self.enough <= 1:
            raise InputError(f"{self.count} grasps", where="--rehearse", allowed="0 or more")


@dataclass(frozen=True)
class RehearsedAnswer(Answer):
    """An answer with the rehearsal of its grasp.

    Attributes:
        rehearsed: Rehearsal of the chosen grasp; None without one.
        surface: Reconstructed surface; None without one.
    """

    rehearsed: Rehearsed | None = None
    surface: Surface | None = None


CONTRADICTED = 0.5
"""Factor on the rehearsed score of a grasp that the resampled-view check rejects."""

REHEARSED_SEARCH = SynthesisConfig(rounds=5, seeds=SeedConfig(palms=40, seeds=12))
"""Number of grasps per round: more than in the paper, because rehearsals distinguish them."""


class RehearsedPlanner(GraspPlanner):
    """A `GraspPlanner` that rehearses grasps before it searches motions.

    Args:
        options: Options with the method "reconstruction": partial views have no closed surface.
        grasps: The success network to use instead of a checkpoint's.
        config: Effort of the search.

    Raises:
        InputError: Another method, or a robot or checkpoint that cannot be used.
    """

    def __init__(
        self,
        options: PlanOptions | None = None,
        grasps: SuccessModel | None = None,
        config: RehearsedPlannerConfig | None = None,
    ) -> None:
        options = options or PlanOptions()
        if options.method != RECONSTRUCTION:
            raise InputError(
                f"the method {options.method} has no closed surface to rehearse on",
                where="--rehearse",
                allowed=f"the method {RECONSTRUCTION}",
            )
        # All seeds are solved to the end: a rehearsal may prefer a grasp with a worse score.
        search = replace(REHEARSED_SEARCH, acceptance=options.synthesis.acceptance)
        self.config = config or RehearsedPlannerConfig()
        options = replace(
            options,
            synthesis=search,
            successive_halving=(),
            resampled_views=self.config.resampled_views,
        )
        super().__init__(options, grasps)
        try_robot(self.robot)  # a rehearsal that cannot be built would look like one that fails
        self._rehearsal = Rehearsal(self.robot, self.config.rehearsal, self.config.execution)

    def plan_seen(
        self,
        perceived: PerceivedObject,
        environment: Environment | None = None,
        start: Array | None = None,
        seed: int = 0,
        rank: Rank | None = None,
        stop: StopCondition | None = None,
        surface: Surface | None = None,
    ) -> Answer:
        """Plan as `GraspPlanner.plan_seen` does; the answer is a `RehearsedAnswer`.

        Args:
            perceived, environment, start, seed: As in `GraspPlanner.plan_seen`.
            rank, stop: Must be None: rehearsals decide.
            surface: Surface to rehearse on instead of the reconstruction's, world frame, for the
                oracle.
        """
        if rank is not None or stop is not None:
            raise ValueError("rehearsals rank the grasps themselves")
        if environment is not None and not environment.table:
            raise InputError(
                "a rehearsal needs a table",
                where="--rehearse",
                allowed="an environment with `table: true`",
                hint="leave --rehearse out",
            )
        began = time.perf_counter()
        if surface is None and perceived.reconstruction is not None:
            resolution = self.config.resolution
            surface = believed_surface(perceived.reconstruction, resolution, perceived.fused)
        meshing = time.perf_counter() - began
        if surface is None:
            answer = super().plan_seen(perceived, environment, start, seed)
            return RehearsedAnswer(answer.plan, answer.target, answer.reconstruction)
        clearance = self.options.clearances.object
        resampled = ResampledViewCheck(self.planner.geometry, perceived.resampled)

        def contradicted(candidates: list[Candidate]) -> list[bool]:
            return list(resampled.contradicted(np.stack([c.q for c in candidates]), clearance))

        least = self.config.slack - clearance
        pool = _Pool(self._rehearsal, surface, self.config, least, contradicted, seed)
        answer = super().plan_seen(
            perceived, environment, start, seed, rank=pool.ranked, stop=pool.stop
        )
        plan = answer.plan
        timings = {**plan.timings, "surface": meshing, "rehearsal": pool.seconds}
        plan = replace(plan, timings=timings)
        return RehearsedAnswer(plan, answer.target, answer.reconstruction, pool.of(plan), surface)


class _Pool:
    """Rehearsed candidates of all rounds."""

    def __init__(
        self,
        rehearsal: Rehearsal,
        surface: Surface,
        config: RehearsedPlannerConfig,
        least_slack: float,
        contradicted: Callable[[list[Candidate]], list[bool]],
        seed: int,
    ) -> None:
        self._rehearsal, self._surface, self._config = rehearsal, surface, config
        self._least_slack, self._seed = least_slack, seed
        self._are_contradicted = contradicted
        self._candidates: list[Candidate] = []
        self._contradicted: list[bool] = []
        self._tried: list[Rehearsed] = []
        self.seconds = 0.0

    def stop(self, new: list[Candidate]) -> bool:
        """Rehearse the candidates of a round; True if one holds often enough."""
        began = time.perf_counter()
        contradicted = self._are_contradicted(new)
        order = promising_first(new, self._least_slack, contradicted)[: self._config.count]
        chosen = [new[k] for k in order]
        try:
            tried = self._rehearsal(*self._surface, np.stack([c.q for c in chosen]), self._seed)
        except InputError:  # nothing solid to rehearse on: the objective alone decides
            tried = [UNTRIED] * len(chosen)
        self._candidates += chosen
        self._contradicted += [contradicted[k] for k in order]
        self._tried += tried
        self.seconds += time.perf_counter() - began
        return any(
            one.tries > 1 and one.share >= self._config.enough and not contradicted[k]
            for k, one in zip(order, tried, strict=True)
        )

    def ranked(self, accepted: list[Candidate]) -> list[Candidate]:
        """The best few candidates of all rounds, best first; unrehearsed ones come last.

        If these have no motion, the others hardly will.
        """
        if not self._candidates and accepted:  # nothing was rehearsed
            self.stop(accepted)
        chances = [CONTRADICTED if one else 1.0 for one in self._contradicted]
        order = [self._candidates[k] for k in best_first(self._tried, chances)]
        order += [c for c in accepted if not any(c is one for one in order)]
        return order[: self._config.most_motions]

    def of(self, plan: Plan) -> Rehearsed | None:
        """Rehearsal of a plan's grasp."""
        for candidate, tried in zip(self._candidates, self._tried, strict=True):
            if np.array_equal(candidate.q, plan.q):
                return tried
        return None


def promising_first(
    candidates: list[Candidate], least_slack: float, contradicted: Sequence[bool]
) -> list[int]:
    """Order of rehearsal: uncontradicted grasps first, then by objective (0 for most good ones),
    then those with enough slack, then by success probability."""

    def cost(k: int) -> tuple[bool, float, bool, float]:
        one = candidates[k]
        return contradicted[k], one.objective, one.object_slack < least_slack, -one.success

    return sorted(range(len(candidates)), key=cost)


def believed_surface(
    reconstruction: Reconstruction, resolution: int = 64, fused: Field | None = None
) -> Surface | None:
    """The reconstructed surface; None if the network sees no inside.

    Args:
        reconstruction: Reconstruction of the first view.
        resolution: Cells along its box.
        fused: Mean field of all views, if there are several.
    """
    try:
        mesh = mesh_reconstruction(reconstruction, resolution, field=fused)
    except EmptySurfaceError:
        return None
    return mesh.vertices, mesh.faces
