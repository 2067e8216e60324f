"""Steps of an outlet thermometer: a two-sided cumulative sum of the residuals of its readings.

A fill scales over weeks, so a change within minutes is never fouling: a step is a bias event, and it opens a jump of
the bias alone. Where a second thermometer in the basin makes the same step, the water itself has changed.

Source: Page, Biometrika 41 (1954) 100 (cumulative sum); Basseville & Nikiforov, Detection of Abrupt Changes, 1993,
ch. 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.tower.air import Array

SMALLEST_K = 0.5
"""Step that is to be found."""
SLACK_K = 0.2
"""Reference value: a little below half of the step, as slow errors of the twin may stand against it."""
LIMIT_K = 0.35
"""Sum at which a step is reported: two or three readings of a step of 0.5 K, 10 to 15 min at a scan of 5 min. It is
five standard deviations of a reading's residual, beyond a reference value of three, so that noise hardly ever reaches
it."""
NOISE = (1.5, 4.0)
"""Reference value and limit in standard deviations of the residuals, where those are larger than above."""
BASE_S, APART_S = 3 * 3600.0, 1200.0
"""The level before: the median over three hours that end twenty minutes ago, so that a step does not enter its own
level."""
CONFIRM_S = 3 * 3600.0
DAY_S = 86400.0
UNUSUAL = 4.0
"""Standard deviations of the usual differences between one day's median and the next, above which a step stands: the
twin's own error moves from day to day with the weather, a thermometer's step stays."""
CONFIRMED = 0.4
"""Share of the smallest step by which the median of three hours after must differ for the step to stand."""
FEWEST = 8
SECOND_SHARE = 0.5
"""Share of a step that a second thermometer must show for it to be one of the water."""


@dataclass(frozen=True)
class Step:
    """A step: when it began, when it was reported, its size K, whether it stayed, and its class."""

    start_s: float
    alarm_s: float
    size: float
    lasting: bool
    kind: str = "thermometer"


def find_steps(time_s: Array, residual: Array, second: Array | None = None) -> list[Step]:
    """Return the steps of a thermometer's residuals.

    Parameters
    ----------
    time_s
        Of the readings (n,), s, rising.
    residual
        Of the readings, K; NaN is left out.
    second
        Residual of a second thermometer of the same water at the same times, K, or None.
    """
    there = np.isfinite(residual)
    t, r = time_s[there], residual[there]
    if len(t) < 2 * FEWEST:
        return []
    other = None if second is None else second[there]
    sigma = 1.4826 * float(np.median(np.abs(np.diff(r)))) / np.sqrt(2.0)
    slack, limit = max(SLACK_K, NOISE[0] * sigma), max(LIMIT_K, NOISE[1] * sigma)
    level = _level_before(t, r)
    least = max(CONFIRMED * SMALLEST_K, UNUSUAL * _usual(t, r))
    found: list[Step] = []
    up = down = 0.0
    began_up = began_down = t[0]
    quiet_until = -np.inf
    for i in range(len(t)):
        if not np.isfinite(level[i]) or t[i] < quiet_until:
            up = down = 0.0
            continue
        x = r[i] - level[i]
        began_up, began_down = (t[i] if up == 0.0 else began_up), (t[i] if down == 0.0 else began_down)
        # One reading counts for no more than the limit less a little: a single wrong one is no step.
        step = min(abs(x) - slack, 0.7 * limit)
        up, down = (max(up + step, 0.0), 0.0) if x > 0.0 else (0.0, max(down + step, 0.0))
        if max(up, down) >= limit:
            found.append(
                _step(t, r, other, float(began_up if up > down else began_down), float(t[i]), float(level[i]), least)
            )
            up = down = 0.0
            quiet_until = t[i] + CONFIRM_S
    return found


def _level_before(t: Array, r: Array) -> Array:
    """Return the median of the readings of three hours that end twenty minutes before each, NaN where there are too
    few."""
    first = np.searchsorted(t, t - APART_S - BASE_S)
    last = np.searchsorted(t, t - APART_S)
    return np.array([np.median(r[a:b]) if b - a >= FEWEST else np.nan for a, b in zip(first, last, strict=True)])


def _day_difference(t: Array, r: Array, at: float) -> float:
    """Return the median of a day's readings from a time on less that of the day before; 0 where either has too few."""
    first, middle, last = np.searchsorted(t, (at - DAY_S, at, at + DAY_S))
    if min(middle - first, last - middle) < FEWEST:
        return 0.0
    return float(np.median(r[middle:last]) - np.median(r[first:middle]))


def _usual(t: Array, r: Array) -> float:
    """Return the robust standard deviation of differences between days, K; 0 for a record of less than four days."""
    if t[-1] - t[0] < 4.0 * DAY_S:
        return 0.0
    found = np.array([_day_difference(t, r, at) for at in np.arange(t[0] + DAY_S, t[-1] - DAY_S, 0.25 * DAY_S)])
    return 1.4826 * float(np.median(np.abs(found)))


def _step(t: Array, r: Array, other: Array | None, start: float, alarm: float, level: float, least: float) -> Step:
    after = (t >= start) & (t <= start + CONFIRM_S)
    size = float(np.median(r[after])) - level
    days = _day_difference(t, r, start)
    lasting = bool(after.sum() >= 3 and min(abs(size), abs(days)) >= least and size * days > 0.0)
    kind = "thermometer"
    if other is not None:
        before = (t >= start - BASE_S) & (t < start)
        seen = other[after & np.isfinite(other)], other[before & np.isfinite(other)]
        if min(len(seen[0]), len(seen[1])) >= FEWEST:
            moved = float(np.median(seen[0]) - np.median(seen[1]))
            kind = "water" if moved * np.sign(size) > SECOND_SHARE * abs(size) else "thermometer"
    return Step(start, alarm, size, lasting, kind)
