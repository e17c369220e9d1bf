"""A ball above the hand, at distances known by hand: other draws that are bigger contradict."""

from __future__ import annotations

import numpy as np
import pytest
from planning_worlds import SphereField

from pointsdf_cli.camera.view import View
from pointsdf_cli.planning.contacts import link_poses
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.resampled_views import ResampledViewCheck, redrawn
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics

CLEARANCE = 0.001


@pytest.fixture(scope="module")
def geometry() -> RobotGeometry:
    return RobotGeometry(Kinematics(load_robot()))


@pytest.fixture(scope="module")
def upright(geometry: RobotGeometry) -> np.ndarray:
    return np.zeros(len(geometry.kinematics.robot.joint_names))  # the arm straight up


def ball_above(geometry: RobotGeometry, q: np.ndarray, gap: float) -> SphereField:
    """A ball of 5 cm radius, whose surface is `gap` [m] away from the robot's highest sample."""
    poses = link_poses(geometry.kinematics, q[None])
    patches = geometry.patches
    rotation, position = poses.rotation[0, patches.link], poses.position[0, patches.link]
    samples = (patches.points @ rotation.transpose(0, 2, 1) + position[:, None]).reshape(-1, 3)
    x, y, z = samples[samples[:, 2].argmax()]
    # All other samples lie below the plane through it that the ball touches above.
    return SphereField(0.05, (x, y, z + 0.05 + gap))


def test_a_draw_that_comes_nearer_than_the_clearance_contradicts(
    geometry: RobotGeometry, upright: np.ndarray
) -> None:
    roomy, close, deep = (ball_above(geometry, upright, gap) for gap in (0.004, 0.0005, -0.003))
    leaning = upright.copy()
    leaning[1] += 0.5  # the shoulder: the hand leaves the ball
    both = np.stack([upright, leaning])
    assert list(ResampledViewCheck(geometry, ()).contradicted(both, CLEARANCE)) == [False, False]
    assert list(ResampledViewCheck(geometry, (roomy,)).contradicted(both, CLEARANCE)) == [
        False,
        False,
    ]
    for near in (close, deep):
        # One witness is enough, whatever the others say.
        resampled = ResampledViewCheck(geometry, (roomy, near))
        assert list(resampled.contradicted(both, CLEARANCE)) == [True, False]


@pytest.mark.parametrize("total", [40, 1000, 5000])
def test_no_two_draws_are_of_the_same_points(total: int) -> None:
    points = np.random.default_rng(0).uniform(0.5, 0.6, (total, 3))
    view = View(points, np.eye(4))
    first, second = ({*map(tuple, redrawn(view, 1000, (0, k)).points)} for k in (1, 2))
    assert len(first) == len(second) == min(1000, round(0.8 * total))
    assert len(first & second) < 0.9 * len(first)


def test_as_many_draws_are_completed_as_are_asked_for_and_they_differ() -> None:
    rng = np.random.default_rng(0)
    outwards = rng.normal(size=(6000, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    points = 0.04 * outwards[outwards[:, 2] < 0] + [0.0, 0.0, 0.8]
    pose = np.eye(4)
    pose[:3, 3] = [0.6, 0.0, -0.7]
    planner = GraspPlanner(PlanOptions(resampled_views=2))
    perceived = planner.see([View(points, pose)], seed=5)
    behind = np.array([[0.6, 0.0, 0.8 - 0.7 + z] for z in (0.01, 0.03, 0.05)])
    first, second = (field(behind) for field in perceived.resampled)
    assert np.abs(first - second).max() > 1e-6
    assert np.abs(first - perceived.target.field(behind)).max() > 1e-6
    again = planner.see([View(points, pose)], seed=5)
    np.testing.assert_array_equal(again.resampled[0](behind), first)
    # The truth, or nothing, in place of what was completed: nothing is left to be contradicted.
    assert planner.see([View(points, pose)], seed=5, field="none").resampled == ()
