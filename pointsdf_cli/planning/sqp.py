"""Sequential quadratic programming for many starts in lockstep.

Each iteration evaluates all starts as one batch and solves one small quadratic program a start
(`step_qp.py`), within a trust region and with slack on the constraints: the ℓ1 penalty function

    φ(x) = f(x) + μ Σ max(0, −c_i(x))

decides which steps are accepted (Nocedal & Wright 2006, section 18.5). The Hessian model is the
problem's own (Gauss-Newton) plus a damped BFGS estimate of the rest of the objective. Constraints
may change from iteration to iteration, so their curvature is left to the trust region.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.cancellation import stop_if_cancelled
from pointsdf_cli.planning.nonlinear import Evaluation, Problem, Solutions
from pointsdf_cli.planning.step_qp import StepQp

LARGEST_RADIUS = 0.5
"""Largest trust region."""
PENALTY = 1e3
"""μ, cost per unit of violation; raised tenfold (twice at most) if a start converges to an
infeasible point."""
LEAST_KEPT = 2
"""Smallest number of starts that always continue."""
FEASIBLE = 1e-4
"""Largest violation that counts as none."""
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
    """Solver for any number of problems."""

    def __init__(self, config: SqpConfig | None = None) -> None:
        self.config = config or SqpConfig()

    def solve(self, problem: Problem, starts: Array, iterations: int | None = None) -> Solutions:
        """See `nonlinear.Solver`."""
        config = self.config
        x = np.clip(np.asarray(starts, dtype=np.float64), problem.lower, problem.upper)
        count, n = x.shape
        now = _copy(problem.evaluate(x))
        program = StepQp(n, now.constraints.shape[1])
        evaluations = count
        rest = np.tile(DAMPING * np.eye(n), (count, 1, 1))
        radius = np.full(count, config.radius)
        penalty = np.full(count, PENALTY)
        done, ended = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        for turn in range(iterations or config.iterations):
            stop_if_cancelled()
            if turn in config.successive_halving:
                ended |= self._worse(now, config.successive_halving.index(turn) + 1)
            live = np.flatnonzero(~(done | ended))
            if not len(live):
                break
            step, promised = self._steps(problem, program, x, now, rest, radius, penalty, live)
            trial = np.clip(x[live] + step, problem.lower, problem.upper)
            new = _copy(problem.evaluate(trial))
            evaluations += len(live)
            before = _penalised(now, penalty[live], live)
            after = _penalised(new, penalty[live])
            self._learn(rest, live, x, trial, now, new)
            gain = (before - after) / np.maximum(promised, 1e-300)
            back = np.flatnonzero((gain < 0.25) & (new.violation > 0))
            if len(back):
                evaluations += len(back)
                after[back] = self._correct(
                    problem, program, trial, new, back, radius, penalty, live, after
                )
            gain = (before - after) / np.maximum(promised, 1e-300)
            better = (gain > 1e-3) & (after < before)
            length = np.abs(trial - x[live]).max(axis=1)
            grown = np.minimum(2 * radius[live], LARGEST_RADIUS)
            radius[live] = np.where(
                gain < 0.25,
                0.4 * np.minimum(radius[live], np.maximum(length, config.smallest_radius)),
                np.where((gain > 0.75) & (length > 0.8 * radius[live]), grown, radius[live]),
            )
            taken = live[better]
            x[taken] = trial[better]
            for kept, fresh in zip(now, new, strict=True):
                kept[taken] = fresh[better]
            little = config.tolerance * np.maximum(1.0, now.objective[live])
            settled = (promised < little) | (radius[live] < config.smallest_radius)
            self._settle(live[settled], now, radius, penalty, done)
        return Solutions(
            x=x,
            objective=now.objective,
            violation=now.violation,
            converged=done & (now.violation <= FEASIBLE),
            evaluations=evaluations,
        )

    def _worse(self, now: Evaluation, times: int) -> np.ndarray:
        """Mask [B] of the starts that stop after `times` halvings: all but the best."""
        count = len(now.objective)
        kept = max(LEAST_KEPT, -(-count // 2**times))
        phi = _penalised(now, np.full(count, PENALTY))
        worse = np.zeros(count, dtype=bool)
        worse[np.argsort(phi, kind="stable")[kept:]] = True
        return worse

    def _settle(
        self, rows: np.ndarray, now: Evaluation, radius: Array, penalty: Array, done: np.ndarray
    ) -> None:
        """Stop starts that can improve no more, or continue them with a higher penalty."""
        config = self.config
        violated = now.violation[rows] > FEASIBLE
        raise_more = violated & (penalty[rows] < 50 * PENALTY)
        again = rows[raise_more]
        penalty[again] *= 10
        radius[again] = config.radius
        done[rows[~raise_more]] = True

    def _steps(
        self,
        problem: Problem,
        program: StepQp,
        x: Array,
        now: Evaluation,
        rest: Array,
        radius: Array,
        penalty: Array,
        live: np.ndarray,
    ) -> tuple[Array, Array]:
        """Steps [A, n] of the active starts and the improvement of φ that the model predicts
        [A]."""
        steps, promised = np.empty((len(live), x.shape[1])), np.empty(len(live))
        hessian = now.curvature[live] + rest[live]
        factor = hessian_factors(hessian)
        for i, b in enumerate(live):
            low = np.maximum(-radius[b], problem.lower - x[b])
            high = np.minimum(radius[b], problem.upper - x[b])
            step = program.solve(
                factor[i],
                now.gradient[b],
                now.jacobian[b],
                now.constraints[b],
                low,
                high,
                float(penalty[b]),
            )
            steps[i] = step
            linear = now.constraints[b] + now.jacobian[b] @ step
            model = now.gradient[b] @ step + 0.5 * step @ hessian[i] @ step
            saved = np.maximum(0, -now.constraints[b]).sum() - np.maximum(0, -linear).sum()
            promised[i] = penalty[b] * saved - model
        return steps, promised

    def _correct(
        self,
        problem: Problem,
        program: StepQp,
        trial: Array,
        new: Evaluation,
        back: np.ndarray,
        radius: Array,
        penalty: Array,
        live: np.ndarray,
        after: Array,
    ) -> Array:
        """Move trial points that left a curved constraint back onto it; returns their φ [C].

        This second-order correction avoids the Maratos effect: without it a good step along a
        curved boundary is rejected because it leaves the boundary. The correction is the smallest
        step that meets the constraints as linearised at the trial point.
        """
        n = trial.shape[1]
        corrected = trial[back].copy()
        for i, a in enumerate(back):
            low = np.maximum(-radius[live[a]], problem.lower - trial[a])
            high = np.minimum(radius[live[a]], problem.upper - trial[a])
            corrected[i] += program.solve(
                np.eye(n), np.zeros(n), new.jacobian[a], new.constraints[a], low, high, 1e3
            )
        corrected = np.clip(corrected, problem.lower, problem.upper)
        there = problem.evaluate(corrected)
        phi = _penalised(there, penalty[live[back]])
        kept = phi < after[back]
        rows = back[kept]
        trial[rows] = corrected[kept]
        for old, fresh in zip(new, there, strict=True):
            old[rows] = fresh[kept]
        return np.minimum(phi, after[back])

    def _learn(
        self,
        rest: Array,
        live: np.ndarray,
        x: Array,
        trial: Array,
        now: Evaluation,
        new: Evaluation,
    ) -> None:
        """Damped BFGS of the curvature beyond the given one (Powell 1978)."""
        s = trial - x[live]
        y = new.gradient - now.gradient[live]
        y = y - (new.curvature @ s[..., None])[..., 0]
        # The first estimate takes its scale from the first change of slope (Nocedal & Wright 6.20).
        sy, yy = (s * y).sum(axis=1), (y * y).sum(axis=1)
        fresh = (rest[live] == DAMPING * np.eye(x.shape[1])).all(axis=(1, 2)) & (sy > 0)
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
        rest[row] += (
            y[:, :, None] * y[:, None, :] / sy[:, None, None]
            - Bs[:, :, None] * Bs[:, None, :] / sBs[:, None, None]
        )
        # Rounding must not take positive definiteness away.
        rest[row] += 1e-9 * np.eye(rest.shape[1])


def _copy(evaluation: Evaluation) -> Evaluation:
    return Evaluation(*(np.array(part) for part in evaluation))


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
