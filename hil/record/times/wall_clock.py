"""Clocks on a wall, which step back: by an hour at a change of clocks, by twelve where AM and PM are missing."""

from __future__ import annotations

import datetime
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

HOUR_S = 3600.0
_MONTHS = (3, 4, 9, 10, 11)
"""Months in which countries begin or end summer time (IANA time zone database, rules since 2007)."""
_LAST_HOUR = 4
"""Last hour of the night for a change of clocks."""
_LONGEST_S = 12 * HOUR_S
"""Longest typical step at which an hour more or less is distinguishable from an ordinary step."""
_JITTER_S = HOUR_S / 4
"""Most that a step may differ from a typical one, so that an hour more or less is no jitter."""
_HALF_DAY = 43_200_000_000
"""Microseconds."""
_NEXT_STEPS = 5
"""Typical steps within which a twelve-hour clock goes on after 12:59; a later time is another record."""


class TimeTextError(ValueError):
    """Error of an ambiguous time column; the message lacks file and column."""


def require_full_clock(micros: NDArray[np.int64], hours: NDArray[np.int64], shown: Callable[[int], str]) -> None:
    """Check that the times are not of a twelve-hour clock without AM and PM.

    Parameters
    ----------
    micros
        Microseconds (n,) in the order of the file.
    hours
        Hours (n,) as the clock shows them.
    shown
        Names the time of a row for the message.

    Raises
    ------
    TimeTextError
        Hours are 1 to 12 alone, and a time steps back by twelve hours and goes on from there.
    """
    steps = np.diff(micros)
    if not (steps < 0).any() or not (steps > 0).any() or hours.min() < 1 or hours.max() > 12:
        return
    after = steps + _HALF_DAY
    passes = (steps < 0) & (after > 0) & (after <= _NEXT_STEPS * np.median(steps[steps > 0]))
    if passes.any():
        raise TimeTextError(
            f"after '{shown(int(np.argmax(passes)))}' the clock steps back by twelve hours, as one of twelve hours "
            "without AM and PM does; write hours from 00 to 23, or AM and PM"
        )


def unfolded(
    seconds: NDArray[np.float64], start: datetime.datetime, place: Callable[[int], str]
) -> tuple[NDArray[np.float64], list[str]]:
    """Return `seconds (n,)` of local times, in file order, without the hour lost or gained by a change of clocks.

    A step counts as a change of clocks only in the night to a Sunday of a month with such changes, before four o'clock,
    and where it differs from an ordinary step by an hour. Among rows an hour or more apart that step must be the only
    one of its kind, since a missing row or a repeated one looks the same. `start` is the local time of 0 s; `place`
    names a row. The second result holds a sentence for each change.
    """
    rows = np.flatnonzero(np.isfinite(seconds))
    if len(rows) < 3:
        return seconds, []
    stamps = seconds[rows]
    steps = np.diff(stamps)
    typical = float(np.median(steps))
    if not 0.0 < typical <= _LONGEST_S:
        return seconds, []
    out = seconds.copy()
    said = []
    for change, sign in ((-HOUR_S, 1.0), (HOUR_S, -1.0)):
        alike = np.flatnonzero(np.abs(steps - change - typical) <= min(0.5 * typical, _JITTER_S))
        found = [at for at in alike if _in_such_a_night(start, float(stamps[at]), typical)]
        if typical >= HOUR_S and len(found) < len(alike):
            continue
        for at in found:
            out[rows[at + 1] :] += sign * HOUR_S
            which = "back" if sign > 0 else "forward"
            said.append(
                f"local time on the night when clocks go {which} looks like {place(int(rows[at + 1]))}: the rows from "
                f"there on are taken an hour {'later' if sign > 0 else 'earlier'}; write times in UTC or with a zone"
            )
    return out, said


def _in_such_a_night(start: datetime.datetime, last_s: float, typical: float) -> bool:
    """Return True if clocks may change between the row at `last_s` and the next: at a full hour of such a night.

    Clocks are changed at a full hour; forward, the row before is in the hour that ends then, and back as well.
    """
    last = start + datetime.timedelta(seconds=last_s - 1.0)
    expected = start + datetime.timedelta(seconds=last_s + typical)
    hour = last.replace(minute=0, second=0, microsecond=0)
    while (hour := hour + datetime.timedelta(hours=1)) <= expected:
        if hour.weekday() == 6 and hour.month in _MONTHS and hour.hour <= _LAST_HOUR:
            return True
    return False
