"""Training a reconstruction network (`rgrasp train-sdf`): config, data, model, optimiser, loop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.checkpoints import read_train_state, write_checkpoint
from pointsdf_cli.io.provenance import data_sha256
from pointsdf_cli.models.processor import keep_large_allocations
from pointsdf_cli.models.shape_model import ShapeModel, has_batch_norm
from pointsdf_cli.training.distributed import ALONE, Workers
from pointsdf_cli.training.ema import WeightAverage
from pointsdf_cli.training.precision import autocast_dtype
from pointsdf_cli.training.resuming import (
    progress_of,
    put_back_optimiser,
    require_same_data,
    require_same_run,
    sense_of_state,
)
from pointsdf_cli.training.sdf_data import Split, augment, predict, read_batch, training_views
from pointsdf_cli.training.sdf_loss import SdfLoss
from pointsdf_cli.training.sdf_pack import Pack
from pointsdf_cli.training.sdf_validation import Validation, validate


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
        precision: `auto` (bfloat16 where the processor has it), `bfloat16` or `float32`.
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
            raise InputError(f"{self.average} is no decay", where="average", allowed="0 to below 1")

    def rate(self, step: int, progress: float) -> float:
        """The learning rate at a step, `progress` ∈ [0, 1] of the way."""
        warm = min(1.0, (step + 1) / max(1, self.warmup))
        if self.schedule == "constant":
            return self.learning_rate * warm
        return self.learning_rate * warm * (0.02 + 0.49 * (1.0 + math.cos(math.pi * progress)))

    def as_dict(self) -> dict[str, Any]:
        """Plain types for config.json."""
        return asdict(self)


LABEL_STRIDE = 101
"""Stride of the labels that identify a data set."""


@dataclass(frozen=True)
class Progress:
    """Progress after a step.

    Attributes:
        step: Steps done.
        fraction: Share of the whole run that is done.
        loss: Mean training loss since the last report.
        clouds_per_second: Since the last report.
        seconds_left: Estimate.
        validation: Set right after a validation.
    """

    step: int
    fraction: float
    loss: float
    clouds_per_second: float
    seconds_left: float
    validation: dict[str, float] | None = None


@dataclass(frozen=True)
class TrainResult:
    """Result of a run.

    Attributes:
        finished: False if it was stopped; `--resume` then carries on.
        step: Steps done.
        seconds: Training time, over all resumed parts.
        history: One entry a validation: step, seconds, train_loss, and the validation's numbers.
        best: The entry whose weights were kept.
    """

    finished: bool
    step: int
    seconds: float
    history: list[dict[str, float]]
    best: dict[str, float] | None


def train_sdf(
    pack: Pack,
    split: Split,
    model: ShapeModel,
    config: TrainConfig,
    out: Path | str,
    *,
    provenance: Mapping[str, Any] | None = None,
    resume: bool = False,
    device: str = "cpu",
    workers: Workers = ALONE,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    should_stop: Callable[[], bool] = lambda: False,
    report_every: float = 2.0,
) -> TrainResult:
    """Train `model` and keep the weights with the lowest loss on held-out objects.

    A stopped and resumed run gives bit for bit the weights of an uninterrupted one (with `steps`,
    on the same machine).

    Args:
        pack: The data.
        split: Views for training and for validation.
        model: Freshly built; its weights are overwritten when resuming.
        config: See `TrainConfig`.
        out: Checkpoint directory: best weights, and the state to resume from.
        provenance: Goes into config.json.
        resume: Carry on from the state in `out`.
        device: Device of the computation.
        workers: The processes that train together; the first one writes and reports.
        on_progress: Called every `report_every` seconds and after each validation.
        should_stop: Asked before each step; True writes the state and returns.

    Raises:
        InputError: Nothing to resume, or it was another configuration or other data; or a step
            has too few clouds for batch norm.
        RgraspError: The loss is no longer finite.
    """
    keep_large_allocations()
    share = min(config.batch_size, len(split.train)) // workers.count
    if share < 2 and has_batch_norm(model):
        raise InputError(
            f"{share} cloud a step in each process: {model.architecture} has batch norm, which "
            "compares clouds",
            where="--batch-size",
            allowed="2 or more, and as many training views",
        )
    target = torch.device(device)
    model.to(target).train()
    optimiser = torch.optim.AdamW(
        model.parameters(),
        lr=config.learning_rate,
        weight_decay=config.weight_decay,
        betas=(0.9, 0.98) if config.schedule == "cosine" else (0.9, 0.999),
        fused=True,
    )
    average = WeightAverage(model, config.average)
    low_precision = autocast_dtype(config.precision, target)
    step, seconds, history = 0, 0.0, list[dict[str, float]]()
    learned_from = data_sha256(
        pack.names,
        pack.object_of_view,
        pack.label_start,
        pack.to_network,  # other views lie elsewhere, other labels are other numbers
        pack.sdf[::LABEL_STRIDE],
        *split,
    )
    losses = torch.zeros((), device=target)
    since_report, since_validation, total = 0, 0, 0.0
    if resume:
        state = read_train_state(out)
        with sense_of_state(out):
            require_same_run(state, model, config.as_dict(), out)
            require_same_data(state, learned_from, out)
            model.load_state_dict(state["model"])
            put_back_optimiser(optimiser, state["optimiser"])
            average.load(state["average"])
            step, seconds, history = progress_of(state, "step", "object_loss")
            # A run of an earlier version does not say: the first mean loss is of what follows then.
            since_validation = max(0, int(state.get("since_validation", 0)))
            total = float(state.get("total", 0.0))

    def save(weights: dict[str, torch.Tensor] | None) -> None:
        if not workers.is_first:
            return
        write_checkpoint(
            out,
            config={
                "architecture": model.architecture,
                "model": model.config(),
                "training": config.as_dict(),
                "progress": {"step": step, "seconds": round(seconds, 1)},
                "best": _best(history),
                **(provenance or {}),
            },
            weights=weights,
            train_state={
                "architecture": model.architecture,
                "arguments": model.config(),
                "config": config.as_dict(),
                "data": learned_from,
                "model": model.state_dict(),
                "optimiser": optimiser.state_dict(),
                "average": average.state(),
                "since_validation": since_validation,
                "total": total,
                "step": step,
                "seconds": seconds,
                "history": history,
            },
        )

    def fraction_done() -> float:
        if config.minutes is None:
            return step / config.steps
        return min(1.0, max(step / config.steps, seconds / (60.0 * config.minutes)))

    clock = reported = time.monotonic()
    while fraction_done() < 1.0:
        if workers.most(should_stop()):
            total = _finite(workers.mean(total + float(losses)), step)  # or the good state stays
            save(None if history else average.weights())
            return TrainResult(False, step, seconds, history, _best(history))

        # The batch, the queries and their turn are a function of (seed, step) alone, as is what
        # dropout leaves out of this worker's share.
        rng = np.random.default_rng([config.seed, 2, step])
        views = training_views(split.train, config.batch_size, step, config.seed)
        batch = read_batch(pack, views, config.queries, rng)
        batch = augment(batch, rng) if config.augmentation else batch
        batch = workers.share(batch).to(target)
        torch.manual_seed(int(rng.integers(2**62)) + workers.rank)

        for group in optimiser.param_groups:
            group["lr"] = config.rate(step, fraction_done())
        with torch.autocast(target.type, low_precision, enabled=low_precision is not None):
            predicted = predict(model, batch)
        loss = config.loss(predicted, batch.sdf)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        workers.average_gradients(model)
        if config.clip:
            torch.nn.utils.clip_grad_norm_(model.parameters(), config.clip)
        optimiser.step()
        average.update(model, step)

        step += 1
        since_report += 1
        since_validation += 1
        losses += loss.detach()
        now = time.monotonic()
        seconds, clock = seconds + now - clock, now
        if config.minutes is not None:
            seconds = workers.most(seconds)  # one clock, or they would not end at the same step
        if now - reported >= report_every:
            mean = float(losses) / since_report
            total += _finite(float(losses), step)
            speed = since_report * config.batch_size / (now - reported)
            left = seconds * (1.0 / max(fraction_done(), 1e-9) - 1.0)
            on_progress(Progress(step, fraction_done(), mean, speed, left))
            losses.zero_()
            since_report, reported = 0, now
        if step % config.validate_every == 0 or fraction_done() >= 1.0:
            total = _finite(workers.mean(total + float(losses)), step)
            result = validate(pack, split, average.model, config.loss, low_precision, target)
            history.append(_entry(step, seconds, total / since_validation, result))
            losses.zero_()
            since_report, since_validation, total = 0, 0, 0.0
            is_best = _best(history) is history[-1]
            save(average.weights() if is_best else None)
            on_progress(
                Progress(step, fraction_done(), history[-1]["train_loss"], 0.0, 0.0, history[-1])
            )
            clock = reported = time.monotonic()
    return TrainResult(True, step, seconds, history, _best(history))


def _finite(loss: float, step: int) -> float:
    if not math.isfinite(loss):
        raise RgraspError(f"the loss is {loss} at step {step}", hint="lower --learning-rate")
    return loss


def _entry(step: int, seconds: float, loss: float, result: Validation) -> dict[str, float]:
    return {"step": step, "seconds": seconds, "train_loss": loss, **result._asdict()}


def _best(history: list[dict[str, float]]) -> dict[str, float] | None:
    return min(history, key=lambda entry: entry["object_loss"], default=None)
