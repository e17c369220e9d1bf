"""Settings of the training of a reconstruction network."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from pointsdf_cli.choices import require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.training.checks import require_positive

LOSSES: dict[str, tuple[str, ...]] = {
    "mse": (),
    "relative": ("near", "sign_weight", "temperature", "quantile", "overlap_weight"),
    "sign": ("sign_weight", "temperature", "quantile", "overlap_weight"),
}
"""Kinds of loss, with the settings that each one uses."""


@dataclass(frozen=True)
class SdfLoss:
    """The error of predicted distances (`sdf_loss`).

    `mse` is the paper's loss. `relative` is

        |p − s| / (|s| + near)  +  sign_weight · BCE(−p / temperature, [s < 0])

    whose first part asks for the same relative accuracy at every distance, and whose second asks
    for the right *sign*: a squared error does not care where the zero is, but that is the shape.
    `sign` is that second part alone: occupancy, for VoxelCNN.

    Where a view leaves the surface uncertain, a symmetric loss predicts the median distance. A thin
    wall of uncertain position then vanishes: no place is inside with a probability above 1/2.
    `overlap_weight` adds 1 − IoU of the two insides of each cloud, by volume and with soft signs
    (Rahman and Wang 2016). It asks for the whole shape: a wall in one of several places is kept,
    although each of them is inside with a probability below 1/2.

    `quantile` q < 0.5 weighs false-outside errors by (1 − q) / q over false-inside errors, so that
    the surface lies where the probability of being inside is q: unseen walls stay, and planning
    errs towards keeping away.

    Attributes:
        kind: `mse`, `relative` or `sign`.
        near: Distance under which the relative error becomes absolute, network units.
        sign_weight: Weight of the sign's cross-entropy.
        temperature: Distance at which a sign counts as certain, network units.
        quantile: Quantile of the distance that is predicted, and chance of being inside at the
            surface.
        overlap_weight: Weight of the overlap.
    """

    kind: str = "relative"
    near: float = 0.05
    sign_weight: float = 0.1
    temperature: float = 0.02
    quantile: float = 0.5
    overlap_weight: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in LOSSES:
            raise InputError(f"no loss {self.kind!r}", where="loss", allowed=", ".join(LOSSES))
        require_positive(self, "near", "temperature")
        for weight in ("sign_weight", "overlap_weight"):
            if getattr(self, weight) != 0:
                require_positive(self, weight)
        if not 0 < self.quantile < 1:
            raise InputError(
                f"{self.quantile} is no quantile", where="--quantile", allowed="between 0 and 1"
            )


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
        require_positive(self, "steps", "batch_size", "queries", "learning_rate", "validate_every")
        if self.minutes is not None:
            require_positive(self, "minutes")
        require_choice(self.schedule, Literal["cosine", "constant"], "--schedule")
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
