"""Variants of the success network: their inputs, and whether their encoder is trained.

| name | encoder | mode |
|---|---|---|
| Geometry (the default) | distances of the reconstruction at the grasp | fixed |
| PointSDF-Fixed, VoxelCNN-Fixed | embedding of a trained reconstruction, frozen | fixed |
| PointSDF-Fine-tuned, VoxelCNN-Fine-tuned | the same, trained on | fine-tuned |
| PointSDF-Scratch, VoxelCNN-Scratch | embedding learned from grasps alone | scratch |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from pointsdf_cli.assets import asset_path
from pointsdf_cli.choices import GRASP_KINDS, Encoder, Mode, require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.checkpoints import read_checkpoint, read_config
from pointsdf_cli.models.grasp_checkpoint import (
    FIXED,
    SCRATCH,
    encoder_path,
    read_grasp_checkpoint,
    weights_hash,
)
from pointsdf_cli.models.grasp_features import GraspFeatures
from pointsdf_cli.models.grasp_prior import GraspPrior, ObjectPlace
from pointsdf_cli.models.grasp_success import EmbeddingNet, GeometryNet
from pointsdf_cli.models.hand_sweep import HandSweep, SweepConfig
from pointsdf_cli.models.registry import build_model, default_checkpoint, load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.training.gs_data import GraspData, Split, fold_grasps, split_grasps
from pointsdf_cli.training.gs_evidence import evidence_of
from pointsdf_cli.training.gs_inputs import (
    CloudInputs,
    FixedInputs,
    Learner,
    embedding_columns,
    geometry_features,
)
from pointsdf_cli.training.gs_prior import FEWEST, fit_prior
from pointsdf_cli.training.precision import autocast_dtype

GEOMETRY, POINTSDF, VOXELCNN = "geometry", "pointsdf", "voxelcnn"
ARCHITECTURES = {
    GEOMETRY: ("pointsdf-ray", "pointsdf"),
    POINTSDF: ("pointsdf-ray", "pointsdf"),
    VOXELCNN: ("voxelcnn",),
}
"""Shape networks allowed for each encoder; the first is the default."""

MEMBERS = 5
"""Size of the ensemble on features of geometry, and number of validation folds of objects."""

FEW_LINKS = 8
"""Largest number of closing links whose pads are five points each: the BarrettHand (6) gained by
them, the Allegro hand (11) lost (docs/notebook.md, "A network that saw a line")."""

DROPOUT = 0.2
"""Dropout of the success network. The published one has none; 256 numbers a cloud overfit a few
hundred objects."""


@dataclass(frozen=True)
class Variant:
    """A choice of `--encoder` and `--mode`.

    Raises:
        InputError: No such choice.
    """

    encoder: str = GEOMETRY
    mode: str = FIXED

    def __post_init__(self) -> None:
        require_choice(self.encoder, Encoder, "--encoder")
        require_choice(self.mode, Mode, "--mode")
        if self.encoder == GEOMETRY and self.mode != FIXED:
            raise InputError(
                "features of geometry are read from a finished reconstruction",
                where=f"--mode {self.mode}",
                allowed=FIXED,
                hint=f"--encoder {POINTSDF} --mode {self.mode}",
            )

    @property
    def title(self) -> str:
        """Name in the paper."""
        names = {POINTSDF: "PointSDF", VOXELCNN: "VoxelCNN"}
        if self.encoder == GEOMETRY:
            return "Geometry"
        return f"{names[self.encoder]}-{self.mode.capitalize()}"

    @property
    def epochs(self) -> int:
        """Default number of passes over the grasps; networks on embeddings need more."""
        return 20 if self.encoder == GEOMETRY else 60


class Prepared(NamedTuple):
    """A variant ready to be trained or scored.

    Attributes:
        learner: Network and inputs.
        network, encoder, sweep: Parts of the checkpoint.
        frozen_from: Checkpoint of a frozen encoder; None for a trained one.
    """

    learner: Learner
    network: EmbeddingNet | GeometryNet
    encoder: ShapeModel
    sweep: HandSweep
    frozen_from: Path | None


@dataclass(frozen=True)
class Sources:
    """Sources of the inputs.

    Attributes:
        cache: Folder of cached evidence.
        sdf: Checkpoint of a reconstruction network; the bundled one if None.
        robot: YAML file of the robot; the bundled one if None.
        jobs: Number of processes that fill the cache.
        on_done: Called with the name of each file after its evidence was computed.
    """

    cache: Path
    sdf: Path | None = None
    robot: Path | None = None
    jobs: int = 1
    on_done: Callable[[str, object], None] | None = None


def split_for(data: GraspData, variant: Variant, validation: float, seed: int) -> Split:
    """Split for training a variant: folds for an ensemble, else a share for validation.

    Raises:
        InputError: Too few objects, or grasps of one label only.
    """
    if variant.encoder == GEOMETRY:
        return fold_grasps(data, MEMBERS, seed)
    return split_grasps(data, validation, seed)


def prepare(
    data: GraspData, split: Split, variant: Variant, sources: Sources, seed: int
) -> Prepared:
    """Prepare an untrained network with the inputs of all grasps.

    Raises:
        InputError: The reconstruction network is missing or of the wrong kind.
    """
    robot = load_robot(sources.robot)
    links = len(robot.tree.links_moved_by(robot.closing_joints))
    sweep = HandSweep(robot, SweepConfig(points_per_pad=5 if links <= FEW_LINKS else 1))
    checkpoint = None if variant.mode == SCRATCH else reconstruction_of(variant, sources.sdf)
    if checkpoint is None:
        encoder = build_model(ARCHITECTURES[variant.encoder][0], seed=seed)
    else:
        encoder = load_model(checkpoint)
    torch.manual_seed(seed)
    if variant.encoder == GEOMETRY:
        features = GraspFeatures(sweep, robot.preshape_ranges)
        network: EmbeddingNet | GeometryNet = GeometryNet(features.size, MEMBERS)
    else:
        network = EmbeddingNet(len(robot.preshape_joints), encoder.embedding_size, dropout=DROPOUT)
    learner = _learner(data, network, encoder, sweep, robot, checkpoint, variant.mode, sources)
    if isinstance(network, GeometryNet):
        assert isinstance(learner, FixedInputs)
        learner.folds = split.folds
        network.scale.fit(learner.columns[0][split.train])
    else:
        numbers, size = learner.pose_and_size()
        network.grasp_scale.fit(numbers[split.train])
        network.size_scale.fit(size[split.train])
    frozen = checkpoint if variant.mode == FIXED else None
    return Prepared(learner, network, encoder, sweep, frozen)


def prepare_trained(
    path: Path, data: GraspData, sources: Sources
) -> tuple[Learner, GraspPrior, dict[str, Any]]:
    """Prepare a trained checkpoint with the inputs of all grasps, its prior and its config.

    Raises:
        InputError: As `read_grasp_checkpoint`.
    """
    robot = load_robot(sources.robot)
    # Of several checkpoints, --sdf applies to those that were trained with it.
    encoder = read_config(path).get("encoder")
    wanted = encoder.get("sha256") if isinstance(encoder, Mapping) else None
    sdf = sources.sdf if sources.sdf and weights_hash(sources.sdf) == wanted else None
    parts = read_grasp_checkpoint(path, sdf, robot)
    mode = parts.config["mode"]
    frozen = encoder_path(read_checkpoint(path), sdf) if mode == FIXED else None
    networks = parts.network, parts.encoder, parts.sweep
    learner = _learner(data, *networks, robot, frozen, mode, sources)
    return learner, parts.prior, parts.config


def title_of(config: dict[str, Any]) -> str:
    """The variant's name from a checkpoint's config."""
    if config["inputs"] == GEOMETRY:
        return Variant().title
    of_voxels = config["encoder"]["architecture"] == "voxelcnn"
    return Variant(VOXELCNN if of_voxels else POINTSDF, config["mode"]).title


def places_of(data: GraspData, robot: RobotDescription) -> list[ObjectPlace]:
    """The place of each grasp's object, from its cloud."""
    base = robot.T_world_base[:3, 3]
    first, back = np.unique(data.scene_of, return_index=True, return_inverse=True)[1:]
    clouds = (apply_transform(data.T_world_camera[row], data.cloud[row]) for row in first)
    of_scene = [ObjectPlace.of(cloud, base) for cloud in clouds]
    return [of_scene[scene] for scene in back]


def prior_of(data: GraspData, robot: RobotDescription) -> GraspPrior:
    """Fit the prior to the successful grasps of training objects; to all grasps of a kind with too
    few successes, with the kind's share of the successes as its weight.

    Fitted to successes it is likelier on held-out successes than fitted to all attempts
    (docs/notebook.md), and its samples hold more often. Grasps that a planner chose follow an
    earlier prior: they count only if there are no others.

    Raises:
        InputError: Too few grasps.
    """
    free = ~data.held_out[data.object_of]
    if not data.planned.all():
        free &= ~data.planned
    places = places_of(data, robot)

    held = free & (data.label == 1)
    counts = np.array([(held & (data.kind == k)).sum() for k in range(len(GRASP_KINDS))])
    chosen = np.where(counts[data.kind] >= FEWEST, held, free)
    # Fit to all grasps if no kind has enough successes.
    shares = np.maximum(counts, 1) if (counts >= FEWEST).any() else None
    rows = np.flatnonzero(chosen)
    grasps = data.preshape[rows], data.T_world_palm[rows], data.kind[rows]
    return fit_prior(*grasps, [places[row] for row in rows], robot.preshape_ranges, shares)


def reconstruction_of(variant: Variant, sdf: Path | None) -> Path:
    """Checkpoint of a variant's reconstruction network: the given one, else a bundled one.

    Raises:
        InputError: The given one is of another architecture.
    """
    if sdf is None:
        is_voxels = variant.encoder == VOXELCNN
        return asset_path("weights/voxelcnn") if is_voxels else default_checkpoint()
    found = load_model(sdf).architecture
    if found not in ARCHITECTURES[variant.encoder]:
        raise InputError(
            f"is a {found}",
            where=f"--sdf {sdf}",
            allowed=" or ".join(ARCHITECTURES[variant.encoder]),
        )
    return Path(sdf)


def _learner(
    data: GraspData,
    network: EmbeddingNet | GeometryNet,
    encoder: ShapeModel,
    sweep: HandSweep,
    robot: RobotDescription,
    frozen: Path | None,
    mode: str,
    sources: Sources,
) -> Learner:
    if mode != FIXED:
        assert isinstance(network, EmbeddingNet)
        return CloudInputs(network, encoder, data, autocast_dtype("auto", torch.device("cpu")))
    assert frozen is not None
    geometry = isinstance(network, GeometryNet)
    # Distances, where the network can give them: one cache then serves both kinds of inputs.
    asked = sweep.config if geometry or encoder.gives_distances else None
    evidence = evidence_of(
        data,
        frozen,
        sources.cache,
        sweep=asked,
        robot=sources.robot,
        jobs=sources.jobs,
        on_done=sources.on_done,
    )
    if geometry:
        features = GraspFeatures(sweep, robot.preshape_ranges)
        columns = geometry_features(data, evidence, features)
        return FixedInputs(network, columns, mirrors=features.mirrored())
    return FixedInputs(network, *embedding_columns(data, evidence))
