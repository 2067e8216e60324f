"""Seconds of a time column: text, typed columns of Parquet, counts from 1970 and day numbers."""

from __future__ import annotations

import datetime
import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.raw import RawRecord, ReadingOptions
from hil.record.times.columns import has_unit, plain_blanks, scale_of
from hil.record.times.counts import names_count, seconds_of_day
from hil.record.times.digits import clock_text, clock_texts, date_texts, may_be_clock, may_be_dates
from hil.record.times.names import names_days, pair_of
from hil.record.times.numbers import EPOCH_S, DayCount, are_days, compact_moments, count_of, day_count
from hil.record.times.parts import find_parts, stamp_texts
from hil.record.times.text import Stamps, TimeTextError, read_stamps, read_times_of_day
from hil.record.times.wall_clock import require_full_clock
from hil.record.values import Sign, parse, trimmed

ZONELESS = "without a time zone, taken as UTC"
"""End of a message on dates and times that may be local."""

_COMPACT = (19_500_101_000000, 21_001_231_235959)
"""Dates and times written as one number, 20260304233000: as milliseconds since 1970 they would be after 2580."""
_DAY_S = 86400.0
_TO_1904 = 1462
"""Days from the beginning of a spreadsheet's dates of 1900 to that of the dates of 1904 (old Macs)."""
_NO_CLOCK = 2.0**63
"""Number above any count of a clock, in nanoseconds too."""
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


@dataclass(frozen=True, eq=False)
class Seconds:
    """Seconds of a column and the time of its zero, with their format."""

    seconds: NDArray[np.float64]
    start: datetime.datetime | None = None
    how: str = ""
    note: str = ""
    zoneless: bool = False


def read_seconds(
    raw: RawRecord, columns: tuple[str, ...], signs: dict[str, Sign], choice: ReadingOptions
) -> Seconds | None:
    """Return the seconds of the rows by their columns of times, None where these hold no time.

    Raises
    ------
    TimeTextError
        The times may be read in two ways.
    """
    if (parts := find_parts(columns)) is not None:
        cells = dict(zip(raw.names, raw.cells, strict=True))
        return of_stamps(read_stamps(stamp_texts(parts, cells, signs)))
    if len(columns) > 1:
        return _pair(raw, columns, signs, choice)
    name = columns[0]
    cells = raw.cells[raw.names.index(name)]
    return _seconds(name, cells, signs.get(name, "."), scale_of(raw, name), choice, has_unit(raw, name))


def _pair(raw: RawRecord, columns: tuple[str, ...], signs: dict[str, Sign], choice: ReadingOptions) -> Seconds | None:
    """Return the times of a column of dates and one of times of day: text, spreadsheet numbers, or counts in a day."""
    cells = dict(zip(raw.names, raw.cells, strict=True))
    dates, times = (cells[name] for name in columns[:2])
    of_day = seconds_of_day(cells, columns[1:], signs) if names_count(columns[1]) is not None else None
    numbers = [parse(one, signs.get(name, ".")) for name, one in zip(columns, (dates, times), strict=False)]
    if all(found is not None and found.present and not found.bad for found in numbers):
        day, hour = (found.values for found in numbers if found is not None)
        count = day_count(float(np.nanmedian(day)))
        if count is not None:
            return _of_days(day + (hour if of_day is None else of_day / _DAY_S), count)
    days, sign = _date_cells(columns[0], dates, signs.get(columns[0], ".")), signs.get(columns[1], ".")
    clock: list[str | None] | None = text_of(times)
    if of_day is not None:
        clock = [clock_text(float(value)) for value in of_day]
    elif may_be_clock(columns[1], times, sign):
        clock = clock_texts(columns[1], times, sign, days)
    if clock is None:
        raise TimeTextError(f"the numbers of '{columns[1]}' are no times of day; name it time_s if they are seconds")
    both = [None if d is None or t is None else f"{d} {t}" for d, t in zip(days, clock, strict=True)]
    return of_stamps(read_stamps(both, choice.dates))


def _date_cells(name: str, cells: Any, sign: Sign) -> list[str | None]:
    """Return the dates of a column as text, with separators where they are digits alone."""
    numbers = parse(cells, sign) if may_be_dates(name, cells, sign) else None
    made = None if numbers is None else date_texts(numbers.values)
    return text_of(cells) if made is None else made


def text_of(cells: Any) -> list[str | None]:
    """Return the cells of a column as text, None if it has none."""
    import pyarrow as pa

    text = trimmed(cells)
    found: list[str | None] = (cells.cast(pa.string()) if text is None else text).to_pylist()
    return [None if cell is None else plain_blanks(cell) for cell in found]


def _with_three_fields(cells: list[str | None], form: str | None) -> list[str | None]:
    """Return times of two numbers as hours, minutes and seconds, as the name of their column says which they are."""
    if form is None:
        return cells
    out: list[str | None] = []
    for cell in cells:
        pair = None if cell is None else re.fullmatch(r"(\d{1,5}):([0-5]\d(?:[.,]\d+)?)", cell)
        if pair is None:
            out.append(cell)
        elif form == "hh:mm":
            out.append(f"{cell}:00")
        else:
            hours, minutes = divmod(int(pair[1]), 60)
            out.append(f"{hours:02d}:{minutes:02d}:{pair[2]}")
    return out


def of_stamps(stamps: Stamps) -> Seconds | None:
    """Return stamps as seconds from the first, None if no cell is one."""
    import pyarrow as pa

    micros = pa.chunked_array([stamps.micros], pa.int64())
    if micros.null_count == len(micros):
        return None
    seconds, origin = _whole_numbers(micros, 1e-6)
    if not stamps.dated:
        note = "" if stamps.how.startswith(("days", "minutes")) else "a gap of a day or more cannot be seen in it"
        return Seconds(seconds, None, stamps.how, note)
    how = stamps.how + ("" if stamps.zoned else f" {ZONELESS}")
    return Seconds(seconds, _EPOCH + datetime.timedelta(seconds=origin), how, stamps.note, not stamps.zoned)


def _of_days(days: NDArray[np.float64], count: DayCount) -> Seconds:
    """Return the times of day numbers, rounded to the millisecond."""
    first = float(np.nanmin(days))
    seconds = np.round((days - first) * 86400.0, 3)
    start = _EPOCH + datetime.timedelta(seconds=round((first - count.of_1970) * 86400.0, 3))
    _require_full_clock(np.round((days - count.of_1970) * 86400.0) * 1e6)
    note, from_1904 = "", start + datetime.timedelta(days=_TO_1904)
    if "spreadsheet" in count.name and from_1904 < datetime.datetime.now(datetime.UTC):
        note = f"days from 1900; in a workbook that counts from 1904 the record begins on {from_1904:%Y-%m-%d}"
    return Seconds(seconds, start, f"{count.name} {ZONELESS}", note, zoneless=True)


def _require_full_clock(micros: NDArray[np.float64]) -> None:
    """Raise TimeTextError where microseconds since 1970 show a clock of twelve hours without AM and PM."""
    there = micros[np.abs(micros) < _NO_CLOCK]
    if len(there) < 2:
        return
    require_full_clock(
        there.astype(np.int64), (there // 3_600_000_000 % 24).astype(np.int64), lambda row: _moment_text(there[row])
    )


def _moment_text(micros: float) -> str:
    return f"{_moment(micros * 1e-6):%Y-%m-%d %H:%M:%S}"


def _seconds(
    name: str, cells: Any, sign: Sign, scale: float, choice: ReadingOptions, unit_given: bool
) -> Seconds | None:
    import pyarrow as pa

    kind = cells.type
    if pa.types.is_date(kind):
        cells = cells.cast(pa.timestamp("ms"))
        kind = cells.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind.unit]
        seconds, origin = _whole_numbers(cells.cast(pa.int64()), 1.0 / per_second)
        if pa.types.is_duration(kind):
            return Seconds(seconds + origin)
        start = _moment(origin)
        _require_full_clock((seconds + origin) * 1e6)
        how = f"a timestamp {ZONELESS}" if kind.tz is None else "a timestamp"
        return Seconds(seconds, start, how, zoneless=kind.tz is None)
    if pa.types.is_time(kind):
        stamps = read_times_of_day(text_of(cells))
        return None if stamps is None else of_stamps(stamps)
    numbers = parse(cells, sign)
    if numbers is None:
        return None
    if numbers.bad > numbers.present / 2:
        written = _with_three_fields(text_of(cells), pair_of(name))
        clock = read_times_of_day(written)
        return of_stamps(clock if clock is not None else read_stamps(written, choice.dates))
    values = np.where(np.abs(numbers.values) < _NO_CLOCK, numbers.values, np.nan)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    middle = float(np.median(finite))
    if _COMPACT[0] <= middle <= _COMPACT[1]:
        stamps = read_stamps([None if math.isnan(x) else f"{x:.0f}" for x in values], choice.dates)
        if sum(x is not None for x in stamps.micros) > len(finite) / 2:
            return of_stamps(stamps)
    if not (unit_given and middle * scale < EPOCH_S[1]) and (moments := compact_moments(values)) is not None:
        return of_stamps(read_stamps(moments, choice.dates))
    if not unit_given and not numbers.bad and choice.time_scale == 1.0:
        digits = _of_digits(name, cells, sign, values, choice)
        if digits is not None:
            return digits
    count = day_count(float(finite.min()))
    count = count if count == day_count(float(finite.max())) else None
    if choice.time_scale == 1.0 and count is not None:
        if scale == _DAY_S or (scale == 1.0 and (names_days(name) or are_days(cells, finite, count, unit_given))):
            return _of_days(values, count)
    elif choice.time_scale == 1.0 and scale == 1.0:
        are_days(cells, finite, None, unit_given)
    read = _since_1970(cells, values, scale, unit_given)
    if numbers.thousands:
        return replace(read, note=f"{numbers.thousands} numbers with marks between thousands read without them")
    return read


def _of_digits(
    name: str, cells: Any, sign: Sign, values: NDArray[np.float64], choice: ReadingOptions
) -> Seconds | None:
    """Return the times of a column of dates, or of times of day, that are digits alone; None for any other."""
    dates = date_texts(values) if np.nanmin(values) >= 1e7 or names_days(name) else None
    if dates is not None:
        return of_stamps(read_stamps(dates, choice.dates))
    clock = clock_texts(name, cells, sign, None)
    if clock is None:
        return None
    stamps = read_times_of_day(clock)
    return None if stamps is None else of_stamps(replace(stamps, how="a time of day in digits (hours, minutes ...)"))


def _since_1970(cells: Any, values: NDArray[np.float64], scale: float, unit_given: bool) -> Seconds:
    """Shift numbers that count from 1970 to their first, and return any other numbers unchanged, in seconds."""
    import pyarrow as pa
    import pyarrow.compute as pc

    middle = float(np.nanmedian(values))
    count = count_of(middle, scale, unit_given)
    if count is None:
        return Seconds(values * scale)
    unit, word = count
    clock_set = 0.5 * middle  # Earlier stamps are of a clock that had not been set yet.
    kind = cells.type
    if pa.types.is_integer(kind) and not pa.types.is_uint64(kind):
        seconds, origin = _whole_numbers(pc.cast(cells, pa.int64()), unit, clock_set)
    else:
        first = values[values >= clock_set].min()
        origin, seconds = float(first) * unit, np.where(values >= clock_set, (values - first) * unit, np.nan)
    return Seconds(seconds, _moment(origin), f"{word} since 1970")


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
