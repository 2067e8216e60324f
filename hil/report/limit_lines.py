"""Limits of test plans in the plots of a report: lines at their levels, and the times at which they were broken."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.journal import StateRow, profile_times

Floats = NDArray[np.float64]
BROKEN, KEPT = "#b3261e", "#5b636b"
"""Colours of a limit that failed, and of any other."""


@dataclass(frozen=True, slots=True)
class LimitLine:
    """Limit at `levels`, in the unit of `columns`, from `from_s` to `to_s`, s of record time.

    `failed_s` are begins and ends of the times at which the limit was broken, s of record time.
    """

    name: str
    columns: frozenset[str]
    levels: tuple[float, ...]
    from_s: float
    to_s: float
    is_broken: bool
    failed_s: tuple[tuple[float, float], ...]

    @property
    def colour(self) -> str:
        """Colour of the line."""
        return BROKEN if self.is_broken else KEPT


def limit_lines(
    document: dict[str, Any], states: Sequence[StateRow], ticks: tuple[NDArray[np.int64], Floats], period_s: float
) -> tuple[LimitLine, ...]:
    """Return the lines of a checked `verdict.json`; none of a limit without a level.

    Parameters
    ----------
    document
        Content of `verdict.json`.
    states
        Transitions of the run.
    ticks
        Numbers (n,) and record times (n,), s, of all ticks.
    period_s
        Length of a tick, s.
    """
    tick, time_s = ticks
    if not len(tick):
        return ()
    profile_s = profile_times(states, tick, period_s) if states else time_s
    several = len(document["tests"]) > 1
    return tuple(
        _line(f"{test['id']}/{limit['id']}" if several else limit["id"], limit, profile_s, time_s)
        for test in document["tests"]
        for limit in test["limits"]
        if limit.get("line") is not None
    )


def _line(name: str, limit: dict[str, Any], profile_s: Floats, time_s: Floats) -> LimitLine:
    line, last = limit["line"], float(time_s[-1])

    def at(wanted_s: float) -> float:
        place = int(np.searchsorted(profile_s, wanted_s - 1e-6))
        return float(time_s[place]) if place < len(time_s) else last

    return LimitLine(
        name,
        frozenset(line["columns"]),
        tuple(line["levels"]),
        at(line["from_s"]),
        at(line["to_s"]),
        limit["verdict"] == "fail",
        tuple((at(span["from_s"]), at(span["to_s"])) for span in limit.get("failed_s", ())),
    )


def of_columns(lines: Sequence[LimitLine], columns: Collection[str]) -> tuple[LimitLine, ...]:
    """Return the lines of a plot of `columns`."""
    return tuple(line for line in lines if not line.columns.isdisjoint(columns))


def levels_in_reach(lines: Sequence[LimitLine], low: float, high: float) -> Iterator[tuple[LimitLine, float]]:
    """Yield lines and levels that are no farther from curves between `low` and `high` than these are apart.

    A level farther off would make the curves flat.
    """
    reach = high - low
    for line in lines:
        for level in line.levels:
            if low - reach <= level <= high + reach:
                yield line, level
