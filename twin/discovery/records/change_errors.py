"""Errors of a twin after fast changes of its readings.

A pump that changes its speed sends a slug of warm water around its loop. A twin of a few volumes has another course of
that, for as long as the water needs to go around, by a share of the change. The noise of a healthy residual is the mean
over a whole record, so that the minutes after such a change would count as an effect that begins with it and fades. A
share of the local change of the twin's own readings is therefore noise beside it, as a form error is of an effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from twin.discovery.records.grid import Grid
from twin.network import Array

SHARES = (0.0, 0.01, 0.03, 0.1)
"""Shares of a change by which a twin's readings may be off after it, equally likely; those of `FORM_ERRORS`."""
LASTING_S = (60.0, 300.0)
"""Times, s, for which they may be off, equally likely. A judgement: water goes around a rig in minutes."""
SLOW_S = 900.0
"""Time, s, over which the residual's moving mean says nothing about fast changes: three times the longest of them."""
SAMPLE_S = 60.0
"""Interval between the means of a residual that are compared with the changes, s."""
FACTORS = 2.0 ** -np.arange(0.0, 10.0, 0.5)
"""Ratios of the variance elsewhere to that of the whole record that are tried: down to a 700th, in steps of 1.4."""


@dataclass(frozen=True)
class ChangeErrors:
    """Errors of a twin after fast changes, as a healthy record shows them.

    Attributes:
        weights: (d, s) posterior probabilities of each duration and share. largest: (d, m) K, largest change of each
            sensor's readings within each duration.
    """

    weights: Array
    largest: Array

    @classmethod
    def of(cls, grid: Grid, readings: Array) -> ChangeErrors:
        """Return the errors in a healthy record; `readings` (n, m), degC, are the twin's."""
        changes = _all_changes(grid, readings)
        weights = _weights(grid, readings, changes, np.zeros_like(readings))
        return cls(weights, changes.max(axis=1))

    def errors(self, grid: Grid, readings: Array) -> Array | None:
        """Return the standard deviation (n, m), K, of the errors in a record; None if there are none.

        A change as large as in health has an error as in health. What it is larger by has a share and a duration of its
        own, given the residual of the record itself.

        Parameters
        ----------
        readings
            (n, m) degC, those of the twin.
        """
        changes = _all_changes(grid, readings)
        met = np.minimum(changes, self.largest[:, None, :])
        known = _variance(self.weights, met)
        beyond = changes - met
        if beyond.any():
            known = known + _variance(_weights(grid, readings, beyond, known), beyond)
        sd: Array = np.sqrt(known)
        return sd if sd.any() else None


def _all_changes(grid: Grid, readings: Array) -> Array:
    """Return the largest fast changes (d, n, m), K, of readings (n, m) within each of the durations `LASTING_S`."""
    return np.array([_changes(readings, max(lasting / grid.step_s, 2.0)) for lasting in LASTING_S])


def _variance(weights: Array, changes: Array) -> Array:
    """Return the variance (n, m), K^2, of errors after changes (d, n, m), averaged over durations and shares."""
    of_each = weights @ np.array(SHARES) ** 2
    found: Array = np.tensordot(of_each, changes**2, axes=1)
    return found


def _weights(grid: Grid, readings: Array, changes: Array, known: Array) -> Array:
    """Return the posterior probabilities (d, s) of durations and shares, given the residual of a record.

    In each interval the residual has the variance s^2 + known + (share * change)^2, with the likeliest s^2 of each
    sensor.
    """
    residual = np.where(np.isfinite(grid.measured), grid.measured - readings, np.nan)
    apart = max(round(SAMPLE_S / grid.step_s), 1)
    squares = _means(_fast(residual, SLOW_S / grid.step_s), apart) ** 2
    before = _means(known, apart)
    found = np.array([[_log_likelihood(squares, before, s**2 * _means(c**2, apart)) for s in SHARES] for c in changes])
    weights: Array = np.exp(found - found.max())
    return weights / weights.sum()


def _fast(values: Array, width: float) -> Array:
    """Return values (n, m) less their moving means over `width` rows; NaN where a value is missing."""
    there = np.isfinite(values)
    size = min(max(round(width), 2), len(values))
    share = uniform_filter1d(there.astype(np.float64), size, axis=0, mode="nearest")
    mean = uniform_filter1d(np.where(there, values, 0.0), size, axis=0, mode="nearest") / np.maximum(share, 1e-9)
    found: Array = values - mean
    return found


def _changes(readings: Array, width: float) -> Array:
    """Return the largest fast change (n, m), K, of readings (n, m) within the `width` rows before each row.

    A jump of the readings deviates from their moving mean by half of it on either side. A steady rise does not deviate.
    """
    size = min(round(width), len(readings))
    fast = 2.0 * np.abs(_fast(readings, width))
    found: Array = maximum_filter1d(fast, size, axis=0, mode="nearest", origin=(size - 1) // 2)
    return found


def _means(values: Array, count: int) -> Array:
    """Return means (n // count, m) of values over `count` rows, NaN where one is missing."""
    rows = len(values) // count * count
    found: Array = values[:rows].reshape(-1, count, values.shape[1]).mean(axis=1)
    return found


def _log_likelihood(squares: Array, *known: Array) -> float:
    """Return the log likelihood of known variances, with the likeliest variance elsewhere of each sensor.

    Args:
        squares: (i, m) K^2, of the residual. known: (i, m) K^2 each.
    """
    total = 0.0
    for found, more in zip(squares.T, np.sum(known, axis=0).T, strict=True):
        there = np.isfinite(found)
        if not there.any() or not found[there].any():
            continue
        variance = found[there].mean() * FACTORS[:, None] + more[there]
        total += float((-0.5 * (np.log(variance) + found[there] / variance)).sum(axis=1).max())
    return total
