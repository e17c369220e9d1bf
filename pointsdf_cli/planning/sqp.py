"""Sequential quadratic programming for many starts in lockstep.

Each iteration evaluates all starts as one batch and solves one small quadratic program a start
(`step_qp.py`), within a trust region and with slack on the constraints: the ℓ1 penalty function

    φ(x) = f(x) + μ Σ max(0, −c_i(x))

decides which steps are accepted (Nocedal & Wright 2006, section 18.5). The Hessian model is the
problem's own (Gauss-Newton) plus a damped BFGS estimate of the rest of the objective. Constraints
may change from iteration to iteration, so their curvature is left to the trust region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.cancellation import stop_if_cancelled
from pointsdf_cli.planning.nonlinear import FEASIBLE, Evaluation, Problem, Solutions
from pointsdf_cli.planning.step_qp import StepQp

LARGEST_RADIUS = 0.5
"""Largest trust region."""
PENALTY = 1e3
"""μ, cost per unit of violation; raised tenfold (twice at most) if a start converges to an
infeasible point."""
LEAST_KEPT = 2
"""Smallest number of starts that always continue."""
DAMPING = 1e-3
"""Constant added to the Hessian model's diagonal."""


@dataclass(frozen=True)
class SqpConfig:
    """Limits of iterations and steps.

    Attributes:
        iterations: Largest number of iterations of one start.
        radius: First trust region: largest change of a variable in one step. Near the object larger
            steps are rejected, each after a wasted iteration.
        smallest_radius: Trust region below which a start has converged.
        tolerance: Predicted improvement of φ below which a start has converged; a share of the
            objective if that is above 1. Plans are accepted below an objective of 5, so hundredths
            do not matter.
        successive_halving: Iterations after which the worse half of the starts stops. The result of
            a start then depends on the others.
    """

    iterations: int = 20
    radius: float = 0.05
    smallest_radius: float = 1e-4
    tolerance: float = 1e-2
    successive_halving: tuple[int, ...] = ()


class Sqp:
    """Solver for any number of problems; its quadratic programs are reused."""

    def __init__(self, config: SqpConfig | None = None) -> None:
        self.config = config or SqpConfig()
        self._programs = cache(StepQp)

    def solve(self, problem: Problem, starts: Array, iterations: int | None = None) -> Solutions:
        """See `nonlinear.Solver`."""
        search = _Search(problem, starts, self.config, self._programs)
        ends = self.config.successive_halving
        for turn in range(iterations or self.config.iterations):
            stop_if_cancelled()
            if turn in ends:
                search.end_worse(ends.index(turn) + 1)
            if not search.advance():
                break
        return Solutions.at(search.x, search.now, search.done, search.evaluations)


class _Search:
    """B starts on their way to a minimum.

    Args:
        problem: Problem of n variables.
        starts: [B, n].
        config: Limits.
        programs: Maker of the quadratic program of n variables and k constraints.

    Attributes:
        x: [B, n], the best points so far.
        now: The problem there.
        done: [B], starts that can improve no more.
        evaluations: Number of evaluations, summed over starts.
    """

    def __init__(
        self,
        problem: Problem,
        starts: Array,
        config: SqpConfig,
        programs: Callable[[int, int], StepQp],
    ) -> None:
        self._problem, self._config, self.evaluations = problem, config, 0
        self.x = self._within(np.asarray(starts, dtype=np.float64))
        count, n = self.x.shape
        self.now = self._evaluated(self.x)
        self._program = programs(n, self.now.constraints.shape[1])
        self._rest = np.tile(DAMPING * np.eye(n), (count, 1, 1))
        self._radius = np.full(count, config.radius)
        self._penalty = np.full(count, PENALTY)
        self.done = np.zeros(count, dtype=bool)
        self._ended = np.zeros(count, dtype=bool)

    def end_worse(self, times: int) -> None:
        """End all starts but the best, after `times` halvings."""
        count = len(self.x)
        kept = max(LEAST_KEPT, -(-count // 2**times))
        phi = _penalised(self.now, np.full(count, PENALTY))
        self._ended[np.argsort(phi, kind="stable")[kept:]] = True

    def advance(self) -> bool:
        """One iteration of the A active starts; False without any."""
        live = np.flatnonzero(~(self.done | self._ended))
        if not len(live):
            return False
        now, config, radius = self.now, self._config, self._radius[live]
        step, promised = self._steps(live)
        trial = self._within(self.x[live] + step)
        new = self._evaluated(trial)
        before = _penalised(now, self._penalty[live], live)
        after = _penalised(new, self._penalty[live])
        self._learn(live, trial, new)
        gain = (before - after) / np.maximum(promised, 1e-300)
        back = np.flatnonzero((gain < 0.25) & (new.violation > 0))
        if len(back):
            after[back] = self._correct(live[back], back, trial, new, after[back])
        gain = (before - after) / np.maximum(promised, 1e-300)
        better = (gain > 1e-3) & (after < before)
        length = np.abs(trial - self.x[live]).max(axis=1)
        grown = np.minimum(2 * radius, LARGEST_RADIUS)
        shrunk = 0.4 * np.minimum(radius, np.maximum(length, config.smallest_radius))
        larger = np.where((gain > 0.75) & (length > 0.8 * radius), grown, radius)
        self._radius[live] = np.where(gain < 0.25, shrunk, larger)
        taken = live[better]
        self.x[taken] = trial[better]
        for kept, fresh in zip(now, new, strict=True):
            kept[taken] = fresh[better]
        little = config.tolerance * np.maximum(1.0, now.objective[live])
        settled = (promised < little) | (self._radius[live] < config.smallest_radius)
        self._settle(live[settled])
        return True

    def _within(self, x: Array) -> Array:
        return np.clip(x, self._problem.lower, self._problem.upper)

    def _evaluated(self, x: Array) -> Evaluation:
        """A copy of the problem at x [A, n]."""
        self.evaluations += len(x)
        return Evaluation(*(np.array(part) for part in self._problem.evaluate(x)))

    def _settle(self, rows: np.ndarray) -> None:
        """Stop starts that can improve no more, or continue them with a higher penalty."""
        violated = self.now.violation[rows] > FEASIBLE
        raise_more = violated & (self._penalty[rows] < 50 * PENALTY)
        again = rows[raise_more]
        self._penalty[again] *= 10
        self._radius[again] = self._config.radius
        self.done[rows[~raise_more]] = True

    def _steps(self, live: np.ndarray) -> tuple[Array, Array]:
        """Steps [A, n] of the active starts and the improvement of φ that the model predicts
        [A]."""
        now = self.now
        steps, promised = np.empty((len(live), self.x.shape[1])), np.empty(len(live))
        hessian = now.curvature[live] + self._rest[live]
        factor = hessian_factors(hessian)
        for i, b in enumerate(live):
            gradient, jacobian, values = now.gradient[b], now.jacobian[b], now.constraints[b]
            penalty = float(self._penalty[b])
            bounds = self._bounds(b, self.x[b])
            step = self._program.solve(factor[i], gradient, jacobian, values, *bounds, penalty)
            steps[i] = step
            linear = values + jacobian @ step
            model = gradient @ step + 0.5 * step @ hessian[i] @ step
            saved = np.maximum(0, -values).sum() - np.maximum(0, -linear).sum()
            promised[i] = penalty * saved - model
        return steps, promised

    def _bounds(self, b: int, x: Array) -> tuple[Array, Array]:
        """Least and largest steps [n] of start b from x [n], by its trust region and the limits."""
        low = np.maximum(-self._radius[b], self._problem.lower - x)
        return low, np.minimum(self._radius[b], self._problem.upper - x)

    def _correct(
        self, starts: np.ndarray, rows: np.ndarray, trial: Array, new: Evaluation, after: Array
    ) -> Array:
        """Move trial points that left a curved constraint back onto it; returns their φ [C].

        This second-order correction avoids the Maratos effect: without it a good step along a
        curved boundary is rejected because it leaves the boundary. The correction is the smallest
        step that meets the constraints as linearised at the trial point.

        Args:
            starts, rows: [C], the starts, and their rows of `trial` and `new`.
            trial, new: Trial points [A, n] of the active starts, and the problem there.
            after: [C], φ at these trial points.
        """
        n = trial.shape[1]
        corrected = trial[rows].copy()
        for i, (b, a) in enumerate(zip(starts, rows, strict=True)):
            low, high = self._bounds(b, trial[a])
            corrected[i] += self._program.solve(
                np.eye(n), np.zeros(n), new.jacobian[a], new.constraints[a], low, high, 1e3
            )
        corrected = self._within(corrected)
        there = self._evaluated(corrected)
        phi = _penalised(there, self._penalty[starts])
        kept = phi < after
        trial[rows[kept]] = corrected[kept]
        for old, fresh in zip(new, there, strict=True):
            old[rows[kept]] = fresh[kept]
        return np.minimum(phi, after)

    def _learn(self, live: np.ndarray, trial: Array, new: Evaluation) -> None:
        """Damped BFGS of the curvature beyond the given one (Powell 1978)."""
        rest = self._rest
        s = trial - self.x[live]
        y = new.gradient - self.now.gradient[live]
        y = y - (new.curvature @ s[..., None])[..., 0]
        # The first estimate takes its scale from the first change of slope (Nocedal & Wright 6.20).
        sy, yy = (s * y).sum(axis=1), (y * y).sum(axis=1)
        fresh = (rest[live] == DAMPING * np.eye(s.shape[1])).all(axis=(1, 2)) & (sy > 0)
        scale = np.clip(yy[fresh] / sy[fresh], DAMPING, 1e6)
        rest[live[fresh]] *= scale[:, None, None] / DAMPING
        B = rest[live]
        Bs = (B @ s[..., None])[..., 0]
        sBs = (s * Bs).sum(axis=1)
        sy = (s * y).sum(axis=1)
        slack = np.maximum(sBs - sy, 1e-300)
        theta = np.where(sy >= 0.2 * sBs, 1.0, 0.8 * sBs / slack)[:, None]
        y = theta * y + (1 - theta) * Bs
        sy = (s * y).sum(axis=1)
        sound = (sBs > 1e-14) & (sy > 1e-14)
        row = live[sound]
        s, y, Bs, sBs, sy = s[sound], y[sound], Bs[sound], sBs[sound], sy[sound]
        seen = y[:, :, None] * y[:, None, :] / sy[:, None, None]
        rest[row] += seen - Bs[:, :, None] * Bs[:, None, :] / sBs[:, None, None]
        # Rounding must not take positive definiteness away.
        rest[row] += 1e-9 * np.eye(rest.shape[1])


def hessian_factors(hessian: Array) -> Array:
    """Upper factors R [A, n, n] with RᵀR = the Hessians [A, n, n].

    A joint of a narrow range curves the prior so much more than the rest that rounding can leave a
    Hessian that is just not positive definite; its diagonal then grows by as much as rounding.
    """
    try:
        factors = np.linalg.cholesky(hessian)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(hessian)
        least = 1e-12 * np.abs(values).max(axis=1, keepdims=True)
        mended = (vectors * np.maximum(values, least)[:, None]) @ vectors.transpose(0, 2, 1)
        factors = np.linalg.cholesky(mended)
    return np.asarray(factors.transpose(0, 2, 1))


def _penalised(at: Evaluation, penalty: Array, rows: np.ndarray | slice = slice(None)) -> Array:
    """φ [A] of some starts, with their penalties [A]."""
    violation = np.maximum(0.0, -at.constraints[rows]).sum(axis=1)
    total: Array = at.objective[rows] + penalty * violation
    return total
