"""Time axis of a record: seconds of its rows, the date of the first, and messages on irregularities."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.record.raw import RawRecord, ReadingOptions, RecordError
from hil.record.times.columns import all_cells, find_columns, has_unit, scale_of
from hil.record.times.counts import with_subseconds
from hil.record.times.names import is_time_name
from hil.record.times.seconds import ZONELESS, Seconds, of_stamps, read_seconds, text_of
from hil.record.times.text import TimeTextError, is_date, is_moment, read_stamps
from hil.record.times.wall_clock import unfolded
from hil.record.times.zone_column import with_zone_column
from hil.record.times.zones import moment_in, zone_of
from hil.record.values import Sign, may_be_lost, trimmed

GAP_PERIODS = 5
"""Typical steps in a step that counts as a gap."""

_LETTERS = re.compile(r"[\[(]\s*([A-Z]{3,5})\s*[\])]")
"""Capital letters in brackets, as abbreviations of zones are written."""
_NO_ZONES = ("YYYY", "HHMM", "LOCAL")
SAME_SPAN = 0.1
"""Relative difference of the spans of two time columns: no clock is that wrong, and units differ by more."""


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """Time axis: `seconds (n,)` as stored, NaN if unreadable; `start` is the UTC time of 0 s if the record states it.
    `zoneless`: dates and times without a time zone, which may be local. `columns` are all source columns of the times.

    `zoneless`: dates and times without a time zone, which may be local. `columns` are all that the times are read from.
    """

    column: str
    seconds: NDArray[np.float64]
    start: datetime.datetime | None
    messages: tuple[str, ...]
    zoneless: bool = False
    columns: tuple[str, ...] = ()


def span(seconds: float) -> str:
    """Format `seconds` for a message: 42 s, 5 min 20 s, 3 h 10 min."""
    if abs(seconds) < 60:
        return f"{seconds:.3g} s"
    whole = round(abs(seconds))
    sign = "-" if seconds < 0 else ""
    if whole < 3600:
        return f"{sign}{whole // 60} min" + (f" {whole % 60} s" if whole % 60 else "")
    minutes = round(whole / 60)
    return f"{sign}{minutes // 60} h" + (f" {minutes % 60} min" if minutes % 60 else "")


def read_time(raw: RawRecord, signs: dict[str, Sign], choice: ReadingOptions) -> TimeAxis:
    """Find and read the time of `raw`, whose numbers have the decimal `signs`.

    Raises
    ------
    RecordError
        There is none, it may be read in two ways, or more rows than `may_be_lost` have none.
    """
    columns = find_columns(raw, signs, choice)
    column = ", ".join(columns)
    messages = []
    try:
        read = read_seconds(raw, columns, signs, choice)
        if choice.time_column is None and read is not None and read.start is None:
            columns, read, said = _checked(raw, columns, read, choice)
            column = columns[0] if said else column
            messages += said
        if read is not None:
            columns, read, said = with_subseconds(raw, columns, read, signs)
            columns, read, more = with_zone_column(raw, columns, read)
            messages += [*said, *more]
    except TimeTextError as error:
        raise RecordError(f"{raw.path}: column '{column}': {error}") from error
    if read is None or not np.isfinite(read.seconds).any():
        raise RecordError(
            f"{raw.path} has no readable time in column '{column}'; write seconds, or ISO 8601 as 2026-11-02T10:00:00Z"
        )
    seconds, zone = read.seconds, zone_of(column)
    is_local = zone is None or not isinstance(zone[1], float)
    if read.zoneless and read.start is not None and is_local:
        seconds, said = unfolded(seconds, read.start, raw.place)
        messages += said
    if read.zoneless and read.start is not None and zone is not None:
        start = moment_in(zone[1], read.start)
        read = replace(read, start=start, how=read.how.replace(ZONELESS, f"in {zone[0]}"), zoneless=False)
    elif read.zoneless and (letters := _LETTERS.search(column)) is not None and letters[1] not in _NO_ZONES:
        messages.append(f"{column}: '{letters[1]}' in its name is no zone of one meaning: write UTC+01:00 or such")
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
        named = unit.get(scale_of(raw, columns[0]), "seconds")
        messages.insert(0, f"column '{column}' is taken for time_s, in {named}")
    messages += [f"{column}: {read.note}"] if read.note else []
    messages += _unreadable(raw, column, seconds)
    return TimeAxis(column, seconds, read.start, tuple(messages), read.zoneless, columns)


def _checked(
    raw: RawRecord, columns: tuple[str, ...], read: Seconds, choice: ReadingOptions
) -> tuple[tuple[str, ...], Seconds, list[str]]:
    """Return the times, or those of a column of dates that runs at another rate than a column without a unit.

    A name with a unit keeps its times, since a simulated rig's clock may go faster than that of the dates.
    """
    for name, cells in zip(raw.names, raw.cells, strict=True):
        if name in columns or not all_cells(cells, is_moment) or all_cells(cells, is_date):
            continue
        try:
            dated = of_stamps(read_stamps(text_of(cells), choice.dates))
        except TimeTextError:
            continue
        if dated is None or dated.start is None:
            continue
        both = np.isfinite(dated.seconds) & np.isfinite(read.seconds)
        rate = float(np.ptp(dated.seconds[both])) if both.any() else 0.0
        other = float(np.ptp(read.seconds[both])) if both.any() else 0.0
        coarse = 2.0 * rate / max(int(both.sum()) - 1, 1)  # Dates may be written to the minute, or be late by a row.
        if not rate or not other or abs(rate - other) <= max(coarse, SAME_SPAN * rate):
            continue
        spans = f"spans {span(other)} where '{name}' spans {span(rate)}"
        if has_unit(raw, columns[0]):
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
    filled = int(held[rows].sum())  # A row without any cell is no loss.
    if filled > may_be_lost(len(seconds)):
        raise RecordError(
            f"{raw.path}: {filled} of {len(seconds)} rows have no readable time in column '{column}' {where}; write "
            "all times in the same way, or take these rows out"
        )
    return [f"{said} no readable time {where}: dropped"]


def numbered(raw: RawRecord) -> TimeAxis:
    """Return rows by their number instead of a time; a possible time column is ignored."""
    column = next((name for name in raw.names if is_time_name(name)), "")
    return TimeAxis(column, np.arange(len(raw.cells[0]), dtype=np.float64), None, (), columns=(column,))
