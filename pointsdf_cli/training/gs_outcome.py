"""Writer of the checkpoint of `train-gs`, during training and at its end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.special import expit

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_config, read_train_state
from pointsdf_cli.io.provenance import git_commit
from pointsdf_cli.models.grasp_checkpoint import weights_hash, write_grasp_checkpoint
from pointsdf_cli.models.grasp_prior import GraspPrior
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.training import gs_metrics
from pointsdf_cli.training.gs_data import GraspData, Split
from pointsdf_cli.training.gs_evaluation import describe_grasps
from pointsdf_cli.training.gs_loop import Fitted, SuccessTraining
from pointsdf_cli.training.gs_variants import FIXED, Prepared, Variant, reconstruction_of

SAVE_EVERY = 20.0
"""Least time between two states written while training [s]."""


def resumable_state(out: Path, variant: Variant, sdf: Path | None = None) -> dict[str, Any]:
    """State of a stopped run in its checkpoint directory.

    Args:
        out: The directory.
        variant: Variant to train.
        sdf: Reconstruction network; the bundled one if None.

    Raises:
        InputError: There is none, or it is of another variant or of another reconstruction network.
    """
    state, config = read_train_state(out), read_config(out)
    found = config.get("variant")
    if found != variant.title:
        raise InputError(
            f"holds a run of {found}, not of {variant.title}",
            where=f"--out {out}",
            hint="give the same --encoder and --mode as before, or choose another --out",
        )
    before = config.get("encoder", {})
    frozen = variant.mode == FIXED
    if frozen and before.get("sha256") != weights_hash(reconstruction_of(variant, sdf)):
        raise InputError(
            f"began with another reconstruction ({before.get('checkpoint')})",
            where=f"--out {out}",
            hint="give the same --sdf as before, or choose another --out",
        )
    return state


@dataclass
class Checkpointer:
    """Writer of one run's checkpoint directory.

    Attributes:
        out: The directory.
        prepared, variant, robot, data, split, config, prior: Inputs of the run.
        half: Store the networks' weights in float16.
    """

    out: Path
    prepared: Prepared
    variant: Variant
    robot: RobotDescription
    data: GraspData
    split: Split
    config: SuccessTraining
    prior: GraspPrior
    half: bool
    _written: float = field(default_factory=time.monotonic)
    _state: dict[str, Any] | None = None

    def save_now_and_then(self, fitted: Fitted, state: dict[str, Any]) -> None:
        """Write after an epoch, if the last state is old enough."""
        self._state = state
        if time.monotonic() - self._written > SAVE_EVERY:
            self._save(fitted)
            self._written = time.monotonic()

    def finish(self, fitted: Fitted) -> dict[str, Any]:
        """Write at the end, or when stopped; returns the results on the validation objects."""
        found: dict[str, Any] = {"finished": fitted.finished, "seconds": round(fitted.seconds, 1)}
        if not fitted.history:
            return found | {"epochs": 0}
        self._save(fitted)
        return found | {"epochs": len(fitted.history), **self._judgement(fitted)}

    def _save(self, fitted: Fitted) -> None:
        weights = dict(fitted.weights)
        weights["network.calibration.scale"] = torch.tensor(fitted.platt.scale)
        weights["network.calibration.shift"] = torch.tensor(fitted.platt.shift)
        write_grasp_checkpoint(
            self.out,
            network=self.prepared.network,
            encoder=self.prepared.encoder,
            weights=weights,
            prior=self.prior,
            frozen_from=self.prepared.frozen_from,
            mode=self.variant.mode,
            robot=self.robot,
            sweep=self.prepared.sweep,
            provenance=self._provenance(fitted),
            train_state=self._state,
            half=self.half,
        )

    def _provenance(self, fitted: Fitted) -> Mapping[str, Any]:
        rows = np.concatenate([self.split.train, self.split.validation])
        return {
            "variant": self.variant.title,
            "training": asdict(self.config),
            "progress": {"epochs": len(fitted.history), "seconds": round(fitted.seconds, 1)},
            "calibration": fitted.platt._asdict(),
            "validation": self._judgement(fitted),
            "data": {
                "meshes": sorted(self.data.meshes[k] for k in np.unique(self.data.object_of[rows])),
                "train": describe_grasps(self.data, self.split.train),
                "validation": describe_grasps(self.data, self.split.validation),
                "folds": None if self.split.folds is None else int(self.split.folds.max()) + 1,
            },
            "git_commit": git_commit(),
        }

    def _judgement(self, fitted: Fitted) -> dict[str, float]:
        label = self.data.label[self.split.validation]
        logits = fitted.validation_logits
        probability = expit(fitted.platt.scale * logits + fitted.platt.shift)
        return {
            "epoch": fitted.best["epoch"],
            "loss": fitted.best["loss"],
            "average_precision": gs_metrics.average_precision(label, logits),
            "roc_auc": gs_metrics.roc_auc(label, logits),
            "f1_at_half": gs_metrics.f1(label, np.asarray(logits > 0)),
            "threshold": gs_metrics.best_threshold(label, probability),
            "base_rate": float(label.mean()),
        }
