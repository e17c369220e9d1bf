"""The paper's solver: SciPy's sequential least squares programming, one start after the other."""

from __future__ import annotations

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.nonlinear import Evaluation, Problem, Solutions

ITERATIONS = 100
"""Largest number of iterations of one start."""
TOLERANCE = 1e-6
"""SciPy's `ftol`."""
FEASIBLE = 1e-4
"""Largest violation that counts as none."""


class Slsqp:
    """SLSQP with the constraints' minimum over each link (the paper's way)."""

    def solve(self, problem: Problem, starts: Array, iterations: int | None = None) -> Solutions:
        """See `nonlinear.Solver`."""
        most = iterations or ITERATIONS
        results = [self._one(problem, start, most) for start in starts]
        x = np.array([r[0] for r in results]).reshape(starts.shape)
        final = problem.evaluate_grouped(x)
        return Solutions(
            x=x,
            objective=final.objective,
            violation=final.violation,
            converged=np.array([r[1] for r in results]) & (final.violation <= FEASIBLE),
            evaluations=sum(r[2] for r in results),
        )

    def _one(self, problem: Problem, start: Array, iterations: int) -> tuple[Array, bool, int]:
        memory = _Memory(problem)
        result = scipy.optimize.minimize(
            lambda x: float(memory(x).objective[0]),
            start,
            jac=lambda x: memory(x).gradient[0],
            bounds=np.column_stack([problem.lower, problem.upper]),
            constraints={
                "type": "ineq",
                "fun": lambda x: memory(x).constraints[0],
                "jac": lambda x: memory(x).jacobian[0],
            },
            method="SLSQP",
            options={"maxiter": iterations, "ftol": TOLERANCE},
        )
        x = np.clip(result.x, problem.lower, problem.upper)
        return x, bool(result.success), memory.count


class _Memory:
    """Last evaluation, shared by SciPy's calls for value, gradient and constraints."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._x: Array | None = None
        self.count = 0

    def __call__(self, x: Array) -> Evaluation:
        if self._x is None or not np.array_equal(x, self._x):
            self._x, self.count = x.copy(), self.count + 1
            self._last = self._problem.evaluate_grouped(x[None])
        return self._last
