"""The time axis of a record: which column it is, seconds from it, and what is odd about them."""

from __future__ import annotations

import datetime
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record_file import MISSING, RawRecord, RecordError, parse

SCALES = {
    "time_s": 1.0,
    "time": 1.0,
    "t": 1.0,
    "t_s": 1.0,
    "seconds": 1.0,
    "time (s)": 1.0,
    "time [s]": 1.0,
    "elapsed_s": 1.0,
    "time (min)": 60.0,
    "time [min]": 60.0,
    "time (h)": 3600.0,
    "time [h]": 3600.0,
    "time_ms": 1e-3,
    "time_min": 60.0,
    "time_h": 3600.0,
    "timestamp": 1.0,
    "datetime": 1.0,
    "date": 1.0,
    "epoch": 1.0,
}
"""Names, lower case, under which a column is taken for the time where there is no `time_s`; s per unit."""

ZONELESS = "without a time zone, taken as UTC"
"""End of what is said of dates and times that may be local."""

GAP_PERIODS = 5
"""A step longer than this many typical steps is a gap."""

_EPOCH_UNITS = (
    (1e17, 1e-9, "nanoseconds"),
    (1e14, 1e-6, "microseconds"),
    (1e11, 1e-3, "milliseconds"),
    (1e8, 1.0, "seconds"),
)
_DOTTED = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+(\d{1,2})(:.*))?")
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """`seconds (n,)` as stored, NaN where unreadable; `start` is the UTC time of 0 s where the record tells.

    `zoneless`: dates and times without a time zone, which may be local.
    """

    column: str
    seconds: NDArray[np.float64]
    start: datetime.datetime | None
    messages: tuple[str, ...]
    zoneless: bool = False


def span(seconds: float) -> str:
    """`seconds` as a reader says it: 42 s, 5 min 20 s, 3 h 10 min."""
    if abs(seconds) < 60:
        return f"{seconds:.3g} s"
    whole = round(abs(seconds))
    sign = "-" if seconds < 0 else ""
    if whole < 3600:
        return f"{sign}{whole // 60} min" + (f" {whole % 60} s" if whole % 60 else "")
    minutes = round(whole / 60)
    return f"{sign}{minutes // 60} h" + (f" {minutes % 60} min" if minutes % 60 else "")


def read_time(raw: RawRecord) -> TimeAxis:
    """Find and read the time column of `raw`; raises RecordError where there is none."""
    column = _find(raw)
    cells = raw.cells[raw.names.index(column)]
    messages = []
    seconds, start, how = _seconds(cells, SCALES.get(column.lower(), 1.0))
    if seconds is None or not np.isfinite(seconds).any():
        raise RecordError(
            f"{raw.path} has no readable time in column '{column}'; write seconds, or ISO 8601 as 2026-11-02T10:00:00Z"
        )
    if start is not None:
        messages.append(f"{column} is {how}: shifted so that {start:%Y-%m-%d %H:%M:%S} UTC is 0 s")
    elif column != "time_s":
        unit = {1e-3: "milliseconds", 60.0: "minutes", 3600.0: "hours"}.get(SCALES.get(column.lower(), 1.0), "seconds")
        messages.append(f"column '{column}' is taken for time_s, in {unit}")
    unreadable = np.flatnonzero(~np.isfinite(seconds))
    if len(unreadable):
        rows = "1 row has" if len(unreadable) == 1 else f"{len(unreadable)} rows have"
        messages.append(f"{rows} no readable time (the first is {raw.place(int(unreadable[0]))}): dropped")
    return TimeAxis(column, seconds, start, tuple(messages), how.endswith(ZONELESS))


def numbered(raw: RawRecord) -> TimeAxis:
    """Rows by their number instead of a time; a column that could be one is left aside."""
    column = next((name for name in raw.names if name.lower() in SCALES), "")
    return TimeAxis(column, np.arange(len(raw.cells[0]), dtype=np.float64), None, ())


def _find(raw: RawRecord) -> str:
    if "time_s" in raw.names:
        return "time_s"
    for name in raw.names:
        if name.lower() in SCALES:
            return name
    import pyarrow as pa

    for name, cells in zip(raw.names, raw.cells, strict=True):
        if pa.types.is_timestamp(cells.type):
            return name
    place = f" line {raw.header_line}" if raw.header_line else ""
    nameless = ", where the first column has no name" if raw.names[0] == "column_1" else ""
    shown = ", ".join(raw.names[:8]) + (", ..." if len(raw.names) > 8 else "")
    raise RecordError(
        f"{raw.path}{place} has no column time_s (it has {shown}{nameless}); name the column of sample times time_s, "
        "in seconds, or give --at-rest to hil diagnose where each row is a steady state"
    )


def _seconds(cells: Any, scale: float) -> tuple[NDArray[np.float64] | None, datetime.datetime | None, str]:
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = cells.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind.unit]
        seconds, origin = _whole_numbers(cells.cast(pa.int64()), 1.0 / per_second)
        if pa.types.is_duration(kind):
            return seconds + origin, None, ""
        return seconds, _EPOCH + datetime.timedelta(seconds=origin), "a timestamp"
    numbers = parse(cells)
    if numbers is None:
        return None, None, ""
    if numbers.bad > numbers.present / 2:
        written = [None if cell is None else cell.strip() for cell in cells.to_pylist()]
        dotted = any(cell and _DOTTED.fullmatch(cell) for cell in written[:9])
        written = [cell and _DOTTED.sub(_as_iso, cell) for cell in written]
        micros = pa.chunked_array([[_iso_microseconds(cell) for cell in written]], pa.int64())
        if micros.null_count == len(micros):
            return None, None, ""
        seconds, origin = _whole_numbers(micros, 1e-6)
        zoned = any(cell and ("Z" in cell or "+" in cell or cell.count("-") > 2) for cell in written[:9])
        how = ("day.month.year" if dotted else "ISO 8601") + ("" if zoned else f" {ZONELESS}")
        return seconds, _EPOCH + datetime.timedelta(seconds=origin), how
    values = numbers.values
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None, None, ""
    values = np.where(np.isfinite(values), values, np.nan)
    for least, unit, word in _EPOCH_UNITS:
        if np.median(finite) < least:
            continue
        clock_set = 0.5 * float(np.median(finite))  # earlier stamps are of a clock that had not been set yet
        if pa.types.is_integer(kind) and not pa.types.is_uint64(kind):
            seconds, origin = _whole_numbers(pc.cast(cells, pa.int64()), unit, clock_set)
        else:
            first = values[values >= clock_set].min()
            origin, seconds = float(first) * unit, np.where(values >= clock_set, (values - first) * unit, np.nan)
        return seconds, _EPOCH + datetime.timedelta(seconds=origin), f"{word} since 1970"
    return values * scale, None, ""


def _whole_numbers(cells: Any, unit: float, least: float = -math.inf) -> tuple[NDArray[np.float64], float]:
    """Integer `cells` of at least `least` as seconds from the first: float64 alone would round epoch nanoseconds."""
    import pyarrow.compute as pc

    valid = pc.is_valid(cells).to_numpy()
    stamps = pc.fill_null(cells, 0).to_numpy()
    valid &= stamps >= least
    if not valid.any():
        return np.full(len(stamps), np.nan), 0.0
    origin = int(stamps[valid].min())
    return np.where(valid, (stamps - origin) * unit, np.nan), origin * unit


def _as_iso(date: re.Match[str]) -> str:
    day, month, year, hour, rest = date.groups()
    return f"{year}-{month:0>2}-{day:0>2}" + (f"T{hour:0>2}{rest}" if hour else "")


def _iso_microseconds(cell: str | None) -> int | None:
    if cell is None or cell.lower() in MISSING:
        return None
    try:
        moment = datetime.datetime.fromisoformat(cell)
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    return (moment - _EPOCH) // datetime.timedelta(microseconds=1)


def order(raw: RawRecord, axis: TimeAxis) -> tuple[NDArray[np.int64], list[str]]:
    """Rows with a readable time in the order of time, equal times in the order of the file; and what was moved."""
    rows = np.flatnonzero(np.isfinite(axis.seconds))
    stamps = axis.seconds[rows]
    steps = np.diff(stamps)
    messages = []
    if (steps < 0).any():
        first = int(np.argmax(steps < 0)) + 1
        count = int((steps < 0).sum())
        again = "once" if count == 1 else f"{count} times"
        back = -steps.min()
        message = f"time goes back {again}, by up to {span(back)} (first at {raw.place(int(rows[first]))}): rows sorted"
        if axis.zoneless and _clocks_went_back(steps):
            message += (
                "; local time on the night when clocks go back looks like that, and two hours become one: write "
                "times in UTC or with their zone"
            )
        elif back > max(60.0, 0.1 * np.ptp(stamps)):
            message += "; if these are two records in one file, split it"
        messages.append(message)
        rows = rows[np.argsort(stamps, kind="stable")]
    return rows, messages


def _clocks_went_back(steps: NDArray[np.float64]) -> bool:
    """Whether each step back is what is left of an hour after one ordinary step."""
    typical = float(np.median(steps))
    return bool((np.abs(3600.0 + steps[steps < 0] - typical) <= 0.5 * typical).all())


def describe_steps(time_s: NDArray[np.float64]) -> list[str]:
    """What is to say of gaps and rate of strictly increasing `time_s (n,)`."""
    steps = np.diff(time_s)
    if len(steps) < 2:
        return []
    messages = []
    typical = float(np.median(steps))
    gaps = steps > GAP_PERIODS * typical
    if gaps.any():
        longest = int(np.argmax(steps))
        count = "1 gap" if gaps.sum() == 1 else f"{gaps.sum()} gaps"
        messages.append(
            f"{count} longer than {span(GAP_PERIODS * typical)}, the longest {steps[longest]:.4g} s at "
            f"{span(time_s[longest])}"
        )
    low, high = np.percentile(steps[~gaps], [5, 95])
    if high - low > 0.1 * typical:
        messages.append(f"sampling is irregular: steps of {low:.3g} to {high:.3g} s, typically {typical:.3g} s")
    return messages
