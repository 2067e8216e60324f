"""Jumps of a clock in the times of a record: clocks that were set, times of another unit, single broken times.

A record is one recording. A step in time that is far longer than all the rest of it is no gap: a clock was set there,
a number was damaged, or a line is no row. Jumps back are handled with the order of the rows (`hil.record.order`).
"""

from __future__ import annotations

import dataclasses
import datetime

import numpy as np
from numpy.typing import NDArray

from hil.record.raw import RawRecord, RecordError
from hil.record.times import GAP_PERIODS, TimeAxis, span
from hil.record.values import may_be_lost

YEAR_S = 365.25 * 86400.0
"""A clock without power falls back to the beginning of its epoch, years before any record."""
FAR = 10.0
"""Ratio of a step to all the rest of the record, an order of magnitude, from which it is no gap of the record."""
_UNITS = {1e3: "1000", 1e6: "a million", 60.0: "60"}
"""Ratios of the units of times (s to ms, s to us, min to s) as a message writes them."""
_FROM_1904_S = 2_082_844_800.0
"""Seconds from 1904-01-01, where the times of LabVIEW and of old Macs begin, to 1970-01-01."""
_ROUND_MS = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Periods at which loggers sample, s, whose thousandfold is no such period."""
_LEAST_MS = 1000.0
"""Typical step from which times are asked about: shorter ones are usual in seconds, too."""

_BITS = (16, 24, 32)
"""Sizes of counters of times, in bits."""
_COUNTS_S = (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-6, 1e-9)
"""Counts of such counters, s."""
_FEW_STEPS = 2.0
"""Typical steps that a rolled-over counter is on after the last time before: more may be another recording."""


def without_rollovers(raw: RawRecord, axis: TimeAxis) -> tuple[TimeAxis, list[str]]:
    """Return the axis with times that go on where a counter of 16, 24 or 32 bits began again, and a message.

    Each step back is by all counts of one size, less one or two typical steps; any other steps back are left alone.
    """
    rows = np.flatnonzero(np.isfinite(axis.seconds))
    steps = np.diff(axis.seconds[rows])
    back = steps < 0.0
    if axis.start is not None or "segment" in raw.names or not back.any() or (steps > 0.0).sum() < 2:
        return axis, []
    typical = float(np.median(steps[steps > 0.0]))
    for bits in _BITS:
        for count_s in _COUNTS_S:
            whole = 2.0**bits * count_s
            on = steps[back] + whole
            if typical > 0.01 * whole or not ((on > 0.0) & (on <= _FEW_STEPS * typical)).all():
                continue
            seconds = axis.seconds.copy()
            seconds[rows[1:]] += whole * np.cumsum(back)
            first = raw.place(int(rows[1:][back][0]))
            times = "once" if back.sum() == 1 else f"{int(back.sum())} times"
            said = (
                f"{axis.column} goes back {times} by 2^{bits} counts of {count_s:g} s (first at {first}), as a counter "
                f"of {bits} bits that began again: the times go on there"
            )
            return dataclasses.replace(axis, seconds=seconds), [said]
    return axis, []


def without_jumps(raw: RawRecord, axis: TimeAxis) -> tuple[NDArray[np.float64], list[str]]:
    """Return the seconds (n,) of the rows, NaN for a few rows whose times lie far from all others, and messages.

    Rows of a run of this project keep their gaps: a run may be resumed after any time, and its segments are numbered.

    Raises
    ------
    RecordError
        The times change their unit, or more rows than `may_be_lost` lie on either side of a jump over years.
    """
    seconds = axis.seconds
    if "segment" in raw.names:
        return seconds, []
    _require_one_unit(raw, axis)
    out = seconds.copy()
    messages: list[str] = []
    most = may_be_lost(len(seconds))
    while (found := _farthest(out)) is not None:
        far, near, step = found
        at = int(np.min(far))
        few = int((~np.isfinite(out) & np.isfinite(seconds)).sum()) + len(far) <= most and FAR * len(far) < len(near)
        if not few:
            early, late = sorted((far, near), key=lambda side: float(out[side[0]]))
            jump = int(late.min())
            if step < YEAR_S or jump < early.min():  # `order` refuses a step back.
                break
            raise RecordError(
                f"{raw.path} {raw.place(jump)}: the time goes on by {step / YEAR_S:.3g} years, as that of a clock that "
                "was set there; correct the times of the rows before or after it, or take them out"
            )
        rows = "1 row lies" if len(far) == 1 else f"{len(far)} rows lie"
        far_off = span(step) if step < YEAR_S else f"{step / YEAR_S:.3g} years"
        messages.append(
            f"{rows} {far_off} from all other times, as those of a broken number or a clock that was not set (the "
            f"first is {raw.place(at)}): left out; correct the time there, or split the file where the gap is real"
        )
        out[far] = np.nan
    return out, messages


def clock_questions(axis: TimeAxis, seconds: NDArray[np.float64], scale: float) -> list[str]:
    """Return questions about the unit and the epoch of the times; `scale` is that of the user, 1 for none."""
    known = seconds[np.isfinite(seconds)]
    said = []
    if axis.start is None and scale == 1.0 and len(known) > 2 and (known == np.round(known)).all():
        typical = float(np.median(np.diff(np.sort(known))))
        as_ms = typical / 1000.0
        if typical >= _LEAST_MS and any(abs(as_ms - period) <= 0.01 * period for period in _ROUND_MS):
            said.append(
                f"{axis.column}: the typical step is {typical:.6g} s, {span(float(np.ptp(known)))} in all: are the "
                "times in milliseconds? --time-scale 0.001 reads them so"
            )
    if axis.start is not None and axis.start > datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=1):
        told = f"{axis.column}: the record begins in the future, on {axis.start:%Y-%m-%d}: is the clock right?"
        from_1904 = axis.start - datetime.timedelta(seconds=_FROM_1904_S)
        if datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC) < from_1904 < datetime.datetime.now(datetime.UTC):
            told += (
                f" Counted from 1904, as LabVIEW does, it begins on {from_1904:%Y-%m-%d}: subtract {_FROM_1904_S:.0f}"
            )
        said.append(told)
    return said


def _farthest(seconds: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64], float] | None:
    """Return the rows on both sides of a step `FAR` times as long as all the rest, fewer rows first, and the step."""
    rows = np.flatnonzero(np.isfinite(seconds))
    if len(rows) < 3:
        return None
    ordered = rows[np.argsort(seconds[rows], kind="stable")]
    steps = np.diff(seconds[ordered])
    at = int(np.argmax(steps))
    step = float(steps[at])
    rest = float(seconds[ordered[-1]] - seconds[ordered[0]]) - step
    if rest <= 0.0 or step <= FAR * rest:
        return None
    sides = sorted((ordered[: at + 1], ordered[at + 1 :]), key=len)
    return sides[0], sides[1], step


def _require_one_unit(raw: RawRecord, axis: TimeAxis) -> None:
    """Raise RecordError where the times go on as those before in another unit: 1772618430, 1772618460000."""
    rows = np.flatnonzero(np.isfinite(axis.seconds))
    origin = 0.0 if axis.start is None else axis.start.timestamp()
    stamps = axis.seconds[rows] + origin
    steps = np.diff(stamps)
    if len(steps) < 2 or not (steps > 0.0).any():
        return
    at = int(np.argmax(np.abs(steps)))
    before = steps[max(at - 20, 0) : at]
    after = steps[at + 1 : at + 21]
    if not len(before) or not len(after):
        return
    slow, fast = float(np.median(before)), float(np.median(after))
    for factor, word in _UNITS.items():
        for by, said in ((factor, f"{word} times as large"), (1.0 / factor, f"smaller by {word}")):
            goes_on = 0.0 < stamps[at + 1] / by - stamps[at] <= GAP_PERIODS * slow
            if goes_on and abs(fast / by - slow) <= 0.1 * slow:
                raise RecordError(
                    f"{raw.path} {raw.place(int(rows[at + 1]))}: from here on the times are {said}: they change "
                    "their unit; write all times in one unit, or split the file there"
                )
