"""Preshapes that the planner proposes for simulated attempts: `collect-grasps --preshapes planned`.

Grasps of the heuristic lie elsewhere than those that a search for a high success probability finds.
The success network learns where its own optimum misleads by trying that (as DAgger does: Ross et
al., AISTATS 2011).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.models.checkpoint_kinds import bundled_success
from pointsdf_cli.models.grasp_checkpoint import reconstruction_to_plan_with, weights_hash
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.seeds import MANY_SEEDS
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.target import EmptyFieldError
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.attempt import SCENE_ATTEMPTS, ObservedScene, PlannedPreshape, Propose

UNLIKELY = ("low_success_probability", "objective")
"""Reasons of candidates that meet all constraints: they are tried as well."""
ROUNDS = 2


@dataclass(frozen=True)
class PlannedPreshapes:
    """Settings of the planner that proposes preshapes.

    Attributes:
        options: Robot and networks; the search is set here.
    """

    options: PlanOptions = field(default_factory=PlanOptions)

    def as_dict(self) -> dict[str, Any]:
        """Checksums of the networks.

        Raises:
            InputError: No success network for the robot, or a checkpoint that cannot be read.
        """
        options = self.options
        robot = load_robot(options.robot)
        success = options.grasp_checkpoint or bundled_success(robot)
        if success is None:
            none = f"no success network for {robot.name} is bundled"
            allowed = "a checkpoint of train-gs"
            hint = "collect heuristic grasps and train one first"
            raise InputError(none, where="--grasp-checkpoint", allowed=allowed, hint=hint)
        shape = options.checkpoint or reconstruction_to_plan_with(success)
        return {"reconstruction": weights_hash(shape), "success": weights_hash(success)}

    def load(self) -> Propose:
        """Load the networks."""
        search = replace(self.options.planner.synthesis, rounds=ROUNDS, seeds=MANY_SEEDS)
        config = replace(self.options.planner, successive_halving=(), synthesis=search)
        return partial(_proposals, GraspPlanner(replace(self.options, planner=config)), search)


def _proposals(
    planner: GraspPlanner, search: SynthesisConfig, scene: ObservedScene, rng: np.random.Generator
) -> list[PlannedPreshape]:
    """A few of the solutions that meet all constraints, at random: not only the best ones."""
    view = View(scene.cloud, scene.T_world_camera, scene.evidence)
    seed = int(rng.integers(2**31))
    try:
        perceived = planner.see([view], seed)
    except EmptyFieldError:
        return []
    kinds = planner.kinds(perceived.points)
    found = planner.planner.solutions(perceived.target, rng, replace(search, kinds=kinds))
    free = found.accepted + [c for c in found.rejected if c.reason in UNLIKELY]
    chain = planner.planner.inverse.chain
    chosen = rng.permutation(len(free))[:SCENE_ATTEMPTS]
    return [PlannedPreshape(free[k].kind, chain.palm(free[k].q), free[k].q) for k in chosen]
