"""Intervals and tests against values worked out by hand or printed in textbooks."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointsdf_cli.errors import InputError
from pointsdf_cli.trials.statistics import mcnemar, sign_flips, wilson


def test_wilson_interval_of_known_shares() -> None:
    # Newcombe (1998), table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for successes, trials, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        share = wilson(successes, trials)
        assert share.low == pytest.approx(low, abs=5e-5)
        assert share.high == pytest.approx(high, abs=5e-5)


@given(st.integers(0, 60), st.integers(0, 60))
def test_the_interval_holds_the_share_and_mirrors(successes: int, failures: int) -> None:
    trials = successes + failures
    share, mirrored = wilson(successes, trials), wilson(failures, trials)
    if trials == 0:
        assert math.isnan(share.value)
        return
    assert 0 <= share.low <= share.value <= share.high <= 1
    assert share.low == pytest.approx(1 - mirrored.high)


def test_more_successes_than_trials_are_refused() -> None:
    with pytest.raises(InputError, match="3 of 2"):
        wilson(3, 2)


def test_mcnemar_counts_the_discordant_pairs_by_coin_tosses() -> None:
    first = [True] * 10 + [False] * 2 + [True] * 5 + [False] * 3
    second = [False] * 10 + [True] * 2 + [True] * 5 + [False] * 3
    test = mcnemar(first, second)
    assert (test.both, test.neither, test.only_first, test.only_second) == (5, 3, 10, 2)
    # 12 tosses, at most 2 or at least 10 heads: 2 (1 + 12 + 66) / 4096.
    assert test.p == pytest.approx(158 / 4096)


def test_equal_outcomes_say_nothing() -> None:
    assert mcnemar([True, False], [True, False]).p == 1.0
    with pytest.raises(InputError):
        mcnemar([True], [True, False])


def test_sign_flips_are_counted_by_hand() -> None:
    # Of the 2⁵ signs of five leads of one side only all and none reach the sum.
    assert sign_flips([2, 1, 2, 2, 4]) == pytest.approx(2 / 32)
    assert sign_flips([2, 1, 2, 2, 4, 0, 0]) == pytest.approx(2 / 32)
    # ±3 ±1: |sum| is 4, 2, 2, 4, and 2 was found.
    assert sign_flips([3, -1]) == 1.0
    assert sign_flips([0, 0]) == 1.0
    assert sign_flips([]) == 1.0
    # Forty objects take no longer than forty sums.
    assert sign_flips([1] * 40) == pytest.approx(2 / 2**40)
