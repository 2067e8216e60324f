"""Dates and times with a column for each part: year, month, day or day of the year, hour, minute, second."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.times.counts import names_count, seconds_of_day
from hil.record.times.digits import clock_text, clock_texts
from hil.record.times.names import is_time_name
from hil.record.times.text import is_time_of_day
from hil.record.times.wall_clock import TimeTextError
from hil.record.values import Sign, parse, trimmed

_WORDS = {
    "year": "year yr jahr yyyy annee année anno año",
    "month": "month mon monat mm mois mese mes",
    "day": "day dd tag jour giorno dia día dayofmonth",
    "doy": "doy yday jday dayofyear julianday tagdesjahres",
    "hour": "hour hours hr hh stunde stunden heure ora hora",
    "minute": "minute minutes min minuten mi",
    "second": "second seconds sec sekunde sekunden ss seconde",
}
_PART_OF = {word: part for part, words in _WORDS.items() for word in words.split()}
_RANGES = {"year": (1950, 2100), "month": (1, 12), "day": (1, 31), "doy": (1, 366)}
_FROM_COARSEST = ("year", "month", "day", "doy", "hour", "minute", "second")
"""Parts of a date; the finest of those that are there may have a fraction."""
_RANGES |= {"hour": (0, 24), "minute": (0, 59), "second": (0, 60)}


def find_parts(names: Sequence[str]) -> dict[str, str] | None:
    """Return part -> column of a date in parts, with `clock` for a column of times of day beside it; None for no date.

    A date needs a year, and a month and day or a day of the year. Minutes need an hour, and seconds need minutes.
    """
    found: dict[str, str] = {}
    for name in names:
        part = _PART_OF.get("".join(letter for letter in name.lower() if letter.isalpha()))
        if part is not None and found.setdefault(part, name) != name:
            return None
    if "year" not in found or not ({"month", "day"} <= found.keys() or "doy" in found):
        return None
    for part, needed in (("minute", "hour"), ("second", "minute")):
        if part in found and needed not in found:
            del found[part]
    if "doy" in found and {"month", "day"} <= found.keys():
        del found["doy"]
    clocks = [name for name in names if name not in found.values() and is_time_name(name)]
    if len(clocks) > 1 or (clocks and "hour" in found):
        return None
    return found | ({"clock": clocks[0]} if clocks else {})


def stamp_texts(parts: Mapping[str, str], cells: Mapping[str, Any], signs: Mapping[str, Sign]) -> list[str | None]:
    """Return the moments of the rows as ISO 8601 text, None where a part is missing.

    Raises:
        TimeTextError: a column holds a number that is no such part of a date, or the clock is none.
    """
    clock = parts.get("clock")
    finest = None if clock is not None else [part for part in _FROM_COARSEST if part in parts][-1]
    numbers = {
        part: _numbers(part, name, cells[name], signs, may_have_fraction=part == finest)
        for part, name in parts.items()
        if part != "clock"
    }
    rows = len(numbers["year"])
    dates = [_date({part: float(values[row]) for part, values in numbers.items()}) for row in range(rows)]
    if clock is None:
        return [None if date is None else date.isoformat(" ") for date in dates]
    days = [None if date is None else f"{date:%Y-%m-%d}" for date in dates]
    text = trimmed(cells[clock])
    times = None if text is None else text.to_pylist()
    if times is None or not all(cell is None or is_time_of_day(cell) for cell in times):
        times = _clock_of_count(clock, cells[clock], signs.get(clock, ".")) or clock_texts(
            clock, cells[clock], signs.get(clock, "."), days
        )
    if times is None:
        raise TimeTextError(f"the numbers of '{clock}' are no times of day beside dates; write hh:mm:ss")
    return [None if day is None or time is None else f"{day} {time}" for day, time in zip(days, times, strict=True)]


def _clock_of_count(name: str, cells: Any, sign: Sign) -> list[str | None] | None:
    """Return the times of day of a column of seconds, minutes or hours since midnight, None for any other column."""
    seconds = None if names_count(name) is None else seconds_of_day({name: cells}, (name,), {name: sign})
    return None if seconds is None else [clock_text(float(value)) for value in seconds]


def _numbers(
    part: str, name: str, cells: Any, signs: Mapping[str, Sign], *, may_have_fraction: bool
) -> NDArray[np.float64]:
    numbers = parse(cells, signs.get(name, "."))
    low, high = _RANGES[part]
    if numbers is None or numbers.bad:
        raise TimeTextError(f"'{name}' holds text where the {part} is expected; write numbers")
    values = numbers.values
    with np.errstate(invalid="ignore"):
        wrong = (values < low) | (np.floor(values) > high) | ((values != np.floor(values)) & (not may_have_fraction))
    if (wrong & np.isfinite(values)).any():
        first = values[wrong & np.isfinite(values)][0]
        raise TimeTextError(
            f"'{name}' holds {first:g}, which is no {_named(part)} of a date; name the column otherwise"
        )
    return values


def _named(part: str) -> str:
    return "day of the year" if part == "doy" else part


def _date(parts: dict[str, float]) -> datetime.datetime | None:
    if any(np.isnan(value) for value in parts.values()):
        return None
    try:
        if "doy" in parts:
            day = datetime.datetime(int(parts["year"]), 1, 1) + datetime.timedelta(days=parts["doy"] - 1.0)
        else:
            day = datetime.datetime(int(parts["year"]), int(parts["month"]), int(parts["day"]))
            day += datetime.timedelta(days=parts["day"] % 1.0)
    except ValueError:
        return None
    hours, minutes, seconds = (parts.get(part, 0.0) for part in ("hour", "minute", "second"))
    return day + datetime.timedelta(hours=hours, minutes=minutes, seconds=seconds)
