"""Settings of the training of a reconstruction network."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from pointsdf_cli.errors import InputError
from pointsdf_cli.training.sdf_loss import SdfLoss


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides a run, besides data and architecture.

    Attributes:
        steps: Optimiser steps.
        minutes: If given, the schedule follows the clock instead: it ends after so many minutes of
            training, wherever the step count then stands (`steps` is only an upper limit). Such a
            run resumes, but how far it gets depends on the machine.
        batch_size: Clouds a step.
        queries: Labelled points a cloud.
        learning_rate: At its highest.
        schedule: `cosine` to 2% of it, or `constant` (the paper).
        warmup: Steps of linear warm-up.
        weight_decay: AdamW's; 0 makes it Adam (the paper).
        clip: Largest gradient norm; 0 for none.
        average: Decay of the exponential moving average of the weights a step; 0 for none.
        augmentation: Mirror and turn the views.
        loss: See `SdfLoss`.
        validate_every: Steps between validations, each followed by a checkpoint.
        precision: `auto` (bfloat16 where it is faster), `bfloat16` or `float32`.
        seed: Random seed of the weights, the order and the queries.
    """

    steps: int = 20_000
    minutes: float | None = None
    batch_size: int = 32
    queries: int = 256
    learning_rate: float = 1e-3
    schedule: str = "cosine"
    warmup: int = 200
    weight_decay: float = 0.01
    clip: float = 1.0
    average: float = 0.999
    augmentation: bool = True
    loss: SdfLoss = field(default_factory=SdfLoss)
    validate_every: int = 1000
    precision: str = "auto"
    seed: int = 0

    def __post_init__(self) -> None:
        positive = ("steps", "batch_size", "queries", "learning_rate", "validate_every", "minutes")
        for name in positive:
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(
                    f"{value} is not positive and finite", where="--" + name.replace("_", "-")
                )
        if self.schedule not in ("cosine", "constant"):
            raise InputError(
                f"no schedule {self.schedule!r}", where="--schedule", allowed="cosine, constant"
            )
        if not 0.0 <= self.average < 1.0:
            raise InputError(
                f"{self.average} is not a decay", where="average", allowed="0 to below 1"
            )

    def rate(self, step: int, progress: float) -> float:
        """The learning rate at a step, `progress` ∈ [0, 1] of the way."""
        warm = min(1.0, (step + 1) / max(1, self.warmup))
        if self.schedule == "constant":
            return self.learning_rate * warm
        return self.learning_rate * warm * (0.02 + 0.49 * (1.0 + math.cos(math.pi * progress)))

    def as_dict(self) -> dict[str, Any]:
        """Plain types for config.json."""
        return asdict(self)
