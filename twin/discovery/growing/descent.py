"""Least squares of many hypotheses at once.

A kernel does a block of particles in the time of one. So the starts of many hypotheses go down side by side, each step
is tried together with the slopes at its end, and where lanes are left, with more damping too.
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
"""Starts that go down side by side; more would only need more memory."""
MOST_DAMPING, LEAST_DAMPING = 1.0e8, 1.0e-6
GAINED = 1.0e-4
"""Share of the squares that a step must gain for another one to be worth it."""


def descend(starts: Sequence[tuple[GrowthProblem, Array]]) -> list[Array]:
    """Where damped Gauss-Newton steps on the squares of the free run and the prior end, for each start.

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
    """Readings (1 + count, n, m) around each of the points asked for."""
    found = readings_of([(way.problem, way.problem.around(v)) for way, points in asked for v in points])
    sizes = [1 + v.size for _, points in asked for v in points]
    each = iter(np.split(found, list(accumulate(sizes))[:-1]))
    return [[next(each) for _ in points] for _, points in asked]


class _Way:
    """One hypothesis on its way down: where it is, `v`, and the steps that it may take from there."""

    def __init__(self, problem: GrowthProblem, v: Array) -> None:
        self.problem, self.v, self.rounds = problem, v, 0
        self._white = Spectrum.white(problem.samples.sigma, len(problem.samples.time))
        self._damping = 1e-3

    def begin(self, around: Array) -> None:
        """Readings (1 + count, n, m) around the start are known."""
        self._cost = self._total(self.v, around[0])
        self._look(around)

    def trials(self, count: int) -> list[Array]:
        """Ends of steps with more and more damping."""
        self._dampings = [self._damping * 10.0**i for i in range(count)]
        return [self._step(d) for d in self._dampings]

    def choose(self, trials: list[Array], around: list[Array]) -> None:
        """Take the least damped of the steps that do better, if any."""
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
        """Normal equations where it is now."""
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
