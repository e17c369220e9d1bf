"""Choice of the grasp by rehearsals on the reconstructed object.

The accepted grasps of a round of seeds are rehearsed; if none is likely enough to hold, another
round follows, and finally the best grasp of all rounds is chosen. Without rehearsals the success
network alone decides (likeliest.py).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.answer import PerceivedObject
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.grasp_planner import (
    RECONSTRUCTION,
    GraspPlanner,
    PlanOptions,
)
from pointsdf_cli.planning.likeliest import ENOUGH, NEARBY, trust
from pointsdf_cli.planning.planner import PREFERRED_SLACK, Planner
from pointsdf_cli.planning.resampled_views import ResampledViewCheck
from pointsdf_cli.planning.seeds import MANY_SEEDS
from pointsdf_cli.planning.success_model import SuccessModel
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.simulation.executor import ExecutorConfig
from pointsdf_cli.simulation.rehearsal import (
    UNTRIED,
    Rehearsal,
    Rehearsed,
    best_first,
)
from pointsdf_cli.simulation.world import try_robot

RESAMPLED_VIEWS = 3
"""Number of further samples of the cloud for the resampled-view check. A grasp that violates the
clearance in any of them never ends the search."""
MOST_MOTIONS = 6
"""Largest number of grasps for which motions are searched: if these have none, the others hardly
will."""
RESOLUTION = 64
"""Cells along the network's box for the surface to rehearse on."""
CONTRADICTED = 0.8
"""Factor on the probability to hold of grasps that the resampled-view check rejects."""
REHEARSED_SEARCH = SynthesisConfig(rounds=5, seeds=MANY_SEEDS)
"""Search settings: more grasps per round than in the paper, because rehearsals distinguish them."""


def rehearsed_planner(
    options: PlanOptions | None = None,
    grasps: SuccessModel | None = None,
    count: int = 12,
    execution: ExecutorConfig | None = None,
) -> GraspPlanner:
    """A planner that rehearses grasps before it searches motions.

    Args:
        options: Options with the method "reconstruction": partial views have no closed surface.
        grasps: The success network to use instead of a checkpoint's.
        count: Number of grasps of the first round to rehearse, the best by the objective; twice as
            many of later ones.
        execution: Execution of grasps; rehearsals use it without hold and pushes.

    Raises:
        InputError: Another method, no grasps to rehearse, or a robot or checkpoint that cannot be
            used.
    """
    options = options or PlanOptions()
    if count < 1:
        raise InputError(f"{count} grasps", where="--rehearse", allowed="0 or more")
    if options.method != RECONSTRUCTION:
        raise InputError(
            f"the method {options.method} has no closed surface to rehearse on",
            where="--rehearse",
            allowed=f"the method {RECONSTRUCTION}",
        )
    # All seeds are solved to the end: a rehearsal may prefer a grasp with a worse score.
    search = replace(REHEARSED_SEARCH, acceptance=options.planner.synthesis.acceptance)
    config = replace(options.planner, synthesis=search, successive_halving=())
    options = replace(options, planner=config, resampled_views=RESAMPLED_VIEWS)
    robot = load_robot(options.robot)
    try_robot(robot)  # a rehearsal that cannot be built would look like one that fails
    return GraspPlanner(options, grasps, GraspRehearsal(robot, count, execution))


class GraspRehearsal:
    """Rehearsal of the accepted grasps of objects, in one physics world.

    Args:
        robot: The robot.
        count: Number of grasps of the first round to rehearse; twice as many of later ones.
        execution: Execution of grasps.
    """

    def __init__(
        self, robot: RobotDescription, count: int, execution: ExecutorConfig | None = None
    ) -> None:
        self._count, self._rehearsal = count, Rehearsal(robot, execution)

    def __call__(
        self,
        planner: Planner,
        perceived: PerceivedObject,
        environment: Environment | None,
        seed: int,
        surface: Surface | None = None,
    ) -> RehearsedChoice | None:
        """The choice among the grasps of one object; None without a surface to rehearse on.

        Args:
            planner: Planner of the grasps.
            perceived: The object.
            environment: Obstacles and table.
            seed: Random seed of the disturbances.
            surface: Surface to rehearse on, world frame; the reconstruction's if None.

        Raises:
            InputError: The environment has no table.
        """
        if environment is not None and not environment.table:
            raise InputError(
                "a rehearsal needs a table",
                where="--rehearse",
                allowed="an environment with `table: true`",
                hint="leave --rehearse out",
            )
        began = time.perf_counter()
        if surface is None and perceived.reconstruction is not None:
            surface = believed_surface(perceived.reconstruction, RESOLUTION, perceived.fused)
        meshing = time.perf_counter() - began
        if surface is None:
            return None
        clearance = planner.config.clearances.object
        check = ResampledViewCheck(planner.geometry, perceived.resampled)

        def contradicted(candidates: list[Candidate]) -> list[bool]:
            return list(check.contradicted(np.stack([c.q for c in candidates]), clearance))

        height = 0.0 if environment is None else environment.table_height
        rehearse = partial(self._rehearsal, *surface, seed=seed, table_height=height)
        return RehearsedChoice(
            rehearse, surface, self._count, PREFERRED_SLACK - clearance, contradicted, meshing
        )


class RehearsedChoice:
    """Choice among the rehearsed candidates of all rounds.

    Args:
        rehearse: Function from configurations [C, J], success probabilities [C] and factors [C] on
            them to rehearsals.
        surface: Surface of the rehearsals.
        count: Number of grasps of the first round to rehearse; twice as many of later ones.
        least_slack: As in `trust`.
        contradicted: Function that tells which candidates the resampled-view check rejects.
        meshing: Seconds that the surface took.
    """

    def __init__(
        self,
        rehearse: Callable[[Array, Array, Array], list[Rehearsed]],
        surface: Surface,
        count: int,
        least_slack: float,
        contradicted: Callable[[list[Candidate]], list[bool]],
        meshing: float,
    ) -> None:
        self.surface = surface
        self.timings = {"rehearsal_surface": meshing, "rehearsal": 0.0}
        self._rehearse, self._count, self._least_slack = rehearse, count, least_slack
        self._are_contradicted = contradicted
        self._candidates: list[Candidate] = []
        self._right: list[float] = []
        self._tried: list[Rehearsed] = []

    def stop(self, new: list[Candidate]) -> bool:
        """Rehearse the candidates of a round; True if one is likely enough to hold."""
        began = time.perf_counter()
        contradicted = np.array(self._are_contradicted(new), dtype=bool)
        trusted = np.array([trust(one, self._least_slack) for one in new])
        right = np.where(contradicted, CONTRADICTED, trusted)
        success = np.array([one.success for one in new])
        # Later rounds have as many again, beside the best so far.
        most = 2 * self._count if self._tried else self._count
        order = np.argsort(-right * success, kind="stable")[:most]
        try:
            q = np.stack([new[k].q for k in order])
            tried = self._rehearse(q, success[order], right[order])
        except InputError:  # nothing solid to rehearse on: the network alone decides
            tried = [UNTRIED] * len(order)
        self._candidates += [new[k] for k in order]
        self._right += list(right[order])
        self._tried += tried
        self.timings["rehearsal"] += time.perf_counter() - began
        return any(
            one.tries and one.chance(success[k]) >= ENOUGH and not contradicted[k]
            for k, one in zip(order, tried, strict=True)
        )

    def best(self) -> list[Candidate]:
        """The grasps beside which the next round samples too: the most likely to hold."""
        return self._best_first()[:NEARBY]

    def ranked(self, accepted: list[Candidate]) -> list[Candidate]:
        """The best few candidates of all rounds, best first; unrehearsed ones come last."""
        if not self._candidates and accepted:  # nothing was rehearsed
            self.stop(accepted)
        order = self._best_first()
        order += [c for c in accepted if not any(c is one for one in order)]
        return order[:MOST_MOTIONS]

    def _best_first(self) -> list[Candidate]:
        success = [each.success for each in self._candidates]
        return [self._candidates[k] for k in best_first(self._tried, success, self._right)]

    def of(self, chosen: Candidate | None) -> Rehearsed | None:
        """Rehearsal of the chosen candidate; None without one."""
        for candidate, tried in zip(self._candidates, self._tried, strict=True):
            if chosen is not None and np.array_equal(candidate.q, chosen.q):
                return tried
        return None


def believed_surface(
    reconstruction: Reconstruction, resolution: int = RESOLUTION, fused: Field | None = None
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
