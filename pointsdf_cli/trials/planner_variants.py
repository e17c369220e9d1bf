"""Planners in a trial: the two methods, and the ablations."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.checkpoints import CONFIG, WEIGHTS, read_checkpoint
from pointsdf_cli.io.input_files import read_input
from pointsdf_cli.models.grasp_checkpoint import read_grasp_checkpoint
from pointsdf_cli.models.grasp_score import load_grasp_model
from pointsdf_cli.planning.answer import Answer
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.fields import MeshField
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.seeds import ObjectGrasps, SuccessModel
from pointsdf_cli.planning.seen_obstacles import seen_obstacles
from pointsdf_cli.planning.table_top import TableTop
from pointsdf_cli.planning.target import EmptyFieldError
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.trials import protocol
from pointsdf_cli.trials.protocol import PlannerVariant


def plan_options(variant: PlannerVariant, plan: PlanOptions) -> PlanOptions:
    """Planning options of a variant.

    Args:
        variant: The variant.
        plan: Options shared by all variants; networks are those of the method "reconstruction".

    Raises:
        InputError: An option is invalid.
    """
    checkpoint = plan.checkpoint
    if variant.ablation.startswith(protocol.CHECKPOINT):
        checkpoint = Path(variant.ablation.removeprefix(protocol.CHECKPOINT))
    # Checkpoint options apply to the reconstruction method, not to the baseline. For another robot
    # there is one success network, which both share.
    reconstructs = variant.method == protocol.RECONSTRUCTION
    own_network = reconstructs or plan.robot is not None
    shape = checkpoint if reconstructs else None
    grasps = plan.grasp_checkpoint if own_network else None
    return replace(plan, method=variant.method, checkpoint=shape, grasp_checkpoint=grasps)


@functools.cache
def weights_of(variant: PlannerVariant, plan: PlanOptions) -> str:
    """Checksum of all checkpoints that affect a trial."""
    total = hashlib.sha256()
    asked = plan_options(variant, plan)
    folders = [asked.checkpoint, asked.grasp_checkpoint, *sorted(asset_path("weights").iterdir())]
    for folder in folders:
        files = [] if folder is None else [folder / WEIGHTS, folder / CONFIG]
        for file in files:
            if file.is_file():
                total.update(read_input(file, "checkpoint"))
    return total.hexdigest()[:16]


def check_variant(variant: PlannerVariant, plan: PlanOptions) -> None:
    """Refuse unusable variants before the first trial.

    Raises:
        InputError: A checkpoint cannot be read.
    """
    asked = plan_options(variant, plan)
    if asked.checkpoint is not None:
        read_checkpoint(asked.checkpoint)
    if asked.grasp_checkpoint is not None or asked.robot is not None:
        read_grasp_checkpoint(asked.grasp_checkpoint, None, load_robot(asked.robot))


class TrialPlanner:
    """A variant ready to plan; networks are loaded once.

    Args:
        variant: The variant.
        plan: Options shared by all variants.
    """

    def __init__(self, variant: PlannerVariant, plan: PlanOptions) -> None:
        self.variant = variant
        grasps: SuccessModel | None = None
        if variant.ablation == protocol.NO_SUCCESS:
            robot = load_robot(plan.robot)
            model = load_grasp_model(plan.grasp_checkpoint, None, plan.device, robot)
            grasps = ConstantSuccess(model)
        self._planner = GraspPlanner(plan_options(variant, plan), grasps)

    def plan(
        self,
        view: View,
        truth: Callable[[], Surface],
        seed: int,
        environment: Environment | None = None,
    ) -> Answer:
        """Plan for one camera's view of the object.

        Args:
            view: The segmented object.
            truth: Function that returns the object's true surface in the world, for the oracle.
            seed: Random seed.
            environment: Result of `surroundings`; the table alone if None.
        """
        field: Field | Literal["none"] | None = None
        if self.variant.ablation == protocol.NO_CONSTRAINT:
            field = "none"
        elif self.variant.ablation == protocol.ORACLE:
            field = MeshField(*truth())
        planner = self._planner
        view = replace(view, evidence=_remaining(view.evidence, self.variant.ablation))
        try:
            perceived = planner.see([view], seed, field)
        except EmptyFieldError as error:
            return planner.nothing(error.what)
        return planner.plan_seen(perceived, environment, seed=seed)

    def surroundings(self, seen: TableTop, seed: int) -> Environment:
        """The table and the other observed objects: reconstructions, or hulls for a variant without
        a reconstruction network."""
        cleaned = self.variant.ablation != protocol.NO_CLEANING
        found, _ = seen_obstacles(seen, self._planner.shape, seed=seed, cleaned=cleaned)
        return Environment(found)


def _remaining(evidence: ViewEvidence | None, ablation: str) -> ViewEvidence | None:
    """The evidence of a view that an ablation leaves."""
    if evidence is None:
        return None
    if ablation == protocol.NO_FREE_SPACE:
        return replace(evidence, visibility=None)
    if ablation == protocol.NO_SUPPORT_PLANE:
        return replace(evidence, support_plane=None)
    return evidence


class ConstantSuccess:
    """A success network with a constant score; its prior is kept."""

    def __init__(self, model: SuccessModel) -> None:
        self._model = model

    def on(
        self, points: Array, T_world_camera: Array, field: Field | None = None, seed: int = 0
    ) -> ObjectGrasps:
        """The same score for every grasp of one object."""
        return _IndifferentScore(self._model.on(points, T_world_camera, field=field, seed=seed))


class _IndifferentScore:
    def __init__(self, score: ObjectGrasps) -> None:
        self._score = score

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        return torch.zeros(len(preshape), dtype=preshape.dtype)

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        return self._score.log_prior(preshape, T_world_palm)

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        return self._score.sample(kind, count, rng)
