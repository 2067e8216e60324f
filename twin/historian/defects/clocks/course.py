"""Tags whose clock goes against those of the other tags by minutes: it drifts, or was set in the middle of the record.

In some weeks of the record each tag has a lag to every other one: that at which their changes go together best. Water
and instruments make lags of minutes, but the same ones in every week. A tag whose lags to all that it goes with change
together has a clock that moved. Nothing is corrected: between the weeks nobody knows its course.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.historian.defects.silence import interface_groups
from twin.historian.tags import Array, Series, longest_interval_s

STEP_S = 300.0
"""Step of the lags: the scan of most tags."""
CHANGE_STEPS = 6
"""Half an hour, over which a change counts, as in `correlations`."""
WEEK_S, LEAST_S = 7.0 * 86400.0, 4.0 * 86400.0
"""Length of a part, and of the shortest one: changes of a few days leave chance lags."""
MOST_PARTS = 8
FARTHEST = 24
"""Largest lag in steps, two hours."""
LEAST_CHANGES = 200
"""Steps of a part in which a tag must change."""
TOGETHER = 0.4
"""Least correlation at the best lag: eight times the spread between chance lags of a week (`correlations`)."""
PARTNERS = 3
"""Witnesses by which a change of lag is confirmed."""
JUDGED = (
    "water_inlet_temperature",
    "water_outlet_temperature",
    "basin_temperature",
    "return_header_temperature",
    "supply_temperature",
    "dry_bulb_temperature",
    "wet_bulb_temperature",
    "relative_humidity",
    "relative_humidity_redundant",
)
"""Roles of water and air. What a controller or a hand moves, as fans, pumps and valves, has the lags of the control,
which change with operation."""
ALIKE, MOVED = 2, 4
"""Steps by which the partners may differ in the median, and from which a clock has moved: 20 min, twice that."""


@dataclass(frozen=True)
class ClockCourse:
    """A clock that moved: its tags, by how much it is later than in the first part, s, and the days of both parts."""

    tags: tuple[str, ...]
    later_s: float
    first_s: float
    last_s: float

    @property
    def says(self) -> str:
        """The finding as a sentence."""
        first, last = (
            datetime.datetime.fromtimestamp(t, datetime.UTC).strftime("%Y-%m-%d") for t in (self.first_s, self.last_s)
        )
        more = f" and {len(self.tags) - 1} further tags" if len(self.tags) > 1 else ""
        way = "later" if self.later_s > 0.0 else "earlier"
        return (
            f"the clock of {self.tags[0]}{more} is {abs(self.later_s) / 60.0:.0f} min {way} about {last} than about "
            f"{first}, against the other tags; used as it stands: set the clock, and correct the stamps in the store"
        )


def moved_clocks(series: Sequence[Series]) -> list[ClockCourse]:
    """Return the tags whose clock moves against those of the others, the surest first.

    Parameters
    ----------
    series
        Series in the order of time with true times as far as they are known.
    """
    usable = [one for one in series if len(one.time_s) > CHANGE_STEPS and one.tag.role in JUDGED]
    if len(usable) <= PARTNERS:
        return []
    start, end = min(one.time_s[0] for one in usable), max(one.time_s[-1] for one in usable)
    parts = int(np.clip((end - start) // WEEK_S, 2, MOST_PARTS))
    length = min(WEEK_S, (end - start) / parts)
    if length < LEAST_S:
        return []
    begins = np.linspace(start, end - length, parts)
    lags = [_lags(usable, begin, begin + length) for begin in begins]
    sets = [(k,) for k in range(len(usable))] + _interfaces(usable)
    found: list[ClockCourse] = []
    moved: set[int] = set()
    while True:
        candidates = [
            (abs(change), tags, part, change)
            for tags in sets
            if not moved & set(tags)
            for part in range(1, parts)
            if (change := _change(lags[0], lags[part], tags, moved)) is not None
        ]
        size, tags, part, change = max(candidates, default=(0.0, (), 0, 0.0))
        if size < MOVED:
            return found
        moved |= set(tags)
        middle, names = 0.5 * length, tuple(usable[k].tag.name for k in tags)
        found.append(ClockCourse(names, STEP_S * change, begins[0] + middle, begins[part] + middle))


def _interfaces(series: Sequence[Series]) -> list[tuple[int, ...]]:
    """Return the tags of each interface that has several, but fewer than half of all."""
    row = {one.tag.name: k for k, one in enumerate(series)}
    groups = [tuple(row[name] for name in group.tags) for group in interface_groups(series)]
    return [group for group in groups if 1 < len(group) < 0.5 * len(series)]


def _change(first: NDArray[np.int_], last: NDArray[np.int_], tags: tuple[int, ...], moved: set[int]) -> float | None:
    """Return by how many steps the lags of tags to all others changed; None where these do not agree."""
    rows = [j for j in range(len(first)) if j not in tags and j not in moved]
    before, after = first[np.ix_(tags, rows)], last[np.ix_(tags, rows)]
    known = (before != UNKNOWN) & (after != UNKNOWN)
    at = known.any(axis=0)
    if at.sum() < PARTNERS:
        return None
    change = np.nanmedian(np.where(known, after - before, np.nan)[:, at], axis=0)
    middle = float(np.median(change))
    return middle if float(np.quantile(np.abs(change - middle), 0.75)) <= ALIKE else None


UNKNOWN = 10 * FARTHEST


def _lags(series: Sequence[Series], start_s: float, end_s: float) -> NDArray[np.int_]:
    """Return the steps by which each tag is later than each other one (k, k); `UNKNOWN` where they go not together."""
    grid = np.arange(start_s, end_s, STEP_S)
    changes = np.stack([_changes(one, grid) for one in series])
    lively = np.count_nonzero(changes, axis=1) >= LEAST_CHANGES
    size = 1 << int(np.ceil(np.log2(len(grid) + FARTHEST)))
    spectra = np.fft.rfft(changes, size, axis=1)
    found = np.full((len(series), len(series)), UNKNOWN)
    window = np.concatenate([np.arange(FARTHEST + 1), np.arange(-FARTHEST, 0)])
    for k in np.flatnonzero(lively).tolist():
        others = np.flatnonzero(lively)
        both = np.fft.irfft(spectra[k] * np.conj(spectra[others]), size, axis=1)[:, window] / len(grid)
        best = np.argmax(np.abs(both), axis=1)
        height = np.abs(both[np.arange(len(others)), best])
        sure = (height >= TOGETHER) & (np.abs(window[best]) < FARTHEST)
        found[k, others[sure]] = window[best[sure]]
    return found


def _changes(series: Series, grid: Array) -> Array:
    """Return bounded changes over half an hour (m,), standardised; 0 where unknown."""
    x = series.at(grid, 1.2 * longest_interval_s(series))
    change = np.zeros(len(x))
    change[CHANGE_STEPS:] = x[CHANGE_STEPS:] - x[:-CHANGE_STEPS]
    change = np.where(np.isfinite(change), change, 0.0)
    size = np.abs(change[change != 0.0])
    if not len(size):
        return change
    limit = 3.0 * float(np.quantile(size, 0.75))
    change = np.clip(change, -limit, limit)
    scale = float(np.sqrt((change**2).mean()))
    return np.asarray(change / scale)
