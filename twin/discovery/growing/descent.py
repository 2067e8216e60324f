"""Damped Gauss-Newton fits of many hypotheses in parallel.

A kernel simulates a block of particles in the time of one, so the fits of many hypotheses step together. Derivatives
cost a simulation for each variable, a step only one. They are therefore kept as long as they predict the squares of the
steps, with a secant update after each (Broyden, Math. Comp. 19 (1965) 577). A fit that begins at another one takes over
its derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from twin.discovery.growing.growth_problem import GrowthFit, GrowthProblem, readings_of
from twin.discovery.growing.likelihood import Spectrum
from twin.kernel import FEW_LANES
from twin.network import Array

ROUNDS = 25
"""Most steps of a fit."""
AT_ONCE = 32
"""Fits that run in parallel; more would only need more memory."""
MOST_DAMPING, LEAST_DAMPING = 1.0e8, 1.0e-6
GAINED = 1.0e-4
"""Least relative fall of the squares by a step for another one to follow."""
KEPT_PROMISE = 0.25
"""Least share of its promised gain with which a step speaks for its derivatives (Nocedal & Wright, algorithm 4.1)."""


@dataclass(frozen=True)
class Start:
    """Start of a fit: point v (count,), and a fit near it whose derivatives hold at first, if any."""

    problem: GrowthProblem
    v: Array
    near: GrowthFit | None = None


@dataclass(frozen=True)
class End:
    """End of a fit: point v (count,) and readings (n, m) there."""

    v: Array
    readings: Array


def descend(starts: Sequence[Start]) -> list[End]:
    """Return the ends of damped Gauss-Newton fits to the squares of the free run and the prior, one for each start.

    Args:
        starts: of problems of one superset and with the same inputs.
    """
    ends: list[End | None] = [None] * len(starts)
    # Fits in one kernel step together.
    waiting = sorted(range(len(starts)), key=lambda i: sorted(starts[i].problem.kinds), reverse=True)
    going: list[tuple[int, _Way]] = []
    while waiting or going:
        while waiting and len(going) < AT_ONCE:
            i = waiting.pop()
            going.append((i, _Way(starts[i])))
        spare = max(FEW_LANES // len(going), 1)
        asked = [(way, way.points(spare)) for _, way in going]
        found = readings_of([(way.problem, points) for way, points in asked])
        edges = list(accumulate(len(points) for _, points in asked))[:-1]
        for (way, points), readings in zip(asked, np.split(found, edges), strict=True):
            way.take(points, readings)
        for i, way in going:
            if way.done:
                ends[i] = End(way.v, way.readings)
        going = [(i, way) for i, way in going if not way.done]
    return [end for end in ends if end is not None]


class _Way:
    """One fit in progress: its point `v`, the readings there, and derivatives that hold or are to be renewed."""

    def __init__(self, start: Start) -> None:
        self.problem, self.v, self.done = start.problem, start.v, False
        self._white = Spectrum.white(self.problem.samples.sigma, len(self.problem.samples.time))
        self._damping, self._rounds = 1e-3, 0
        self._begun = self._holds = False
        self._lacking = np.ones(self.v.size, dtype=bool)
        self._slopes = np.zeros((self._white.variance.size, self.v.size))
        if start.near is not None:
            known, self._lacking = self.problem.taken_over(start.near)
            self._slopes = self.problem.whitened(known, self._white)
        self._fresh = start.near is None

    def points(self, count: int) -> Array:
        """Return the points (P, count) to simulate next: those around `v`, or ends of steps with increasing damping."""
        if not self._holds:
            around = self.problem.around(self.v)
            return around[np.concatenate([[not self._begun], self._lacking])]
        self._dampings = [self._damping * 10.0**i for i in range(count)]
        return np.stack([self._step(d) for d in self._dampings])

    def take(self, points: Array, readings: Array) -> None:
        """Take the readings (P, n, m) of the points asked for."""
        if self._holds:
            self._choose(points, readings)
            return
        if not self._begun:
            self._begun, self.readings, readings = True, readings[0].copy(), readings[1:]
            self._residual = self._whitened(self.readings)
            self._cost = self._total(self.v, self._residual)
        if self._lacking.any():
            slopes = self.problem.slopes(self.v, self.readings, readings, self._lacking)
            self._slopes[:, self._lacking] = self.problem.whitened(slopes, self._white)
        self._hessian = self._slopes.T @ self._slopes
        self._holds = True
        self._look()

    def _choose(self, points: Array, readings: Array) -> None:
        """Take the least damped of the steps that lower the squares, if any.

        Derivatives that no longer hold may point uphill. Of the steps along them only the most damped ones, which
        hardly move, then lower the squares, by rounding. That is no end of a fit but a reason to renew the derivatives.
        """
        for damping, point, there in zip(self._dampings, points, readings, strict=True):
            residual = self._whitened(there)
            new = self._total(point, residual)
            if new < self._cost:
                if not self._fresh and damping > self._damping and self._cost - new < GAINED * new:
                    break
                self._move(damping, point, there, residual, new)
                return
        if not self._fresh:
            self._renew()
            return
        self._damping = 10.0 * self._dampings[-1]
        self.done = self._damping >= MOST_DAMPING

    def _move(self, damping: float, point: Array, there: Array, residual: Array, new: float) -> None:
        """Go to a point with less squares; update the derivatives by the step, or have them renewed."""
        step, gained = point - self.v, self._cost - new
        predicted = self._residual - self._slopes @ step
        promised = self._cost - self._total(point, predicted)
        self.v, self.readings, self._residual, self._cost = point, there.copy(), residual, new
        self._damping = max(damping / 10.0, LEAST_DAMPING)
        self._rounds += 1
        if self._rounds >= ROUNDS:
            self.done = True
            return
        off, along = predicted - residual, step / float(step @ step)
        mixed = np.outer(self._slopes.T @ off, along)
        self._hessian = self._hessian + mixed + mixed.T + float(off @ off) * np.outer(along, along)
        self._slopes = self._slopes + np.outer(off, along)
        self._look()
        little = GAINED * new
        if gained < little and (self._fresh or self._promise() < little):
            self.done = True
        elif gained < little or gained < KEPT_PROMISE * promised:
            self._renew()
        else:
            self._fresh = False

    def _renew(self) -> None:
        """Have the derivatives computed anew at the current point."""
        self._lacking, self._holds, self._fresh = np.ones(self.v.size, dtype=bool), False, True

    def _promise(self) -> float:
        """Return the fall of the squares that the derivatives predict for the next step."""
        point = self._step(self._damping)
        return self._cost - self._total(point, self._residual - self._slopes @ (point - self.v))

    def _whitened(self, readings: Array) -> Array:
        return self.problem.whitened(self.problem.samples.measured - readings, self._white)

    def _total(self, at: Array, residual: Array) -> float:
        return float(residual @ residual + at @ self.problem.precision @ at)

    def _look(self) -> None:
        """Compute the normal equations at the current point."""
        p, v = self.problem, self.v
        hessian = self._hessian + p.precision
        self._pull = self._slopes.T @ self._residual - p.precision @ v
        diagonal = np.diag(hessian)
        held = ((v <= p.low) & (self._pull < 0.0)) | ((v >= p.high) & (self._pull > 0.0))
        self._free = ~held & (diagonal > 1e-12 * diagonal.max())
        self._inner = hessian[np.ix_(self._free, self._free)]
        self._reach = p.reach.copy()
        self._reach[p.q + p.k :] *= np.maximum(np.abs(v[p.q + p.k :]), 1.0)

    def _step(self, damping: float) -> Array:
        step = np.zeros_like(self.v)
        damped = self._inner + damping * np.diag(np.diag(self._inner))
        step[self._free] = np.linalg.solve(damped, self._pull[self._free])
        return np.clip(self.v + np.clip(step, -self._reach, self._reach), self.problem.low, self.problem.high)
