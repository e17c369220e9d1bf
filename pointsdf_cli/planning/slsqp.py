"""The paper's solver: SciPy's sequential least squares programming, one start after the other."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.cancellation import stop_if_cancelled
from pointsdf_cli.planning.nonlinear import Evaluation, Problem, Solutions

ITERATIONS = 100
"""Largest number of iterations of one start."""
TOLERANCE = 1e-6
"""SciPy's `ftol`."""


class Slsqp:
    """SLSQP with the constraints' minimum over each link (the paper's way)."""

    def solve(self, problem: Problem, starts: Array, iterations: int | None = None) -> Solutions:
        """See `nonlinear.Solver`."""
        most = iterations or ITERATIONS
        results = [self._one(problem, start, most) for start in starts]
        x = np.array([r[0] for r in results]).reshape(starts.shape)
        ended = np.array([r[1] for r in results])
        return Solutions.at(x, problem.evaluate_grouped(x), ended, sum(r[2] for r in results))

    def _one(self, problem: Problem, start: Array, iterations: int) -> tuple[Array, bool, int]:
        @lru_cache(maxsize=1)
        def evaluated(point: bytes) -> Evaluation:
            stop_if_cancelled()
            return problem.evaluate_grouped(np.frombuffer(point)[None])

        def at(x: Array) -> Evaluation:
            """The last evaluation, shared by SciPy's calls for value, gradient and constraints."""
            return evaluated(x.tobytes())

        result = scipy.optimize.minimize(
            lambda x: float(at(x).objective[0]),
            start,
            jac=lambda x: at(x).gradient[0],
            bounds=np.column_stack([problem.lower, problem.upper]),
            constraints={
                "type": "ineq",
                "fun": lambda x: at(x).constraints[0],
                "jac": lambda x: at(x).jacobian[0],
            },
            method="SLSQP",
            options={"maxiter": iterations, "ftol": TOLERANCE},
        )
        x = np.clip(result.x, problem.lower, problem.upper)
        return x, bool(result.success), evaluated.cache_info().misses
