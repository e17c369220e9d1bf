"""Training a success network (`rgrasp train-gs`): config, batches, optimiser, loop, calibration."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.provenance import data_sha256
from pointsdf_cli.models.processor import keep_large_allocations
from pointsdf_cli.training.checks import require_positive, require_share
from pointsdf_cli.training.gs_calibration import Platt, fit_platt, negative_log_likelihood
from pointsdf_cli.training.gs_data import GraspData, Split
from pointsdf_cli.training.gs_inputs import Index, Learner
from pointsdf_cli.training.gs_metrics import average_precision, roc_auc
from pointsdf_cli.training.resuming import progress_of, put_back_optimiser, state_as_input_error


@dataclass(frozen=True)
class SuccessTraining:
    """Training settings, apart from data and architecture.

    Attributes:
        epochs: Largest number of passes over the training grasps.
        batch_size: Number of grasps per step.
        learning_rate: Peak learning rate, followed by a cosine to 1% of it.
        encoder_rate: Learning rate of a trained encoder, as a share of it.
        warmup: Number of steps of linear warm-up.
        weight_decay: Weight decay of AdamW.
        patience: Number of epochs without improvement after which the run ends.
        validation: Share of the training objects for validation.
        seed: Random seed of the split, the weights and the order.
    """

    epochs: int = 60
    batch_size: int = 128
    learning_rate: float = 2e-3
    encoder_rate: float = 0.3
    warmup: int = 50
    weight_decay: float = 0.05
    patience: int = 15
    validation: float = 0.15
    seed: int = 0

    def __post_init__(self) -> None:
        require_positive(self, "epochs", "batch_size", "learning_rate", "encoder_rate", "patience")
        require_share(self, "validation")

    def rate(self, step: int, steps: int) -> float:
        """Learning rate at a step."""
        warm = min(1.0, (step + 1) / max(1, self.warmup))
        return self.learning_rate * warm * (0.01 + 0.495 * (1 + math.cos(math.pi * step / steps)))


class Fitted(NamedTuple):
    """Result of a run.

    Attributes:
        finished: Whether the run finished; a stopped one resumes from the last state.
        weights: Weights of the best epoch, by module and name, such as `network.leave.bias`.
        platt: Calibration of these weights on the validation objects.
        validation_logits: Raw logits of the best epoch.
        history: One entry per epoch.
        seconds: Training time, over all resumed parts.
    """

    finished: bool
    weights: dict[str, Tensor]
    platt: Platt
    validation_logits: NDArray[np.float64]
    history: list[dict[str, float]]
    seconds: float

    @property
    def best(self) -> dict[str, float]:
        """The entry of the best epoch."""
        return min(self.history, key=lambda entry: entry["loss"])

    def describe(self) -> str:
        """Describe the last epoch in one line."""
        entry = self.history[-1]
        return (
            f"epoch {entry['epoch']:.0f}: loss {entry['train_loss']:.4f}, validation "
            f"{entry['loss']:.4f}, average precision {entry['average_precision']:.3f}, "
            f"AUC {entry['roc_auc']:.3f}; {self.seconds:.0f} s"
        )


def train_success(
    data: GraspData,
    split: Split,
    learner: Learner,
    config: SuccessTraining,
    *,
    resume: Mapping[str, Any] | None = None,
    on_epoch: Callable[[Fitted, dict[str, Any]], None] = lambda fitted, state: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Fitted:
    """Train, keep the epoch with the highest likelihood on held-out objects, and calibrate it
    there.

    The classes are balanced by weight. The criterion is the likelihood of the validation grasps
    after calibration, which removes the effects of base rate and overconfidence. A stopped and
    resumed run gives bit for bit the weights of an uninterrupted one.

    Args:
        data: The grasps.
        split: Split by object.
        learner: Network and inputs; its weights are overwritten when resuming.
        config: Training settings.
        resume: State from an earlier call of `on_epoch`.
        on_epoch: Called after each epoch with the result so far, and the state.
        should_stop: Called before each step; True discards the current epoch and returns.

    Raises:
        InputError: `resume` is of another run.
        RgraspError: The loss is not finite.
    """
    keep_large_allocations()
    run = _Run(data, split, learner, config)
    if resume is not None:
        run.restore(resume)
    clock = time.monotonic()
    while not run.finished:
        if not run.train_epoch(should_stop):
            return run.found(finished=False)
        run.judge_epoch()
        now = time.monotonic()
        run.seconds, clock = run.seconds + now - clock, now
        on_epoch(run.found(finished=False), run.state())
    return run.found(finished=True)


class _Run:
    """State of a training run, and what changes it."""

    def __init__(
        self, data: GraspData, split: Split, learner: Learner, config: SuccessTraining
    ) -> None:
        self._data, self._split, self._learner, self._config = data, split, learner, config
        self._label = torch.from_numpy(data.label)
        self._truth = data.label[split.validation]
        held = float(data.label[split.train].mean())
        self._class_weight = torch.tensor([0.5 / (1.0 - held), 0.5 / held])
        shares = {"network": 1.0, "encoder": config.encoder_rate}
        groups = [
            {"params": part.parameters(), "share": shares[name]}
            for name, part in learner.modules.items()
        ]
        self._optimiser = torch.optim.AdamW(groups, weight_decay=config.weight_decay, fused=True)
        torch.manual_seed(config.seed)
        self._data_hash = data_sha256(
            data.names, data.object_of, data.T_world_palm, data.label, split.train, split.validation
        )
        self._epoch, self._train_loss, self.seconds = 0, 0.0, 0.0
        self._history: list[dict[str, float]] = []
        self._best: dict[str, Tensor] = {}
        self._platt, self._logits = Platt(1.0, 0.0), np.zeros(len(self._truth))

    @property
    def finished(self) -> bool:
        """Whether all epochs are done, or the patience is exhausted."""
        losses = [entry["loss"] for entry in self._history] or [0.0]
        exhausted = len(losses) - 1 - int(np.argmin(losses)) >= self._config.patience
        return self._epoch >= self._config.epochs or exhausted

    def train_epoch(self, should_stop: Callable[[], bool]) -> bool:
        """One pass over the training grasps; False if it was stopped.

        Raises:
            RgraspError: The loss is not finite.
        """
        config, train = self._config, self._split.train
        # A remainder below half a batch joins the batch before: it might be of one scene alone, and
        # batch norm cannot learn from one cloud.
        batches = max(1, math.floor(len(train) / config.batch_size + 0.5))
        rng = np.random.default_rng([config.seed, 3, self._epoch])
        order = scene_order(self._data, train, rng)
        total = 0.0
        self._learner.modules.train()
        for number in range(batches):
            if should_stop():
                return False
            last = None if number + 1 == batches else (number + 1) * config.batch_size
            rate = config.rate(self._epoch * batches + number, config.epochs * batches)
            total += self._take_step(order[number * config.batch_size : last], rate, rng) / batches
        if not math.isfinite(total):
            raise RgraspError(
                f"the loss is {total} in epoch {self._epoch}", hint="lower --learning-rate"
            )
        self._epoch += 1
        self._train_loss = total
        return True

    def _take_step(self, index: Index, rate: float, rng: np.random.Generator) -> float:
        """One optimiser step on some grasps; its loss."""
        for group in self._optimiser.param_groups:
            group["lr"] = rate * group["share"]
        predicted = self._learner.training_logits(index, rng)
        target = self._label[index]
        weight = self._learner.member_weights(index) * self._class_weight[target.long()]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(
            predicted, target.expand_as(predicted), weight=weight.expand_as(predicted)
        )
        # Members share only the gains of two layer norms, so the losses are summed, not averaged:
        # each member gets the gradient of its own loss.
        self._optimiser.zero_grad(set_to_none=True)
        (loss * len(predicted)).backward()
        torch.nn.utils.clip_grad_norm_(self._learner.modules.parameters(), 5.0)
        self._optimiser.step()
        return loss.item()

    def judge_epoch(self) -> None:
        """Evaluate the weights on the validation grasps, and keep them if they are the best yet."""
        logits = self._learner.validation_logits(self._split.validation)
        platt = fit_platt(self._truth, logits)
        entry = {
            "epoch": float(self._epoch),
            "train_loss": self._train_loss,
            "loss": negative_log_likelihood(self._truth, logits, platt),
            "average_precision": average_precision(self._truth, logits),
            "roc_auc": roc_auc(self._truth, logits),
        }
        if not self._history or entry["loss"] < min(e["loss"] for e in self._history):
            self._best = copy.deepcopy(weights_of(self._learner))
            self._platt, self._logits = platt, logits
        self._history.append(entry)

    def found(self, finished: bool) -> Fitted:
        """The best weights so far."""
        return Fitted(finished, self._best, self._platt, self._logits, self._history, self.seconds)

    def state(self) -> dict[str, Any]:
        """State for `restore`; copies, since a stop within the next epoch writes them later."""
        return {
            "config": asdict(self._config),
            "data": self._data_hash,
            "weights": copy.deepcopy(weights_of(self._learner)),
            "optimiser": copy.deepcopy(self._optimiser.state_dict()),
            "rng": torch.get_rng_state(),
            "epoch": self._epoch,
            "seconds": self.seconds,
            "history": self._history,
            "best": self._best,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a state.

        Raises:
            InputError: It is of another run.
        """
        with state_as_input_error():
            if state["config"] != asdict(self._config):
                raise InputError("began with other settings", hint="leave --resume out")
            if state["data"] != self._data_hash:
                raise InputError(
                    "began with other grasps, or with other objects held out",
                    hint="leave --resume out",
                )
            load = self._learner.modules.load_state_dict
            load(state["weights"])
            put_back_optimiser(self._optimiser, state["optimiser"])
            torch.set_rng_state(state["rng"])
            self._epoch, self.seconds, self._history = progress_of(state, "epoch", "loss")
            self._best = dict(state["best"])
            if self._history and not self._best:
                raise ValueError("epochs without weights")
            load(self._best or state["weights"])
        if self._best:
            self._logits = self._learner.validation_logits(self._split.validation)
            self._platt = fit_platt(self._truth, self._logits)
            load(state["weights"])


def scene_order(data: GraspData, index: Index, rng: np.random.Generator) -> Index:
    """Grasps [n] in random order, those of a scene together, so that its cloud is encoded once."""
    rank = rng.permutation(int(data.scene_of.max()) + 1)[data.scene_of[index]]
    return index[np.lexsort((rng.random(len(index)), rank))]


def weights_of(learner: Learner) -> dict[str, Tensor]:
    """All weights and buffers by module and name."""
    return dict(learner.modules.state_dict())
