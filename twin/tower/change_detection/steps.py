"""Steps of an outlet thermometer: a two-sided cumulative sum of the residuals of its readings.

A fill scales over weeks, so a change within minutes is never fouling: a step is a bias event, and it opens a jump of
the bias alone. Where a second thermometer in the basin makes the same step, the water itself has changed. Where the
fan's power steps in the same minutes, beyond what speed and air explain, the air flow has: the step opens a jump of the
air.

A cell that stands ages neither its fill nor its thermometer, and work on either is done while it stands. So levels
before and after a long stop are compared as if it had been a short one (`running_time`).

Source: Page, Biometrika 41 (1954) 100 (cumulative sum); Basseville & Nikiforov, Detection of Abrupt Changes, 1993,
ch. 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.tower.air import Array
from twin.tower.estimates import RATE_D

SMALLEST_K = 0.5
"""Step that is to be found."""
SLACK_K = 0.2
"""Reference value: a little below half of the step, as slow errors of the twin may stand against it."""
LIMIT_K = 0.3
"""Sum at which a step is reported: two readings of a step of 0.5 K, 2 (0.5 - 0.2), even where the level before is off
by 0.15 K. It is five standard deviations of a reading's residual, beyond a reference value of three, so that noise
hardly ever reaches it."""
NOISE = (1.5, 4.0)
"""Reference value and limit in standard deviations of the residuals, where those are larger than above."""
BASE_S, APART_S = 3 * 3600.0, 1200.0
"""The level before: the median over three hours that end twenty minutes ago, so that a step does not enter its own
level. Where they hold fewer than `FEWEST` readings it is that of the last `FEWEST` within a day."""
HELD = 2.0
"""Scans without a new reading after which an archive that reports by exception holds the last one: another one would
have been stored."""
SCAN_SHARE = 0.01
"""Share of the intervals between readings that are no longer than a scan."""
CONFIRM_S = 3 * 3600.0
DAY_S = 86400.0
LONG_STOP_S = 0.5 * DAY_S
"""Time without a steady reading that counts as `APART_S`, so that a level before it is a level of the day before."""
UNUSUAL = 4.0
"""Standard deviations of the usual differences within hours above which a fan or a basin has moved."""
CONFIRMED = 0.4
"""Share of the smallest step by which the median of three hours after must differ for the step to stand."""
FEWEST_DAYS = 4
"""Differences between days, a quarter of one apart, that tell the usual size where other days have steps as well."""
FEWEST = 8
SECOND_SHARE = 0.5
"""Share of a step within which a second thermometer must show the same one for it to be one of the water, and at most
which it may show for it to have stood still. A basin also moves by itself, as other cells come and go: then it tells
nothing."""


@dataclass(frozen=True)
class Step:
    """A step: when it began, when it was reported, its size K, whether it stayed, and its class: thermometer, water or
    fan. `alone`: no second thermometer of the water tells its class. `power`: step of the fan's power, of its
    logarithm. `stop_s`: how long no steady reading was there before `start_s`, within which it happened; else 0."""

    start_s: float
    alarm_s: float
    size: float
    lasting: bool
    kind: str = "thermometer"
    alone: bool = True
    power: float = 0.0
    stop_s: float = 0.0

    @property
    def since_s(self) -> float:
        """Return the earliest time at which it may have happened."""
        return self.start_s - self.stop_s


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
    clock_s, r = time_s[there], residual[there]
    if len(clock_s) < 2 * FEWEST:
        return []
    t = running_time(clock_s)
    other = None if second is None else second[there]
    sigma = 1.4826 * float(np.median(np.abs(np.diff(r)))) / np.sqrt(2.0)
    slack, limit = max(SLACK_K, NOISE[0] * sigma), max(LIMIT_K, NOISE[1] * sigma)
    at, value = _with_held(t, r)
    level = _level_before(t, r, at)
    found: list[Step] = []
    up = down = 0.0
    began_up = began_down = at[0]
    quiet_until = -np.inf
    for i in range(len(at)):
        if not np.isfinite(level[i]) or at[i] < quiet_until:
            up = down = 0.0
            continue
        x = value[i] - level[i]
        began_up, began_down = (at[i] if up == 0.0 else began_up), (at[i] if down == 0.0 else began_down)
        # One reading counts for no more than the limit less a little: a single wrong one is no step.
        more = min(abs(x) - slack, 0.7 * limit)
        up, down = (max(up + more, 0.0), 0.0) if x > 0.0 else (0.0, max(down + more, 0.0))
        if max(up, down) >= limit:
            start = float(began_up if up > down else began_down)
            size = float(np.median(r[(t >= start) & (t <= start + CONFIRM_S)])) - float(level[i])
            found.append(Step(start, float(at[i]), size, False))
            up = down = 0.0
            quiet_until = at[i] + CONFIRM_S
    found = _with_lasting(found, t, r)
    if other is not None:
        moves = _short_differences(t, other)
        found = [_with_second(step, t, other, _unusual(*moves, step.start_s)) for step in found]
    return [_by_clock(step, clock_s, t) for step in found]


def _with_lasting(steps: Sequence[Step], t: Array, r: Array) -> list[Step]:
    """Return the steps with whether each has stayed, by the difference of the days about it.

    With a step of size s that difference d is normal about s, without one about 0, in both cases with the usual
    standard deviation u of differences that no step enters. So the log odds of a step rise by (2 d s - s^2) / (2 u^2);
    those before are the rate of steps over that of reports in this record. A day ends at another step: the level beyond
    it is another one. Differences of such shorter spans are usual in their own size.
    """
    whole = _differences(t, r, DAY_S, DAY_S)
    before = np.log(RATE_D["bias"] * max((t[-1] - t[0]) / DAY_S, 1.0) / max(len(steps), 1))
    spans = _spans(steps, t, r, whole, before)
    smallest = CONFIRMED * SMALLEST_K
    days = [_difference(t, r, one.start_s, *span) for one, span in zip(steps, spans, strict=True)]
    stayed = [min(abs(s.size), abs(d)) >= smallest and s.size * d > 0.0 for s, d in zip(steps, days, strict=True)]
    kept = np.array([s.start_s for s, alike in zip(steps, stayed, strict=True) if alike])
    found = []
    for one, day, alike, span in zip(steps, days, stayed, spans, strict=True):
        at, differences = whole if min(span) >= DAY_S else _differences(t, r, *span)
        apart = np.abs(at - one.start_s) >= DAY_S
        rows = apart & (np.abs(at[:, None] - kept) >= DAY_S).all(axis=1)
        usual = max(_spread(differences[rows if rows.sum() >= FEWEST_DAYS else apart]), 1e-3)
        odds = before + (2.0 * day * one.size - one.size**2) / (2.0 * usual**2)
        after = (t >= one.start_s) & (t <= one.start_s + CONFIRM_S)
        lasting = alike and after.sum() >= 3 and odds > 0.0
        found.append(replace(one, lasting=bool(lasting)))
    return found


def _spans(
    steps: Sequence[Step], t: Array, r: Array, whole: tuple[Array, Array], before: float
) -> list[tuple[float, float]]:
    """Return the time before and after each step whose readings tell whether it stays, s: a day, or up to another
    report within it where the level moves on at both.

    A level that comes back is a disturbance of hours, which a day outlasts. It moves on where the levels before the
    first and after the second report differ by a step's odds, with the usual size of the differences `whole` between
    days that neither enters and the log odds `before`.
    """
    starts = np.array([-np.inf, *(one.start_s for one in steps), np.inf])
    own = np.minimum(np.diff(starts), DAY_S)
    found = np.full((len(steps), 2), DAY_S)
    for k in range(len(steps) - 1):
        first, second = starts[k + 1], starts[k + 2]
        i, j, m, n = np.searchsorted(t, (first - own[k], first, second, second + own[k + 2]))
        if own[k + 1] < DAY_S and min(j - i, m - j, n - m) >= FEWEST:
            net = float(np.median(r[m:n]) - np.median(r[i:j]))
            apart = (whole[0] <= first - DAY_S) | (whole[0] >= second + DAY_S)
            usual = max(_spread(whole[1][apart if apart.sum() >= FEWEST_DAYS else slice(None)]), 1e-3)
            if before + net**2 / (2.0 * usual**2) > 0.0:
                found[k, 1] = found[k + 1, 0] = own[k + 1]
    return [(float(one), float(other)) for one, other in found]


def _spread(values: Array) -> float:
    """Return the robust standard deviation of values about zero, 0 of none."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def _by_clock(step: Step, clock_s: Array, t: Array) -> Step:
    """Return a step in running time with its times by the clock."""
    first, alarm = (_clock_time(clock_s, t, one) for one in (step.start_s, step.alarm_s))
    k = int(np.searchsorted(clock_s, first))
    gap = first - float(clock_s[k - 1]) if 0 < k < len(clock_s) and clock_s[k] == first else 0.0
    return replace(step, start_s=first, alarm_s=alarm, stop_s=gap if gap > LONG_STOP_S else 0.0)


def running_time(time_s: Array) -> Array:
    """Return times (n,), s, in which a pause of more than `LONG_STOP_S` lasts `APART_S`."""
    gaps = np.diff(time_s)
    cut = np.where(gaps > LONG_STOP_S, gaps - APART_S, 0.0)
    found: Array = time_s - np.concatenate([[0.0], np.cumsum(cut)])
    return found


def _clock_time(clock_s: Array, running_s: Array, at: float) -> float:
    """Return the time of a moment in running time: within a long stop, that of the first reading after it."""
    k = min(int(np.searchsorted(running_s, at)), len(running_s) - 1)
    if k and clock_s[k] - clock_s[k - 1] > LONG_STOP_S:
        return float(clock_s[k])
    return float(clock_s[k] + at - running_s[k])


def _with_held(t: Array, r: Array) -> tuple[Array, Array]:
    """Return times and readings (n + held,) with one more for each reading that the archive held."""
    gaps = np.diff(t)
    wait = HELD * max(float(np.quantile(gaps, SCAN_SHARE)), 60.0)
    held = np.flatnonzero(gaps > wait)
    times, values = np.concatenate([t, t[held] + wait]), np.concatenate([r, r[held]])
    order = np.argsort(times, kind="stable")
    return times[order], values[order]


def _level_before(t: Array, r: Array, at: Array) -> Array:
    """Return the median of the readings before each time, as `BASE_S` says, NaN where there are too few."""
    last = np.searchsorted(t, at - APART_S)
    first = np.minimum(np.searchsorted(t, at - APART_S - BASE_S), np.maximum(last - FEWEST, 0))
    first = np.maximum(first, np.searchsorted(t, at - APART_S - DAY_S))
    return np.array([np.median(r[a:b]) if b - a >= FEWEST else np.nan for a, b in zip(first, last, strict=True)])


def _difference(t: Array, r: Array, at: float, before_s: float, after_s: float) -> float:
    """Return the median of the readings after a time less that of those before it; 0 where either has too few."""
    first, middle, last = np.searchsorted(t, (at - before_s, at, at + after_s))
    if min(middle - first, last - middle) < FEWEST:
        return 0.0
    return float(np.median(r[middle:last]) - np.median(r[first:middle]))


def _differences(t: Array, r: Array, before_s: float, after_s: float) -> tuple[Array, Array]:
    """Return times every quarter of a day and the differences between the spans about them, K; none of a record of
    less than four days."""
    if t[-1] - t[0] < 4.0 * DAY_S:
        return np.zeros(0), np.zeros(0)
    at = np.arange(t[0] + DAY_S, t[-1] - DAY_S, 0.25 * DAY_S)
    return at, np.array([_difference(t, r, one, before_s, after_s) for one in at])


def _with_second(step: Step, t: Array, other: Array, limit: float) -> Step:
    """Return a step with its class by a second thermometer, which moves by up to `limit` K in such hours by itself.

    It tells nothing where it has too few readings, or has moved by another size, at another time or no more than it
    does by itself.
    """
    if not step.lasting:
        return step
    there = np.isfinite(other)
    moved = _short_difference(t[there], other[there], step.start_s, np.nan)
    share = moved / step.size
    if abs(share) < SECOND_SHARE:
        return replace(step, alone=False)
    same = abs(share - 1.0) <= SECOND_SHARE and abs(moved) > limit
    same = same and abs(_split(t[there], other[there], step.start_s) - step.start_s) <= APART_S
    return replace(step, kind="water", alone=False) if same else step


def with_fan(steps: Sequence[Step], time_s: Array, power: Array) -> list[Step]:
    """Return the steps, those of the fan with their class: the power steps as well, within twenty minutes of them.

    Parameters
    ----------
    steps
        Of an outlet thermometer.
    time_s
        Of the power (n,), s, rising.
    power
        Logarithm of the fan's power less that by the twin (n,); NaN is missing.
    """
    there = np.isfinite(power)
    clock_s, r = time_s[there], power[there]
    if len(clock_s) < 2 * FEWEST:
        return list(steps)
    t = running_time(clock_s)
    usual = _short_differences(t, r)
    found = []
    for step in steps:
        start_s = float(np.interp(step.start_s, clock_s, t))
        size, limit = _short_difference(t, r, start_s), _unusual(*usual, start_s)
        fan = step.kind == "thermometer" and abs(size) > limit > 0.0
        fan = fan and abs(_split(t, r, start_s) - start_s) <= APART_S
        found.append(replace(step, kind="fan", power=size) if fan else step)
    return found


def _short_difference(t: Array, r: Array, at: float, unknown: float = 0.0) -> float:
    """Return the difference of the medians of three hours after and before a time; `unknown` where there are too
    few."""
    first, middle, last = np.searchsorted(t, (at - BASE_S, at, at + BASE_S))
    if min(middle - first, last - middle) < FEWEST:
        return unknown
    return float(np.median(r[middle:last]) - np.median(r[first:middle]))


def _short_differences(t: Array, r: Array) -> tuple[Array, Array]:
    """Return times every quarter of a day, and `_short_difference` at each."""
    at = np.arange(t[0] + BASE_S, t[-1] - BASE_S, 0.25 * DAY_S)
    there = np.isfinite(r)
    return at, np.array([_short_difference(t[there], r[there], one) for one in at])


def _unusual(at: Array, differences: Array, step_s: float) -> float:
    """Return the difference within hours beyond the usual ones, those that a step does not enter."""
    apart = np.abs(at - step_s) >= BASE_S
    return UNUSUAL * _spread(differences[apart]) if apart.any() else np.inf


def _split(t: Array, r: Array, at: float) -> float:
    """Return the time within an hour of another one that splits the values of three hours before and after best into
    two levels, by least absolute error."""
    first, last = np.searchsorted(t, (at - BASE_S, at + BASE_S))
    near = np.flatnonzero(np.abs(t - at) <= 3600.0)
    splits = np.unique(near[(near - first >= FEWEST) & (last - near >= FEWEST)])[::2]
    loss = [sum(float(np.abs(p - np.median(p)).sum()) for p in (r[first:k], r[k:last])) for k in splits]
    return float(t[splits[int(np.argmin(loss))]]) if loss else np.inf
