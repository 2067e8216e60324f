"""90 % interval of the outlet's true temperature, from the hidden residuals of its thermometer.

A hidden residual is the prediction's error plus the noise of one reading, so its quantile is too wide for the water.
The noise shows in the differences of residuals close to each other. These hold the noise of the inputs as well, which
the prediction carries into the water's error. The twin's slopes divide the two:

    mean square difference / 2 = s^2 (1 + a^2 + b^2)

s is the noise of a thermometer, a and b are the outlet's slopes by inlet and wet bulb, which thermometers of the same
kind measure. The noise of the inputs is a lower bound of the water's error. The quantile of a class of minutes is
that of split conformal prediction with windows as its exchangeable units, since residuals within a window are
correlated.

Sources: Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, 2005, sec. 4.5 (quantiles by category,
Mondrian); Lei et al., J. Am. Stat. Assoc. 113 (2018) 1094 (split conformal prediction).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.estimates import Estimate
from twin.tower.minutes import Minutes
from twin.tower.model import DEVIATIONS, NAMES, SLOW

WINDOW_S = 7200.0
"""Target interval of the paper: 120 minutes, whose outlet readings are hidden from the prediction in them."""
QUANTILE = 0.9
NORMAL = 1.6449
"""Half width of a 90 % interval in standard deviations."""
FEWEST_WINDOWS = 9
"""Windows below which a class takes the quantile of a coarser one: the level 0.9 (n + 1)/n of a smaller number n
exceeds 1."""
START_MIN = (5, 20)
"""Minutes after a start up to which classes of their own reach."""
WET_C = (5.0, 12.0, 18.0, 23.0)
"""Wet bulbs between which classes lie: the twin's error grows with the distance from its test points."""
NEAR_S = 900.0
"""Longest time between two readings whose difference counts as noise: a steady minute has this long of rest before it.
All pairs count. An archive that reports by exception stores a reading because it differs from the one before it, so
the noise of neighbours alone is too large."""
FEWEST_PAIRS = 40
"""Pairs of readings below which no noise is taken off."""
STEP = 3.0
"""Differences beyond this many of their root mean square are steps and no noise, and are left out."""
BY_THERMOMETER = ("inlet_bias", "wet_bulb_bias")
"""Constants of the twin that shift an input as the noise of its thermometer does."""


@dataclass(frozen=True)
class ReadingNoise:
    """Noise in a hidden residual: variance of the outlet's reading, and of the prediction by its inputs, K^2."""

    reading: float
    inputs: float


def half_width(minutes: Minutes, of_minute: NDArray[np.intp], t_out: Array, bias: Array, p: Estimate) -> Array:
    """Return the half width of the outlet's 90 % interval, K (n,).

    Parameters
    ----------
    minutes
        The cell's record.
    of_minute
        Steady block of each minute (n,), -1 for none.
    t_out
        Prediction with the own window's readings hidden, degC (n,).
    bias
        Of the thermometer, K (n,).
    p
        Posterior of the blocks.
    """
    residual = minutes.outlet - bias - t_out
    half = _hidden_quantiles(np.abs(residual), minutes)
    noise = _noise(residual, minutes, of_minute, p)
    water = np.maximum(half**2 - NORMAL**2 * noise.reading, NORMAL**2 * noise.inputs)
    # No residual shows the error of the bias, since prediction and bias err oppositely.
    bias_sd = p.sd()[p.cells_at(minutes.time_s)][:, DEVIATIONS.index("bias")]
    return np.sqrt(water + (NORMAL * bias_sd) ** 2)


def _hidden_quantiles(size: Array, minutes: Minutes) -> Array:
    """Return the 90 % quantile of the absolute residuals `size` in the class of each minute, K (n,)."""
    there = np.isfinite(size)
    window = np.floor(minutes.time_s / WINDOW_S).astype(np.int64)
    half = np.full(len(size), np.nan)
    for kind, fewest in zip(_classes(minutes), (FEWEST_WINDOWS, FEWEST_WINDOWS, 1), strict=True):
        for one in np.unique(kind[np.isnan(half)]):
            seen = there & (kind == one)
            count = len(np.unique(window[seen]))
            if count >= fewest:
                level = min(QUANTILE * (count + 1.0) / count, 1.0)
                half[np.isnan(half) & (kind == one)] = np.quantile(size[seen], level)
    return np.where(np.isnan(half), np.max(size[there], initial=0.0), half)


def _classes(minutes: Minutes) -> tuple[NDArray[np.intp], ...]:
    """Return the class of each minute from fine to coarse: just after a start, else its regime, steady or not, by the
    weather; then without the weather; then start, steady or neither."""
    index = np.arange(len(minutes.known))
    since = index - np.maximum.accumulate(np.where(minutes.known, -1, index))
    since = np.where(np.maximum.accumulate(~minutes.known), since, START_MIN[-1] + 1)
    start = np.digitize(since, START_MIN, right=True)
    weather = np.digitize(np.nan_to_num(minutes.operation.inputs.wet), WET_C)
    steady, starts, weathers = minutes.steady.astype(int), len(START_MIN), len(WET_C) + 1
    regime = 2 * minutes.regime.astype(int) + steady
    return (
        np.where(start < starts, start, starts + regime * weathers + weather),
        np.where(start < starts, 0, 1 + regime),
        np.where(start < starts, 0, 1 + steady),
    )


def _noise(residual: Array, minutes: Minutes, of_minute: NDArray[np.intp], p: Estimate) -> ReadingNoise:
    """Return the noise in the residuals by the differences of those in steady minutes close to each other."""
    rows = np.flatnonzero(np.isfinite(residual) & (of_minute >= 0))
    value, time = residual[rows], minutes.time_s[rows]
    found: list[Array] = []
    for lag in range(1, len(rows)):
        near = time[lag:] - time[:-lag] <= NEAR_S
        if not near.any():
            break
        found.append((value[lag:] - value[:-lag])[near])
    steps = np.concatenate(found) if found else np.zeros(0)
    if len(steps) < FEWEST_PAIRS:
        return ReadingNoise(0.0, 0.0)
    total = 0.5 * _usual_square(steps)
    inlet, wet = (p.jacobian[of_minute[rows], len(SLOW) + NAMES.index(name)] for name in BY_THERMOMETER)
    reading = total / (1.0 + float(np.mean(inlet**2 + wet**2)))
    return ReadingNoise(reading, total - reading)


def _usual_square(steps: Array) -> float:
    """Return the mean square of the steps without those beyond `STEP` of its root, until none is left beyond."""
    square = np.sort(steps**2)
    count = len(square)
    while True:
        mean = float(square[:count].mean())
        kept = int(np.searchsorted(square[:count], STEP**2 * mean, side="right"))
        if kept == count:
            return mean
        count = kept
