"""Both solvers on problems whose optima can be worked out by hand; the step's program alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import pytest

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.nonlinear import Evaluation, Solver
from pointsdf_cli.planning.slsqp import Slsqp
from pointsdf_cli.planning.sqp import Sqp, SqpConfig, hessian_factors
from pointsdf_cli.planning.step_qp import StepQp


@dataclass
class Sum:
    """A problem from functions of one point; `known_curvature` gives the Hessian of f."""

    f: Callable[[Array], float]
    df: Callable[[Array], Array]
    c: Callable[[Array], Array]
    dc: Callable[[Array], Array]
    lower: Array
    upper: Array
    starts: Array
    optimum: Array
    known_curvature: Array | None = None

    def evaluate(self, x: Array) -> Evaluation:
        n = x.shape[1]
        curvature = np.zeros((n, n)) if self.known_curvature is None else self.known_curvature
        return Evaluation(
            np.array([self.f(p) for p in x]),
            np.array([self.df(p) for p in x]),
            np.tile(curvature, (len(x), 1, 1)),
            np.array([self.c(p) for p in x]),
            np.array([self.dc(p) for p in x]),
        )

    evaluate_grouped = evaluate


def nearest_point_outside_a_circle() -> Sum:
    # min |x − a|² outside the unit circle, a = (0.3, 0.4): the optimum is a / |a|.
    a = np.array([0.3, 0.4])
    return Sum(
        lambda x: float(((x - a) ** 2).sum()),
        lambda x: 2 * (x - a),
        lambda x: np.array([np.linalg.norm(x) - 1]),
        lambda x: (x / np.linalg.norm(x))[None],
        np.full(2, -3.0),
        np.full(2, 3.0),
        np.array([[2.0, 1.0], [0.5, 0.5], [0.1, 2.0]]),
        np.array([0.6, 0.8]),
    )


def farthest_point_inside_a_circle() -> Sum:
    # max 3 x + 4 y inside the unit circle: (0.6, 0.8). Only the constraint is curved.
    g = np.array([-3.0, -4.0])
    return Sum(
        lambda x: float(g @ x),
        lambda x: g,
        lambda x: np.array([1 - x @ x]),
        lambda x: -2 * x[None],
        np.full(2, -3.0),
        np.full(2, 3.0),
        np.array([[0.0, 0.0], [-1.0, 0.5], [2.0, 2.0]]),
        np.array([0.6, 0.8]),
    )


def rosenbrock_below_a_line() -> Sum:
    # Rosenbrock with x ≤ 0.4 as a bound and x + y ≤ 0.7.
    def df(x: Array) -> Array:
        r = x[1] - x[0] ** 2
        return np.array([-2 * (1 - x[0]) - 40 * x[0] * r, 20 * r])

    return Sum(
        lambda x: float((1 - x[0]) ** 2 + 10 * (x[1] - x[0] ** 2) ** 2),
        df,
        lambda x: np.array([0.7 - x[0] - x[1]]),
        lambda x: np.array([[-1.0, -1.0]]),
        np.array([-2.0, -2.0]),
        np.array([0.4, 2.0]),
        np.array([[-1.0, 1.0], [0.0, 0.0], [0.4, -1.5]]),
        # With x ≤ 0.4 the line leaves y ≤ 0.3, and y = x² = 0.16 is inside: the bound alone acts.
        np.array([0.4, 0.16]),
    )


def a_good_enough_score() -> Sum:
    # max(s − β, 0)² with s = |x − a|² − 1, β = −2 is |x − a|² + 1 squared; beyond a wall x ≥ 1.
    a = np.array([0.0, 0.0, 0.5])
    return Sum(
        lambda x: float((((x - a) ** 2).sum() + 1) ** 2),
        lambda x: 2 * (((x - a) ** 2).sum() + 1) * 2 * (x - a),
        lambda x: np.array([x[0] - 1.0, 5.0 - x[1]]),
        lambda x: np.array([[1.0, 0, 0], [0, -1.0, 0]]),
        np.full(3, -4.0),
        np.full(3, 4.0),
        np.array([[2.0, 2.0, 2.0], [-1.0, 1.0, -2.0]]),
        np.array([1.0, 0.0, 0.5]),
    )


PROBLEMS = [
    nearest_point_outside_a_circle,
    farthest_point_inside_a_circle,
    rosenbrock_below_a_line,
    a_good_enough_score,
]
SOLVERS = [Slsqp(), Sqp(SqpConfig(iterations=100, tolerance=1e-8, smallest_radius=1e-6))]


@pytest.mark.parametrize("make", PROBLEMS)
@pytest.mark.parametrize("solver", SOLVERS, ids=lambda s: type(s).__name__)
def test_known_optima_are_found_from_every_start(make: Callable[[], Sum], solver: Solver) -> None:
    problem = make()
    found = solver.solve(problem, problem.starts)
    np.testing.assert_allclose(
        found.x, np.tile(problem.optimum, (len(problem.starts), 1)), atol=2e-3
    )
    assert found.violation.max() < 1e-4
    assert found.converged.all()


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda s: type(s).__name__)
def test_what_cannot_be_met_is_not_called_solved(solver: Solver) -> None:
    problem = nearest_point_outside_a_circle()
    problem.upper, problem.lower = np.full(2, 0.5), np.full(2, -0.5)
    found = solver.solve(problem, np.zeros((2, 2)) + 0.1)
    assert not found.converged.any()
    # The corner of the box is as near to the circle as it gets.
    assert found.violation.min() >= 1 - np.sqrt(0.5) - 1e-6


def test_an_infeasible_linearisation_does_not_kill_a_start() -> None:
    # At the start the two linearised constraints contradict each other within the trust region.
    problem = farthest_point_inside_a_circle()
    problem.c = lambda x: np.array([1 - x @ x, x[0] - 0.2])
    problem.dc = lambda x: np.array([-2 * x, [1.0, 0.0]])
    found = Sqp().solve(problem, np.array([[-2.9, -2.9]]))
    np.testing.assert_allclose(found.x, [[0.6, 0.8]], atol=5e-3)


def test_the_same_starts_give_the_same_solutions_alone_and_together() -> None:
    problem = nearest_point_outside_a_circle()
    together = Sqp().solve(problem, problem.starts).x
    alone = [Sqp().solve(problem, start[None]).x[0] for start in problem.starts]
    np.testing.assert_array_equal(together, np.array(alone))


def test_halving_ends_the_worse_starts_and_leaves_the_best_alone() -> None:
    problem = rosenbrock_below_a_line()
    rng = np.random.default_rng(0)
    starts = rng.uniform(-1.5, 1.5, (8, 2))
    exact = {"iterations": 100, "tolerance": 1e-8, "smallest_radius": 1e-6}
    every = Sqp(SqpConfig(**exact)).solve(problem, starts)
    halved = Sqp(SqpConfig(successive_halving=(3, 6), **exact)).solve(problem, starts)
    assert halved.evaluations < every.evaluations
    best = halved.objective.argmin()
    np.testing.assert_allclose(halved.x[best], problem.optimum, atol=2e-3)
    assert halved.converged.sum() < 8


def test_a_hessian_that_rounding_leaves_indefinite_is_mended() -> None:
    good, steep = np.diag([1.0, 2.0, 3.0]), 1e7
    bad = np.diag([steep, 1.0, -1e-10 * steep])
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(bad)
    factors = hessian_factors(np.stack([good, bad]))
    again = factors.transpose(0, 2, 1) @ factors
    assert np.allclose(again[0], good)
    assert np.abs(again[1] - bad).max() < 1e-9 * steep


def test_the_steps_program_is_the_one_that_cvxpy_solves() -> None:
    rng = np.random.default_rng(3)
    n, k = 6, 9
    program = StepQp(n, k)
    for _ in range(5):
        factor = np.triu(rng.normal(size=(n, n)))
        g, jacobian = rng.normal(size=n), rng.normal(size=(k, n))
        c, low, high = rng.normal(size=k) - 0.5, -rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n)
        d, t = cp.Variable(n), cp.Variable(k, nonneg=True)
        cost = 0.5 * cp.sum_squares(factor @ d) + g @ d + 3.0 * cp.sum(t)
        cp.Problem(cp.Minimize(cost), [jacobian @ d + c + t >= 0, d >= low, d <= high]).solve(
            solver=cp.OSQP, eps_abs=1e-9, eps_rel=1e-9, max_iter=100_000
        )
        step = program.solve(factor, g, jacobian, c, low, high, 3.0)
        np.testing.assert_allclose(step, d.value, atol=1e-4)


def test_the_steps_matrices_are_those_that_cvxpy_compiles() -> None:
    n, k = 4, 6
    rng = np.random.default_rng(3)
    d, t = cp.Variable(n), cp.Variable(k, nonneg=True)
    factor, jacobian = cp.Parameter((n, n)), cp.Parameter((k, n))
    gradient, low, high = cp.Parameter(n), cp.Parameter(n), cp.Parameter(n)
    values, penalty = cp.Parameter(k), cp.Parameter(nonneg=True)
    cost = 0.5 * cp.sum_squares(factor @ d) + gradient @ d + penalty * cp.sum(t)
    bounds = [jacobian @ d + values + t >= 0, d >= low, d <= high]
    parameters = [factor, gradient, jacobian, values, low, high, penalty]
    for parameter in parameters:
        parameter.value = rng.uniform(1, 2, parameter.shape) if parameter.shape else 3.0
    stated, _, _ = cp.Problem(cp.Minimize(cost), bounds).get_problem_data(cp.CLARABEL)
    matrix, linear, bound = StepQp(n, k).data(*(parameter.value for parameter in parameters))
    assert (matrix != stated["A"]).nnz == 0
    np.testing.assert_array_equal(linear, stated["c"])
    np.testing.assert_array_equal(bound, stated["b"])
