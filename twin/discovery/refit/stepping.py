"""Damped Gauss-Newton for residuals with kinks in some variables: several trial steps are simulated side by side.

Block means have a kink where an onset passes from one block into the next, so an onset's derivative may hold on one
side only and not far, and must not slow down the other variables. Marquardt, J. SIAM 11 (1963) 431, otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.network import Array

DAMPINGS, FURTHER, SHORTER = (1.0, 30.0, 1000.0), 4.0, 0.3
"""Trial steps: factors on the damping, on the length, and the share for variables with kinks. Eight runs cost little
more than one."""
LITTLE, LEAST = 1.0e-4, 0.2
"""Gain, relative to all squares and absolute, at which the fit has converged."""
PREDICTED = 0.7
"""Ratio of gained to predicted squares, and its inverse, within which derivatives hold for another step."""
CALMER, STIFFER = 10.0, 1.0e3
"""Factors by which damping falls after a step that gained, and rises after none did."""
MOST_ITERATIONS, NOTHING = 4, 1.0e-6
"""Iterations of a bounded step per variable, and the relative gain below which no bound is released again."""
LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING = 1.0e-6, 1.0e-3, 1.0e6
"""Levenberg-Marquardt damping, relative to the curvature of each variable: its bounds and its first value."""
UNMOVED, FLOOR = 1.0e-9, 1.0e-9
"""Curvature relative to the median below which a variable stays, and relative to the largest by which it is damped at
least: both far above rounding, 1e-16, and far below any curvature that a record shows."""


@dataclass(frozen=True)
class LeastSquaresProblem:
    """Least-squares problem over v (c,): minimise |residual|^2 + v' precision v.

    Attributes:
        residuals: function that returns the residuals (P, rows) at v (P, c).
        jacobian: function that returns the derivatives (rows, c) of the simulated values at v (c,), which are the
            residual's with the opposite sign, and those (rows, t) of variables with kinks towards lower values.
        precision: (c, c) of the prior about 0.
        low, high: (c,) bounds.
        reach: (c,) longest steps, unless derivatives held so far.
        kinked: (t,) indices of variables with kinks.
        kink_spacing: distance of the kinks, in the unit of these variables.
        scale: (c,) large change of each variable, in its unit.
    """

    residuals: Callable[[Array], Array]
    jacobian: Callable[[Array], tuple[Array, Array]]
    precision: Array
    low: Array
    high: Array
    reach: Array
    kinked: np.ndarray
    kink_spacing: float
    scale: Array

    def total_squares(self, v: Array, residual: Array) -> Array:
        """Return the squares (P,) at v (P, c)."""
        total: Array = (residual**2).sum(axis=1) + ((v @ self.precision) * v).sum(axis=1)
        return total


@dataclass(frozen=True)
class SearchPoint:
    """Point of the search: v (c,), residual (rows,), and the squares."""

    v: Array
    residual: Array
    total: float


@dataclass(frozen=True)
class TrialStep:
    """Step (c,), its damping, the multiple of the longest step that it may have, and its predicted squares."""

    step: Array
    damping: float
    longer: float
    total: float


def minimise(problem: LeastSquaresProblem, v: Array, rounds: int) -> tuple[SearchPoint, Array, bool]:
    """Return the minimum of the squares near v (c,) after at most some rounds, the derivatives (rows, c), and
    convergence.

    Before convergence the derivatives are those of the last round. After a single round, which serves for the squares
    alone, they are those of its beginning.
    """
    residuals = problem.residuals(v[None])
    point = SearchPoint(v, residuals[0], float(problem.total_squares(v[None], residuals)[0]))
    jacobian = problem.jacobian(point.v)
    damping, longer, fresh = FIRST_DAMPING, 1.0, True
    for _ in range(rounds):
        little = max(LITTLE * point.total, LEAST)
        tried = _trial_steps(problem, point, jacobian, damping, longer)
        if point.total - min(s.total for s in tried) > little:
            best, found = _best(problem, point, tried)
            gained, predicted = point.total - found.total, point.total - best.total
            if gained > 0.0:
                longer = longer * best.longer if best.damping == damping else 1.0
                damping = max(best.damping / CALMER, LEAST_DAMPING)
                done = fresh and gained < little
                point, fresh = found, False
                if done:
                    break
                smooth = not best.step[problem.kinked].any()
                if smooth and gained > little and PREDICTED * predicted < gained < predicted / PREDICTED:
                    continue
            elif fresh:
                damping, longer = damping * STIFFER, 1.0
                if damping > MOST_DAMPING:
                    break
                continue
        elif fresh:
            break
        if rounds > 1:
            jacobian, fresh = problem.jacobian(point.v), True
    else:
        return point, jacobian[0], False
    return point, jacobian[0] if fresh else problem.jacobian(point.v)[0], True


def _best(problem: LeastSquaresProblem, point: SearchPoint, tried: list[TrialStep]) -> tuple[TrialStep, SearchPoint]:
    """Return the step to the least squares, and its end point; a step with NaN leads nowhere."""
    steps = np.stack([s.step for s in tried])
    steps[~np.isfinite(steps).all(axis=1)] = 0.0
    v = np.clip(point.v + steps, problem.low, problem.high)
    residuals = problem.residuals(v)
    totals = problem.total_squares(v, residuals)
    k = int(np.argmin(totals))
    return tried[k], SearchPoint(v[k], residuals[k], float(totals[k]))


def _trial_steps(
    problem: LeastSquaresProblem, point: SearchPoint, jacobian: tuple[Array, Array], damping: float, longest: float
) -> list[TrialStep]:
    """Return trial steps: kinked variables held, moved by their derivatives, all or each alone, and across their kinks.

    Derivatives predict nothing across a kink: such a step has no predicted gain.
    """
    kinked, towards_lower = problem.kinked, jacobian[1]
    slopes = jacobian[0].copy()
    held = np.zeros(len(kinked))
    model = _QuadraticModel.of(problem, point, slopes, damping, longest)
    tried = [model.step(held, held, damped=d) for d in DAMPINGS] + [model.step(held, held, longer=FURTHER)]
    left = point.residual - slopes @ tried[0].step
    down, up = held.copy(), held.copy()
    for n, i in enumerate(kinked):
        later, sooner = max(float(slopes[:, i] @ left), 0.0), min(float(towards_lower[:, n] @ left), 0.0)
        if later**2 * (towards_lower[:, n] ** 2).sum() >= sooner**2 * (slopes[:, i] ** 2).sum():
            up[n] = np.inf if later else 0.0
        else:
            slopes[:, i], down[n] = towards_lower[:, n], np.inf
    if down.any() or up.any():
        model = _QuadraticModel.of(problem, point, slopes, damping, longest)
        full = model.step(down, up)
        onsets = full.step[kinked]
        others = [SHORTER * onsets, *(np.where(kinked == i, onsets, 0.0) for i in kinked if len(kinked) > 1)]
        tried += [full, *(model.step(np.maximum(-x, 0.0), np.maximum(x, 0.0)) for x in others)]
        for multiple in (1.0, FURTHER):
            across = tried[0].step.copy()
            across[kinked] += multiple * problem.kink_spacing * (np.sign(up) - np.sign(down))
            tried.append(TrialStep(across, damping, 1.0, point.total))
    return tried


@dataclass(frozen=True)
class _QuadraticModel:
    """Quadratic form of the squares about a point, by its derivatives `slopes` (rows, c).

    Attributes:
        hessian: (c, c), of Gauss-Newton. descent: (c,) half the negative gradient. curvature: (c,) of variables in
            units of their scale.
    """

    problem: LeastSquaresProblem
    point: SearchPoint
    slopes: Array
    damping: float
    longest: float
    hessian: Array
    descent: Array
    curvature: Array

    @classmethod
    def of(
        cls, problem: LeastSquaresProblem, point: SearchPoint, slopes: Array, damping: float, longest: float
    ) -> _QuadraticModel:
        """Return the form at a point, for damped steps of at most `longest` times the reach of the problem."""
        hessian: Array = slopes.T @ slopes + problem.precision
        descent = slopes.T @ point.residual - problem.precision @ point.v
        curvature = np.diag(hessian) * problem.scale**2
        return cls(problem, point, slopes, damping, longest, hessian, descent, curvature)

    def step(self, down: Array, up: Array, damped: float = 1.0, longer: float = 1.0) -> TrialStep:
        """Return the damped step within bounds.

        Args:
            down, up: (t,) largest moves of kinked variables.
            damped, longer: factors on damping and reach.
        """
        problem, v, curvature = self.problem, self.point.v, self.curvature
        reach = self.longest * longer * problem.reach
        low, high = np.maximum(problem.low - v, -reach), np.minimum(problem.high - v, reach)
        low[problem.kinked] = np.maximum(low[problem.kinked], -down)
        high[problem.kinked] = np.minimum(high[problem.kinked], up)
        # A variable that changes nothing (an onset where its effect is nothing yet, say) stays where it is.
        free = curvature >= UNMOVED * np.median(curvature)
        floor = np.maximum(curvature, FLOOR * curvature.max())
        stiff = self.hessian + self.damping * damped * np.diag(floor / problem.scale**2)
        step = bounded_step(stiff, self.descent, np.where(free, low, 0.0), np.where(free, high, 0.0))
        total = problem.total_squares((v + step)[None], (self.point.residual - self.slopes @ step)[None])
        return TrialStep(step, self.damping * damped, longer, float(total[0]))


def bounded_step(hessian: Array, descent: Array, low: Array, high: Array) -> Array:
    """Return the step s (c,) that minimises s H s / 2 - descent s subject to low <= s <= high, where 0 is feasible.

    Active sets (Nocedal & Wright, Numerical Optimization, algorithm 16.3): step towards the minimum of the free
    variables until one meets its bound and stays there; once none does, release the bound with the largest multiplier.

    Args:
        hessian: (c, c), positive definite. descent: (c,) negative gradient at 0. low, high: (c,).
    """
    diagonal = np.diag(hessian)
    step = np.zeros_like(descent)
    movable = high > low
    free = movable.copy()
    for _ in range(MOST_ITERATIONS * len(descent)):
        direction = np.zeros_like(step)
        rest = (descent - hessian @ step)[free]
        direction[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest)
        bound = np.where(direction > 0.0, high, low)
        share = np.divide(bound - step, direction, out=np.full_like(direction, np.inf), where=direction != 0.0)
        first = int(np.argmin(share))
        if share[first] < 1.0:
            step = np.clip(step + share[first] * direction, low, high)
            step[first], free[first] = bound[first], False
            continue
        step = np.clip(step + direction, low, high)
        multiplier = descent - hessian @ step
        inward = np.where(movable & ~free, np.where(step == low, multiplier, -multiplier), 0.0)
        gain = np.maximum(inward, 0.0) ** 2 / np.maximum(diagonal, 1e-300)
        most = int(np.argmax(gain))
        if gain[most] <= NOTHING * float(descent @ step):
            break
        free[most] = True
    return step
