"""Which grasps are rehearsed first."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.rehearsed import promising_first


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
