"""Which grasp the success network alone chooses, and when it ends the search."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.likeliest import ENOUGH, MOST_MOTIONS, NEARBY, TIGHT, LikeliestChoice


def grasp(success: float, slack: float = 0.02, cost: float = 0.0, reason: str = "") -> Candidate:
    x = np.zeros(0)
    return Candidate(x, x, success, 0.0, cost, slack, 1.0, 1.0, 1.0, reason)


@pytest.mark.parametrize(
    ("success", "slack", "ends"),
    [
        (ENOUGH, 0.02, True),
        (ENOUGH - 0.01, 0.02, False),
        (ENOUGH, 0.004, False),  # tight
        (ENOUGH / TIGHT + 0.001, 0.004, True),
    ],
)
def test_a_grasp_that_is_likely_enough_ends_the_search(
    success: float, slack: float, ends: bool
) -> None:
    choice = LikeliestChoice(0.005)
    assert choice.stop([grasp(0.2), grasp(success, slack)]) is ends
    assert not choice.stop([grasp(0.5)])  # of the new ones only


def test_the_likeliest_of_all_rounds_comes_first_whatever_its_cost() -> None:
    choice = LikeliestChoice(0.005)
    first, second, tight = grasp(0.7, cost=4.0), grasp(0.6), grasp(0.73, slack=0.001)
    choice.stop([second])
    choice.stop([tight, first, *(grasp(0.01 * k) for k in range(20))])
    ranked = choice.ranked([second, tight, first])
    assert ranked[:3] == [first, tight, second]  # 0.7, 0.73 · 0.95, 0.6
    assert len(ranked) == MOST_MOTIONS
    assert choice.best() == ranked[:NEARBY]
    assert choice.of(first) is None


def test_fallbacks_keep_their_order() -> None:
    fallbacks = [grasp(0.1, reason="closing"), grasp(0.2, reason="low_success_probability")]
    assert LikeliestChoice(0.005).ranked(fallbacks) == fallbacks
