"""Confidence interval of a share, and test for a difference between two methods on the same
trials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from pointsdf_cli.errors import InputError

CONFIDENCE = 0.95
"""Confidence of all intervals."""


class Share(NamedTuple):
    """Successes of trials with their Wilson score interval.

    Attributes:
        successes, trials: Counts.
        low, high: Bounds of the interval; NaN without trials.
    """

    successes: int
    trials: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """Successes over trials; NaN without trials."""
        return self.successes / self.trials if self.trials else float("nan")


def wilson(successes: int, trials: int) -> Share:
    """A share with its 95% Wilson (1927) score interval, which stays within 0 and 1.

    Raises:
        InputError: More successes than trials.
    """
    if not 0 <= successes <= trials:
        raise InputError(f"{successes} of {trials}", allowed="0 ≤ successes ≤ trials")
    if trials == 0:
        return Share(0, 0, float("nan"), float("nan"))
    low, high = binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    # At 0 and 1 the bound is exact; correct its rounding error.
    low = 0.0 if successes == 0 else float(low)
    high = 1.0 if successes == trials else float(high)
    return Share(successes, trials, low, high)


class Paired(NamedTuple):
    """Two methods on the same trials.

    Attributes:
        both, neither: Number of pairs in which both or neither succeeded.
        only_first, only_second: Number of pairs in which only one did.
        p: Two-sided p-value of the exact McNemar test; assumes independent trials.
    """

    both: int
    neither: int
    only_first: int
    only_second: int
    p: float


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    """The exact McNemar test of two methods' outcomes on the same trials, in the same order.

    Raises:
        InputError: Different lengths.
    """
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    if a.shape != b.shape or a.ndim != 1:
        raise InputError(f"outcomes of {a.shape} and {b.shape} trials", allowed="pairs")
    only_first, only_second = int((a & ~b).sum()), int((b & ~a).sum())
    discordant = only_first + only_second
    p = binomtest(only_first, discordant, 0.5).pvalue if discordant else 1.0
    return Paired(int((a & b).sum()), int((~a & ~b).sum()), only_first, only_second, float(p))


def sign_flips(differences: Sequence[int]) -> float:
    """Two-sided p-value of a sum of differences under random signs (Fisher 1935); 1 if all are 0.

    With one difference per object it tests whether a method is better on objects of the same kind:
    trials with one object are not independent.

    Args:
        differences: Whole numbers, one per object.
    """
    ways = {0: 1}  # number of sign patterns with each sum
    for size in (abs(int(value)) for value in differences):
        more: dict[int, int] = {}
        for total, count in ways.items():
            for new in (total + size, total - size):
                more[new] = more.get(new, 0) + count
        ways = more
    found = abs(sum(int(value) for value in differences))
    return sum(n for total, n in ways.items() if abs(total) >= found) / 2 ** len(differences)
