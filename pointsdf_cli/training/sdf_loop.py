"""Training a reconstruction network (`rgrasp train-sdf`): data, model, optimiser, loop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
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
    state_as_input_error,
)
from pointsdf_cli.training.sdf_config import TrainConfig
from pointsdf_cli.training.sdf_data import Split, augment, predict, read_batch, training_views
from pointsdf_cli.training.sdf_loss import sdf_loss, validate
from pointsdf_cli.training.sdf_pack import Pack
from pointsdf_cli.training.sdf_progress import Progress, TrainResult

LABEL_STRIDE = 101
"""Stride of the labels that identify a data set."""


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

    A run that was stopped and resumed gives bit for bit the weights of an uninterrupted one (with
    `steps`, on the same machine).

    Args:
        pack: The data.
        split: Views for training and for validation.
        model: Freshly built; its weights are overwritten when resuming.
        config: Settings.
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
    _require_enough_clouds(model, config, split, workers)
    run = _Run(pack, split, model, config, torch.device(device), workers)
    if resume:
        run.restore(out)
    reported = time.monotonic()
    while run.fraction < 1.0:
        if workers.most(should_stop()):
            run.collect_losses()  # raises before a state without finite losses replaces a good one
            run.save(out, provenance)
            return run.result(finished=False)
        run.take_step()
        now = time.monotonic()
        if now - reported >= report_every:
            on_progress(run.progress(now - reported))
            reported = now
        if run.step % config.validate_every == 0 or run.fraction >= 1.0:
            entry = run.validate()
            run.save(out, provenance)
            on_progress(Progress(run.step, run.fraction, entry["train_loss"], 0.0, 0.0, entry))
            reported = time.monotonic()
    return run.result(finished=True)


class _Run:
    """State of a training run, and what changes it.

    Attributes:
        average: Moving average of the weights.
        step: Steps done.
        seconds: Training time, over all resumed parts.
        history: One entry per validation.
    """

    def __init__(
        self,
        pack: Pack,
        split: Split,
        model: ShapeModel,
        config: TrainConfig,
        device: torch.device,
        workers: Workers,
    ) -> None:
        self._pack, self._split, self._config = pack, split, config
        self._device, self._workers = device, workers
        self._precision = autocast_dtype(config.precision, device)
        self._model = model.to(device).train()
        self._optimiser = torch.optim.AdamW(
            model.parameters(),
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
            betas=(0.9, 0.98) if config.schedule == "cosine" else (0.9, 0.999),
            fused=True,
        )
        self.average = WeightAverage(model, config.average)
        self._data_hash = data_sha256(
            pack.names,
            pack.object_of_view,
            pack.label_start,
            pack.to_network,  # other views lie elsewhere, other labels are other numbers
            pack.sdf[::LABEL_STRIDE],
            *split,
        )
        self.step, self.seconds = 0, 0.0
        self.history: list[dict[str, float]] = []
        # Losses since the last validation: their number, the sum of those that were read back, and
        # on the device the sum of the others.
        self._loss_count, self._loss_sum = 0, 0.0
        self._unread = torch.zeros((), device=device)
        self._unread_count = 0

    @property
    def fraction(self) -> float:
        """Share of the run that is done, by steps or by the clock."""
        done = self.step / self._config.steps
        if self._config.minutes is None:
            return done
        return min(1.0, max(done, self.seconds / (60.0 * self._config.minutes)))

    def take_step(self) -> None:
        """One optimiser step; its time counts as training time."""
        began = time.monotonic()
        config, model = self._config, self._model
        # The batch, the queries and their turn are a function of (seed, step) alone, as is what
        # dropout leaves out of this worker's share.
        rng = np.random.default_rng([config.seed, 2, self.step])
        views = training_views(self._split.train, config.batch_size, self.step, config.seed)
        batch = read_batch(self._pack, views, config.queries, rng)
        batch = augment(batch, rng) if config.augmentation else batch
        batch = self._workers.share(batch).to(self._device)
        torch.manual_seed(int(rng.integers(2**62)) + self._workers.rank)

        for group in self._optimiser.param_groups:
            group["lr"] = config.rate(self.step, self.fraction)
        low = self._precision
        with torch.autocast(self._device.type, low, enabled=low is not None):
            predicted = predict(model, batch)
        loss = sdf_loss(config.loss, predicted, batch.sdf)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self._workers.average_gradients(model)
        if config.clip:
            torch.nn.utils.clip_grad_norm_(model.parameters(), config.clip)
        self._optimiser.step()
        self.average.update(model, self.step)
        self.step += 1
        self._loss_count += 1
        self._unread += loss.detach()
        self._unread_count += 1
        self.seconds += time.monotonic() - began
        if config.minutes is not None:
            # Without one clock they would not end at the same step.
            self.seconds = self._workers.most(self.seconds)

    def progress(self, seconds: float) -> Progress:
        """Progress after this worker's last steps, which took `seconds`.

        Raises:
            RgraspError: Their losses are not finite.
        """
        read, steps = finite(float(self._unread), self.step), self._unread_count
        self._loss_sum += read
        self._clear_unread()
        speed = steps * self._config.batch_size / seconds
        left = self.seconds * (1.0 / max(self.fraction, 1e-9) - 1.0)
        return Progress(self.step, self.fraction, read / steps, speed, left)

    def _clear_unread(self) -> None:
        self._unread.zero_()
        self._unread_count = 0

    def collect_losses(self) -> None:
        """Make the sum of losses that of all workers, on average.

        Raises:
            RgraspError: It is not finite.
        """
        total = self._workers.mean(self._loss_sum + float(self._unread))
        self._loss_sum = finite(total, self.step)
        self._clear_unread()

    def validate(self) -> dict[str, float]:
        """Judge the averaged weights by held-out views; the new entry of the history."""
        self.collect_losses()
        model, loss = self.average.model, self._config.loss
        result = validate(self._pack, self._split, model, loss, self._precision, self._device)
        finite(result.object_loss, self.step)
        mean = self._loss_sum / self._loss_count
        entry = {"step": self.step, "seconds": self.seconds, "train_loss": mean}
        entry |= result._asdict()
        self.history.append(entry)
        self._loss_count, self._loss_sum = 0, 0.0
        return entry

    def result(self, finished: bool) -> TrainResult:
        """The run so far."""
        return TrainResult(finished, self.step, self.seconds, self.history, _best(self.history))

    def save(self, out: Path | str, provenance: Mapping[str, Any] | None) -> None:
        """Write the state, and the weights unless better ones are there; by the first worker."""
        if not self._workers.is_first:
            return
        validated = self.history and self._loss_count == 0
        is_best = not self.history or (validated and _best(self.history) is self.history[-1])
        model, config = self._model, asdict(self._config)
        write_checkpoint(
            out,
            config={
                "architecture": model.architecture,
                "model": model.config(),
                "training": config,
                "progress": {"step": self.step, "seconds": round(self.seconds, 1)},
                "best": _best(self.history),
                **(provenance or {}),
            },
            weights=self.average.weights() if is_best else None,
            train_state={
                "architecture": model.architecture,
                "arguments": model.config(),
                "config": config,
                "data": self._data_hash,
                "model": model.state_dict(),
                "optimiser": self._optimiser.state_dict(),
                "average": self.average.weights(),
                "since_validation": self._loss_count,
                "total": self._loss_sum,
                "step": self.step,
                "seconds": self.seconds,
                "history": self.history,
            },
        )

    def restore(self, out: Path | str) -> None:
        """Read the state that `save` wrote.

        Raises:
            InputError: There is none, or it is of another configuration or of other data.
        """
        state = read_train_state(out)
        with state_as_input_error(out):
            require_same_run(state, self._model, asdict(self._config), out)
            require_same_data(state, self._data_hash, out)
            self._model.load_state_dict(state["model"])
            put_back_optimiser(self._optimiser, state["optimiser"])
            self.average.load(state["average"])
            self.step, self.seconds, self.history = progress_of(state, "step", "object_loss")
            self._loss_count = max(0, int(state["since_validation"]))
            self._loss_sum = float(state["total"])


def _require_enough_clouds(
    model: ShapeModel, config: TrainConfig, split: Split, workers: Workers
) -> None:
    share = min(config.batch_size, len(split.train)) // workers.count
    if share < 2 and has_batch_norm(model):
        raise InputError(
            f"{share} cloud a step in each process: {model.architecture} has batch norm, which "
            "compares clouds",
            where="--batch-size",
            allowed="2 or more, and as many training views",
        )


def finite(loss: float, step: int) -> float:
    """The loss of a step.

    Raises:
        RgraspError: It is NaN or infinite.
    """
    if not math.isfinite(loss):
        raise RgraspError(f"the loss is {loss} at step {step}", hint="lower --learning-rate")
    return loss


def _best(history: list[dict[str, float]]) -> dict[str, float] | None:
    return min(history, key=lambda entry: entry["object_loss"], default=None)
