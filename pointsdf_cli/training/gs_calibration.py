"""Calibration of probabilities: a temperature and a shift, by likelihood.

A network trained on balanced classes does not know the base rate, and one trained for long is too
sure. Both are mended by two numbers, log h = log σ(a z + b), fitted to held-out objects (Platt
1999; b = 0 is the temperature scaling of Guo et al. 2017). The ranking does not change, for a > 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

SCALES = (0.05, 10.0)
"""a is kept in here: a network that knows nothing gets flat, never reversed."""


class Platt(NamedTuple):
    """a (one over the temperature) and b."""

    scale: float
    shift: float


def negative_log_likelihood(
    label: NDArray[np.floating], logit: NDArray[np.floating], platt: Platt
) -> float:
    """Mean −log probability of the labels [N] given raw logits [N]."""
    z = platt.scale * logit + platt.shift
    return float((np.logaddexp(0.0, z) - label * z).mean())


def fit_platt(label: NDArray[np.floating], logit: NDArray[np.floating]) -> Platt:
    """The two numbers that make labels [N] likeliest; the problem is convex.

    Each kind is drawn in as if one more of it had ended the other way, so that perfectly told apart
    classes do not ask for infinite sureness (Platt's correction).
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
