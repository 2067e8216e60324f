"""Null distribution of the best effect's gain: records simulated without a further effect are searched like the real
one.

The null is the fit without the effect. Its residual's spectrum, corrected for the fitted parameters, generates new
residuals. Each is scored against every candidate, to first order, with its spectrum estimated anew as for the real
record. The slow misfit of a short record has few degrees of freedom, and a likelihood that profiles their variance is
too small; how much depends on the record, so it is simulated (parametric bootstrap of the maximum; Westfall & Young,
Resampling-Based Multiple Testing, 1993).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.discovery.growing.growth_problem import GrowthFit, GrowthProblem
from twin.discovery.growing.likelihood import Spectrum, table
from twin.discovery.growing.scoring import answer_of, scores

DRAWS = 100
"""Records drawn from noise alone: their largest score is one that chance reaches once in a hundred."""
TAIL = 3.14
"""Standard deviations above its mean of the 99 % quantile of a maximum (Gumbel)."""


@dataclass(frozen=True)
class Chance:
    """Null distribution of the best effect's fall of -2 log likelihood: mean and standard deviation."""

    mean: float
    sd: float

    @property
    def limit(self) -> float:
        """Return the gain that noise exceeds in one of a hundred records."""
        return self.mean + TAIL * self.sd

    def of(self, gain: float) -> float:
        """Return the p-value of a gain, by the Gumbel distribution of maxima."""
        scale = max(self.sd * math.sqrt(6.0) / math.pi, 1e-9)
        return -math.expm1(-math.exp(min((self.mean - 0.5772 * scale - gain) / scale, 700.0)))


def by_chance(problem: GrowthProblem, fit: GrowthFit, seed: int = 0) -> Chance:
    """Return the null distribution of the best effect's gain on records like this one that lack nothing beyond
    `fit`.
    """
    found = [one.entry for one in scores(problem.superset, problem, fit) if max(one.squares, one.likely) > 0.0]
    if not found:
        return Chance(0.0, 0.0)
    sigma = problem.samples.sigma
    n, m = problem.samples.measured.shape
    white = Spectrum.white(sigma, n)
    j = problem.whitened(fit.slopes, white)
    inverse = np.linalg.pinv(j.T @ j + fit.precision, rcond=1e-13, hermitian=True)
    signatures = np.stack([problem.whitened(answer_of(problem, fit, e), white) for e in found], axis=1)
    signatures -= j @ (inverse @ (j.T @ signatures))
    squares = np.maximum((signatures**2).sum(axis=0), 1e-30)
    both = np.array([e.candidate.lower < 0.0 for e in found])
    # Squares and products of the cosines, by band and sensor, are all that a likelihood needs.
    tried = table(n)
    shaped = signatures.reshape(n, m, -1)
    own = tried.sums(shaped**2)
    roots = fit.spectrum.roots / sigma
    rng = np.random.default_rng(seed)
    best = np.empty(DRAWS)
    for d in range(DRAWS):
        drawn = (rng.normal(0.0, 1.0, (n, m)) * roots).ravel()
        drawn -= j @ (inverse @ (j.T @ drawn))
        size = signatures.T @ drawn / squares
        size = np.where(both, size, np.maximum(size, 0.0))
        mine = drawn.reshape(n, m)
        before = tried.sums(mine**2)
        after = before[:, :, None] - 2.0 * size * tried.sums(mine[:, :, None] * shaped) + size**2 * own
        by_sensor = [tried.best(np.column_stack([before[:, i], np.maximum(after[:, i], 0.0)]))[0] for i in range(m)]
        cost = np.sum(by_sensor, axis=0)
        best[d] = cost[0] - cost.min()
    return Chance(float(best.mean()), float(best.std()))
