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
MOST_TURNS, NOTHING = 4, 1.0e-6
"""Iterations of a bounded step per variable, and the relative gain below which no bound is released again."""
LEAST_DAMPED, FIRST_DAMPED, MOST_DAMPED = 1.0e-6, 1.0e-3, 1.0e6


@dataclass(frozen=True)
class LeastSquaresProblem:
    """Least-squares problem over v (c,): minimise |residual|^2 + v' precision v.

    Attributes:
        look: residuals (P, rows) at v (P, c).
        slopes: derivatives (rows, c) of the residual at v (c,), and for variables with kinks (rows, bends) towards
            lower values.
        precision: (c, c). low, high: (c,) bounds. reach: (c,) longest steps, unless derivatives held so far.
        bends: (bends,) indices of variables with kinks. leap: distance of the kinks.
        scale: (c,) large change of each variable, in its unit.
    """

    look: Callable[[Array], Array]
    slopes: Callable[[Array], tuple[Array, Array]]
    precision: Array
    low: Array
    high: Array
    reach: Array
    bends: np.ndarray
    leap: float
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
    """Step (c,), its damping, its longest multiple, and the squares that its derivatives predict."""

    step: Array
    damping: float
    longer: float
    total: float


def minimise(squares: LeastSquaresProblem, v: Array, rounds: int) -> tuple[SearchPoint, Array, bool]:
    """Return the minimum of the squares near v (c,) after at most some rounds, the derivatives (rows, c), and
    convergence.

    Before convergence the derivatives are those of the last round. After a single round, which serves for the squares
    alone, they are those of its beginning.
    """
    residuals = squares.look(v[None])
    place = SearchPoint(v, residuals[0], float(squares.total_squares(v[None], residuals)[0]))
    slopes = squares.slopes(place.v)
    damping, longer, fresh = FIRST_DAMPED, 1.0, True
    for _ in range(rounds):
        little = max(LITTLE * place.total, LEAST)
        tried = _steps(squares, place, slopes, damping, longer)
        if place.total - min(s.total for s in tried) > little:
            best, found = _best(squares, place, tried)
            gained, predicted = place.total - found.total, place.total - best.total
            if gained > 0.0:
                longer = longer * best.longer if best.damping == damping else 1.0
                damping = max(best.damping / CALMER, LEAST_DAMPED)
                done = fresh and gained < little
                place, fresh = found, False
                if done:
                    break
                straight = not best.step[squares.bends].any()
                if straight and gained > little and PREDICTED * predicted < gained < predicted / PREDICTED:
                    continue
            elif fresh:
                damping, longer = damping * STIFFER, 1.0
                if damping > MOST_DAMPED:
                    break
                continue
        elif fresh:
            break
        if rounds > 1:
            slopes, fresh = squares.slopes(place.v), True
    else:
        return place, slopes[0], False
    return place, slopes[0] if fresh else squares.slopes(place.v)[0], True


def _best(squares: LeastSquaresProblem, place: SearchPoint, tried: list[TrialStep]) -> tuple[TrialStep, SearchPoint]:
    """Return the step to the least squares, and its end point; a step with NaN leads nowhere."""
    steps = np.stack([s.step for s in tried])
    steps[~np.isfinite(steps).all(axis=1)] = 0.0
    v = np.clip(place.v + steps, squares.low, squares.high)
    residuals = squares.look(v)
    totals = squares.total_squares(v, residuals)
    k = int(np.argmin(totals))
    return tried[k], SearchPoint(v[k], residuals[k], float(totals[k]))


def _steps(
    squares: LeastSquaresProblem, place: SearchPoint, slopes: tuple[Array, Array], damping: float, longest: float
) -> list[TrialStep]:
    """Return trial steps: kinked variables held, moved by their derivatives, all or each alone, and across their kinks.

    Derivatives predict nothing across a kink: such a step has no predicted gain.
    """
    bends, lower = squares.bends, slopes[1]
    along = slopes[0].copy()

    def form() -> tuple[Array, Array]:
        """Return matrix and gradient of the squares' quadratic form by the derivatives."""
        hessian: Array = along.T @ along + squares.precision
        return hessian, along.T @ place.residual - squares.precision @ place.v

    def step(down: Array, up: Array, damped: float = 1.0, longer: float = 1.0) -> TrialStep:
        """Return a step with kinked variables moving down and up (bends,) no further than this."""
        reach = longest * longer * squares.reach
        low, high = np.maximum(squares.low - place.v, -reach), np.minimum(squares.high - place.v, reach)
        low[bends], high[bends] = np.maximum(low[bends], -down), np.minimum(high[bends], up)
        much = np.diag(hessian) * squares.scale**2
        # What changes nothing (an onset where its effect is nothing yet, say) stays where it is.
        free = much >= 1e-9 * np.median(much)
        stiff = hessian + damping * damped * np.diag(np.maximum(much, 1e-9 * much.max()) / squares.scale**2)
        taken = bounded(stiff, pull, np.where(free, low, 0.0), np.where(free, high, 0.0))
        total = squares.total_squares((place.v + taken)[None], (place.residual - along @ taken)[None])
        return TrialStep(taken, damping * damped, longer, float(total[0]))

    hessian, pull = form()
    down, up = np.zeros(len(bends)), np.zeros(len(bends))
    tried = [step(down, up, damped=d) for d in DAMPINGS] + [step(down, up, longer=FURTHER)]
    left = place.residual - along @ tried[0].step
    for n, i in enumerate(bends):
        later, sooner = max(float(along[:, i] @ left), 0.0), min(float(lower[:, n] @ left), 0.0)
        if later**2 * (lower[:, n] ** 2).sum() >= sooner**2 * (along[:, i] ** 2).sum():
            up[n] = np.inf if later else 0.0
        else:
            along[:, i], down[n] = lower[:, n], np.inf
    if down.any() or up.any():
        hessian, pull = form()
        full = step(down, up)
        way = full.step[bends]
        ways = [SHORTER * way, *(np.where(bends == i, way, 0.0) for i in bends if len(bends) > 1)]
        tried += [full, *(step(np.maximum(-w, 0.0), np.maximum(w, 0.0)) for w in ways)]
        for bent in (1.0, FURTHER):
            leap = tried[0].step.copy()
            leap[bends] += bent * squares.leap * (np.sign(up) - np.sign(down))
            tried.append(TrialStep(leap, damping, 1.0, place.total))
    return tried


def bounded(hessian: Array, pull: Array, low: Array, high: Array) -> Array:
    """Return the step s that minimises s H s / 2 - pull s subject to low <= s <= high, where 0 is feasible.

    Active sets (Nocedal & Wright, Numerical Optimization, algorithm 16.3): step towards the minimum of the free
    variables until one meets its bound and stays there; once none does, release the bound with the largest multiplier.
    """
    diagonal = np.diag(hessian)
    step = np.zeros_like(pull)
    movable = high > low
    free = movable.copy()
    for _ in range(MOST_TURNS * len(pull)):
        way = np.zeros_like(step)
        rest = (pull - hessian @ step)[free]
        way[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest)
        bound = np.where(way > 0.0, high, low)
        share = np.divide(bound - step, way, out=np.full_like(way, np.inf), where=way != 0.0)
        first = int(np.argmin(share))
        if share[first] < 1.0:
            step = np.clip(step + share[first] * way, low, high)
            step[first], free[first] = bound[first], False
            continue
        step = np.clip(step + way, low, high)
        slope = pull - hessian @ step
        inward = np.where(movable & ~free, np.where(step == low, slope, -slope), 0.0)
        gain = np.maximum(inward, 0.0) ** 2 / np.maximum(diagonal, 1e-300)
        most = int(np.argmax(gain))
        if gain[most] <= NOTHING * float(pull @ step):
            break
        free[most] = True
    return step
