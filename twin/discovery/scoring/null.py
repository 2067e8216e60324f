"""Threshold of the score that keeps false alarms rare: the highest score in records without an effect.

Every law, shape and onset is one try, and they are many and correlated; a score that would be rare for one of them is
common for the best. So records of noise alone, of the very kind that the record is weighed by, go through the same
scan, and the highest score of each is kept (max-T: Westfall & Young, Resampling-Based Multiple Testing, 1993). Noise is
drawn in whitened coordinates, where the tunables have been projected out, so no simulation is needed.
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
EVERY = 2
"""Of the onsets looked at: the next one would hardly find more in noise."""
FALSE_ALARMS = 0.01
"""Share of healthy records that may be called anything else, over the whole catalogue."""
_TINY = 1e-12


@dataclass(frozen=True)
class Null:
    """Best scores (d,) of records of noise, sorted."""

    best: Array

    def quantile(self, rate: float) -> float:
        """Score that the best of a record of noise exceeds with probability `rate`; by the fitted tail where rare."""
        location, scale = self._tail()
        return location - scale * math.log(-math.log1p(-rate))

    def family_wise(self, z: float) -> float:
        """Probability that noise alone reaches a best score of z, over the whole catalogue."""
        location, scale = self._tail()
        return -math.expm1(-math.exp(-(z - location) / scale))

    def _tail(self) -> tuple[float, float]:
        """Location and scale of the Gumbel law of the same mean and spread: maxima of many tries follow it."""
        scale = float(np.std(self.best, ddof=1)) * math.sqrt(6.0) / math.pi
        return float(np.mean(self.best)) - 0.5772 * scale, max(scale, 1e-6)


def null_scores(score_test: ScoreTest, laws: list[CandidateLaw], draws: int = DRAWS, seed: int = 0) -> Null:
    """Best scores of records of noise in this score test, every candidate in all its shapes from every onset."""
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
