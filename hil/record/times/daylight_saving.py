"""Local times that jump by an hour in the nights when clocks are changed, to times that go on."""

from __future__ import annotations

import datetime
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

HOUR_S = 3600.0
_MONTHS = (3, 4, 9, 10, 11)
"""Months in which countries begin or end summer time (IANA time zone database, rules since 2007)."""
_LAST_HOUR = 4
"""Hour of the night before which clocks are changed."""
_LONGEST_S = 12 * HOUR_S
"""Longest typical step of which an hour more or less can be told from an ordinary one."""
_JITTER_S = HOUR_S / 4
"""Most that a step may differ from a typical one, so that an hour more or less is no jitter."""


def unfolded(
    seconds: NDArray[np.float64], start: datetime.datetime, place: Callable[[int], str]
) -> tuple[NDArray[np.float64], list[str]]:
    """Return `seconds (n,)` of local times, in the order of the file, without the hour lost or won by clocks.

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
    """Return True where clocks may change between the row at `last_s` and the next: at a full hour of such a night.

    Clocks are changed at a full hour; forward, the row before is in the hour that ends then, and back as well.
    """
    last = start + datetime.timedelta(seconds=last_s - 1.0)
    expected = start + datetime.timedelta(seconds=last_s + typical)
    hour = last.replace(minute=0, second=0, microsecond=0)
    while (hour := hour + datetime.timedelta(hours=1)) <= expected:
        if hour.weekday() == 6 and hour.month in _MONTHS and hour.hour <= _LAST_HOUR:
            return True
    return False
