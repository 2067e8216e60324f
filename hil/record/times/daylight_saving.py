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


def unfolded(
    seconds: NDArray[np.float64], start: datetime.datetime, place: Callable[[int], str]
) -> tuple[NDArray[np.float64], list[str]]:
    """Return `seconds (n,)` of local times, in the order of the file, without the hour lost or won by clocks.

    A step counts as a change of clocks only in the night to a Sunday of a month with such changes, before four o'clock,
    and where it differs from an ordinary step by an hour. `start` is the local time of 0 s; `place` names a row. The
    second result says what was done, a sentence for each change.
    """
    rows = np.flatnonzero(np.isfinite(seconds))
    if len(rows) < 3:
        return seconds, []
    stamps = seconds[rows]
    steps = np.diff(stamps)
    typical = float(np.median(steps))
    if not 0.0 < typical < HOUR_S:
        return seconds, []
    out = seconds.copy()
    said = []
    for change, sign in ((-HOUR_S, 1.0), (HOUR_S, -1.0)):
        for at in np.flatnonzero(np.abs(steps - change - typical) <= 0.5 * typical):
            if not _in_such_a_night(start + datetime.timedelta(seconds=float(stamps[at])), typical, sign):
                continue
            out[rows[at + 1] :] += sign * HOUR_S
            which = "back" if sign > 0 else "forward"
            said.append(
                f"local time on the night when clocks go {which} looks like {place(int(rows[at + 1]))}: the rows from "
                f"there on are taken an hour {'later' if sign > 0 else 'earlier'}; write times in UTC or with a zone"
            )
    return out, said


def _in_such_a_night(last: datetime.datetime, typical: float, sign: float) -> bool:
    """Return True where the row after local time `last`, had clocks not been changed, begins an hour or follows it.

    Clocks are changed at a full hour; forward, the row before is in the hour that ends then, and back as well.
    """
    expected = last + datetime.timedelta(seconds=typical)
    over = expected.minute * 60 + expected.second + expected.microsecond * 1e-6
    at_full_hour = over < typical + 1.0
    return expected.weekday() == 6 and expected.month in _MONTHS and expected.hour <= _LAST_HOUR and at_full_hour
