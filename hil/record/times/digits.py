"""Dates and times of day that are written as one number each: 20260304 and 93015 for 2026-03-04 09:30:15.

Loggers without a clock format write such columns, often without their leading zeros. Read as seconds they jump by 41 at
the end of each minute. A column is read as a clock where its name or its zeros say so, or where its steps are regular
as a clock and not as seconds. Where both fit and the times differ, it is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.times.names import format_of, is_time_name, names_days, names_unit
from hil.record.times.wall_clock import TimeTextError
from hil.record.values import Sign, parse, trimmed

Values = NDArray[np.float64]

_DAY_S = 86400.0
_ODD = 0.5
"""Relative distance from the median step beyond which a step is irregular: clocks jitter, and a gap is longer."""
_ELAPSED = re.compile(r"elapsed|run|rel|x value", re.IGNORECASE)
"""Names of times since the beginning, which no clock shows."""


@dataclass(frozen=True)
class _Clock:
    """Form of a clock's digits: `name` as users write it, and the value of one hour and of one minute in them."""

    name: str
    hour: int
    minute: int

    def seconds(self, values: Values) -> Values | None:
        """Return seconds after midnight of `values (n,)`, None where one is no time of day; 2400 ends the day."""
        known = np.isfinite(values)
        if not ((values[known] >= 0.0) & (values[known] <= 24.0 * self.hour)).all():
            return None
        rest = values % self.hour
        hours, minutes = values // self.hour, rest // self.minute
        seconds = rest % self.minute if self.minute > 1 else np.zeros_like(values)
        made = hours * 3600.0 + minutes * 60.0 + seconds
        whole = self.minute > 1 or (values[known] == np.round(values[known])).all()
        fits = (minutes < 60) & (seconds < 60) & (made <= _DAY_S)
        return made if whole and bool(fits[known].all()) else None


_CLOCKS = (_Clock("HHMMSS", 10_000, 100), _Clock("HHMM", 100, 1))


def may_be_clock(name: str, cells: Any, sign: Sign) -> bool:
    """Return True for a column of a time's name whose numbers all are times of day as digits."""
    if not is_time_name(name) or names_unit(name) or _ELAPSED.search(name):
        return False
    values = _numbers(cells, sign)
    return values is not None and any(clock.seconds(values) is not None for clock in _CLOCKS)


def may_be_dates(name: str, cells: Any, sign: Sign) -> bool:
    """Return True for a column named after dates whose numbers all are dates as six to eight digits."""
    values = _numbers(cells, sign)
    return names_days(name) and values is not None and date_texts(values) is not None


def date_texts(values: Values) -> list[str | None] | None:
    """Return dates of the digits yyyymmdd, ddmmyyyy or of two digits each, in the order of the file; None for others.

    Their order of day, month and year stays open where it does not begin with the year of four digits.
    """
    there = values[np.isfinite(values)]
    if not len(there) or (there != np.round(there)).any():
        return None
    least, most = float(there.min()), float(there.max())
    if least >= 1e7 and _are_dates(there // 10_000, there // 100 % 100, there % 100):
        return [None if np.isnan(x) else _separated(f"{x:.0f}", 4, 6) for x in values]
    first, second, last = (there // 1e6, there // 1e4 % 100, there % 1e4) if most >= 1e6 else _pairs(there)
    if most >= 1e8 or least < (1e6 if most >= 1e6 else 1e5):
        return None
    years = last if most >= 1e6 else 2000.0 + last
    if most >= 1e6:
        fits = _are_dates(years, second, first) or _are_dates(years, first, second)
    else:
        orders = ((years, second, first), (years, first, second), (2000.0 + first, second, last))
        fits = any(_are_dates(*order) for order in orders)
    if not fits:
        return None
    width = 8 if most >= 1e6 else 6
    return [None if np.isnan(x) else _separated(f"{x:0{width}.0f}", 2, 4) for x in values]


def _separated(digits: str, first: int, second: int) -> str:
    return f"{digits[:first]}-{digits[first:second]}-{digits[second:]}"


def clock_texts(name: str, cells: Any, sign: Sign, dates: Sequence[str | None] | None) -> list[str | None] | None:
    """Return times as `hh:mm:ss`, None where the column holds seconds.

    Args:
        name, cells, sign: of the column. dates: that of each row (n,), None for a column without dates beside it.

    Raises:
        TimeTextError: the name says that it is a clock and a number is none; or it may be one and may be seconds.
    """
    if names_unit(name) or _ELAPSED.search(name):
        return None
    values = _numbers(cells, sign)
    if values is None:
        return None
    fits = {clock: made for clock in _CLOCKS if (made := clock.seconds(values)) is not None}
    asked = format_of(name) or _padded(cells)
    if asked is not None:
        fits = {clock: made for clock, made in fits.items() if clock.name == asked}
        if not fits and format_of(name) is not None:
            raise TimeTextError(f"its name says {asked}, and not all of its numbers are such times; correct the name")
    if not fits:
        return None
    clock = next(iter(fits)) if asked is not None else _likeliest(values, fits, _day_starts(dates))
    return None if clock is None else [clock_text(x) for x in fits[clock]]


def _numbers(cells: Any, sign: Sign) -> Values | None:
    numbers = parse(cells, sign)
    if numbers is None or numbers.bad or np.isinf(numbers.values).any() or np.isnan(numbers.values).all():
        return None
    return numbers.values


def _padded(cells: Any) -> str | None:
    """Return the form that leading zeros show: all cells have four or six digits, and one begins with zero."""
    text = trimmed(cells)
    whole = [] if text is None else [re.split("[.,]", cell)[0] for cell in text.drop_null().to_pylist()]
    if not any(cell.startswith("0") for cell in whole):
        return None
    return {frozenset((4,)): "HHMM", frozenset((6,)): "HHMMSS"}.get(frozenset(map(len, whole)))


def _day_starts(dates: Sequence[str | None] | None) -> Values | None:
    """Return a number for each row's day (n,) in s, a day apart where the text of the date changes."""
    if dates is None:
        return None
    changed = [k > 0 and date != dates[k - 1] for k, date in enumerate(dates)]
    return np.cumsum(changed) * _DAY_S


def _likeliest(values: Values, fits: dict[_Clock, Values], days: Values | None) -> _Clock | None:
    """Return the clock whose steps are more regular than all other readings'; None for seconds.

    Raises:
        TimeTextError: two readings are as regular, and the times between their rows differ.
    """
    readings: dict[_Clock | None, Values] = {}
    for clock, made in fits.items():
        readings[clock] = _steps(made, days)
    if days is None or float(np.nanmax(values)) < _DAY_S:
        readings[None] = _steps(values, days) if days is not None else np.diff(values[np.isfinite(values)])
    odd = {clock: _odd(steps) for clock, steps in readings.items()}
    best = [clock for clock, count in odd.items() if count == min(odd.values())]
    if len(best) == 1:
        return best[0]
    steps = readings.get(None, np.zeros(0))
    if None in best and days is None and len(steps) and values[0] in (0.0, float(np.median(steps))):
        return None  # A time since the beginning begins at zero, or one step later.
    if all(np.array_equal(readings[clock], readings[best[0]]) for clock in best[1:]):
        return best[0] if days is not None else None
    if days is None and None in best and not _crosses(values, best):
        return None
    may_be = " or ".join("seconds" if clock is None else f"digits of {clock.name}" for clock in best)
    names = " or ".join("time_s" if clock is None else clock.name for clock in best)
    raise TimeTextError(f"{values[0]:.12g} may be {may_be}; name the column of times {names}")


def _steps(seconds: Values, days: Values | None) -> Values:
    """Return the steps between rows in s; without dates a clock that goes back by half a day passed midnight."""
    known = np.isfinite(seconds)
    steps = np.diff(seconds[known] + (days[known] if days is not None else 0.0))
    return steps if days is not None else np.where(steps < -_DAY_S / 2, steps + _DAY_S, steps)


def _crosses(values: Values, clocks: Sequence[_Clock | None]) -> bool:
    """Return True where a number passed the end of a minute of HHMMSS, where seconds would have gone on to 60."""
    there = values[np.isfinite(values)]
    return any(clock is not None and clock.minute > 1 for clock in clocks) and len(np.unique(there // 100)) > 1


def _odd(steps: Values) -> int:
    """Return the number of steps that go back, or differ from the median of those that go on."""
    forward = steps[steps > 0.0]
    if not len(forward):
        return len(steps)
    middle = float(np.median(forward))
    return int((steps < 0.0).sum() + (np.abs(forward - middle) > _ODD * middle).sum())


def clock_text(seconds: float) -> str | None:
    """Return seconds of the day as hh:mm:ss, with the parts of a second where there are any; None for NaN."""
    if np.isnan(seconds):
        return None
    micros = round(float(seconds) * 1e6)
    minutes, rest = divmod(micros, 60_000_000)
    fraction = f".{rest % 1_000_000:06d}" if rest % 1_000_000 else ""
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{rest // 1_000_000:02d}{fraction}"


def _pairs(numbers: Values) -> tuple[Values, Values, Values]:
    return numbers // 10_000, numbers // 100 % 100, numbers % 100


def _are_dates(years: Values, months: Values, days: Values) -> bool:
    """Return True for dates of 1950 to 2100; the length of a month is left to the reading of the dates."""
    fits = (years >= 1950) & (years < 2101) & (months >= 1) & (months <= 12) & (days >= 1) & (days <= 31)
    return bool(fits.all())
