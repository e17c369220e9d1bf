"""The quadratic subproblem of one step, written in cvxpy, compiled once, solved by Clarabel.

    min  ½ ‖F d‖² + g · d + μ Σ t      over the step d [n] and slack t [k]
    s.t. J d + c + t ≥ 0,   t ≥ 0,   low ≤ d ≤ high

With slack an infeasible linearisation only costs; for μ above the multipliers the penalty is exact.

cvxpy needs a millisecond to fill in parameters, and Clarabel half of one to solve. So cvxpy states
the problem and is asked twice, with numbered parameters, which entry of the solver's matrices holds
which parameter; from then on the entries are written directly.
"""

from __future__ import annotations

import clarabel
import cvxpy as cp
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pointsdf_cli.errors import RgraspError

Array = NDArray[np.float64]


class StepQp:
    """Solves the subproblem again and again for one n and k."""

    def __init__(self, n: int, k: int) -> None:
        self.n, self.k = n, k
        d, t = cp.Variable(n), cp.Variable(k, nonneg=True)
        factor, jacobian = cp.Parameter((n, n)), cp.Parameter((k, n))
        gradient, low, high = cp.Parameter(n), cp.Parameter(n), cp.Parameter(n)
        values, penalty = cp.Parameter(k), cp.Parameter(nonneg=True)
        problem = cp.Problem(
            cp.Minimize(0.5 * cp.sum_squares(factor @ d) + gradient @ d + penalty * cp.sum(t)),
            [jacobian @ d + values + t >= 0, d >= low, d <= high],
        )
        # The order in which `solve` concatenates them.
        self._parameters = [factor, gradient, jacobian, values, low, high, penalty]
        self._problem = problem
        self._compile()

    def solve(
        self,
        factor: Array,
        gradient: Array,
        jacobian: Array,
        values: Array,
        low: Array,
        high: Array,
        penalty: float,
    ) -> Array:
        """The step d [n].

        Args:
            factor: F [n, n] with FᵀF the Hessian model.
            gradient: g [n].
            jacobian: J [k, n].
            values: c [k].
            low, high: [n], what the trust region and the joint limits leave.
            penalty: μ.
        """
        numbers = np.concatenate(
            [
                factor.ravel(order="F"),
                gradient,
                jacobian.ravel(order="F"),
                values,
                low,
                high,
                [penalty],
            ]
        )
        matrix, cost, bound = (fill(numbers) for fill in self._fills)
        self._matrix.data[:] = matrix
        solver = clarabel.DefaultSolver(
            self._quadratic, cost, self._matrix, bound, self._cones, self._settings
        )
        step = np.array(solver.solve().x)[self._step]
        # Interior points stop a hair outside of the box at worst.
        return np.clip(step, low, high)

    def _compile(self) -> None:
        sizes = [int(p.size) for p in self._parameters]
        ids = np.arange(1.0, sum(sizes) + 1)
        first, second = self._data(ids), self._data(2 * ids)
        self._matrix = sparse.csc_matrix(first["A"])
        self._quadratic = sparse.csc_matrix(sparse.triu(first["P"]))
        self._fills = [
            _Fill(np.asarray(a), np.asarray(b), len(ids))
            for a, b in (
                (first["A"].data, second["A"].data),
                (first["c"], second["c"]),
                (first["b"], second["b"]),
            )
        ]
        dims = first["dims"]
        self._cones = [clarabel.ZeroConeT(dims.zero), clarabel.NonnegativeConeT(dims.nonneg)]
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False
        self._settings.presolve_enable = False
        self._settings.max_threads = 1
        # The step stands where its gradient does in the cost.
        offset = sizes[0]
        places = self._fills[1].places
        self._step = np.array([int(np.flatnonzero(places == offset + i)[0]) for i in range(self.n)])
        check = np.random.default_rng(0).uniform(1, 2, len(ids))
        data = self._data(check)
        same = [
            np.allclose(self._fills[0](check), data["A"].data),
            np.allclose(self._fills[1](check), data["c"]),
            np.allclose(self._fills[2](check), data["b"]),
            np.allclose(self._quadratic.data, sparse.csc_matrix(sparse.triu(data["P"])).data),
        ]
        if not all(same):
            raise RgraspError(
                "this cvxpy compiles the step's quadratic program in another form than expected",
                where=f"cvxpy {cp.__version__}",
                hint="install the versions in constraints.txt",
            )

    def _data(self, numbers: Array) -> dict:
        offset = 0
        for parameter in self._parameters:
            size = int(parameter.size)
            chunk = numbers[offset : offset + size]
            parameter.value = (
                chunk.reshape(parameter.shape, order="F") if parameter.shape else (float(chunk[0]))
            )
            offset += size
        data, _, _ = self._problem.get_problem_data(cp.CLARABEL)
        return dict(data)


class _Fill:
    """Entries of the solver's data as `constant + sign · parameter`, found from two probes.

    Attributes:
        places: For each entry the parameter in it, or `count` where there is none.
    """

    def __init__(self, once: Array, twice: Array, count: int) -> None:
        # With parameters p and 2 p an entry is constant + p, then constant + 2 p.
        linear = twice - once
        self._constant = once - linear
        self._sign = np.sign(linear)
        number = np.rint(np.abs(linear)).astype(np.int64)
        self.places = np.where(number > 0, number - 1, count)

    def __call__(self, numbers: Array) -> Array:
        padded = np.append(numbers, 0.0)
        filled: Array = self._constant + self._sign * padded[self.places]
        return filled
