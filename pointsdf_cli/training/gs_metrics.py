"""Quality of predicted success probabilities: counts, rankings, calibration, intervals.

All functions take labels [N] (1 held, 0 lost) and scores or probabilities [N]. Equal scores share
a rank, so a constant score gives exactly the base rate and an area of one half.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score, f1_score, roc_auc_score

from pointsdf_cli.geometry.arrays import Array

BINS = 10
"""Number of bins of equally many predictions, for the calibration error."""

CANDIDATES = 20
"""Number of grasps of one object from which the top one is chosen."""

BOOTSTRAPS = 500


class Interval(NamedTuple):
    """A number and its 95% interval over objects; NaN if undefined, as that of one object is."""

    value: float
    low: float
    high: float


def f1(label: NDArray[np.floating], chosen: NDArray[np.bool_]) -> float:
    """F1 score 2 TP / (2 TP + FP + FN) of grasps [N]; 0 without any positives."""
    return float(f1_score(label == 1, chosen, zero_division=0.0))


def best_threshold(label: NDArray[np.floating], score: NDArray[np.floating]) -> float:
    """Threshold of the score with the highest F1."""
    order = np.argsort(-score, kind="stable")
    held = np.cumsum(label[order])
    values = 2.0 * held / (np.arange(1, len(label) + 1) + label.sum())
    # Thresholds lie only between different scores.
    last = np.append(score[order][1:] < score[order][:-1], True)
    return float(score[order][np.argmax(np.where(last, values, -1.0))])


def average_precision(label: NDArray[np.floating], score: NDArray[np.floating]) -> float:
    """Average precision Σ (R_k − R_{k−1}) P_k over thresholds; NaN without a held grasp."""
    return float(average_precision_score(label, score)) if label.any() else float("nan")


def roc_auc(label: NDArray[np.floating], score: NDArray[np.floating]) -> float:
    """Area under the ROC curve: probability that a held grasp scores above a lost one; NaN without
    both."""
    both = 0 < label.sum() < len(label)
    return float(roc_auc_score(label, score)) if both else float("nan")


def brier(label: NDArray[np.floating], probability: NDArray[np.floating]) -> float:
    """Mean squared error of the probability."""
    return float(((probability - label) ** 2).mean())


def reliability(label: NDArray[np.floating], probability: NDArray[np.floating]) -> Array:
    """Reliability diagram [BINS, 3]: mean probability, share held and count of bins of equally many
    predictions.

    Equal predictions get their common share held, because their order is arbitrary.
    """
    _, which = np.unique(probability, return_inverse=True)
    held = (np.bincount(which, label) / np.bincount(which))[which]
    parts = [part for part in np.array_split(np.argsort(probability), BINS) if len(part)]
    return np.array([(probability[p].mean(), held[p].mean(), len(p)) for p in parts])


def calibration_error(label: NDArray[np.floating], probability: NDArray[np.floating]) -> float:
    """Expected calibration error: mean |share held − mean probability| over the bins."""
    found = reliability(label, probability)
    return float((np.abs(found[:, 0] - found[:, 1]) * found[:, 2]).sum() / found[:, 2].sum())


def top_choice(
    label: NDArray[np.floating],
    score: NDArray[np.floating],
    groups: NDArray[np.integer],
    rng: np.random.Generator,
    draws: int = 40,
) -> tuple[Array, Array]:
    """Success of the highest-scored of `CANDIDATES` random grasps of each object.

    For objects with fewer grasps, all are candidates. Ties are broken at random.

    Returns:
        Success of the top choice [O], mean over draws, and of a random choice [O].
    """
    top, random = [], []
    for group in np.unique(groups):
        rows = np.flatnonzero(groups == group)
        wins = []
        for _ in range(draws):
            offered = rng.permutation(rows)[:CANDIDATES]
            wins.append(label[offered[np.argmax(score[offered])]])
        top.append(np.mean(wins))
        random.append(label[rows].mean())
    return np.array(top), np.array(random)


def over_objects(
    measures: Mapping[str, Callable[[NDArray[np.int64]], float]],
    groups: NDArray[np.integer],
    seed: int = 0,
) -> dict[str, Interval]:
    """Measures with 95% bootstrap intervals over objects: grasps of one object are not independent.

    Args:
        measures: Functions of indices of grasps, by name.
        groups: [N], the object of each grasp.
        seed: Random seed.
    """
    rng = np.random.default_rng(seed)
    rows = [np.flatnonzero(groups == group) for group in np.unique(groups)]
    everything = np.arange(len(groups))
    drawn = [
        np.concatenate([rows[k] for k in rng.integers(len(rows), size=len(rows))])
        for _ in range(BOOTSTRAPS)
    ]
    found = {}
    for name, measure in measures.items():
        values = np.array([measure(index) for index in drawn])
        values = values[np.isfinite(values)] if len(rows) > 1 else values[:0]
        low, high = np.percentile(values, [2.5, 97.5]) if len(values) else (np.nan, np.nan)
        found[name] = Interval(measure(everything), float(low), float(high))
    return found
