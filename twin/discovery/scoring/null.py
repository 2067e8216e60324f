"""Threshold of the score at a low false-alarm rate: the highest score in simulated records without an effect.

Every law, shape and onset is one test, and tests are many and correlated: a score that is rare for one of them is
common for the best. Records of noise alone, of the covariance that weights the record, therefore pass the same scan,
and the highest score of each is kept (max-T: Westfall & Young, Resampling-Based Multiple Testing, 1993). Noise is drawn
in whitened coordinates, with the tunables projected out, so no simulation is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.sweep import Courses
from twin.network import Array

DRAWS = 128
"""Residuals drawn from noise; their largest scores give the quantile of the threshold."""
EVERY = 2
"""Step between the scanned onsets: every one of them would hardly raise the highest score of noise."""
FALSE_ALARMS = 0.01
"""Share of healthy records that may have another verdict than adequate, over the whole catalogue."""
_TINY = 1e-12
"""Share of the largest squares below which squares are rounding."""


@dataclass(frozen=True)
class Null:
    """Highest scores (d,) of records of noise, sorted."""

    best: Array

    def quantile(self, rate: float) -> float:
        """Return the score that the best of a record of noise exceeds with probability `rate`; by the fitted tail if
        rare.
        """
        location, scale = self._tail()
        return location - scale * math.log(-math.log1p(-rate))

    def family_wise(self, z: float) -> float:
        """Return the family-wise p-value of a best score z, over the whole catalogue."""
        location, scale = self._tail()
        return -math.expm1(-math.exp(-(z - location) / scale))

    def _tail(self) -> tuple[float, float]:
        """Return location and scale of the Gumbel distribution with the same mean and spread, which maxima follow."""
        scale = float(np.std(self.best, ddof=1)) * math.sqrt(6.0) / math.pi
        return float(np.mean(self.best)) - 0.5772 * scale, max(scale, 1e-6)


def null_scores(score_test: ScoreTest, laws: list[CandidateLaw], draws: int = DRAWS, seed: int = 0) -> Null:
    """Return the null distribution of the best score: every candidate in all its shapes from every onset."""
    scores = score_test.noise_scores(np.random.default_rng(seed), draws)
    known = Courses.of(score_test)
    steps, grown = (c[:, ::EVERY].astype(np.float32) for c in (known.steps, known.growths))
    best = np.zeros(draws)
    for law in laws:
        p = score_test.vector(law)
        exact, drawn = score_test.small(p, scores)
        scale = max(float(np.trace(exact)), _TINY)
        gram, score = (exact / scale).astype(np.float32), (drawn / scale).astype(np.float32)
        families = [steps] if law.candidate.shapes == ("step",) else [steps, grown]
        if law.candidate.begins:
            families = [known.beyond(law.candidate)[1][:, ::EVERY].astype(np.float32)]
        for courses in (c for c in families if c.shape[1]):
            bottom = np.maximum((courses * (gram @ courses)).sum(axis=0), 1e-6)
            top = courses.T @ score
            size = top / bottom[:, None]
            inside = (size >= law.candidate.lower) & (size <= law.candidate.upper)
            gain = np.where(inside & (np.abs(size) >= law.candidate.lumped), top * size, 0.0)
            best = np.maximum(best, scale * gain.max(axis=0))
    return Null(np.sort(np.sqrt(best)))
