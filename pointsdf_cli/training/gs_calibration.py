"""Calibration of probabilities: a temperature and a shift, by maximum likelihood.

Training on balanced classes removes the base rate, and long training makes a network overconfident.
Two numbers correct both, log h = log σ(a z + b), fitted to held-out objects (Platt 1999; b = 0 is
the temperature scaling of Guo et al. 2017). The ranking does not change, as a > 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

SCALES = (0.05, 10.0)
"""Bounds of a: an uninformative network becomes flat, never reversed."""


class Platt(NamedTuple):
    """Parameters of the calibration: a (one over the temperature) and b."""

    scale: float
    shift: float


def negative_log_likelihood(
    label: NDArray[np.floating], logit: NDArray[np.floating], platt: Platt
) -> float:
    """Mean −log probability of the labels [N] given raw logits [N]."""
    z = platt.scale * logit + platt.shift
    return float((np.logaddexp(0.0, z) - label * z).mean())


def fit_platt(label: NDArray[np.floating], logit: NDArray[np.floating]) -> Platt:
    """Fit the calibration to labels [N] and raw logits [N] by maximum likelihood; it is convex.

    Target probabilities are smoothed as by one further example of each class with the other label,
    so that separable classes do not give infinite confidence (Platt's correction).
    """
    label = np.asarray(label, dtype=np.float64)
    logit = np.asarray(logit, dtype=np.float64)
    held = label.sum()
    high, low = (held + 1) / (held + 2), 1 / (len(label) - held + 2)
    target = np.where(label == 1, high, low)

    def loss(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        z = x[0] * logit + x[1]
        error = expit(z) - target
        value = (np.logaddexp(0.0, z) - target * z).mean()
        return float(value), np.array([(error * logit).mean(), error.mean()])

    start = np.array([1.0, np.log((held + 1) / (len(label) - held + 1))])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[SCALES, (None, None)])
    return Platt(float(found.x[0]), float(found.x[1]))
