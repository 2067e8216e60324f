"""Ten-minute windows from a stream of samples, and the kind of each window.

Windows lie on a grid from the first sample on. A window is complete with the sample after which the next one,
at the same pace, would belong to the following window. After a gap it is complete with the first sample beyond its end.
So a window of 600 samples at 1 Hz is complete with its 600th. Its size never depends on how the stream is cut
into blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.calibrators.base import Window, WindowKind, total_rmse
from twin.network import Array, WindowRules

LEAST_ROWS = 8
"""Rows with at least one finite measurement below which a window is skipped."""
LEAST_SPAN = 0.5
"""Share of the window's length that those rows must span."""


def last_row_of_window(times: Array, pace: Array, end: float) -> int | None:
    """Return the position in `times` (n,) of the sample that completes a window ending at `end` s, or None.

    `pace` (n,) s is the sampling interval expected after each sample.
    """
    tolerance = 1e-3 * pace
    beyond = int(np.searchsorted(times, end))
    complete = np.flatnonzero(times[:beyond] + pace[:beyond] >= end - tolerance[:beyond])
    return int(complete[0]) if complete.size else None


def window_index(time: float, origin: float, rules: WindowRules) -> int:
    """Return the number of the grid cell that contains a stamp."""
    return max(math.floor((time - origin) / rules.window_s + 1e-9), 0)


@dataclass(frozen=True)
class WindowSamples:
    """Samples of a window.

    Attributes
    ----------
    time, inputs, measured
        (n,) s; (n, c) without NaN; (n, m) degC, NaN where masked.
    read
        (n, c) bool, True where an input was read; None where all of them were.
    """

    time: Array
    inputs: Array
    measured: Array
    read: np.ndarray | None = None


def make_window(
    number: int,
    samples: WindowSamples,
    state: Array,
    parameters: Array,
    live: Array,
    rules: WindowRules,
    kelvin_per_unit: Array | float = 1.0,
) -> Window:
    """Return a completed window with its errors and kind.

    Parameters
    ----------
    number
        Index of the window in its run.
    samples
        Samples of the window, at least one.
    state, parameters
        State of the live twin at the first sample, and its full parameter vector (p,).
    live
        (n, m) degC, readings that the live twin predicted.
    rules
        Limits that decide the kind.
    kelvin_per_unit
        (m,) weights of the readings in the errors, see `Network.kelvin_per_unit`.
    """
    time, inputs, measured = samples.time, samples.inputs, samples.measured
    read = np.ones(inputs.shape, dtype=bool) if samples.read is None else samples.read
    residual = (live - measured) * kelvin_per_unit
    first = max(int(np.searchsorted(time, time[0] + rules.first_s)), 1)
    mismatch = initial_mismatch(residual[:first])
    error = total_rmse(residual)
    rows = np.flatnonzero(np.isfinite(measured).any(axis=1))
    enough = rows.size >= LEAST_ROWS and time[rows[-1]] - time[rows[0]] >= LEAST_SPAN * rules.window_s
    kind = classify_window(mismatch, error, rules) if enough else "skipped"
    return Window(number, time, inputs, measured, read, state, parameters, live, first, mismatch, error, kind)


def initial_mismatch(residual: Array) -> float:
    """Return the root mean square over sensors of their mean mismatch at the beginning of a window, K.

    The mean over the beginning is used, not its first sample: with a single reading of 0.05 K noise, half of all
    healthy windows would count as mismatched.
    """
    good = np.isfinite(residual)
    count = good.sum(axis=0)
    mean = np.where(good, residual, 0.0).sum(axis=0) / np.maximum(count, 1)
    seen = mean[count > 0]
    return float(np.sqrt(np.mean(seen**2))) if seen.size else 0.0


def classify_window(initial_mismatch_K: float, error_K: float, rules: WindowRules) -> WindowKind:
    """Return the kind of a window: section 2.4 of Energies 2026, 19, 2452, with numbers.

    A large mismatch at the start makes a recovery window. A start and a full window that are both above the
    calibrated threshold make a stall window. Everything else is a calibrated window.
    """
    if initial_mismatch_K > rules.large_K:
        return "recovery"
    if initial_mismatch_K > rules.calibrated_K and error_K > rules.calibrated_K:
        return "stall"
    return "calibrated"
