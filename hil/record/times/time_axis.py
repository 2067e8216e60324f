"""The time axis of a record: which columns it is in, seconds from it, and what is odd about them."""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.raw import RawRecord, Reading, RecordError
from hil.record.times.daylight_saving import unfolded
from hil.record.times.names import SECONDS_PER, is_time_name, names_dates, names_unit, seconds_per_unit
from hil.record.times.numbers import EPOCH_S, are_days, compact_moments, count_of
from hil.record.times.text import (
    Stamps,
    TimeTextError,
    is_date,
    is_moment,
    is_time_of_day,
    read_stamps,
    read_times_of_day,
)
from hil.record.values.numbers import Sign, may_be_lost, parse, trimmed

ZONELESS = "without a time zone, taken as UTC"
"""End of what is said of dates and times that may be local."""

GAP_PERIODS = 5
"""A step longer than this many typical steps is a gap."""

SAME_SPAN = 0.1
"""Part by which the spans of two columns of times may differ: no clock is that wrong, and units differ by more."""

SHEET_DAYS = (20_000.0, 80_000.0)
"""Day numbers of a spreadsheet, of the years 1954 to 2119."""
_SHEET_EPOCH = datetime.datetime(1899, 12, 30, tzinfo=datetime.UTC)
"""Day 0 of spreadsheets from March 1900 on (ECMA-376, 18.17.4.1, with the leap day 1900 that they count)."""

_COMPACT = (19_500_101_000000, 21_001_231_235959)
"""Dates and times written as one number, 20260304233000: as milliseconds since 1970 they would be after 2580."""
_NO_CLOCK = 2.0**63
"""No clock counts that far, not in nanoseconds either."""
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_SAMPLE = 9
"""Cells from which a column of text is told to be one of dates or times."""


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """`seconds (n,)` as stored, NaN where unreadable; `start` is the UTC time of 0 s where the record tells.

    `zoneless`: dates and times without a time zone, which may be local. `columns` are all that the times are read from.
    """

    column: str
    seconds: NDArray[np.float64]
    start: datetime.datetime | None
    messages: tuple[str, ...]
    zoneless: bool = False
    columns: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Read:
    """Seconds of a column and the time of its zero, with how it is written."""

    seconds: NDArray[np.float64]
    start: datetime.datetime | None = None
    how: str = ""
    note: str = ""
    zoneless: bool = False


def span(seconds: float) -> str:
    """Return `seconds` as a reader says it: 42 s, 5 min 20 s, 3 h 10 min."""
    if abs(seconds) < 60:
        return f"{seconds:.3g} s"
    whole = round(abs(seconds))
    sign = "-" if seconds < 0 else ""
    if whole < 3600:
        return f"{sign}{whole // 60} min" + (f" {whole % 60} s" if whole % 60 else "")
    minutes = round(whole / 60)
    return f"{sign}{minutes // 60} h" + (f" {minutes % 60} min" if minutes % 60 else "")


def read_time(raw: RawRecord, signs: dict[str, Sign], choice: Reading) -> TimeAxis:
    """Find and read the time of `raw`, whose numbers have the decimal `signs`.

    Raises:
        RecordError: there is none, it may be read in two ways, or more rows than `may_be_lost` have none.
    """
    columns = _find(raw, signs, choice)
    column = ", ".join(columns)
    messages = []
    try:
        read = _read(raw, columns, signs, choice)
        if choice.time_column is None and read is not None and read.start is None:
            columns, read, said = _checked(raw, columns, read, choice)
            column = columns[0] if said else column
            messages += said
    except TimeTextError as error:
        raise RecordError(f"{raw.path}: column '{column}': {error}") from error
    if read is None or not np.isfinite(read.seconds).any():
        raise RecordError(
            f"{raw.path} has no readable time in column '{column}'; write seconds, or ISO 8601 as 2026-11-02T10:00:00Z"
        )
    seconds = read.seconds
    if read.zoneless and read.start is not None:
        seconds, said = unfolded(seconds, read.start, raw.place)
        messages += said
    if choice.time_scale != 1.0:
        seconds = seconds * choice.time_scale
        messages.append(f"{column} is taken {choice.time_scale:g} times, as --time-scale says")
    if read.start is not None:
        messages.insert(0, f"{column} is {read.how}: shifted so that {read.start:%Y-%m-%d %H:%M:%S} UTC is 0 s")
    elif read.how:
        messages.insert(0, f"{column} is {read.how}: shifted so that the first is 0 s")
    elif column != "time_s":
        unit = {1e-3: "milliseconds", 60.0: "minutes", 3600.0: "hours", 86400.0: "days"}
        unit |= {1e-6: "microseconds", 1e-9: "nanoseconds"}
        messages.insert(0, f"column '{column}' is taken for time_s, in {unit.get(_scale(raw, columns[0]), 'seconds')}")
    messages += [f"{column}: {read.note}"] if read.note else []
    messages += _unreadable(raw, column, seconds)
    return TimeAxis(column, seconds, read.start, tuple(messages), read.zoneless, columns)


def _read(raw: RawRecord, columns: tuple[str, ...], signs: dict[str, Sign], choice: Reading) -> _Read | None:
    if len(columns) == 2:
        return _pair(raw, columns, signs, choice)
    name = columns[0]
    cells = raw.cells[raw.names.index(name)]
    return _seconds(name, cells, signs.get(name, "."), _scale(raw, name), choice, _has_unit(raw, name))


def _checked(
    raw: RawRecord, columns: tuple[str, ...], read: _Read, choice: Reading
) -> tuple[tuple[str, ...], _Read, list[str]]:
    """Return the times, or those of a column of dates that goes on at another rate than a column without a unit.

    A name with a unit keeps its times, since a simulated rig's clock may go faster than that of the dates.
    """
    for name, cells in zip(raw.names, raw.cells, strict=True):
        if name in columns or not is_time_name(name) or not _all(cells, is_moment) or _all(cells, is_date):
            continue
        try:
            dated = _of_stamps(read_stamps(_text(cells), choice.dates))
        except TimeTextError:
            continue
        if dated is None or dated.start is None:
            continue
        both = np.isfinite(dated.seconds) & np.isfinite(read.seconds)
        rate = float(np.ptp(dated.seconds[both])) if both.any() else 0.0
        other = float(np.ptp(read.seconds[both])) if both.any() else 0.0
        coarse = 2.0 * rate / max(int(both.sum()) - 1, 1)  # dates may be written to the minute, or be late by a row
        if not rate or not other or abs(rate - other) <= max(coarse, SAME_SPAN * rate):
            continue
        spans = f"spans {span(other)} where '{name}' spans {span(rate)}"
        if _has_unit(raw, columns[0]):
            return columns, read, [f"column '{columns[0]}' {spans}: --time-column {name} takes the dates"]
        return (name, *columns), dated, [f"column '{columns[0]}' without a unit {spans}: the dates are taken"]
    return columns, read, []


def _unreadable(raw: RawRecord, column: str, seconds: NDArray[np.float64]) -> list[str]:
    rows = np.flatnonzero(~np.isfinite(seconds))
    if not len(rows):
        return []
    said = "1 row has" if len(rows) == 1 else f"{len(rows)} rows have"
    where = f"(the first is {raw.place(int(rows[0]))})"
    held = np.zeros(len(seconds), dtype=bool)
    for cells in raw.cells:
        text = trimmed(cells)
        held |= (cells if text is None else text).is_valid().to_numpy()
    filled = int(held[rows].sum())  # a row without any cell is no loss
    if filled > may_be_lost(len(seconds)):
        raise RecordError(
            f"{raw.path}: {filled} of {len(seconds)} rows have no readable time in column '{column}' {where}; write "
            "all times in the same way, or take these rows out"
        )
    return [f"{said} no readable time {where}: dropped"]


def numbered(raw: RawRecord) -> TimeAxis:
    """Return rows by their number instead of a time; a column that could be one is left aside."""
    column = next((name for name in raw.names if is_time_name(name)), "")
    return TimeAxis(column, np.arange(len(raw.cells[0]), dtype=np.float64), None, (), columns=(column,))


def _scale(raw: RawRecord, column: str) -> float:
    """Return seconds per unit of the time column: as its name says, else as the file does."""
    named = seconds_per_unit(column)
    if named in (None, 1.0) and (unit := (raw.units or {}).get(column)):
        return SECONDS_PER.get(unit.lower(), 1.0)
    return named or 1.0


def _has_unit(raw: RawRecord, column: str) -> bool:
    """Return True where the name of the time column or the file gives its unit."""
    return names_unit(column) or (raw.units or {}).get(column, "").lower() in SECONDS_PER


def _find(raw: RawRecord, signs: dict[str, Sign], choice: Reading) -> tuple[str, ...]:
    """Return the column of times, or that of dates and that of times of day."""
    if choice.time_column is not None:
        wanted = (choice.time_column,) if choice.time_column in raw.names else tuple(choice.time_column.split(","))
        wanted = tuple(name.strip() for name in wanted)
        for name in wanted:
            if name not in raw.names:
                raise RecordError(f"{raw.path} has no column '{name}'; it has {_shown(raw)}")
        if len(wanted) > 2:
            raise RecordError(f"{raw.path}: --time-column takes one name, or two for dates and times of day")
        return wanted if len(wanted) == 2 else _with_partner(raw, wanted[0], signs)
    if "time_s" in raw.names:
        return ("time_s",)
    for name in raw.names:
        if is_time_name(name):
            return _with_partner(raw, name, signs)
    import pyarrow as pa

    for name, cells in zip(raw.names, raw.cells, strict=True):
        if pa.types.is_timestamp(cells.type) or pa.types.is_date(cells.type) or _all(cells, is_moment):
            return _with_partner(raw, name, signs)
    place = f" line {raw.header_line}" if raw.header_line else ""
    nameless = ", where the first column has no name" if raw.names[0] == "column_1" else ""
    raise RecordError(
        f"{raw.path}{place} has no column time_s (it has {_shown(raw)}{nameless}); name the column of sample times "
        "time_s, in seconds, or give --time-column; where each row is a steady state, give --at-rest to hil diagnose"
    )


def _shown(raw: RawRecord) -> str:
    return ", ".join(raw.names[:8]) + (", ..." if len(raw.names) > 8 else "")


def _with_partner(raw: RawRecord, name: str, signs: dict[str, Sign]) -> tuple[str, ...]:
    """Return the column alone, or with the one that has its dates or its times of day."""
    pairs = zip(raw.names, raw.cells, strict=True)
    kinds = {other: kind for other, cells in pairs if (kind := _kind(other, cells, signs.get(other, ".")))}
    kind = kinds.get(name, "")
    if not kind:
        return (name,)
    partners = [other for other, its in kinds.items() if other != name and its and its != kind]
    named = [other for other in partners if is_time_name(other)]
    partners = named if len(named) == 1 else partners
    if not partners:
        return (name,)
    if len(partners) > 1:
        raise RecordError(
            f"{raw.path} has the columns {', '.join(partners)} besides '{name}', and each may hold its "
            f"{'times of day' if kind == 'date' else 'dates'}; name both with --time-column {name},{partners[0]}"
        )
    return (name, partners[0]) if kind == "date" else (partners[0], name)


def _kind(name: str, cells: Any, sign: Sign) -> str:
    """Return "date" for a column of dates without times, "time" for one of times of day, "" for any other."""
    import pyarrow as pa

    if pa.types.is_date(cells.type):
        return "date"
    if pa.types.is_time(cells.type):
        return "time"
    if _all(cells, is_date):
        return "date"
    if _all(cells, is_time_of_day):
        return "time"
    if not is_time_name(name):
        return ""
    numbers = parse(cells, sign)
    values = numbers.values[np.isfinite(numbers.values)] if numbers is not None else np.zeros(0)
    if len(values) and names_dates(name) and (values >= SHEET_DAYS[0]).all() and (values <= SHEET_DAYS[1]).all():
        return "date" if (values == np.round(values)).all() else ""
    return "time" if len(values) and (values >= 0.0).all() and (values < 1.0).all() else ""


def _all(cells: Any, test: Any) -> bool:
    """Return True where the first cells of a column of text all pass a test."""
    text = trimmed(cells)
    if text is None:
        return False
    first = text.drop_null()[:_SAMPLE].to_pylist()
    return bool(first) and all(test(cell) for cell in first)


def _pair(raw: RawRecord, columns: tuple[str, ...], signs: dict[str, Sign], choice: Reading) -> _Read | None:
    """Return the times of a column of dates and one of times of day; as text, or as numbers of a spreadsheet."""
    dates, times = (raw.cells[raw.names.index(name)] for name in columns)
    numbers = [parse(cells, signs.get(name, ".")) for name, cells in zip(columns, (dates, times), strict=True)]
    if all(found is not None and found.present and not found.bad for found in numbers):
        day, hour = (found.values for found in numbers if found is not None)
        return _of_days(day + hour)
    texts = [_text(dates), _text(times)]
    both = [None if d is None or t is None else f"{d} {t}" for d, t in zip(*texts, strict=True)]
    return _of_stamps(read_stamps(both, choice.dates))


def _text(cells: Any) -> list[str | None]:
    import pyarrow as pa

    text = trimmed(cells)
    found: list[str | None] = (cells.cast(pa.string()) if text is None else text).to_pylist()
    return found


def _of_stamps(stamps: Stamps) -> _Read | None:
    import pyarrow as pa

    micros = pa.chunked_array([stamps.micros], pa.int64())
    if micros.null_count == len(micros):
        return None
    seconds, origin = _whole_numbers(micros, 1e-6)
    if not stamps.dated:
        note = "" if stamps.how.startswith("days") else "a gap of a day or more cannot be seen in it"
        return _Read(seconds, None, stamps.how, note)
    how = stamps.how + ("" if stamps.zoned else f" {ZONELESS}")
    return _Read(seconds, _EPOCH + datetime.timedelta(seconds=origin), how, stamps.note, not stamps.zoned)


def _of_days(days: NDArray[np.float64]) -> _Read:
    """Return the times of day numbers of a spreadsheet, rounded to the millisecond."""
    first = float(np.nanmin(days))
    seconds = np.round((days - first) * 86400.0, 3)
    start = _SHEET_EPOCH + datetime.timedelta(seconds=round(first * 86400.0, 3))
    return _Read(seconds, start, f"day numbers of a spreadsheet {ZONELESS}", zoneless=True)


def _seconds(name: str, cells: Any, sign: Sign, scale: float, choice: Reading, unit_given: bool) -> _Read | None:
    import pyarrow as pa

    kind = cells.type
    if pa.types.is_date(kind):
        cells = cells.cast(pa.timestamp("ms"))
        kind = cells.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind.unit]
        seconds, origin = _whole_numbers(cells.cast(pa.int64()), 1.0 / per_second)
        if pa.types.is_duration(kind):
            return _Read(seconds + origin)
        return _Read(seconds, _moment(origin), "a timestamp")
    if pa.types.is_time(kind):
        stamps = read_times_of_day(_text(cells))
        return None if stamps is None else _of_stamps(stamps)
    numbers = parse(cells, sign)
    if numbers is None:
        return None
    if numbers.bad > numbers.present / 2:
        written = _text(cells)
        clock = read_times_of_day(written)
        return _of_stamps(clock if clock is not None else read_stamps(written, choice.dates))
    values = np.where(np.abs(numbers.values) < _NO_CLOCK, numbers.values, np.nan)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    middle = float(np.median(finite))
    if _COMPACT[0] <= middle <= _COMPACT[1]:
        stamps = read_stamps([None if math.isnan(x) else f"{x:.0f}" for x in values], choice.dates)
        if sum(x is not None for x in stamps.micros) > len(finite) / 2:
            return _of_stamps(stamps)
    if not (unit_given and middle * scale < EPOCH_S[1]) and (moments := compact_moments(values)) is not None:
        return _of_stamps(read_stamps(moments, choice.dates))
    if choice.time_scale == 1.0 and scale == 1.0:
        if names_dates(name) and SHEET_DAYS[0] <= middle <= SHEET_DAYS[1]:
            return _of_days(values)
        if are_days(cells, finite, unit_given):
            return _of_days(values)
    read = _since_1970(cells, values, scale, unit_given)
    if numbers.thousands:
        return replace(read, note=f"{numbers.thousands} numbers with marks between thousands read without them")
    return read


def _since_1970(cells: Any, values: NDArray[np.float64], scale: float, unit_given: bool) -> _Read:
    """Return numbers that count from 1970 shifted to their first, and any other numbers as they are, in seconds."""
    import pyarrow as pa
    import pyarrow.compute as pc

    middle = float(np.nanmedian(values))
    count = count_of(middle, scale, unit_given)
    if count is None:
        return _Read(values * scale)
    unit, word = count
    clock_set = 0.5 * middle  # earlier stamps are of a clock that had not been set yet
    kind = cells.type
    if pa.types.is_integer(kind) and not pa.types.is_uint64(kind):
        seconds, origin = _whole_numbers(pc.cast(cells, pa.int64()), unit, clock_set)
    else:
        first = values[values >= clock_set].min()
        origin, seconds = float(first) * unit, np.where(values >= clock_set, (values - first) * unit, np.nan)
    return _Read(seconds, _moment(origin), f"{word} since 1970")


def _moment(seconds: float) -> datetime.datetime:
    try:
        return _EPOCH + datetime.timedelta(seconds=seconds)
    except OverflowError:
        raise TimeTextError("its numbers are no times since 1970; write seconds from the beginning") from None


def _whole_numbers(cells: Any, unit: float, least: float = -math.inf) -> tuple[NDArray[np.float64], float]:
    """Return integer `cells` of at least `least` as seconds from the first: float64 would round epoch nanoseconds."""
    import pyarrow.compute as pc

    valid = pc.is_valid(cells).to_numpy()
    stamps = pc.fill_null(cells, 0).to_numpy()
    valid &= stamps >= least
    if not valid.any():
        return np.full(len(stamps), np.nan), 0.0
    origin = int(stamps[valid].min())
    return np.where(valid, (stamps - origin) * unit, np.nan), origin * unit
