"""Interface between solvers and problems.

min f(x)   subject to   c(x) ≥ 0,   lower ≤ x ≤ upper,   from many starts x [B, n]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array


class Evaluation(NamedTuple):
    """A problem at B points.

    Attributes:
        objective: [B], f.
        gradient: [B, n].
        curvature: [B, n, n], positive semidefinite, the known part of f's Hessian (Gauss-Newton);
            zeros if unknown.
        constraints: [B, K], the values c of least slack.
        jacobian: [B, K, n], their derivatives.
    """

    objective: Array
    gradient: Array
    curvature: Array
    constraints: Array
    jacobian: Array

    @property
    def violation(self) -> Array:
        """Largest violation [B]; 0 without any."""
        return np.maximum(0.0, -self.constraints.min(axis=1, initial=0.0))


FEASIBLE = 1e-4
"""Largest violation that counts as none."""


class Problem(Protocol):
    """A batched nonlinear problem."""

    lower: Array
    upper: Array

    def evaluate(self, x: Array) -> Evaluation:
        """Evaluate at x [B, n]; the choice of reported constraints may differ between points.

        Constraints that are not reported must have more slack than those that are.
        """

    def evaluate_grouped(self, x: Array) -> Evaluation:
        """Evaluate at x [B, n] with the same constraints, in the same order, at every point."""


@dataclass(frozen=True)
class Solutions:
    """Results for B starts.

    Attributes:
        x: [B, n].
        objective: [B].
        violation: [B], the largest, in the constraints' unit.
        converged: bool [B], whether the solver's tolerances were met.
        evaluations: Number of evaluations of the problem, summed over starts.
    """

    x: Array
    objective: Array
    violation: Array
    converged: NDArray[np.bool_]
    evaluations: int

    @classmethod
    def at(cls, x: Array, end: Evaluation, ended: NDArray[np.bool_], evaluations: int) -> Solutions:
        """Solutions x [B, n] with the problem there; `ended` [B] marks starts whose solver could
        improve them no more."""
        violation = end.violation
        converged = ended & (violation <= FEASIBLE)
        return cls(x, end.objective, violation, converged, evaluations)


class Solver(Protocol):
    """Protocol of a solver."""

    def solve(self, problem: Problem, starts: Array, iterations: int | None = None) -> Solutions:
        """Solve from all starts [B, n]; equal input gives equal output.

        Args:
            problem: Problem to solve.
            starts: Starting points.
            iterations: Largest number of iterations; the solver's default if None.
        """
