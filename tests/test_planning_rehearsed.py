"""Which grasps are rehearsed first, and when there are enough."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.rehearsed import RehearsedChoice, promising_first
from pointsdf_cli.simulation.rehearsal import Rehearsed


def grasp(success: float, slack: float, objective: float = 0.0) -> Candidate:
    none = np.zeros(0)
    return Candidate(none, none, success, 0.0, objective, slack, 1.0, 1.0, 1.0, "")


def test_of_good_grasps_those_with_room_come_first() -> None:
    tight, roomy = grasp(0.95, 0.001), grasp(0.7, 0.02)
    likely, poor = grasp(0.8, 0.005), grasp(0.3, 0.02, objective=0.4)
    grasps, none = [poor, tight, roomy, likely], [False] * 4
    assert promising_first(grasps, 0.005, none) == [3, 2, 1, 0]
    # Without a wish for room, by success alone; a grasp that is not good stays behind.
    assert promising_first(grasps, 0.0, none) == [1, 3, 2, 0]


def test_what_another_draw_contradicts_comes_last() -> None:
    likely, poor = grasp(0.8, 0.02), grasp(0.3, 0.02, objective=0.4)
    assert promising_first([likely, poor], 0.005, [True, False]) == [1, 0]


def test_a_firm_grasp_ends_the_search_and_one_that_creeps_only_in_the_second_round() -> None:
    results = {"lost": Rehearsed(2, 0, 0, 0.0), "creeps": Rehearsed(2, 2, 0, 0.15)}
    results["firm"] = Rehearsed(8, 7, 7, 0.15)

    def ended(*rounds: str) -> list[bool]:
        """Whether the search has ended after each round of one grasp."""
        turns = iter(rounds)
        surface = (np.zeros((0, 3)), np.zeros((0, 3), int))
        choice = RehearsedChoice(
            lambda q: [results[next(turns)]], surface, 12, 0.0, lambda new: [False] * len(new), 0.0
        )
        return [choice.stop([grasp(0.9, 0.02)]) for _ in rounds]

    assert ended("firm") == [True]
    assert ended("creeps", "lost") == [False, True]
    assert ended("lost", "lost", "creeps", "lost") == [False, False, True, True]
    assert ended("lost", "firm") == [False, True]
