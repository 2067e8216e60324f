"""Judgement of limits on the data of a run: pass, fail, or inconclusive where values are missing.

A limit passes only with all values of its time. With missing values it fails where the known ones prove that, and is
inconclusive otherwise. A gap that a limit admits is left out, except where the limit measures a time: then it passes or
fails only if it does so with the missing values on either side.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.testing.bound_limits import BoundLimit
from hil.testing.judgement.levels import line_of
from hil.testing.judgement.settling import judge_settling
from hil.testing.judgement.verdicts import Finding, Verdict, shown, worst
from hil.testing.limits import TIMES_S, Bound, Compared, Follows, NoEffect, NoTrip, Settles, Trips, TwinError
from hil.testing.plan import Limit
from hil.testing.run_data import Floats, RunData, Trip, carried_on, longest_piece, root_mean_square, ticks_within

Bools = NDArray[np.bool_]
_MOST_SPANS = 50
"""Most times of failure that a result names: a plot shows no more."""
_SAME_S = 1e-6
"""Time by which two times may differ and still be the same, s."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """Verdict on one limit.

    `value` is the measured quantity in `unit`, None where none was found, `at_s` the profile time of the worst value,
    s, `text` a sentence with both. `line` has columns, levels and times of the limit in plots (see `line_of`), None
    without a level; `failed_s` are begins and ends of the times at which it was broken, s of profile time.
    """

    limit: Limit
    verdict: Verdict
    text: str
    value: float | None = None
    unit: str = ""
    at_s: float | None = None
    column: str = ""
    line: dict[str, Any] | None = None
    failed_s: tuple[tuple[float, float], ...] = ()


def judge(bound: BoundLimit, data: RunData) -> Judgement:
    """Return the judgement of a limit on a run; that of a limit of several columns is the worst of theirs."""
    with np.errstate(over="ignore", invalid="ignore"):  # `_said` takes care of values without a number
        return replace(_judged(bound, data), line=line_of(bound))


def _judged(bound: BoundLimit, data: RunData) -> Judgement:
    statement = bound.statement
    if isinstance(statement, NoEffect):
        return _said(bound, _no_effect(data))
    if isinstance(statement, NoTrip):
        return _said(bound, _no_trip(bound, data))
    if isinstance(statement, Trips):
        return _said(bound, _trips(bound, statement, data))
    if isinstance(statement, TwinError):
        residual = data.measured(statement.sensor) - data.twins[statement.twin][statement.sensor]
        return _said(bound, _twin_error(_Times.of(bound, data, residual), statement, bound))
    found = [(_column(bound, data, column), column) for column in bound.columns]
    found += [(stood, column) for column in bound.columns if (stood := _standing(bound, data, column)) is not None]
    chosen, column = worst(found)
    judged = _said(bound, chosen)
    return replace(judged, column=column, text=f"{column}: {judged.text}" if len(bound.columns) > 1 else judged.text)


def judge_all(limits: Sequence[BoundLimit], data: RunData) -> tuple[Judgement, ...]:
    """Return the judgements of all limits."""
    return tuple(judge(limit, data) for limit in limits)


def _said(bound: BoundLimit, found: Finding) -> Judgement:
    unit = found.unit or bound.unit
    if found.value is not None and not math.isfinite(found.value):  # values too large to be added
        if found.verdict == "fail":
            return Judgement(bound.limit, "fail", found.text, None, unit)
        return Judgement(bound.limit, "inconclusive", f"a value is too large to be judged: {found.text}", None, unit)
    return Judgement(bound.limit, found.verdict, found.text, found.value, unit, found.at_s, failed_s=found.failed_s)


@dataclass(frozen=True, slots=True)
class _Times:
    """Ticks of a limit: `time_s` (n,) and the values `x` (n,), NaN where missing.

    `unknown` (m,) tells of each tick that the profile has in the time of the limit, from number `first` on, whether its
    value is missing; one on which the condition of the limit is known not to hold needs none. `part` (n,) is the number
    of the part of the run, between two times at which the profile stood.
    """

    time_s: Floats
    x: Floats
    position: NDArray[np.int64]
    part: NDArray[np.int64]
    unknown: Bools
    first: int
    period_s: float
    at_most_s: float

    @classmethod
    def of(cls, bound: BoundLimit, data: RunData, values: Floats) -> _Times:
        """Return the ticks on which `values` (n,) of the run count for a limit."""
        wanted = ticks_within(bound.from_s, bound.to_s, data.period_s)
        position = data.positions()
        inside = (position >= wanted.start) & (position < wanted.stop)
        position, time_s, x = position[inside], data.time_s[inside], values[inside]
        covered, counts = np.isfinite(x), np.ones(len(x), dtype=np.bool_)
        if bound.condition is not None and bound.while_ is not None:
            on = data.columns[bound.condition][inside]
            counts = np.isfinite(on) & within(on, bound.while_)
            covered = np.isfinite(on) & (covered | ~counts)
        unknown = np.ones(len(wanted), dtype=np.bool_)
        unknown[position[covered] - wanted.start] = False
        return cls(
            time_s[counts],
            x[counts],
            position[counts],
            np.cumsum(data.stood, dtype=np.int64)[inside][counts],
            unknown,
            wanted.start,
            data.period_s,
            bound.limit.gap_at_most_s,
        )

    @property
    def is_missing(self) -> bool:
        """True where values are missing for longer than the limit admits."""
        return longest_piece(self.unknown)[0] * self.period_s > self.at_most_s + 0.5 * self.period_s

    @property
    def known(self) -> Bools:
        """Ticks (n,) with a value."""
        return np.isfinite(self.x)

    def beyond(self, threshold: Bound) -> Bools:
        """Return of each tick of the profile (m,) whether its value is known and within `threshold`."""
        found = np.zeros(len(self.unknown), dtype=np.bool_)
        found[self.position[self.known & within(self.x, threshold)] - self.first] = True
        return found

    def missing(self, value: float | None = None, unit: str = "") -> Finding:
        """Return the finding that values are missing; `value` in `unit` is that of the known ones."""
        length, begin = longest_piece(self.unknown)
        for_s, from_s = max(length, 1) * self.period_s, (self.first + begin) * self.period_s
        text = f"values are missing, at the longest for {for_s:g} s from {from_s:g} s on"
        return Finding("inconclusive", text, value, unit)


def within(x: Floats, bound: Bound) -> Bools:
    """Return which of `x` (n,) are within a bound."""
    number = bound.amount.number
    if bound.upper is not None:
        return np.asarray((x >= number) & (x <= bound.upper.number))
    compare = {"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal}[bound.operator]
    return np.asarray(compare(x, number))


def _margins(x: Floats, bound: Bound) -> Floats:
    """Return the distances (n,) of `x` (n,) from a bound, positive inside."""
    if bound.upper is not None:
        return np.minimum(x - bound.amount.number, bound.upper.number - x)
    return bound.amount.number - x if bound.operator in ("<", "<=") else x - bound.amount.number


def _column(bound: BoundLimit, data: RunData, column: str) -> Finding:
    statement = bound.statement
    if isinstance(statement, Settles):
        return judge_settling(bound, statement, data, column)
    if isinstance(statement, Follows):
        return _follows(bound, statement, data, column)
    assert isinstance(statement, Compared)
    times = _Times.of(bound, data, data.columns[column])
    if not times.known.any():
        is_never = not times.is_missing and bound.condition is not None
        text = "its condition was never fulfilled" if is_never else "it has no good value"
        return Finding("inconclusive", text)
    if statement.measure in ("time", "longest"):
        return _duration(times, statement, bound.unit, _stood_beyond_s(bound, statement, data, column))
    if statement.measure != "value":
        return _statistic(times, statement, bound.unit)
    return _values(times, statement.bound, bound.unit)


def _standing(bound: BoundLimit, data: RunData, column: str) -> Finding | None:
    """Return the failure of a limit on a tick on which the profile stood; None where there is none.

    The clock of the profile says nothing of these ticks, so that a limit with times is not for them.
    """
    said, ticks = bound.statement, data.standing
    if ticks is None or not holds_always(bound):
        return None
    assert isinstance(said, Compared)
    x = ticks.columns[column]
    wrong = np.isfinite(x) & np.where(ticks.as_profile, ~within(x, said.bound), is_above(x, said.bound))
    if bound.condition is not None and bound.while_ is not None:
        wrong &= within(ticks.columns[bound.condition], bound.while_)
    if not wrong.any():
        return None
    margins = np.where(wrong, _margins(x, said.bound), np.inf)
    at = int(np.argmin(margins))
    value, at_s = float(x[at]), float(ticks.time_s[at])
    text = f"{shown(value, bound.unit)} while the profile stood at {at_s:g} s, the limit is {said.bound}"
    return Finding("fail", text, value, at_s=at_s, margin=float(margins[at]))


def _stood_beyond_s(bound: BoundLimit, said: Compared, data: RunData, column: str) -> float:
    """Return the time for which a value was beyond the threshold of a limit while the profile stood, s.

    At the rig's safe values and in a thermal restore only a value above it counts, as in `_standing`.
    """
    ticks = data.standing
    if ticks is None or said.threshold is None:
        return 0.0
    beyond = (
        within(ticks.columns[column], said.threshold) & (bound.from_s <= ticks.time_s) & (ticks.time_s <= bound.to_s)
    )
    if not said.threshold.operator.startswith(">"):
        beyond &= ticks.as_profile
    if bound.condition is not None and bound.while_ is not None:
        beyond &= within(ticks.columns[bound.condition], bound.while_)
    return float(beyond.sum()) * data.period_s


def holds_always(bound: BoundLimit) -> bool:
    """Return True for a limit on every value, without times of its own: it also holds while the profile stands."""
    said, window = bound.statement, bound.limit.sentence.window
    if window.from_s is not None or window.to_s is not None or not isinstance(said, Compared):
        return False
    is_upper = said.bound.operator.startswith("<")
    every = {"value": True, "max": is_upper, "min": not is_upper and said.bound.upper is None}
    return every.get(said.measure, False)


def is_above(x: Floats, bound: Bound) -> Bools:
    """Return which of `x` (n,) are above the upper end of a bound; none where it has no upper end.

    At the rig's safe values and in a thermal restore only this end holds: a heater that is off there is no failure.
    """
    if bound.upper is not None:
        return np.asarray(x > bound.upper.number)
    if not bound.operator.startswith("<"):
        return np.zeros(np.shape(x), dtype=np.bool_)
    return np.asarray(np.isfinite(x) & ~within(x, bound))


def _values(times: _Times, bound: Bound, unit: str) -> Finding:
    """Return the finding on a bound that holds for every value."""
    known = np.flatnonzero(times.known)
    margins = _margins(times.x[known], bound)
    at = known[int(np.argmin(margins))]
    value, at_s, margin = float(times.x[at]), float(times.time_s[at]), float(margins.min())
    wrong = known[~within(times.x[known], bound)]
    if len(wrong):
        for_s, first_s = len(wrong) * times.period_s, times.time_s[wrong[0]]
        text = (
            f"{shown(value, unit)} at {at_s:g} s, the limit is {bound}; beyond it for {for_s:g} s from {first_s:g} s on"
        )
        spans = _spans(times.time_s[wrong], times.period_s)
        return Finding("fail", text, value, at_s=at_s, margin=margin, failed_s=spans)
    if times.is_missing:
        return times.missing(value)
    return Finding("pass", f"at worst {shown(value, unit)} at {at_s:g} s", value, at_s=at_s, margin=margin)


def _spans(time_s: Floats, period_s: float) -> tuple[tuple[float, float], ...]:
    """Return begins and ends, s, of the pieces of ticks at `time_s` (n,), at least one; at most `_MOST_SPANS`."""
    gaps = np.flatnonzero(np.diff(time_s) > 1.5 * period_s)
    if len(gaps) >= _MOST_SPANS:  # the shortest gaps are closed
        longest = np.argsort(-np.diff(time_s)[gaps], kind="stable")[: _MOST_SPANS - 1]
        gaps = gaps[np.sort(longest)]
    begins, ends = time_s[np.concatenate([[0], gaps + 1])], time_s[np.concatenate([gaps, [len(time_s) - 1]])]
    return tuple(zip(begins.tolist(), ends.tolist(), strict=True))


def _statistic(times: _Times, said: Compared, unit: str) -> Finding:
    """Return the finding on a statistic of all values; more values could only worsen those that prove a failure."""
    x, grows = times.x[times.known], False
    at_s: float | None = None
    if said.measure in ("max", "min"):
        pick = np.argmax if said.measure == "max" else np.argmin
        at = np.flatnonzero(times.known)[int(pick(x))]
        value, at_s = float(times.x[at]), float(times.time_s[at])
        grows = said.bound.upper is None and said.bound.operator.startswith("<" if said.measure == "max" else ">")
    elif said.measure == "ramp":
        steepest = _steepest(times, said, TIMES_S[unit.rpartition("/")[2]])
        if steepest is None:
            stood = len(np.unique(times.part)) > 1 and not times.is_missing
            return (
                Finding("inconclusive", "the profile stood within the span of the ramp") if stood else times.missing()
            )
        value, at_s = steepest
        grows = said.bound.upper is None and said.bound.operator.startswith("<")
    else:
        value = _plain_statistic(x, said)
    margin = float(_margins(np.array([value]), said.bound)[0])
    text = f"{shown(value, unit)}" + (f" at {at_s:g} s" if at_s is not None else "")
    if not within(np.array([value]), said.bound)[0] and (grows or not times.is_missing):
        return Finding("fail", f"{text}, the limit is {said.bound}", value, at_s=at_s, margin=margin)
    if times.is_missing:
        return times.missing(value)
    return Finding("pass", text, value, at_s=at_s, margin=margin)


def _plain_statistic(x: Floats, said: Compared) -> float:
    if said.measure == "mean":
        return float(np.mean(x))
    if said.measure == "deviation":
        return float(np.std(x))
    if said.measure == "range":
        return float(np.ptp(x))
    return float(np.percentile(x, said.percent))


def _duration(times: _Times, said: Compared, unit: str, stood_s: float) -> Finding:
    """Return the finding on a time beyond a threshold, in all or at the longest.

    It lies between the time without and with the ticks whose value is missing: each may have been beyond, or not. The
    time `stood_s`, s, beyond it while the profile stood proves no failure, and no time that it could exceed is passed.
    """
    assert said.threshold is not None
    beyond = times.beyond(said.threshold)
    ticks = [beyond, beyond | times.unknown]
    if said.measure == "longest":
        pieces = [longest_piece(flags) for flags in ticks]
    else:
        pieces = [(int(flags.sum()), int(np.argmax(flags))) for flags in ticks]
    least, most = (length * times.period_s for length, _ in pieces)
    at_s = (times.first + pieces[0][1]) * times.period_s if pieces[0][0] else None
    inside = within(np.array([least, most]), said.bound)
    text = f"{shown(least, unit)}" + (f" from {at_s:g} s on" if at_s is not None else "")
    margin = float(_margins(np.array([least, most]), said.bound).min())
    if not _reaches(least, most, said.bound):
        proven = least if said.bound.operator.startswith("<") or said.bound.upper is not None else most
        return Finding("fail", f"{text}, the limit is {said.bound}", proven, at_s=at_s, margin=margin)
    if times.is_missing:
        return times.missing(least)
    if inside.all():
        is_proven = not said.bound.operator.startswith("<") or bool(within(np.array([most + stood_s]), said.bound)[0])
        if stood_s == 0.0 or is_proven:
            return Finding("pass", text, least, at_s=at_s, margin=margin)
        text = f"{text}, and {stood_s:g} s more while the profile stood; the limit is {said.bound}"
        return Finding("inconclusive", text, least, at_s=at_s)
    text = f"between {shown(least, unit)} and {shown(most, unit)}, by the values that are missing"
    return Finding("inconclusive", f"{text}; the limit is {said.bound}", least, at_s=at_s)


def _reaches(least: float, most: float, bound: Bound) -> bool:
    """Return True where a value between `least` and `most` is within a bound."""
    if bound.upper is not None:
        return least <= bound.upper.number and most >= bound.amount.number
    return bool(within(np.array([least if bound.operator.startswith("<") else most]), bound)[0])


def _steepest(times: _Times, said: Compared, per_s: float) -> tuple[float, float] | None:
    """Return the steepest change over `over_s` in units in `per_s`, and its beginning in s; None without a pair."""
    assert said.over_s is not None
    later = np.searchsorted(times.time_s, times.time_s + said.over_s - 0.5 * times.period_s)
    there = later < len(times.time_s)
    first, last = np.flatnonzero(there), later[there]
    apart = times.time_s[last] - times.time_s[first]
    change = (times.x[last] - times.x[first]) / apart * per_s
    # While the profile stood, the value went on by an unknown time of the profile.
    is_pair = (np.abs(apart - said.over_s) <= (0.5 + _SAME_S) * times.period_s) & (
        times.part[last] == times.part[first]
    )
    change = np.where(is_pair, change, np.nan)
    change = np.abs(change) if said.direction == 0 else said.direction * change
    if not np.isfinite(change).any():
        return None
    at = int(np.nanargmax(change))
    return float(change[at]), float(times.time_s[first[at]])


def _follows(bound: BoundLimit, said: Follows, data: RunData, column: str) -> Finding:
    assert bound.setpoint is not None and said.constant_s is not None
    wanted, read = data.columns[bound.setpoint], data.columns[column]
    # A set-point that is missing for a while, and then the same, has not changed: the ticks after it are judged.
    last = carried_on(wanted)
    # After a time at which the profile stood, the reading follows it anew.
    changed = np.concatenate([[True], ~(last[1:] == last[:-1])]) if len(last) else np.zeros(0, dtype=np.bool_)
    changed |= data.stood
    since = np.maximum.accumulate(np.where(changed, np.arange(len(wanted)), 0))
    constant = data.time_s - data.time_s[since] >= said.constant_s - _SAME_S
    relative = said.band.unit == "%" and bound.unit != "%"
    off = read - wanted
    if relative:
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.where(wanted != 0.0, 100.0 * off / np.abs(wanted), 0.0)
            off = np.where(np.isfinite(read) & np.isfinite(wanted), off, np.nan)
        constant &= wanted != 0.0
    # A tick counts where its set-point is constant; one without a set-point is missing.
    unknown = ~np.isfinite(wanted)
    times = _Times.of(bound, data, np.where(constant | unknown, off, 0.0))
    inside = _Times.of(bound, data, np.where(constant, off, np.nan))
    if not inside.known.any():
        if times.is_missing:
            return times.missing()
        text = f"its set-point was at no time constant for {said.constant_s:g} s" + (" and not 0" if relative else "")
        return Finding("inconclusive", text)
    at = int(np.nanargmax(np.abs(inside.x)))
    value, at_s = float(inside.x[at]), float(inside.time_s[at])
    unit = "%" if relative else said.band.unit or ""
    margin = said.band.number - abs(value)
    text = f"at worst {shown(value, unit)} off its set-point at {at_s:g} s"
    if margin < 0.0:
        return Finding("fail", f"{text}, the limit is {said.band}", value, unit, at_s, margin)
    if times.is_missing:
        return times.missing(value, unit)
    return Finding("pass", text, value, unit, at_s, margin)


def _twin_error(times: _Times, said: TwinError, bound: BoundLimit) -> Finding:
    off = times.x[times.known]
    if not len(off):
        return times.missing()
    if said.kind == "rmse":
        value, at_s = root_mean_square(off), None
    elif said.kind == "bias":
        value, at_s = float(np.mean(off)), None
    else:
        at = np.flatnonzero(times.known)[int(np.argmax(np.abs(off)))]
        value, at_s = float(abs(times.x[at])), float(times.time_s[at])
    text = f"{shown(value, bound.unit)} of twin {said.twin}" + (f" at {at_s:g} s" if at_s is not None else "")
    is_inside = bool(within(np.array([value]), said.bound)[0])
    proves = said.kind == "largest" and said.bound.operator.startswith("<")
    if not is_inside and (proves or not times.is_missing):
        return Finding("fail", f"{text}, the limit is {said.bound}", value, at_s=at_s)
    return times.missing(value) if times.is_missing else Finding("pass", text, value, at_s=at_s)


def _no_effect(data: RunData) -> Finding:
    if data.diagnosis is None:
        return Finding("inconclusive", "the run has no diagnosis; make one with `hil diagnose RUN`, then judge again")
    found = data.diagnosis
    if found.doubts:
        doubts = "; ".join(found.doubts)
        text = f"the diagnosis, {found.verdict}, does not count: {doubts}; run `hil diagnose RUN`, then judge again"
        return Finding("inconclusive", text)
    text = f"the diagnosis is {found.verdict}" + (f": {found.summary}" if found.summary else "")
    if found.verdict == "adequate":
        return Finding("pass" if data.has_ended else "inconclusive", text)
    return Finding("fail" if found.verdict in ("effect found", "ambiguous") else "inconclusive", text)


def _tripped(bound: BoundLimit, data: RunData) -> list[Trip]:
    """Return the trips by interlocks, rig or link in the time of a limit, without those by the test or the bench."""
    within_s = (trip for trip in data.trips if bound.from_s - _SAME_S <= trip.at_s <= bound.to_s + _SAME_S)
    return [trip for trip in within_s if trip.by == "protection"]


def _ended_early(bound: BoundLimit, data: RunData) -> Finding | None:
    """Return the finding on a run whose profile ended before that of the limit; None where it went on to it."""
    last_s = float(data.time_s[-1]) if len(data.time_s) else -math.inf
    if data.has_ended or (bound.to_s < data.duration_s and last_s >= bound.to_s - _SAME_S):
        return None
    end = "its end" if bound.to_s >= data.duration_s else f"{bound.to_s:g} s of the profile"
    why = f": {data.reason}" if data.reason else ""
    if data.trips and data.trips[-1].by != "protection":
        by = "a limit of a test ended it, and no protection" if data.trips[-1].by == "test" else "a fault of the bench"
        why += f" ({by})"
    return Finding("inconclusive", f"the run did not go to {end}{why}")


def _no_trip(bound: BoundLimit, data: RunData) -> Finding:
    found = _tripped(bound, data)
    if found:
        return Finding("fail", found[0].reason, at_s=found[0].at_s)
    others = {"test": "tripped by a limit of a test", "bench": "interrupted by a fault of the bench"}
    noted = [f"{others[trip.by]} at {trip.at_s:g} s" for trip in data.trips if trip.by != "protection"]
    text = "nothing tripped" + (f"; the run was {', '.join(noted)} and went on" if noted else "")
    return _ended_early(bound, data) or Finding("pass", text)


def _trips(bound: BoundLimit, said: Trips, data: RunData) -> Finding:
    """Return the finding on a trip that the test asks for, by the right cause and in its time."""
    found = _tripped(bound, data)
    named = [
        trip
        for trip in found
        if said.signal is None or any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", trip.reason) for name in said.names)
    ]
    if named:
        return Finding("pass", f"at {named[0].at_s:g} s: {named[0].reason}", at_s=named[0].at_s)
    if found:
        text = f"tripped by something else than {said.signal} at {found[0].at_s:g} s: {found[0].reason}"
        return Finding("fail", text, at_s=found[0].at_s)
    return _ended_early(bound, data) or Finding("fail", "nothing tripped in its time")
