"""Motions: bounds on what moves how far, straight approaches, free ways, times within limits."""

from __future__ import annotations

import ast
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from planning_worlds import CylinderField, SphereField
from scipy.interpolate import CubicHermiteSpline

import pointsdf_cli
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.motion_file import velocities_of
from pointsdf_cli.planning import approach
from pointsdf_cli.planning import motion as motion_module
from pointsdf_cli.planning.approach import LENGTH, retreat
from pointsdf_cli.planning.cancellation import CancelledError, cancellable
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.motion import MotionConfig, plan_motion
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.timing import CRUISE, RAMP, time_path
from pointsdf_cli.robot.cartesian_path import follow
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.inverse_kinematics import IkConfig, InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

ROBOT = load_robot()
KINEMATICS = Kinematics(ROBOT)
GEOMETRY = RobotGeometry(KINEMATICS)
IK = InverseKinematics(ROBOT, IkConfig(pool=4000))
CAN = (0.6, 0.1, 0.12)
FIELD = CylinderField(0.035, 0.24, CAN)


def grasp(distance: float = 0.075, start: int = 0) -> np.ndarray:
    """The palm in front of the can, facing it, thumb up."""
    palm = np.eye(4)
    palm[:3, :3] = np.column_stack([(1, 0, 0), (0, 0, 1), (0, -1, 0)])
    palm[:3, 3] = np.array(CAN) - [distance, -0.03, 0]
    found = IK.solve(palm)
    arms = found.arm[0][found.reached[0]]
    q = np.array([ROBOT.configuration(arm, np.array([0.0] * 6 + [1.3, 0.5])) for arm in arms])
    slack = PathChecker(GEOMETRY, FIELD).slack(q)
    return q[np.argsort(-slack)[start]]


def test_no_point_moves_farther_than_the_bound_says() -> None:
    rng = np.random.default_rng(0)
    reach = GEOMETRY.reach
    surface = [(link, torch.tensor(p)) for link, p in robot_surface(ROBOT, 0.03).items()]
    for _ in range(30):
        a = rng.uniform(ROBOT.lower, ROBOT.upper)
        b = a + rng.normal(0, 0.3, len(a)) * (rng.random(len(a)) < 0.4)
        both = KINEMATICS.points(torch.tensor(np.stack([a, b])), surface)
        for (link, _), points in zip(surface, both, strict=True):
            moved = float((points[1] - points[0]).norm(dim=-1).max())
            assert moved <= np.abs(b - a) @ reach[KINEMATICS.index(link)] + 1e-12


def test_a_thin_wall_between_two_free_ends_is_not_jumped() -> None:
    # A wire of 2 mm that the stretched hand sweeps through while the shoulder turns.
    pose = np.eye(4)
    q = ROBOT.home.copy()
    _, position = (t.numpy() for t in KINEMATICS(torch.tensor(q)))
    palm = position[KINEMATICS.index("allegro_palm")]
    radius = np.hypot(palm[0], palm[1])
    angle = np.arctan2(palm[1], palm[0]) + 0.45
    pose[:3, 3] = (radius * np.cos(angle), radius * np.sin(angle), palm[2])
    wire = Obstacle("wire", "box", (0.002, 0.002, 0.3), pose)
    far = SphereField(0.01, (0, 0, 5.0))
    checker = PathChecker(GEOMETRY, far, Environment((wire,)))
    ends = np.stack([q, q])
    ends[1, 0] += 0.9
    assert (checker.slack(ends) > 0).all()
    assert not checker.is_free(ends)
    assert PathChecker(GEOMETRY, far).is_free(ends)


def test_ways_are_free_where_a_close_look_at_everything_finds_them_free() -> None:
    checker, rng = PathChecker(GEOMETRY, FIELD), np.random.default_rng(2)
    free = []
    for _ in range(40):
        ends = np.stack([ROBOT.home, grasp()])[rng.integers(2, size=2)]
        ends[:, :7] += rng.normal(0, 0.3, (2, 7))
        ends = np.clip(ends, ROBOT.lower, ROBOT.upper)
        dense = ends[0] + np.linspace(0, 1, 400)[:, None] * (ends[1] - ends[0])
        close = float(checker.slack(dense).min())
        free.append(checker.is_free(ends))
        if abs(close) > 1e-3:  # between the checked ones there may be a little less
            assert free[-1] == (close >= 0)
        assert checker.is_free(ends) == free[-1]
    assert 5 < sum(free) < 35


def test_the_retreat_is_straight_and_keeps_turn_and_hand() -> None:
    q = grasp()
    checker = PathChecker(GEOMETRY, FIELD)
    assert checker.slack(q[None])[0] >= 0
    path = retreat(checker, IK.chain, q)
    assert path is not None
    np.testing.assert_array_equal(path[0], q)
    np.testing.assert_array_equal(path[:, 7:], np.tile(q[7:], (len(path), 1)))
    rotation, position, _ = IK.chain.palm_and_jacobian(path[:, :7])
    assert len(path) == 9
    gone = position - position[0]
    way = gone[-1] / np.linalg.norm(gone[-1])
    np.testing.assert_allclose(np.linalg.norm(gone[-1]), LENGTH, atol=1e-4)
    np.testing.assert_allclose(gone, np.outer(gone @ way, way), atol=1e-4)
    np.testing.assert_allclose(rotation, np.tile(rotation[0], (9, 1, 1)), atol=1e-4)


def test_a_retreat_ends_where_the_arm_would_leave_the_line_between_two_solutions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same palm poses, but from the fourth on with the elbow elsewhere."""
    q = grasp()

    def elbow_jumps(*given: Any) -> tuple[np.ndarray, np.ndarray]:
        paths, reached = follow(*given)
        palm = IK.chain.palm(np.concatenate([paths[0, 3], q[7:]]))
        found = IK.solve(palm)
        arms = found.arm[0][found.reached[0]]
        away = np.abs(arms - paths[0, 3]).max(axis=1)
        paths[0, 3] = arms[away.argmax()]
        return paths, reached

    monkeypatch.setattr(approach, "follow", elbow_jumps)
    way = -IK.chain.palm(q)[:3, 0]
    free = PathChecker(GEOMETRY, SphereField(0.01, (0, 0, 5.0)), Environment(table=False))
    assert len(approach._straight(free, IK.chain, q, IK.chain.palm(q), way)) == 3


def test_a_motion_ends_in_the_grasp_and_is_free_at_every_millimetre() -> None:
    q = grasp()
    checker = PathChecker(GEOMETRY, FIELD)
    motion = plan_motion(checker, IK, ROBOT.home, q, seed=3)
    assert motion.failure == ""
    assert motion.trajectory is not None
    trajectory = motion.trajectory
    np.testing.assert_array_equal(trajectory.positions[0], ROBOT.home)
    np.testing.assert_array_equal(trajectory.positions[-1], q)
    assert ((trajectory.positions >= ROBOT.lower - 1e-9).all(axis=0)).all()
    assert ((trajectory.positions <= ROBOT.upper + 1e-9).all(axis=0)).all()
    # An independent look: dense samples, every distance, no shortcuts by bounds.
    t = np.linspace(0, trajectory.times[-1], 600)
    dense = np.stack(
        [np.interp(t, trajectory.times, one) for one in trajectory.positions.T], axis=-1
    )
    assert checker.slack(dense).min() >= -5e-4
    # The preshape is taken first and kept.
    after = motion.corners[1:, 7:]
    np.testing.assert_array_equal(after, np.tile(q[7:], (len(after), 1)))


def behind_a_wall() -> tuple[PathChecker, np.ndarray, np.ndarray]:
    """A checker with a wall, a start and a grasp that it stands between."""
    q = grasp()
    pose = np.eye(4)
    pose[:3, 3] = (0.42, -0.16, 0.25)
    wall = Obstacle("wall", "box", (0.3, 0.02, 0.5), pose)
    start = ROBOT.home.copy()
    start[0] = -1.2
    checker = PathChecker(GEOMETRY, FIELD, Environment((wall,)))
    assert checker.slack(q[None])[0] >= 0
    assert not checker.is_free(np.stack([start, q]))
    return checker, start, q


@pytest.fixture
def search_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions without the way over a place above the approach."""
    monkeypatch.setattr(motion_module, "ABOVE", ())


def test_behind_a_wall_the_hand_comes_from_above_without_a_search() -> None:
    checker, start, q = behind_a_wall()
    motion = plan_motion(checker, IK, start, q, config=MotionConfig(checks=1))
    assert checker.is_free(motion.corners)
    shaped, above, begins, *approach = motion.corners[1:]
    np.testing.assert_array_equal(shaped[:7], start[:7])
    rise = IK.chain.palm(above) - IK.chain.palm(begins)
    assert rise[2, 3] == pytest.approx(0.1, abs=0.003)
    assert len(approach) == 8


@pytest.mark.usefixtures("search_alone")
def test_a_wall_is_driven_around_and_equal_seeds_give_equal_motions() -> None:
    motions = []
    for _ in range(2):
        checker, start, q = behind_a_wall()
        motions.append(plan_motion(checker, IK, start, q, seed=1))
    assert motions[0].failure == ""
    assert checker.is_free(motions[0].corners)
    np.testing.assert_array_equal(motions[0].corners, motions[1].corners)


CLOCKS = ("time", "monotonic", "perf_counter", "process_time", "thread_time")


@pytest.mark.usefixtures("search_alone")
def test_a_motion_does_not_depend_on_any_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    checker, start, q = behind_a_wall()
    usual = plan_motion(checker, IK, start, q, seed=1)
    hours = iter(range(0, 10**9, 3600))
    for clock in CLOCKS:  # a machine so busy that an hour passes between any two checks
        monkeypatch.setattr(time, clock, lambda: float(next(hours)))
    slow = plan_motion(checker, IK, start, q, seed=1)
    monkeypatch.undo()
    assert slow.failure == ""
    np.testing.assert_array_equal(slow.corners, usual.corners)


@pytest.mark.usefixtures("search_alone")
def test_a_cancelled_search_ends_at_once() -> None:
    checker, start, q = behind_a_wall()
    begun = checker.checked
    usual = plan_motion(checker, IK, start, q, seed=1)
    needed = checker.checked - begun
    assert usual.failure == ""
    begun, asked = checker.checked, []

    def stopped() -> bool:
        asked.append(0)
        return len(asked) > 2  # once before the search

    with cancellable(stopped), pytest.raises(CancelledError):
        plan_motion(checker, IK, start, q, seed=1)
    assert checker.checked - begun < needed


@pytest.mark.usefixtures("search_alone")
def test_a_search_ends_with_its_number_of_checks() -> None:
    checker, start, q = behind_a_wall()
    before = checker.checked
    few = plan_motion(checker, IK, start, q, seed=1, config=MotionConfig(attempts=2, checks=1))
    assert few.failure == "no free way was found to where the approach begins"
    assert few.attempts == 2
    assert checker.checked - before < 1000  # the retreat and the last edge of each search, too


def test_results_are_decided_by_no_clock() -> None:
    # Below the command line a clock may only measure what is reported: `perf_counter`.
    decided = {}
    for floor in ("geometry", "robot", "camera", "models", "planning", "simulation", "trials"):
        for file in (Path(pointsdf_cli.__file__).parent / floor).rglob("*.py"):
            named = {
                node.attr
                for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
                if isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id == "time"
            } - {"perf_counter"}
            if named:
                decided[file.name] = named
    assert decided == {"run.py": {"process_time"}}  # trials/run.py reports it as planning_cpu


def test_why_there_is_no_motion() -> None:
    q = grasp()
    here = CylinderField(0.2, 1.0, (0.0, 0.0, 0.9))
    inside = plan_motion(PathChecker(GEOMETRY, here), IK, ROBOT.home, q)
    assert "where it starts" in inside.failure
    checker = PathChecker(GEOMETRY, FIELD)
    with pytest.raises(InputError, match="joint limits"):
        plan_motion(checker, IK, ROBOT.home + 10, q)


def test_a_pedestal_under_the_base_is_in_no_ones_way() -> None:
    pose = np.eye(4)
    pose[2, 3] = -0.25
    pedestal = Obstacle("pedestal", "box", (0.4, 0.4, 0.5), pose)
    checker = PathChecker(GEOMETRY, FIELD, Environment((pedestal,), table=False))
    assert checker.slack(ROBOT.home[None])[0] > 0
    goal = ROBOT.home.copy()
    goal[0] += 0.3
    assert checker.is_free(np.stack([ROBOT.home, goal]))


def test_times_keep_speed_limits_and_the_path() -> None:
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, 0.4, (8, 5)), axis=0)
    velocity = rng.uniform(0.5, 2.0, 5)
    trajectory = time_path(path, velocity, 0.8)
    speed = np.diff(trajectory.positions, axis=0) / np.diff(trajectory.times)[:, None]
    assert (np.abs(speed) <= 0.8 * velocity + 1e-9).all()
    # Every corner is passed, and every point lies on a leg.
    for corner in path:
        assert np.abs(trajectory.positions - corner).max(axis=1).min() < 1e-12
    # From rest to rest.
    assert (np.abs(speed[[0, -1]]) <= 0.8 * velocity * 0.5).all()


def test_a_cubic_through_the_motion_needs_no_more_acceleration_than_ramps() -> None:
    rng = np.random.default_rng(0)
    velocity = rng.uniform(0.5, 2.0, 5)
    sharp = np.cumsum(rng.normal(0, 0.4, (8, 5)), axis=0)
    way = np.linspace(0, np.pi, 40)[:, None]
    bent = np.concatenate([np.cos(way), np.sin(way)], axis=1) * [[0.8, 0.5]]  # 40 slight bends
    for path, limits in ((sharp, velocity), (bent, velocity[:2])):
        motion = time_path(path, limits, 0.8)
        v = velocities_of(motion.times, motion.positions)
        duration = np.diff(motion.times)[:, None]
        mean = np.diff(motion.positions, axis=0) / duration
        # The cubic keeps the speed limit between the points, too.
        cubic = CubicHermiteSpline(motion.times, motion.positions, v)
        between = np.linspace(motion.times[:-1], motion.times[1:], 17).ravel()
        assert (np.abs(cubic(between, 1)) <= 0.8 * limits).all()
        # Second derivatives of each piece's cubic at its two ends.
        ends = np.abs([6 * mean - 4 * v[:-1] - 2 * v[1:], -6 * mean + 2 * v[:-1] + 4 * v[1:]])
        assert (ends / duration <= 2.1 * 0.8 * limits / RAMP).all()


def test_one_joint_over_a_long_way_takes_as_long_as_a_ramp_says() -> None:
    # 1 rad/s, ramp 0.5 s up and down, 4 rad: 4 s at full speed plus half a ramp at each end, and a
    # little more: the full speed is not quite reached.
    trajectory = time_path(np.array([[0.0], [4.0]]), np.array([1.0]), 1.0)
    assert trajectory.times[-1] == pytest.approx(4 / CRUISE + RAMP, abs=0.01)
    assert time_path(np.array([[1.0], [1.0]]), np.array([1.0]), 1.0).times.tolist() == [0.0]


def test_a_motion_is_proven_free_only_below_the_sum_of_its_distances() -> None:
    # Distances of 4 and 6 cm at both ends: a motion of up to 8 cm, and of 12 cm, cannot touch.
    ends, moved = np.array([[0.04, 0.06]]), np.array([[0.1, 0.1]])
    doubts = PathChecker._in_doubt(None, ends, ends, moved)  # type: ignore[arg-type]
    assert doubts.tolist() == [[True, False]]


def test_a_hand_that_cannot_take_its_preshape_does_not_start() -> None:
    checker = PathChecker(GEOMETRY, FIELD)
    really = checker.is_free

    def is_free(path: np.ndarray) -> bool:
        opening = np.ptp(path[:, 7:], axis=0).max() > 0
        return not opening and really(path)

    checker.is_free = is_free  # type: ignore[method-assign]
    assert "preshape" in plan_motion(checker, IK, ROBOT.home, grasp(), seed=3).failure
