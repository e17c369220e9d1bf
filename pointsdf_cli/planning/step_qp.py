"""The quadratic subproblem of one step, solved by Clarabel.

    min  ½ ‖F d‖² + g · d + μ Σ t      over the step d [n] and slack t [k]
    s.t. J d + c + t ≥ 0,   t ≥ 0,   low ≤ d ≤ high

Slack keeps the subproblem feasible even if the linearised constraints are not; for μ above the
multipliers the penalty is exact.

Clarabel minimises ½ xᵀP x + q · x with A x + s = b, s in a cone. Here x = (y, d, t) with y = F d,
so that P is the identity on y, and the rows of A are

    [ −I   F    0 ]        0     y = F d
    [  0   0   −I ]        0     t ≥ 0
    [  0  −J   −I ]  ≤     c     J d + c + t ≥ 0
    [  0  −I    0 ]     −low     d ≥ low
    [  0   I    0 ]     high     d ≤ high

cvxpy would build the same matrices from the problem above (a test compares them), but importing it
takes longer than solving all steps of a plan. The sparsity pattern of the matrices never changes:
each step writes its numbers into it.
"""

from __future__ import annotations

import clarabel
import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array


class StepQp:
    """Solver of the subproblem for fixed n and k, made once and used for every step."""

    def __init__(self, n: int, k: int) -> None:
        self.n, self.k = n, k
        eye = scipy.sparse.identity
        parts = [  # the ones are places of F and −J
            [-eye(n), np.ones((n, n)), None],
            [None, None, -eye(k)],
            [None, np.ones((k, n)), -eye(k)],
            [None, -eye(n), None],
            [None, eye(n), None],
        ]
        self._matrix = scipy.sparse.bmat(parts, format="csc")
        # Column j of d holds F's column, −J's, and the two bounds; nothing else ever changes.
        assert (np.diff(self._matrix.indptr)[n : 2 * n] == n + k + 2).all()
        self._columns = self._matrix.data[n : n + n * (n + k + 2)].reshape(n, n + k + 2)
        rest = scipy.sparse.csc_matrix((n + k, n + k))
        self._quadratic = scipy.sparse.block_diag((eye(n), rest), format="csc")
        self._cones = [clarabel.ZeroConeT(n), clarabel.NonnegativeConeT(2 * n + 2 * k)]
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False
        self._settings.presolve_enable = False
        self._settings.max_threads = 1

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
            low, high: [n], bounds of the trust region and the joint limits.
            penalty: μ.
        """
        matrix, cost, bound = self.data(factor, gradient, jacobian, values, low, high, penalty)
        solver = clarabel.DefaultSolver(
            self._quadratic, cost, matrix, bound, self._cones, self._settings
        )
        step = np.array(solver.solve().x)[self.n : 2 * self.n]
        # Interior-point solutions can lie outside the box by rounding.
        return np.clip(step, low, high)

    def data(
        self,
        factor: Array,
        gradient: Array,
        jacobian: Array,
        values: Array,
        low: Array,
        high: Array,
        penalty: float,
    ) -> tuple[scipy.sparse.csc_matrix, Array, Array]:
        """A, q and b of the module's docstring; A is overwritten by the next call."""
        n, k = self.n, self.k
        self._columns[:, :n] = factor.T
        self._columns[:, n : n + k] = -jacobian.T
        cost = np.concatenate([np.zeros(n), gradient, np.full(k, penalty)])
        bound = np.concatenate([np.zeros(n + k), values, -low, high])
        return self._matrix, cost, bound
