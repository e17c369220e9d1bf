"""Distance of closing fingers to obstacles: the Panda's jaws, whose way is worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planning_worlds import SphereField

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.planning.acceptance import AcceptanceConfig, Candidate
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.closing_check import STEPS, ClosingCheck, _coupled
from pointsdf_cli.planning.contacts import link_poses
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.reasons import warning
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics

PANDA = load_robot("panda")
KINEMATICS = Kinematics(PANDA)
GEOMETRY = RobotGeometry(KINEMATICS)
OPEN = PANDA.home
STEP = 0.04 / STEPS
"""Each jaw slides 4 cm [m]."""


def in_world(x: float, y: float, z: float) -> Array:
    """A point of the hand's frame, whose y axis leads from jaw to jaw; pads are at z = 0.105."""
    poses, hand = link_poses(KINEMATICS, OPEN[None]), KINEMATICS.index("panda_hand")
    return np.asarray(poses.rotation[0, hand] @ [x, y, z] + poses.position[0, hand])


BETWEEN, FAR = in_world(0, 0, 0.105), np.array([5.0, 5.0, 5.0])


def slack(
    at: Array, radius: float, grasped: float, centre: Array = BETWEEN, least: float = 0.0
) -> float:
    """Slack to a spherical obstacle while the jaws close on a sphere of radius `grasped`."""
    obstacle = Obstacle("ball", "sphere", (radius,), transform(np.eye(3), at))
    bodies = BodyDistances(GEOMETRY, Environment((obstacle,)))
    field = SphereField(grasped, tuple(centre))
    return float(ClosingCheck(GEOMETRY, field, bodies, least).slack(OPEN[None])[0])


def test_jaws_stop_at_the_object_and_keep_their_distance_to_what_is_behind() -> None:
    # The pads stop 2 cm from the middle, 12 mm from a ball of 8 mm there; a step earlier or later.
    assert slack(BETWEEN, 0.008, grasped=0.02) == pytest.approx(0.012, abs=STEP)
    assert slack(BETWEEN, 0.008, grasped=0.03) == pytest.approx(0.022, abs=STEP)
    assert slack(BETWEEN, 0.008, grasped=0.02, least=0.005) == pytest.approx(0.007, abs=STEP)


def test_jaws_that_meet_nothing_sweep_all_of_their_way() -> None:
    assert slack(BETWEEN, 0.008, grasped=0.02, centre=FAR) < 0
    # 4 cm off the middle towards one jaw: behind the pad, which leaves.
    beside = in_world(0.03, 0, 0.105)
    assert slack(beside, 0.005, grasped=0.02, centre=FAR) > 0.01


def test_the_slack_of_a_hand_does_not_depend_on_the_hands_checked_with_it() -> None:
    half = OPEN.copy()
    half[PANDA.closing_columns] = 0.021
    obstacle = Obstacle("ball", "sphere", (0.008,), transform(np.eye(3), BETWEEN))
    bodies = BodyDistances(GEOMETRY, Environment((obstacle,)))
    check = ClosingCheck(GEOMETRY, SphereField(0.0205, tuple(BETWEEN)), bodies, 0.0)
    together = check.slack(np.stack([OPEN, half]))
    apart = np.concatenate([check.slack(OPEN[None]), check.slack(half[None])])
    np.testing.assert_array_equal(together, apart)


def test_coupled_jaws_stop_when_both_are_stopped() -> None:
    # A ball 25 mm off the middle stops the left jaw at 35 mm; the right one pushes on, and with it
    # the left one moves on to the middle.
    aside, inside = in_world(0, 0.025, 0.105), in_world(0, 0.012, 0.105)
    assert slack(inside, 0.003, grasped=0.01, centre=aside) < 0
    assert slack(inside, 0.003, grasped=0.0225, centre=BETWEEN) == pytest.approx(0.0075, abs=STEP)


def test_a_chain_of_couplings_is_one_group() -> None:
    joints = [
        SimpleNamespace(name=name, mimic=leader)
        for name, leader in (("a", None), ("b", ("a", 1.0)), ("c", ("b", 1.0)), ("d", None))
    ]
    robot = SimpleNamespace(tree=SimpleNamespace(joints=joints), closing_joints=("c", "a", "d"))
    found = _coupled(robot)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found, [[1, 1, 0], [1, 1, 0], [0, 0, 1]])


def test_without_obstacles_there_is_nothing_to_meet() -> None:
    bodies = BodyDistances(GEOMETRY, Environment())
    check = ClosingCheck(GEOMETRY, SphereField(0.02, tuple(BETWEEN)), bodies, 0.0)
    np.testing.assert_array_equal(check.slack(np.stack([OPEN, OPEN])), [np.inf, np.inf])
    assert check.slack(np.zeros((0, len(OPEN)))).shape == (0,)


def test_only_accepted_candidates_get_the_reason() -> None:
    none = np.zeros(0)
    good = Candidate(none, OPEN, 0.9, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, "")
    poor = replace(good, reason="objective")
    obstacle = Obstacle("ball", "sphere", (0.008,), transform(np.eye(3), BETWEEN))
    bodies = BodyDistances(GEOMETRY, Environment((obstacle,)))
    met = ClosingCheck(GEOMETRY, SphereField(0.01, tuple(FAR)), bodies, 0.0)
    config, hit = AcceptanceConfig(), replace(good, reason="object_collision")
    judged = met.judged([poor, good, hit], config)
    assert [c.reason for c in judged] == ["objective", "closing", "object_collision"]
    # A fallback may become the plan, and is checked, too; what collides never does.
    assert judged[0].closing_slack == judged[1].closing_slack < 0
    assert judged[2].closing_slack == np.inf
    assert "too near" in warning(judged[0], 8)
    assert "none looks good" in warning(poor, 8)
    kept = ClosingCheck(GEOMETRY, SphereField(0.02, tuple(BETWEEN)), bodies, 0.0)
    (one,) = kept.judged([good], config)
    assert one.reason == ""
    assert one.closing_slack == pytest.approx(0.012, abs=STEP)
    assert kept.judged([], config) == []
