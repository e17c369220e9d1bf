"""Evaluation of success networks and baselines on held-out objects (Figure 3), for `eval-gs`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.training import gs_metrics
from pointsdf_cli.training.gs_data import GraspData
from pointsdf_cli.training.sdf_table import aligned, interval

PUBLISHED = {
    "PointSDF-Scratch": 0.640,
    "PointSDF-Fixed": 0.581,
    "VoxelCNN-Scratch": 0.400,
    "VoxelCNN-Fixed": 0.536,
}
"""F1 at threshold 0.5 in the paper's Figure 3."""


@dataclass(frozen=True)
class Scored:
    """Predictions of one method for N grasps.

    Attributes:
        name: Name of the method.
        score: [N], score for ranking.
        chosen: bool [N], predicted success at the method's threshold: 0.5 for a network trained on
            balanced classes (as in the figure), the threshold of highest F1 on known grasps for a
            baseline without probabilities.
        probability: [N], calibrated; None for a baseline.
        threshold: Threshold of the probability with the highest F1 on validation objects.
    """

    name: str
    score: Array
    chosen: NDArray[np.bool_]
    probability: Array | None = None
    threshold: float | None = None

    def at(self, rows: NDArray[np.int64]) -> Scored:
        """Predictions for the grasps `rows`."""
        probability = None if self.probability is None else self.probability[rows]
        return replace(
            self, score=self.score[rows], chosen=self.chosen[rows], probability=probability
        )


def measure(data: GraspData, rows: NDArray[np.int64], scored: Scored, seed: int) -> dict[str, Any]:
    """All metrics of one method on the grasps `rows`, with 95% intervals over objects.

    `scored` holds the predictions for these grasps alone, in their order.
    """
    label, groups = data.label[rows].astype(np.float64), data.object_of[rows]
    score, chosen = scored.score, scored.chosen
    measures = {
        "f1": lambda i: gs_metrics.f1(label[i], chosen[i]),
        "average_precision": lambda i: gs_metrics.average_precision(label[i], score[i]),
        "roc_auc": lambda i: gs_metrics.roc_auc(label[i], score[i]),
    }
    probability, threshold = scored.probability, scored.threshold
    if probability is not None and threshold is not None:
        measures |= {
            "f1_calibrated": lambda i: gs_metrics.f1(label[i], probability[i] > 0.5),
            "f1_chosen": lambda i: gs_metrics.f1(label[i], probability[i] >= threshold),
            "precision_at_0.6": lambda i: _share(label[i][probability[i] > 0.6]),
            "brier": lambda i: gs_metrics.brier(label[i], probability[i]),
            "calibration_error": lambda i: gs_metrics.calibration_error(label[i], probability[i]),
        }
    found: dict[str, Any] = {
        name: interval._asdict()
        for name, interval in gs_metrics.over_objects(measures, groups, seed).items()
    }
    top, random = gs_metrics.top_choice(label, score, groups, np.random.default_rng([seed, 1]))
    choices = {
        "top": lambda i: float(top[i].mean()),
        "random": lambda i: float(random[i].mean()),
        "ratio": lambda i: float(top[i].mean() / max(random[i].mean(), 1e-9)),
    }
    ranking = gs_metrics.over_objects(choices, np.arange(len(top)), seed)
    found["top_choice"] = {name: interval._asdict() for name, interval in ranking.items()}
    if probability is not None:
        found["chosen_above_0.6"] = int((probability > 0.6).sum())
        found["reliability"] = gs_metrics.reliability(label, probability).tolist()
        found["threshold"] = threshold
    return found


def describe_grasps(data: GraspData, rows: NDArray[np.int64]) -> dict[str, Any]:
    """Number of grasps and share that held, by kind."""
    label, kind = data.label[rows], data.kind[rows]
    objects, base_rate = len(np.unique(data.object_of[rows])), float(label.mean())
    found: dict[str, Any] = {"objects": objects, "grasps": len(rows), "base_rate": base_rate}
    for number, name in enumerate(GRASP_KINDS):
        of_kind = label[kind == number]
        found[name] = {"grasps": len(of_kind), "base_rate": _share(of_kind)}
    return found


def table_lines(table: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The table as aligned text, the paper's F1 beside ours."""
    head = (
        "method", "F1 at 0.5", "95%", "paper", "F1 chosen", "AP", "95%", "AUC", "Brier", "ECE",
        "top of 20", "random",
    )  # fmt: skip
    rows: list[Sequence[str]] = [head]
    for name, entry in table.items():
        f1, ap, ranking = entry["f1"], entry["average_precision"], entry["top_choice"]
        paper = f"{PUBLISHED[name]:.3f}" if name in PUBLISHED else ""
        ranges = [interval(found["low"], found["high"], 3) for found in (f1, ap)]
        cells = [name, _number(f1), ranges[0], paper]
        cells += [_number(entry.get("f1_chosen")), _number(ap), ranges[1]]
        cells += [_number(entry.get(key)) for key in ("roc_auc", "brier", "calibration_error")]
        rows.append((*cells, _number(ranking["top"]), _number(ranking["random"])))
    return aligned(rows)


def _share(label: NDArray[np.floating]) -> float:
    return float(label.mean()) if len(label) else float("nan")


def _number(entry: Mapping[str, float] | None) -> str:
    return "" if entry is None else f"{entry['value']:.3f}"
