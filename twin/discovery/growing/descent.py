"""Damped Gauss-Newton fits of many hypotheses in parallel.

A kernel simulates a block of particles in the time of one. The fits of many hypotheses therefore step together: each
step is simulated with the derivatives at its end, and free lanes try more damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from twin.discovery.growing.growth_problem import GrowthProblem, readings_of
from twin.discovery.growing.likelihood import Spectrum
from twin.kernel import FEW_LANES
from twin.network import Array

ROUNDS = 25
AT_ONCE = 32
"""Fits that run in parallel; more would only need more memory."""
MOST_DAMPING, LEAST_DAMPING = 1.0e8, 1.0e-6
GAINED = 1.0e-4
"""Least relative fall of the squares by a step for another one to follow."""


def descend(starts: Sequence[tuple[GrowthProblem, Array]]) -> list[Array]:
    """Return the end points of damped Gauss-Newton fits to the squares of the free run and the prior, one for each
    start.

    Args:
        starts: problems of one superset and with the same inputs, each with its variables (count,).
    """
    return [v for first in range(0, len(starts), AT_ONCE) for v in _together(starts[first : first + AT_ONCE])]


def _together(starts: Sequence[tuple[GrowthProblem, Array]]) -> list[Array]:
    ways = [_Way(problem, v) for problem, v in starts]
    for way, around in zip(ways, _around([(w, [w.v]) for w in ways]), strict=True):
        way.begin(around[0])
    while going := [w for w in ways if w.rounds < ROUNDS]:
        count = max(FEW_LANES // sum(1 + w.v.size for w in going), 1)
        trials = [(w, w.trials(count)) for w in going]
        for (way, tried), around in zip(trials, _around(trials), strict=True):
            way.choose(tried, around)
    return [w.v for w in ways]


def _around(asked: Sequence[tuple[_Way, list[Array]]]) -> list[list[Array]]:
    """Return the readings (1 + count, n, m) around each of the given points."""
    found = readings_of([(way.problem, way.problem.around(v)) for way, points in asked for v in points])
    sizes = [1 + v.size for _, points in asked for v in points]
    each = iter(np.split(found, list(accumulate(sizes))[:-1]))
    return [[next(each) for _ in points] for _, points in asked]


class _Way:
    """One fit in progress: its point `v`, and the steps from there."""

    def __init__(self, problem: GrowthProblem, v: Array) -> None:
        self.problem, self.v, self.rounds = problem, v, 0
        self._white = Spectrum.white(problem.samples.sigma, len(problem.samples.time))
        self._damping = 1e-3

    def begin(self, around: Array) -> None:
        """Take the readings (1 + count, n, m) around the start."""
        self._cost = self._total(self.v, around[0])
        self._look(around)

    def trials(self, count: int) -> list[Array]:
        """Return the ends of steps with increasing damping."""
        self._dampings = [self._damping * 10.0**i for i in range(count)]
        return [self._step(d) for d in self._dampings]

    def choose(self, trials: list[Array], around: list[Array]) -> None:
        """Take the least damped of the steps that lower the squares, if any."""
        for damping, trial, there in zip(self._dampings, trials, around, strict=True):
            new = self._total(trial, there[0])
            if new < self._cost:
                gained, self._cost, self.v = self._cost - new, new, trial
                self._damping = max(damping / 10.0, LEAST_DAMPING)
                self.rounds = ROUNDS if gained < GAINED * new else self.rounds + 1
                if self.rounds < ROUNDS:
                    self._look(there)
                return
        self._damping = 10.0 * self._dampings[-1]
        if self._damping >= MOST_DAMPING:
            self.rounds = ROUNDS

    def _total(self, at: Array, readings: Array) -> float:
        white = self.problem.whitened(self.problem.samples.measured - readings, self._white)
        return float(white @ white + at @ self.problem.precision @ at)

    def _look(self, around: Array) -> None:
        """Compute the normal equations at the current point."""
        p, v = self.problem, self.v
        residual, slopes = p.sloped(v, around)
        r, j = p.whitened(residual, self._white), p.whitened(slopes, self._white)
        hessian = j.T @ j + p.precision
        self._pull = j.T @ r - p.precision @ v
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
