"""Conformal intervals: predicted scales times factors from windows outside of training.

Split conformal prediction with normalised scores (Papadopoulos et al., ECML 2002), with a factor for each bin
(Mondrian). Errors inside a window are correlated, so a window gives one score for an output: that of one random step.
Parameters are binned by their change probability. Few change, so that one factor for all would cover 90 % of the
constant ones and half of the changed ones. crepes computes the factors if it is installed, else `quantile`, with the
same numbers.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.calibrators.hiera_unet.model.config import HieraError
from twin.network import Array

LEAST = 40
"""Scores below which a bin has no factor of its own."""
CONFIDENCE = 0.90
CHANCES = (0.05, 0.3, 0.7)
"""Change probabilities that separate the bins of parameters."""


@dataclass(frozen=True)
class Factors:
    """Conformal factors: half width = factor * scale.

    Attributes:
        confidence: nominal coverage. overall: (Q,) factors, one a quantity. binned: bin -> (Q,), for bins with enough
            scores. counts: bin -> scores. method: name of the algorithm.
    """

    confidence: float
    overall: tuple[float, ...]
    binned: dict[int, tuple[float, ...]]
    counts: dict[int, int]
    method: str

    def of(self, bins: np.ndarray) -> Array:
        """Return factors (N, Q) of windows in `bins` (N,)."""
        return np.array([self.binned.get(int(b), self.overall) for b in bins]).reshape(len(bins), -1)

    def document(self) -> dict[str, Any]:
        return {
            "confidence": self.confidence,
            "overall": list(self.overall),
            "method": self.method,
            "binned": {str(b): list(v) for b, v in self.binned.items()},
            "counts": {str(b): n for b, n in self.counts.items()},
        }

    @classmethod
    def read(cls, document: dict[str, Any]) -> Factors:
        return cls(
            document["confidence"],
            tuple(map(float, document["overall"])),
            {int(b): tuple(map(float, v)) for b, v in document["binned"].items()},
            {int(b): n for b, n in document["counts"].items()},
            document["method"],
        )


def fit(scores: Array, bins: np.ndarray, confidence: float = CONFIDENCE) -> Factors:
    """Return factors from scores (N, Q) = |error| / scale, NaN where the truth is unknown, of windows in `bins` (N,).

    Raises:
        HieraError: too few scores for the confidence.
    """
    quantile, method = _method()
    counts = {int(b): int(n) for b, n in zip(*np.unique(bins, return_counts=True), strict=True)}
    overall = tuple(quantile(column, confidence) for column in scores.T)
    if not np.isfinite(overall).all():
        raise HieraError(
            f"{len(scores)} windows are too few to calibrate {confidence:.0%} intervals; generate more for calibration"
        )
    binned: dict[int, tuple[float, ...]] = {}
    for b in counts:
        own = scores[bins == b]
        enough = np.isfinite(own).sum(axis=0) >= LEAST
        if enough.any():
            found = [quantile(own[:, q], confidence) if enough[q] else overall[q] for q in range(own.shape[1])]
            binned[b] = tuple(found)
    return Factors(confidence, overall, binned, counts, method)


def by_chance(chance: Array) -> np.ndarray:
    """Return the bins of parameters with these change probabilities, of the same shape."""
    return np.digitize(chance, CHANCES)


def fit_parameters(error: Array, sd: Array, chance: Array) -> Factors | None:
    """Return one factor a bin, from errors (N, P), NaN without a label, their standard deviations and change
    probabilities.

    None if too few are known.
    """
    scores = (np.abs(error) / sd).reshape(-1, 1)
    if not np.isfinite(quantile(scores[:, 0], CONFIDENCE)):
        return None
    return fit(scores, by_chance(chance).reshape(-1))


def one_a_window(error: Array, scale: Array, rng: np.random.Generator) -> Array:
    """Return scores (N, Y): |error| / scale (N, n, Y) at one random known step of each window and output."""
    score = np.abs(error) / scale
    chance = np.where(np.isfinite(score), rng.random(score.shape), -1.0)
    step = chance.argmax(axis=1)
    return np.asarray(np.take_along_axis(score, step[:, None], axis=1)[:, 0])


def quantile(scores: Array, confidence: float) -> float:
    """Return the ceil((n + 1) confidence)-th smallest of the finite scores; infinite if there are too few."""
    known = np.sort(scores[np.isfinite(scores)])
    rank = int(np.ceil((known.size + 1) * confidence - 1e-9))
    return float(known[rank - 1]) if 0 < rank <= known.size else float("inf")


def by_crepes(scores: Array, confidence: float) -> float:
    """Return the same by crepes: half the width of the interval around 0 at scale 1."""
    from crepes import ConformalRegressor

    known = scores[np.isfinite(scores)]
    if not 0 < int(np.ceil((known.size + 1) * confidence - 1e-9)) <= known.size:
        return float("inf")
    regressor = ConformalRegressor().fit(residuals=known)
    return float(np.ravel(regressor.predict_int(y_hat=np.zeros(1), confidence=confidence))[1])


def _method() -> tuple[Any, str]:
    if importlib.util.find_spec("crepes") and importlib.util.find_spec("sklearn"):
        return by_crepes, "crepes"
    return quantile, "split conformal"
