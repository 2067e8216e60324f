"""Map from the readings before a leap to those after it, fitted to the prediction of a tag by the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.historian.defects.panel import RobustPredictor, known_median
from twin.historian.tags import Array, Mask

LEAST_ROWS = 16
"""Rows of a quarter of an hour on either side by which a leap is judged: four hours of operation."""
CLEAR = 0.35
"""Largest median distance of the mapped readings from their prediction, as a share of the leap."""
EXPLAINS = 0.3
"""Share of the leap by which the shorter side is worse predicted without it."""
DECISIVE = 4.0
"""Times by which the mapped readings of one side are nearer to their prediction than the readings as they stand, so
that the other tags need not rest: a step of the plant is in those tags, and its mapped readings are not nearer."""
BACK = 0.35
"""Share of a leap, at the usual reading, by which the return from it may differ."""
ROUNDS = 4


@dataclass(frozen=True)
class Leap:
    """A leap of a tag: times of the readings before and after it, and the map from the old reading to the new one."""

    before_s: float
    after_s: float
    factor: float
    constant: float
    doubt: float
    """Distance of the mapped readings from their prediction, as a share of the leap."""
    hidden: bool
    """No sample shows it."""


@dataclass(frozen=True)
class ScaleFit:
    """Map of the readings after a leap, their leap (m,) and the distance of the mapped readings from the prediction."""

    factor: float
    constant: float
    leap: Array
    residual: Array

    @property
    def error(self) -> float:
        """Median distance from the prediction; infinite where there is none."""
        if not np.isfinite(self.residual).any():
            return float(np.inf)
        return known_median(np.abs(self.residual))

    def doubt(self, after: Mask) -> float:
        """Return the distance of the mapped readings from the prediction as a share of the leap."""
        return self.error / known_median(np.abs(self.leap[after]))

    def is_borne_out(self, plain: Array, after: Mask, *, alone: bool) -> bool:
        """Return whether the other tags go with the mapped readings on both sides, and cannot explain them unmapped.

        They do not where the mapped readings are decisively nearer to their prediction on both sides, or where the leap
        is a large share of what they leave.

        Parameters
        ----------
        plain
            Distance of the readings as they stand from a prediction without the leap (m,).
        after
            Rows after the leap (m,).
        alone
            No other tag moved then. Else the mapped readings must be `DECISIVE` times as near to their prediction.
        """
        known = np.isfinite(self.residual) & np.isfinite(plain)
        parts = [known & after, known & ~after]
        size = float(np.median(np.abs(self.leap[parts[0]]))) if parts[0].any() else 0.0
        if size <= 0.0:
            return False
        if any(float(np.median(np.abs(self.residual[part]))) > CLEAR * size for part in parts):
            return False
        nearer = [np.abs(plain[part]).mean() / max(np.abs(self.residual[part]).mean(), 1e-9) for part in parts]
        if min(nearer) >= DECISIVE:
            return True  # however much of the leap some twenty tags explain by chance
        if not alone and max(nearer) < DECISIVE:
            return False
        gained = float(np.abs(plain[known]).sum() - np.abs(self.residual[known]).sum())
        return gained > EXPLAINS * size * float(min(part.sum() for part in parts))


def fitted_map(
    x: Array, after: Mask, predict: RobustPredictor, *, ratio: bool, first: float | None = None
) -> ScaleFit | None:
    """Return the map by a factor (or else a constant) with which the readings after a leap go with the prediction.

    `first` is the factor to begin with; None for that of the hours about the leap.
    """
    sides = [np.flatnonzero(np.isfinite(x) & part) for part in (~after, after)]
    near = [float(np.median(x[part])) for part in (sides[0][-LEAST_ROWS // 4 :], sides[1][: LEAST_ROWS // 4])]
    if ratio and not (near[0] > 0.0 and near[1] > 0.0):
        return None
    factor, constant = (first or near[1] / near[0], 0.0) if ratio else (1.0, near[1] - near[0])
    for _ in range(ROUNDS):
        mapped = np.where(after, (x - constant) / factor, x)
        predicted, _ = predict(mapped)
        there = predicted[sides[1]]
        if ratio:
            factor = float(np.median(x[sides[1]] / np.where(there > 0.0, there, np.nan)))
            if not factor > 0.0:
                return None
        else:
            constant = float(np.median(x[sides[1]] - there))
    return fit_with_map(x, after, predict, factor, constant)


def fit_with_map(x: Array, after: Mask, predict: RobustPredictor, factor: float, constant: float) -> ScaleFit:
    """Return how the readings go with the prediction if those after a leap are mapped back by this map."""
    mapped = np.where(after, (x - constant) / factor, x)
    predicted, _ = predict(mapped)
    return ScaleFit(factor, constant, np.where(after, x - mapped, 0.0), mapped - predicted)
