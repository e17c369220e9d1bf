"""Registry of architectures, and their reconstruction from a checkpoint's config.json."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from pointsdf_cli.assets import asset_path
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.io.checkpoints import WEIGHTS, Checkpoint, read_checkpoint
from pointsdf_cli.models.pointsdf import PointSDF
from pointsdf_cli.models.pointsdf_ray import PointSDFRay
from pointsdf_cli.models.processor import use_threads as use_threads
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.models.voxelcnn import VoxelCNN

ARCHITECTURES: dict[str, type[ShapeModel]] = {
    model.architecture: model for model in (PointSDFRay, PointSDF, VoxelCNN)
}


def default_checkpoint() -> Path:
    """The bundled reconstruction network, trained with errors of sensors and masks."""
    return asset_path("weights/pointsdf_real")


def build_model(
    architecture: str, arguments: Mapping[str, Any] | None = None, seed: int = 0
) -> ShapeModel:
    """Build a model with random weights.

    Args:
        architecture: A key of `ARCHITECTURES`.
        arguments: Arguments from its `config()`; the defaults if None.
        seed: Random seed of the initial weights.

    Raises:
        InputError: The architecture is unknown, or the arguments do not fit it.
    """
    if architecture not in ARCHITECTURES:
        raise InputError(
            f"no architecture {architecture!r}", where="model", allowed=", ".join(ARCHITECTURES)
        )
    try:
        with torch.random.fork_rng(devices=[]):  # the caller's generator stays as it is
            torch.manual_seed(seed)
            return ARCHITECTURES[architecture](**dict(arguments or {}))
    except (TypeError, ValueError, RuntimeError, LookupError) as error:
        raise InputError(f"cannot be built as {architecture}: {error}", where="model") from error


def load_model(path: Path | str | None = None, device: str = "cpu") -> ShapeModel:
    """Load the model of a checkpoint directory, in float32 and evaluation mode.

    Args:
        path: The checkpoint; the bundled default if None.
        device: Device of the model.

    Raises:
        InputError: The checkpoint does not exist, its architecture is unknown, or its weights have
            other shapes.
    """
    return model_from_checkpoint(read_checkpoint(path or default_checkpoint())).to(device)


def load_cached(checkpoint: Path) -> ShapeModel:
    """`load_model`, once in a process while the weights' file stays the same."""
    weights = checkpoint / WEIGHTS
    return _loaded(checkpoint, weights.stat().st_mtime_ns if weights.is_file() else 0)


@lru_cache(maxsize=4)
def _loaded(checkpoint: Path, written: int) -> ShapeModel:
    return load_model(checkpoint)


def model_from_checkpoint(checkpoint: Checkpoint) -> ShapeModel:
    """Rebuild the model of a checkpoint, in float32 and evaluation mode."""
    config = checkpoint.config
    try:
        with as_input_error(checkpoint.path):
            model = build_model(str(config.get("architecture")), config.get("model"))
            model.load_state_dict(float_weights(checkpoint))
    except RuntimeError as error:
        first = str(error).strip().splitlines()[1:2] or [str(error)]
        what = f"weights do not fit the architecture in config.json: {first[0].strip()}"
        raise InputError(what, where=checkpoint.path) from error
    model.requires_grad_(False)
    return model.eval()


def float_weights(checkpoint: Checkpoint, prefix: str = "") -> dict[str, torch.Tensor]:
    """A checkpoint's tensors by what follows `prefix` in their names; numbers in float32."""
    return {
        name.removeprefix(prefix): tensor.float() if tensor.is_floating_point() else tensor
        for name, tensor in checkpoint.weights.items()
        if name.startswith(prefix)
    }
