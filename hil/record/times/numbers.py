"""Numbers in a column of times: seconds, a count since 1970, day numbers, or a date written as one number.

A number alone does not show its kind. The name's unit comes first, then the only kind that gives a date between 2000
and 2100. Where two kinds remain and their times differ, the column is refused.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.times.text import TimeTextError
from hil.record.values import trimmed

EPOCH_S = (946_684_800.0, 4_102_444_800.0)
"""Seconds since 1970 of the years 2000 and 2100: a record with a date lies between them."""
UPTIME_S = 1e8
"""Longest time from the start in s without a unit in the column's name: three years."""
COUNTS = ((1e-9, "nanoseconds"), (1e-6, "microseconds"), (1e-3, "milliseconds"), (1.0, "seconds"))
_WORDS = {60.0: "minutes", 3600.0: "hours"} | dict(COUNTS)
_DAY_S = 86400.0


@dataclass(frozen=True)
class DayCount:
    """Numbering of days with their fractions.

    Attributes
    ----------
    name, one
        Of several and of one, for messages.
    of_1970
        The number of 1970-01-01 00:00.
    first, last
        Numbers that are taken for it.
    """

    name: str
    one: str
    of_1970: float
    first: float
    last: float


DAY_COUNTS = (
    DayCount("day numbers of a spreadsheet", "a day number of a spreadsheet", 25_569.0, 20_000.0, 51_544.0),
    DayCount("modified Julian dates", "a modified Julian date", 40_587.0, 51_544.0, 88_070.0),
    DayCount("day numbers of MATLAB", "a day number of MATLAB", 719_529.0, 726_834.0, 767_011.0),
    DayCount("Julian dates", "a Julian date", 2_440_587.5, 2_447_892.0, 2_488_070.5),
)
"""Day counts in use. 51544 is 2000-01-01 as a modified Julian date and 2041-02-11 in a spreadsheet: no record is of the
future, and none before 2000 has modified Julian dates. Spreadsheets count from 1899-12-30 (ECMA-376, 18.17.4.1), MATLAB
from the year 0, Julian dates from noon.
"""
TINY_S = 0.5
"""Largest median step of day numbers, but for daily values, below half a day: as seconds it would be below half a
second.
"""
_ROUND_S = tuple(k * unit for unit in (1, 60) for k in (1, 2, 5, 10, 15, 20, 30)) + tuple(
    3600 * k for k in (1, 2, 3, 4, 6, 8, 12)
)
"""Periods at which loggers sample, s."""
_REMEDY = "write the unit into the column's name (time_s, time_d), or give dates as 2026-11-02T10:00:00Z"


def count_of(middle: float, scale: float, unit_given: bool) -> tuple[float, str] | None:
    """Return seconds per count and its word for numbers that count from 1970; None for a time from the beginning.

    Parameters
    ----------
    middle
        Median of the numbers.
    scale
        Seconds per unit that the name or the file gives, 1 without one.
    unit_given
        True where the name or the file gives the unit; it wins over the size of the numbers.

    Raises
    ------
    TimeTextError
        The numbers are too large for a time since the beginning and are no date of 2000 to 2100.
    """
    seconds = middle * scale
    if unit_given and scale < _DAY_S and EPOCH_S[0] <= seconds < EPOCH_S[1]:
        return scale, _WORDS.get(scale, "seconds")
    if seconds < (EPOCH_S[1] if unit_given else UPTIME_S) or scale >= _DAY_S:
        return None
    for unit, word in COUNTS:
        if EPOCH_S[0] <= middle * unit < EPOCH_S[1]:
            return unit, word
    raise TimeTextError(
        f"{middle:.15g} is no time between 2000 and 2100, neither as seconds, milliseconds, microseconds or "
        f"nanoseconds since 1970 nor as digits of a date; {_REMEDY}"
    )


def compact_moments(values: NDArray[np.float64]) -> list[str | None] | None:
    """Return numbers of the digits yyyymmddHHMM, yymmddHHMMSS or yymmddHHMM as ISO 8601; None where one is no date.

    Ten digits below 2200000000 are left to seconds since 1970, which they are until 2039.
    """
    written = [None if math.isnan(x) else f"{x:.0f}" for x in values]
    there = [text for text in written if text is not None]
    lengths = {len(text) for text in there}
    if lengths == {12}:
        ways: tuple[str, ...] = ("%Y%m%d%H%M", "%y%m%d%H%M%S")
    elif lengths == {10} and min(there) >= "2200000000":
        ways = ("%y%m%d%H%M",)
    else:
        return None
    for way in ways:
        try:
            found = [None if text is None else datetime.datetime.strptime(text, way) for text in written]
        except ValueError:
            continue
        if all(one is None or 2000 <= one.year < 2069 for one in found):
            return [None if one is None else one.isoformat(" ") for one in found]
    return None


def day_count(middle: float) -> DayCount | None:
    """Return the numbering of days whose years since 1954 hold the number `middle`; None for no such number."""
    return next((count for count in DAY_COUNTS if count.first <= middle < count.last), None)


def are_days(cells: Any, values: NDArray[np.float64], count: DayCount | None, unit_given: bool) -> bool:
    """Return True for day numbers, False for seconds.

    Parameters
    ----------
    cells
        Of the column as stored, which show how many decimals were written.
    values
        Finite numbers of the column.
    count
        Numbering of days that they may be in, None for parts of a day.
    unit_given
        True where the name of the column says that they are seconds.

    Raises
    ------
    TimeTextError
        They may be days and seconds.
    """
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0.0]
    if not len(steps) or float(np.median(steps)) >= TINY_S:
        return False
    if unit_given and count is None:
        return False
    grid = _grid_of_days(values, _written_to(cells), whole=count is not None)
    if grid and count is not None and not unit_given:
        return True
    if grid or (count is not None and not unit_given):
        kind = count.one if count is not None else "a part of a day"
        named = "" if unit_given else ", or time_d into the column's name"
        raise TimeTextError(
            f"{values[0]:.12g} looks like {kind}; give --time-scale 86400{named} where it is one, and write seconds "
            "(time_s) where it is not"
        )
    return False


def _written_to(cells: Any) -> float:
    """Return the last decimal place of text cells, that of a float64 day number for others."""
    text = trimmed(cells)
    found: Sequence[str | None] = [] if text is None else text.to_pylist()
    places = [len(cell) - 1 - max(cell.rfind("."), cell.rfind(",")) for cell in found if cell and set(cell) & set(".,")]
    return max(10.0 ** -max(places, default=10), 1e-9)


def _grid_of_days(values: NDArray[np.float64], place: float, *, whole: bool) -> bool:
    """Return True where values lie on whole seconds as parts of a day, but not on whole milliseconds as seconds.

    With `whole` any number of seconds will do as their period, else only one at which loggers sample.
    """
    as_ms = (values - values[0]) * 1000.0
    if (np.abs(as_ms - np.round(as_ms)) < 1e-4).all():
        return False
    passed = np.mod(values - values[0], 1.0) if float(np.ptp(values)) <= 1.0 else values - values[0]
    passed, tolerance = passed * _DAY_S, place * _DAY_S
    steps = np.abs(np.diff(passed))
    middle = float(np.median(steps[steps > tolerance])) if (steps > tolerance).any() else 0.0
    least, most = math.ceil(max(middle - tolerance, 4 * tolerance, 1.0)), math.floor(middle + tolerance)
    periods = range(least, most + 1) if whole else [s for s in _ROUND_S if least <= s <= most]
    return any((np.abs(passed - period * np.round(passed / period)) <= tolerance + 1e-3).all() for period in periods)
