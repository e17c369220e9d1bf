"""Which grasp is chosen among the accepted ones."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.likeliest import (
    PREFERRED_SLACK,
    TIGHT,
    likeliest_first,
    probability_to_hold,
)

CLEARANCE = 0.001


def grasp(success: float, slack: float = 0.02, cost: float = 0.0) -> Candidate:
    x = np.zeros(0)
    return Candidate(x, x, success, 0.0, cost, slack, 1.0, 1.0, 1.0, "")


@pytest.mark.parametrize(
    ("distance", "factor"),
    [(0.02, 1.0), (PREFERRED_SLACK + 1e-6, 1.0), (PREFERRED_SLACK - 1e-6, TIGHT), (0.001, TIGHT)],
)
def test_a_grasp_near_the_object_is_trusted_less(distance: float, factor: float) -> None:
    one = grasp(0.8, distance - CLEARANCE)
    assert probability_to_hold(one, CLEARANCE) == pytest.approx(0.8 * factor)


def test_the_likeliest_comes_first_whatever_its_cost() -> None:
    first, second, tight = grasp(0.7, cost=4.0), grasp(0.6), grasp(0.73, slack=0.001)
    assert likeliest_first([second, tight, first], CLEARANCE) == [first, tight, second]
    equal = [grasp(0.5), grasp(0.5)]
    assert likeliest_first(equal, CLEARANCE)[0] is equal[0]
