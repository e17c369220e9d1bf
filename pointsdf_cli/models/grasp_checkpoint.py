"""Checkpoints of `train-gs`: network, prior, and the shape network that they read.

A frozen encoder is not stored: config.json names its checkpoint, with a hash of the weights. An
encoder that was trained too is stored, without the untrained decoder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from pointsdf_cli.assets import asset_path, assets_folder
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import (
    WEIGHTS,
    Checkpoint,
    read_checkpoint,
    read_config,
    write_checkpoint,
)
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.models.checkpoint_kinds import (
    ARCHITECTURE,
    bundled_success,
    check_robot,
    check_success,
)
from pointsdf_cli.models.grasp_features import GraspFeatures
from pointsdf_cli.models.grasp_prior import GraspPrior
from pointsdf_cli.models.grasp_success import NETWORKS, EmbeddingNet, GeometryNet
from pointsdf_cli.models.hand_sweep import HandSweep, SweepConfig
from pointsdf_cli.models.registry import build_model, default_checkpoint, float_weights, load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.robot.description import RobotDescription, load_robot

BUNDLED = "weights/grasp_geometry"
BUNDLED_PREFIX = "bundled:"

FIXED, SCRATCH = "fixed", "scratch"


@dataclass(frozen=True)
class GraspParts:
    """Contents of a checkpoint, rebuilt.

    Attributes:
        network: Network of either kind, calibrated, in evaluation mode.
        prior: The mixture.
        encoder: The shape network with the embedding or the distances.
        robot: The robot of the training data.
        sweep: Sweep of its closing hand.
        config: Everything in config.json.
    """

    network: EmbeddingNet | GeometryNet
    prior: GraspPrior
    encoder: ShapeModel
    robot: RobotDescription
    sweep: HandSweep
    config: dict[str, Any] = field(default_factory=dict)


def write_grasp_checkpoint(
    path: Path | str,
    *,
    network: EmbeddingNet | GeometryNet,
    encoder: ShapeModel,
    weights: Mapping[str, Tensor] | None,
    prior: GraspPrior,
    frozen_from: Path | None,
    mode: str,
    robot: RobotDescription,
    sweep: HandSweep,
    provenance: Mapping[str, Any],
    train_state: Mapping[str, Any] | None = None,
    half: bool = False,
) -> None:
    """Write or replace a checkpoint.

    Args:
        path: The directory.
        network, encoder: The architectures.
        weights: `network.…`, and `encoder.…` if that was trained too; None keeps the stored ones.
        prior: The prior, stored in double precision.
        frozen_from: Checkpoint of a frozen encoder.
        mode: One of `choices.Mode`.
        robot, sweep: Robot and closing hand of the training data.
        provenance: Further entries of config.json.
        train_state: State to resume from.
        half: Store weights of the networks in float16.
    """

    stored = None
    if weights is not None:
        stored = prior.state() | {
            name: tensor.half() if half and tensor.is_floating_point() else tensor
            for name, tensor in weights.items()
        }
    config = {
        "architecture": ARCHITECTURE,
        "inputs": network.inputs,
        "mode": mode,
        "network": network.config(),
        "encoder": {
            "architecture": encoder.architecture,
            "model": encoder.config(),
            **(_reference(frozen_from) if frozen_from is not None else {}),
        },
        "sweep": asdict(sweep.config),
        "robot": {
            "name": robot.name,
            "preshape_joints": list(robot.preshape_joints),
            "course": sweep.course().round(5).tolist(),
        },
        **provenance,
    }
    write_checkpoint(path, config=config, weights=stored, train_state=train_state)


def read_grasp_checkpoint(
    path: Path | str | None = None,
    sdf_checkpoint: Path | str | None = None,
    robot: RobotDescription | None = None,
) -> GraspParts:
    """Read and rebuild everything, in float32 and evaluation mode.

    Args:
        path: The checkpoint; where None, the bundled one of the robot.
        sdf_checkpoint: Path of the frozen encoder, if it has moved.
        robot: The robot; the bundled one if None.

    Raises:
        InputError: The checkpoint does not exist or is of another kind or robot, or its encoder is
            missing or has other weights.
    """
    robot = robot or load_robot()
    checkpoint = read_checkpoint(path or bundled_success(robot) or asset_path(BUNDLED))
    config, where = checkpoint.config, checkpoint.path
    check_success(config, where)
    _check_config(config, where)
    check_robot(robot, config["robot"]["name"], config["robot"]["preshape_joints"], where)
    try:
        network = NETWORKS[config["inputs"]](**config["network"])
        sizes = {**config["sweep"], "grid": tuple(config["sweep"]["grid"])}
        sweep = HandSweep(robot, SweepConfig(**sizes))
        network.load_state_dict(float_weights(checkpoint, "network."))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(
            f"does not fit its config.json ({str(error).splitlines()[0]})", where=where
        ) from error
    check_hand(sweep, config, where)
    _check_features(network, sweep, robot, where)
    network.requires_grad_(False).eval()
    prior = GraspPrior.from_state(checkpoint.weights)
    encoder = _encoder(checkpoint, sdf_checkpoint)
    return GraspParts(network, prior, encoder, robot, sweep, config)


def _check_config(config: Mapping[str, Any], where: object) -> None:
    """Require the keys of config.json that are read.

    Raises:
        InputError: A key is missing: the file is damaged or was written by hand.
    """
    of_robot = ("name", "preshape_joints", "course")
    parts = {"robot": of_robot, "mode": (), "encoder": (), "inputs": ()}
    for key, inner in parts.items():
        missing = key not in config or (
            key in ("robot", "encoder") and not isinstance(config[key], Mapping)
        )
        if missing or any(name not in config[key] for name in inner):
            raise InputError(f"its config.json has no usable {key!r}", where=where)
    joints, encoder = config["robot"]["preshape_joints"], config["encoder"]
    if not (isinstance(joints, list) and all(isinstance(name, str) for name in joints)):
        raise InputError("its config.json has no usable 'preshape_joints'", where=where)
    own = config["mode"] != FIXED
    if own and not {"architecture", "model"} <= set(encoder):
        raise InputError("its config.json has no usable 'encoder'", where=where)


def check_hand(sweep: HandSweep, config: Mapping[str, Any], where: object) -> None:
    """Refuse a checkpoint trained with a hand whose fingers move differently.

    Raises:
        InputError: The fingers move differently.
    """
    now = sweep.course()
    try:
        course = np.asarray(config["robot"]["course"], dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError("its config.json has no usable 'course'", where=where) from error
    if course.shape != now.shape or not np.allclose(course, now, atol=COURSE_OFF):
        raise InputError(
            f"was trained with another hand or palm frame of {config['robot']['name']!r}: the "
            "fingers close elsewhere, so its predictions do not apply",
            where=where,
            allowed="palm frame, links, limits, closing joints and speeds as in training",
            hint="collect-grasps and train-gs again with this --robot",
        )


def _check_features(
    network: EmbeddingNet | GeometryNet, sweep: HandSweep, robot: RobotDescription, where: object
) -> None:
    """Refuse a network of geometry that was trained with other shapes of the hand.

    Raises:
        InputError: The hand has another number of features.
    """
    if isinstance(network, GeometryNet):
        learned = network.config()["features"]
        now = GraspFeatures(sweep, robot.preshape_ranges).size
        if now != learned:
            raise InputError(
                f"was trained with other shapes of the hand: it reads {learned} features, and "
                f"this hand has {now}",
                where=where,
                hint="fix a camera or tool to the arm's last link instead of the hand; for another "
                "hand collect-grasps and train-gs with this --robot",
            )


COURSE_OFF = 3e-3
"""Largest distance [m] between the pad positions of hands that count as the same."""


def weights_hash(path: Path | str) -> str:
    """SHA-256 of a checkpoint's weights file.

    Raises:
        InputError: There is none.
    """
    file = Path(path) / WEIGHTS
    if not file.is_file():
        raise InputError(f"has no {WEIGHTS}", where=path, allowed="a checkpoint directory")
    return file_sha256(file)


def _reference(path: Path) -> dict[str, str]:
    path = path.resolve()
    home = (assets_folder() / "weights").resolve()
    name = f"{BUNDLED_PREFIX}{path.name}" if path.parent == home else str(path)
    return {"checkpoint": name, "sha256": weights_hash(path)}


def encoder_path(checkpoint: Checkpoint, override: Path | str | None = None) -> Path:
    """Path of a checkpoint's frozen encoder.

    Args:
        checkpoint: Checkpoint of mode `fixed`.
        override: New path, if it has moved.

    Raises:
        InputError: It is missing, or has other weights than those that were trained with.
    """
    config = checkpoint.config["encoder"]
    stored = str(config.get("checkpoint"))
    path = Path(override) if override is not None else Path(stored)
    if override is None and stored.startswith(BUNDLED_PREFIX):
        path = asset_path(f"weights/{stored.removeprefix(BUNDLED_PREFIX)}")
    if not path.is_dir():
        raise InputError(
            f"the encoder of its training is missing ({path})",
            where=checkpoint.path,
            hint="give its checkpoint directory with --sdf",
        )
    if weights_hash(path) != config.get("sha256"):
        raise InputError(
            f"was trained with other weights than those in {path}",
            where=checkpoint.path,
            hint="give the encoder's checkpoint with --sdf, or train again",
        )
    return path


def reconstruction_to_plan_with(grasp_checkpoint: Path | str | None) -> Path:
    """Reconstruction network to plan with: the bundled one that the success network was trained
    on, if it names one; else the default one.

    Raises:
        InputError: The success network's config.json cannot be read.
    """
    encoder = {} if grasp_checkpoint is None else read_config(grasp_checkpoint).get("encoder")
    name = str(encoder.get("checkpoint", "")) if isinstance(encoder, Mapping) else ""
    if name.startswith(BUNDLED_PREFIX):
        return asset_path(f"weights/{name.removeprefix(BUNDLED_PREFIX)}")
    return default_checkpoint()


def other_training_reconstruction(
    grasp_checkpoint: Path | str, sdf_checkpoint: Path | str
) -> Path | None:
    """Reconstruction that a success network on geometry was trained with, if not `sdf_checkpoint`.

    Such a network reads any field, but its probabilities are calibrated for fields of the
    reconstruction that it was trained with.

    Args:
        grasp_checkpoint: The success network.
        sdf_checkpoint: The reconstruction network that it will read.

    Returns:
        None if they are the same, or if the success network has its own encoder.

    Raises:
        InputError: A checkpoint does not exist.
    """
    checkpoint = read_checkpoint(grasp_checkpoint)
    config = checkpoint.config
    if config.get("inputs") != "geometry" or config.get("mode") != FIXED:
        return None
    _check_config(config, checkpoint.path)
    learned = config["encoder"]
    if learned.get("sha256") == weights_hash(sdf_checkpoint):
        return None
    return Path(str(learned.get("checkpoint")))


def _encoder(checkpoint: Checkpoint, override: Path | str | None) -> ShapeModel:
    if checkpoint.config["mode"] == FIXED:
        return load_model(encoder_path(checkpoint, override))
    config = checkpoint.config["encoder"]
    model = build_model(config["architecture"], config["model"])
    missing, unexpected = model.load_state_dict(float_weights(checkpoint, "encoder."), strict=False)
    parts = tuple(f"{part}." for part in model.encoder_parts)
    if unexpected or any(name.startswith(parts) for name in missing):
        raise InputError("holds no complete encoder", where=checkpoint.path)
    return model.requires_grad_(False).eval()
