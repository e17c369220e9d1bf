"""The whole problem: derivatives of objective and constraints, margins, and what solvers make."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_worlds import CylinderField, NearPalm

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.planning.cancellation import CancelledError, cancellable
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.grasp_problem import Clearances, GraspProblem
from pointsdf_cli.planning.objective import ALPHA, BETA
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.slsqp import Slsqp
from pointsdf_cli.planning.sqp import Sqp
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics

CENTRE = (0.6, 0.0, 0.12)
RADIUS = 0.035
# Palm where the can's middle is, less its radius and half a palm: out of reach of the constraint.
PLACE = (0.6 - RADIUS - 0.02, 0.0, 0.12)


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return load_robot()


@pytest.fixture(scope="module")
def problem(robot: RobotDescription) -> GraspProblem:
    rest = np.zeros(8)
    rest[6:] = (1.3, 0.5)
    score = NearPalm(PLACE, (1.0, 0.0, 0.0), rest)
    return GraspProblem(
        RobotGeometry(Kinematics(robot)), score, CylinderField(RADIUS, 0.24, CENTRE), Environment()
    )


def starts(robot: RobotDescription, problem: GraspProblem, count: int) -> np.ndarray:
    """Palms 8 cm in front of the can, facing it, thumb up, by inverse kinematics."""
    palm = np.eye(4)
    palm[:3, :3] = np.column_stack([(1, 0, 0), (0, 0, 1), (0, -1, 0)])
    palm[:3, 3] = np.array(PLACE) - [0.08, 0, 0]
    found = InverseKinematics(robot).solve(palm)
    arm = found.arm[0][found.reached[0]][:count]
    preshape = np.tile([0.0] * 6 + [1.3, 0.5], (len(arm), 1))
    return np.hstack([arm, preshape])


def test_the_objective_is_zero_below_beta_and_the_square_of_the_excess_above(robot) -> None:
    rest = np.zeros(8)
    score = NearPalm((0.5, 0, 0.3), (1.0, 0, 0), rest)
    field = CylinderField(RADIUS, 0.24, CENTRE)
    problem = GraspProblem(RobotGeometry(Kinematics(robot)), score, field)
    x = np.random.default_rng(0).uniform(problem.lower, problem.upper, (6, 15))
    cost = problem.cost(x)
    s = -cost.log_success - ALPHA * cost.log_prior
    np.testing.assert_allclose(cost.value, np.maximum(s - BETA, 0) ** 2, rtol=1e-12)
    score.log_success = lambda preshape, palm: torch.full((len(palm),), -BETA * 100)
    assert (problem.cost(x).value == 0).all()
    assert (problem.cost(x).gradient == 0).all()


def test_derivatives_of_objective_and_constraints_agree_with_differences(problem) -> None:
    rng = np.random.default_rng(1)
    x = starts(load_robot(), problem, 3) + rng.normal(0, 0.02, (3, 15))
    grouped = problem.evaluate_grouped(x)
    step = 1e-6
    for b in range(len(x)):
        around = np.concatenate([x[b] + step * np.eye(15), x[b] - step * np.eye(15)])
        values = problem.evaluate_grouped(around)
        slope = (values.objective[:15] - values.objective[15:]) / (2 * step)
        np.testing.assert_allclose(grouped.gradient[b], slope, rtol=1e-4, atol=1e-3)
        numeric = (values.constraints[:15] - values.constraints[15:]).T / (2 * step)
        near = grouped.constraints[b] < 0.03
        assert near.sum() > 5
        agree = np.isclose(grouped.jacobian[b], numeric, atol=2e-3).all(axis=1)
        # Where two points are equally near, the two sides differ.
        assert agree[near].mean() > 0.85


def test_critical_constraints_hold_every_violated_one(problem) -> None:
    x = np.random.default_rng(2).uniform(problem.lower, problem.upper, (10, 15))
    every = problem.evaluate_grouped(x)
    critical = problem.evaluate(x)
    np.testing.assert_allclose(critical.violation, every.violation, atol=1e-12)
    worst = np.min(problem.residuals(x), axis=0)
    np.testing.assert_allclose(-np.minimum(worst, 0), every.violation, atol=1e-12)


def test_violations_are_the_negative_slack_of_every_kind(problem) -> None:
    x = np.random.default_rng(3).uniform(problem.lower, problem.upper, (40, 15))
    slack = np.minimum(0.0, np.stack(problem.residuals(x)))
    assert (slack.min(axis=1)[[1, 3]] < 0).all()  # some meet the table, some themselves
    np.testing.assert_array_equal(problem.violations(x), slack)


@pytest.mark.parametrize("solver", [Sqp(), Slsqp()], ids=lambda s: type(s).__name__)
def test_solutions_touch_nothing_and_reach_the_unconstrained_best_as_far_as_allowed(
    robot, problem, solver
) -> None:
    x0 = starts(robot, problem, 2)
    found = solver.solve(problem, x0)
    assert found.converged.all()
    assert np.min(problem.residuals(found.x)) > -2e-4
    assert ((found.x >= problem.lower) & (found.x <= problem.upper)).all()
    assert (found.objective < 0.5 * problem.cost(x0).value).all()


def test_equal_starts_give_equal_plans(robot, problem) -> None:
    x0 = starts(robot, problem, 2)
    np.testing.assert_array_equal(Sqp().solve(problem, x0).x, Sqp().solve(problem, x0).x)


def test_a_negative_clearance_is_refused() -> None:
    with pytest.raises(InputError, match="clearance"):
        Clearances(object=-0.01)


@pytest.mark.parametrize("name", ["post", "object", "allegro_palm"])
def test_an_obstacle_may_have_any_name(name: str, robot, problem) -> None:  # type: ignore[no-untyped-def]
    x = starts(robot, problem, 1)
    palm = Obstacle(name, "sphere", (0.02,), transform(np.eye(3), np.array(PLACE) - [0.08, 0, 0]))
    there = GraspProblem(
        RobotGeometry(Kinematics(robot)),
        NearPalm(PLACE, (1.0, 0.0, 0.0), np.zeros(8)),
        CylinderField(RADIUS, 0.24, CENTRE),
        Environment(obstacles=(palm,)),
    )
    free, met = problem.residuals(x), there.residuals(x)
    assert met.obstacles < 0 < free.obstacles
    assert (met.object, met.self_collision) == (free.object, free.self_collision)


def test_clearances_given_as_whole_numbers_keep_the_others_fractions() -> None:
    """The clearance to the object is written into an array made from the two others."""
    margin = Clearances(0.005, 0, 0).of_bodies(np.array([True, False]))
    margin[0] = 0.005
    assert margin.tolist() == [0.005, 0.0]


def test_links_that_coupled_joints_move_against_each_other_are_kept_apart() -> None:
    """One variable moves all links of the 2F-85, those of its two sides in opposite directions."""
    robot = load_robot("ur5e_2f85")
    field = CylinderField(RADIUS, 0.24, CENTRE)
    score = NearPalm(PLACE, (1.0, 0.0, 0.0), np.zeros(len(robot.preshape_joints)))
    problem = GraspProblem(RobotGeometry(Kinematics(robot)), score, field)
    slack = problem._measured(((problem.lower + problem.upper) / 2)[None], gradients=False)[2][0]
    compared = {frozenset(problem.names[k]) for k in np.flatnonzero(np.isfinite(slack))}
    for side in ("left", "right"):
        assert frozenset(("wrist_3_link", f"{side}_inner_finger")) in compared
    assert frozenset(("left_outer_knuckle", "right_outer_knuckle")) in compared
    assert frozenset(("left_inner_knuckle", "right_inner_knuckle")) in compared


def test_a_cancelled_slsqp_ends_at_its_next_evaluation(robot, problem) -> None:
    calls = []

    def stopped() -> bool:
        calls.append(0)
        return len(calls) > 2

    with cancellable(stopped), pytest.raises(CancelledError):
        Slsqp().solve(problem, starts(robot, problem, 1))
    assert len(calls) == 3
