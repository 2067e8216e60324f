"""Counts in columns of their own beside dates and times: seconds of the day, hours and minutes, parts of a second.

`Date,Seconds` has a count that begins again with each date; a count that runs on over the dates is a time since the
beginning, and the dates are not needed. `Date,Hour,Minute` has parts of a clock, `Date,Time,ms` parts of a second.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.record.raw import RawRecord
from hil.record.times.names import SECONDS_PER, is_time_name, names_unit, seconds_per_unit
from hil.record.values import Sign, may_be_lost, parse

if TYPE_CHECKING:
    from hil.record.times.seconds import Seconds

_DAY_S = 86400.0
_WORDS = {
    3600.0: r"hours?|hrs?|hh|stunden?|heures?|ore|ora|horas?|uren|uur",
    60.0: r"minutes?|mins|minuten?|minuti|minuto|minutos",
    1.0: r"seconds?|secs?|sekunden?|secondes?|secondi|segundos?",
    1e-3: r"msecs?|milliseconds?|millisekunden?|millisecondes?",
}
_BESIDE_HOURS = {"mm": 60.0, "min": 60.0, "ss": 1.0, "ms": 1e-3}
"""Names that are counts only beside hours: alone they are millimetres or a minimum."""
_SUBSECONDS = (
    (1e-3, r"ms|msecs?|millis?|milliseconds?|millisekunden?|millisecondes?|milisegundos|millisecondi"),
    (1e-6, r"us|µs|usecs?|micros?|microseconds?|mikrosekunden?|microsecondes?"),
    (1e-9, r"ns|nsecs?|nanos?|nanoseconds?|nanosekunden?"),
    (1e-2, r"hundredths?|hundertstel|centi[eè]mes|centiseconds?"),
    (1e-1, r"tenths?|zehntel|dixi[eè]mes"),
)
_SUBSECOND_NAME = r"(?:time|zeit|timestamp|sub|fraction|frac|fractional)?[\s_.\[(]*(?:{})[\])]?"
_OF_DAY = r"(?:of(?:the)?day|(?:since|after|past|from)midnight|destages|seitmitternacht|dujour|depuisminuit)"
_SHORT = r"sod|secofday|tod"


def _bare(name: str) -> str:
    return re.sub(r"[\W_]+", "", name.strip().lower())


def names_count(name: str) -> float | None:
    """Return seconds per unit of a count within a day, by the name of its column; None for any other name."""
    bare = _bare(name)
    for seconds, words in _WORDS.items():
        if re.fullmatch(f"(?:{words}){_OF_DAY}?", bare):
            return seconds
    if re.fullmatch(_SHORT, bare):
        return 1.0
    found = re.fullmatch(rf"(?:tod|time{_OF_DAY})(.*)", bare)
    if found is not None and found[1] in SECONDS_PER:
        return SECONDS_PER[found[1]]
    scale = seconds_per_unit(name) if is_time_name(name) and names_unit(name) else None
    return scale if scale is not None and scale < _DAY_S else None


def find_counts(raw: RawRecord, dates: str, signs: dict[str, Sign]) -> tuple[tuple[str, ...], bool]:
    """Return the columns of counts beside the column `dates`, coarsest first, and True where they begin at midnight.

    No columns are returned where the numbers are neither within a day nor go on over the dates.
    """
    found: dict[float, str] = {}
    for name in raw.names:
        scale = None if name == dates else names_count(name)
        if scale is not None and found.setdefault(scale, name) != name:
            return (), False
    if 3600.0 in found:
        for name in raw.names:
            if (beside := _BESIDE_HOURS.get(_bare(name))) is not None:
                found.setdefault(beside, name)
    columns = tuple(found[scale] for scale in sorted(found, reverse=True))
    if not columns:
        return (), False
    cells = dict(zip(raw.names, raw.cells, strict=True))
    of_day = seconds_of_day(cells, columns, signs)
    if len(columns) > 1:
        return (columns, True) if of_day is not None else ((), False)
    if of_day is not None and re.search(f"{_OF_DAY}|^(?:{_SHORT})", _bare(columns[0])):
        return columns, True
    numbers = parse(cells[columns[0]], signs.get(columns[0], "."))
    if numbers is None or numbers.bad:
        return (), False
    known = np.isfinite(numbers.values)
    days = np.array(cells[dates].to_pylist(), dtype=object)[known]
    steps, changes = np.diff(numbers.values[known]), days[1:] != days[:-1]
    if changes.all():  # One row a day: a total of the day, not its time.
        return (), False
    for back in (steps < 0.0, steps > 0.0):  # The newest row may stand first.
        if int((back & ~changes).sum()) <= may_be_lost(len(known)):
            begins_again = int((back & changes).sum()) > 0
            return (columns, begins_again) if of_day is not None or not begins_again else ((), False)
    return (), False


def seconds_of_day(
    cells: Mapping[str, Any], columns: Sequence[str], signs: Mapping[str, Sign]
) -> NDArray[np.float64] | None:
    """Return seconds of the day (n,) of columns of counts, or None where they are no parts of one clock.

    Of several columns, coarsest first, each counts within a unit of the one before it.
    """
    total, most = None, _DAY_S
    for name in columns:
        scale = names_count(name) or _BESIDE_HOURS.get(_bare(name))
        numbers = None if scale is None else parse(cells[name], signs.get(name, "."))
        if scale is None or numbers is None or numbers.bad or not numbers.present:
            return None
        seconds = np.where(np.isfinite(numbers.values), numbers.values * scale, np.nan)
        known = seconds[np.isfinite(seconds)]
        if not len(known) or known.min() < 0.0 or known.max() > most or (most < _DAY_S and known.max() == most):
            return None
        total = seconds if total is None else total + seconds
        most = scale
    return total


def with_subseconds(
    raw: RawRecord, columns: tuple[str, ...], read: Seconds, signs: dict[str, Sign]
) -> tuple[tuple[str, ...], Seconds, list[str]]:
    """Return the columns and the times with the parts of a second that a column of its own gives, and messages.

    Its name is a part of a second, and all its numbers are whole and below one second. Times that have fractions
    themselves are complete.
    """
    known = np.isfinite(read.seconds)
    whole = read.seconds[known]
    if not len(whole) or (np.abs(whole - np.round(whole)) > 1e-6).any():
        return columns, read, []
    for name, cells in zip(raw.names, raw.cells, strict=True):
        if name in columns or (part := names_subseconds(name)) is None:
            continue
        numbers = parse(cells, signs.get(name, "."))
        if numbers is None or numbers.bad or not np.isfinite(numbers.values[known]).all():
            continue
        counts = numbers.values
        there = counts[known]
        if (there < 0.0).any() or (there * part >= 1.0).any() or (there != np.round(there)).any():
            return columns, read, [f"column '{name}' has numbers that are no parts of a second: not added to the times"]
        seconds = np.round((read.seconds + counts * part) / part) * part
        first = float(np.nanmin(seconds)) if read.start is not None else 0.0
        start = None if read.start is None else read.start + datetime.timedelta(seconds=first)
        said = [f"column '{name}' gives the parts of a second of the times"] if there.any() else []
        return (*columns, name), replace(read, seconds=seconds - first, start=start), said
    return columns, read, []


def names_subseconds(name: str) -> float | None:
    """Return seconds per unit of a count of parts of a second, by the name of its column; None for any other name."""
    bare = name.strip().lower()
    return next((part for part, words in _SUBSECONDS if re.fullmatch(_SUBSECOND_NAME.format(words), bare)), None)
