"""Default settings of `train-sdf` for each model and preset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from pointsdf_cli.choices import Model, Preset, require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.training.checks import option_of
from pointsdf_cli.training.sdf_config import LOSSES, SdfLoss, TrainConfig

SMALL_POINTSDF: dict[str, Any] = {
    "centres": (256, 96, 32, 12),
    "neighbours": (24, 16, 16, 12),
    "mlps": ((32, 64), (64, 128), (96, 192), (128, 256)),
    "weight_channels": 8,
    "query_width": 256,
    "head": (256, 256, 256),
    "tail": (256, 256, 256),
}
"""Architecture of `pointsdf` in preset `small`; that of `paper` is the default."""
SIDEWAYS = 1e-3
"""`sideways` of `pointsdf-ray` (`experiments/symmetric_point_distance.py --sideways`)."""
PAPER_EPOCHS = 100
"""Epochs of preset `paper`."""


def preset(model: str, name: str) -> tuple[dict[str, Any], TrainConfig]:
    """Architecture arguments and training settings.

    `paper` is the published recipe: squared error, Adam at a constant 1e-5, batches of 16 clouds
    with 256 queries, and `paper_steps` of them. `small` trains in an hour or two on one processor
    core.

    Raises:
        InputError: No such model or preset.
    """
    require_choice(model, Model, "--model")
    require_choice(name, Preset, "--preset")
    if name == "paper":
        if model == "pointsdf-ray":
            raise InputError("pointsdf-ray is not in the paper", where="--preset", allowed="small")
        return {}, TrainConfig(
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
        return dict(SMALL_POINTSDF), TrainConfig()
    evidence = {"revolution": True, "sideways": SIDEWAYS, "box": True, "surroundings": True}
    return evidence, TrainConfig()


def settings(model: str, name: str, given: Mapping[str, Any]) -> tuple[dict[str, Any], TrainConfig]:
    """A preset with other settings.

    Args:
        model, name: As for `preset`.
        given: Settings of `TrainConfig` and `SdfLoss` by name; other names are passed over, None
            keeps the preset's. With `minutes` alone the number of steps has no limit.

    Raises:
        InputError: No such model or preset, a number is out of its range, or a setting of the loss
            that the model's does not use.
    """
    arguments, config = preset(model, name)
    if given.get("minutes") and given.get("steps") is None:
        given = {**given, "steps": 10_000_000}
    asked = settings_of(SdfLoss, given)
    used = LOSSES[config.loss.kind]
    for option in asked.keys() - {*used, "kind"}:
        raise InputError(
            f"the loss of {model} --preset {name} ({config.loss.kind}) does not use it",
            where=option_of(option),
            allowed=", ".join(map(option_of, used)) or "none",
            hint="leave it out",
        )
    loss = replace(config.loss, **asked)
    return arguments, replace(config, loss=loss, **settings_of(TrainConfig, given))


def settings_of(kind: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Values of the fields of the dataclass `kind` that are given and not None."""
    names = {field.name for field in fields(kind)}
    return {k: v for k, v in given.items() if k in names and v is not None}


def paper_steps(views: int, batch_size: int) -> int:
    """Number of steps in `PAPER_EPOCHS` epochs."""
    return max(1, PAPER_EPOCHS * views // batch_size)
