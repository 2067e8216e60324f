"""Evidence about a cell's deviations beside its thermometers: inspections, traverses, certificates.

An inspection gives an interval: inside it there is no loss, outside it the loss is linear. Such a loss is the negative
logarithm of a density that is flat inside and has exponential tails; its product with a Gaussian is replaced by the
Gaussian of the same mean and variance (moment matching, Minka 2001), so that it joins a least-squares fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TAIL = 0.25
"""Scale of an interval's exponential tails as a share of its width: an inspector's bounds are seldom exceeded by half
of it."""
LEAST_PRECISION = 1e-6
"""Precision, relative to that of what is known, of a moment-matched interval that adds nothing to it."""


@dataclass(frozen=True)
class Label:
    """A deviation seen otherwise, between `low` and `high`; with an `sd` a point, both bounds its value. As
    deviations."""

    time_s: float
    cell: int
    parameter: str
    low: float
    high: float
    sd: float | None = None
    source: str = ""


def interval_as_gaussian(low: float, high: float, mean: float, sd: float) -> tuple[float, float]:
    """Return value and standard deviation of the Gaussian observation that moment-matches an interval.

    Parameters
    ----------
    low, high
        The interval.
    mean, sd
        Of what is known without it.
    """
    tail = TAIL * (high - low)
    x = np.linspace(min(low - 8.0 * tail, mean - 6.0 * sd), max(high + 8.0 * tail, mean + 6.0 * sd), 2001)
    logs = -0.5 * ((x - mean) / sd) ** 2 - np.maximum(np.maximum(low - x, x - high), 0.0) / tail
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    m = float(weight @ x)
    v = float(weight @ (x - m) ** 2)
    precision = max(1.0 / v - 1.0 / sd**2, LEAST_PRECISION / sd**2)
    value = (m / v - mean / sd**2) / precision if precision > LEAST_PRECISION / sd**2 else m
    return value, precision**-0.5
