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
from pointsdf_cli.training.gs_calibration import Platt, fit_platt, negative_log_likelihood
from pointsdf_cli.training.gs_data import GraspData, Split
from pointsdf_cli.training.gs_inputs import Index, Learner
from pointsdf_cli.training.gs_metrics import average_precision, roc_auc
from pointsdf_cli.training.resuming import progress_of, put_back_optimiser, sense_of_state


@dataclass(frozen=True)
class SuccessTraining:
    """Everything that decides a run, besides data and architecture.

    Attributes:
        epochs: Passes over the training grasps, at most.
        batch_size: Grasps a step.
        learning_rate: At its highest; a cosine to 1% of it.
        encoder_rate: Share of it for an encoder that is trained along.
        warmup: Steps of linear warm-up.
        weight_decay: AdamW's.
        patience: Epochs without a better validation before the run ends.
        validation: Share of the training objects that validate.
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
        for name in ("epochs", "batch_size", "learning_rate", "encoder_rate", "patience"):
            if getattr(self, name) <= 0:
                raise InputError(
                    f"{getattr(self, name)} is not positive", where="--" + name.replace("_", "-")
                )
        if not 0.0 < self.validation < 1.0:
            raise InputError(
                f"{self.validation} is no share", where="--validation", allowed="between 0 and 1"
            )

    def rate(self, step: int, steps: int) -> float:
        """Learning rate at a step."""
        warm = min(1.0, (step + 1) / max(1, self.warmup))
        return self.learning_rate * warm * (0.01 + 0.495 * (1 + math.cos(math.pi * step / steps)))


class Fitted(NamedTuple):
    """Result of a run.

    Attributes:
        finished: False if it was stopped; it then resumes from the last state.
        weights: Weights of the best epoch, by module and name, such as `network.leave.bias`.
        platt: Calibration of these weights on the validation objects.
        validation_logits: Raw, of the best epoch.
        history: One entry an epoch.
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
    """Train, keep the epoch that is likeliest on held-out objects, and calibrate it there.

    The classes are balanced by weight. An epoch is judged by the likelihood of the validation
    grasps after calibration, which neither the base rate nor overconfidence can spoil. A stopped
    and resumed run gives bit for bit the weights of an uninterrupted one.

    Args:
        data: The grasps.
        split: By object.
        learner: Network and inputs; its weights are overwritten when resuming.
        config: See `SuccessTraining`.
        resume: A state that `on_epoch` was given.
        on_epoch: Called after each epoch with what was found so far, and the state.
        should_stop: Asked before each step; the epoch that was begun is then lost.

    Raises:
        InputError: `resume` is of another run.
        RgraspError: The loss is no longer finite.
    """
    keep_large_allocations()
    label = torch.from_numpy(data.label)
    held = float(data.label[split.train].mean())
    weight = torch.tensor([0.5 / (1.0 - held), 0.5 / held])
    head = [p for name, m in learner.modules.items() if name == "network" for p in m.parameters()]
    others = [p for name, m in learner.modules.items() if name != "network" for p in m.parameters()]
    groups = [{"params": head, "share": 1.0}]
    if others:
        groups.append({"params": others, "share": config.encoder_rate})
    optimiser = torch.optim.AdamW(groups, weight_decay=config.weight_decay, fused=True)
    per_epoch = _batch_count(len(split.train), config.batch_size)
    torch.manual_seed(config.seed)
    epoch, seconds = 0, 0.0
    history: list[dict[str, float]] = []
    best: dict[str, Tensor] = {}
    learns_from = data_sha256(
        data.names, data.object_of, data.T_world_palm, data.label, split.train, split.validation
    )
    if resume is not None:
        with sense_of_state():
            if resume["config"] != asdict(config):
                raise InputError("was begun with other settings", hint="drop --resume")
            if resume.get("data", learns_from) != learns_from:
                raise InputError(
                    "was begun with other grasps, or with other objects held out",
                    hint="drop --resume",
                )
            load_weights(learner, resume["weights"])
            put_back_optimiser(optimiser, resume["optimiser"])
            torch.set_rng_state(resume["rng"])
            epoch, seconds, history = progress_of(resume, "epoch", "loss")
            best = dict(resume["best"])
            load_weights(learner, best or resume["weights"])  # whether they fit
            load_weights(learner, resume["weights"])
            if history and not best:
                raise ValueError("epochs without weights")

    truth = data.label[split.validation]
    platt, logits = Platt(1.0, 0.0), np.zeros(len(truth))
    if best:
        platt, logits = _judged(learner, best, split.validation, truth)

    def found(finished: bool) -> Fitted:
        return Fitted(finished, best, platt, logits, history, seconds)

    clock = time.monotonic()
    while epoch < config.epochs and not _exhausted(history, config.patience):
        rng = np.random.default_rng([config.seed, 3, epoch])
        order = scene_order(data, split.train, rng)
        total = 0.0
        learner.train(True)
        for number in range(per_epoch):
            if should_stop():
                return found(False)
            last = None if number + 1 == per_epoch else (number + 1) * config.batch_size
            index = order[number * config.batch_size : last]
            rate = config.rate(epoch * per_epoch + number, config.epochs * per_epoch)
            for group in optimiser.param_groups:
                group["lr"] = rate * group["share"]
            predicted = learner.training_logits(index, rng)
            target = label[index]
            teaches = learner.member_weights(index) * weight[target.long()]
            loss = torch.nn.functional.binary_cross_entropy_with_logits(
                predicted, target.expand_as(predicted), weight=teaches.expand_as(predicted)
            )
            # Members share but the gains of two layer norms: each must get the gradient of its own
            # loss, not of the mean.
            optimiser.zero_grad(set_to_none=True)
            (loss * len(predicted)).backward()
            torch.nn.utils.clip_grad_norm_(head + others, 5.0)
            optimiser.step()
            total += loss.item() / per_epoch
        if not math.isfinite(total):
            raise RgraspError(f"the loss is {total} in epoch {epoch}", hint="lower --learning-rate")
        epoch += 1
        now_logits = learner.validation_logits(split.validation)
        now_platt = fit_platt(truth, now_logits)
        entry = {
            "epoch": float(epoch),
            "train_loss": total,
            "loss": negative_log_likelihood(truth, now_logits, now_platt),
            "average_precision": average_precision(truth, now_logits),
            "roc_auc": roc_auc(truth, now_logits),
        }
        if not history or entry["loss"] < min(e["loss"] for e in history):
            best, platt, logits = copy.deepcopy(weights_of(learner)), now_platt, now_logits
        history.append(entry)
        now = time.monotonic()
        seconds, clock = seconds + now - clock, now
        state = {
            "config": asdict(config),
            "data": learns_from,
            # Copies: a stop within the next epoch writes this state after more steps.
            "weights": copy.deepcopy(weights_of(learner)),
            "optimiser": copy.deepcopy(optimiser.state_dict()),
            "rng": torch.get_rng_state(),
            "epoch": epoch,
            "seconds": seconds,
            "history": history,
            "best": best,
        }
        on_epoch(found(False), state)
    return found(True)


def _batch_count(grasps: int, size: int) -> int:
    """Batches an epoch; a rest below half a batch joins the one before.

    It may be grasps of one scene alone, and batch norm cannot learn from one cloud.
    """
    return max(1, math.floor(grasps / size + 0.5))


def scene_order(data: GraspData, index: Index, rng: np.random.Generator) -> Index:
    """Grasps [n] in random order, those of one scene together, so that its cloud is read once."""
    rank = rng.permutation(int(data.scene_of.max()) + 1)[data.scene_of[index]]
    return index[np.lexsort((rng.random(len(index)), rank))]


def weights_of(learner: Learner) -> dict[str, Tensor]:
    """All weights and buffers by module and name."""
    return {
        f"{module}.{name}": tensor
        for module, part in learner.modules.items()
        for name, tensor in part.state_dict().items()
    }


def load_weights(learner: Learner, weights: Mapping[str, Tensor]) -> None:
    """Put the weights of `weights_of` back."""
    for module, part in learner.modules.items():
        start = f"{module}."
        part.load_state_dict(
            {n.removeprefix(start): t for n, t in weights.items() if n.startswith(start)}
        )


def _judged(
    learner: Learner, best: Mapping[str, Tensor], index: Index, truth: NDArray[np.float32]
) -> tuple[Platt, NDArray[np.float64]]:
    """Calibration and logits of kept weights, leaving the learner's own as they are."""
    now = copy.deepcopy(weights_of(learner))
    load_weights(learner, best)
    logits = learner.validation_logits(index)
    load_weights(learner, now)
    return fit_platt(truth, logits), logits


def _exhausted(history: list[dict[str, float]], patience: int) -> bool:
    losses = [entry["loss"] for entry in history]
    return bool(losses) and len(losses) - 1 - int(np.argmin(losses)) >= patience
