"""Default settings of `train-sdf` for each model and preset."""

from __future__ import annotations

from typing import Any, get_args

from pointsdf_cli.choices import Model, Preset
from pointsdf_cli.errors import InputError
from pointsdf_cli.models.pointsdf import PRESETS as POINTSDF_PRESETS
from pointsdf_cli.models.revolution import SIDEWAYS
from pointsdf_cli.training.sdf_config import TrainConfig
from pointsdf_cli.training.sdf_loss import SdfLoss

PAPER_EPOCHS = 100
"""Epochs of preset `paper`."""

MODELS, PRESETS = get_args(Model), get_args(Preset)


def preset(model: str, name: str) -> tuple[dict[str, Any], TrainConfig]:
    """Architecture arguments and training settings.

    `paper` is the published recipe: squared error, Adam at a constant 1e-5, batches of 16 clouds
    with 256 queries, and `paper_steps` of them. `small` trains in an hour or two on one processor
    core.

    Raises:
        InputError: No such model or preset.
    """
    if model not in MODELS:
        raise InputError(f"no model {model!r}", where="--model", allowed=", ".join(MODELS))
    if name not in PRESETS:
        raise InputError(f"no preset {name!r}", where="--preset", allowed=", ".join(PRESETS))
    if name == "paper":
        if model == "pointsdf-ray":
            raise InputError("pointsdf-ray is not in the paper", where="--preset", allowed="small")
        return dict(POINTSDF_PRESETS["paper"]) if model == "pointsdf" else {}, TrainConfig(
            batch_size=16,
            learning_rate=1e-5,
            schedule="constant",
            warmup=1,
            weight_decay=0.0,
            clip=0.0,
            average=0.0,
            augmentation=False,
            loss=SdfLoss("mse" if model == "pointsdf" else "sign", sign_weight=1.0),
            precision="float32",
        )
    if model == "voxelcnn":
        return {}, TrainConfig(loss=SdfLoss("sign", sign_weight=1.0))
    if model == "pointsdf":
        return dict(POINTSDF_PRESETS["small"]), TrainConfig()
    evidence = {"revolution": True, "sideways": SIDEWAYS, "box": True, "surroundings": True}
    return evidence, TrainConfig()


def paper_steps(views: int, batch_size: int) -> int:
    """Number of steps in `PAPER_EPOCHS` epochs."""
    return max(1, PAPER_EPOCHS * views // batch_size)
