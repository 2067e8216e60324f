"""Tags in local time by what the change of clock does to their stamps.

Where summer time ends, local stamps go through one hour twice: in the order of storing they fall back, and the hour
holds twice the usual samples. Where it begins, an hour has none. This shows local time where all tags of a store have
it, which no comparison of tags can. A record without a change of clock shows nothing.
"""

from __future__ import annotations

import datetime
import zoneinfo
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.historian.defects.silence import SURE, Group
from twin.historian.tags import Array, Series

AROUND_S = 2.0 * 3600.0
"""Time before and after the hour from which the rate of samples is learned, as in `silence`."""
HOUR_S = 3600.0
DAY_S = 86400.0
STRONG = 3.0
"""Log-likelihood ratio from which an interface is counted as evidence against the rest: 20 to 1 (Kass & Raftery)."""
CHANCE = 1e-3
"""Chance that a fall in the order of storing lies in the hour that comes twice by itself: a thousand to one."""
TIGHT = 0.25
"""Share of the hour by which a silence may be longer than the hour that local time leaves out."""


@dataclass(frozen=True)
class ClockChange:
    """Change of a zone's clock: time (UTC, s since 1970) and the offsets from UTC before and after, s."""

    time_s: float
    before_s: float
    after_s: float

    @property
    def stamps(self) -> tuple[float, float]:
        """Local stamps that come twice, or never."""
        low, high = sorted((self.before_s, self.after_s))
        return self.time_s + low, self.time_s + high

    @property
    def back(self) -> bool:
        """True if the clock goes back, so that stamps come twice."""
        return self.after_s < self.before_s


def clock_changes(zone: str, start_s: float, end_s: float) -> list[ClockChange]:
    """Return the changes of a zone's clock between two times, s since 1970."""
    days = np.arange(np.floor(start_s / DAY_S), np.ceil(end_s / DAY_S) + 1.0) * DAY_S
    offset = np.array([_offset_s(day, zone) for day in days])
    found = []
    for k in np.flatnonzero(np.diff(offset) != 0.0):
        hours = days[k] + HOUR_S * np.arange(25)
        fine = np.array([_offset_s(hour, zone) for hour in hours])
        found += [ClockChange(float(hours[j + 1]), fine[j], fine[j + 1]) for j in np.flatnonzero(np.diff(fine))]
    return found


def _offset_s(utc_s: float, zone: str) -> float:
    moment = datetime.datetime.fromtimestamp(utc_s, datetime.UTC).astimezone(zoneinfo.ZoneInfo(zone))
    offset = moment.utcoffset()
    return offset.total_seconds() if offset is not None else 0.0


def second_pass(stamp_s: Array, change: ClockChange) -> slice | None:
    """Return the rows, in the order of storing, from the first one after the clock went back; None where the order
    does not show it.

    Parameters
    ----------
    stamp_s
        Local stamps (n,) in the order of storing.
    change
        Change at which the clock goes back.
    """
    low, high = change.stamps
    inside = (stamp_s >= low) & (stamp_s <= high)
    step = np.diff(stamp_s)
    back = (step < 0.0) & inside[:-1] & inside[1:]
    large = np.flatnonzero(back & (step <= -0.5 * (high - low)))
    if len(large) == 1:
        return slice(int(large[0]) + 1, None)
    # A tag that stood still about the change falls by less. Stores that mix their order do so at other times as well.
    falls = np.flatnonzero(back)
    elsewhere = int((step < 0.0).sum()) - len(falls)
    by_chance = elsewhere * (high - low) / max(float(np.ptp(stamp_s)), 1.0) if len(stamp_s) else 0.0
    return slice(int(falls[0]) + 1, None) if len(falls) == 1 and by_chance <= CHANCE else None


@dataclass(frozen=True)
class ByChange:
    """Tags whose stamps the changes of clock show to be local time, and those whose stamps they show not to be."""

    local: frozenset[str]
    fixed: frozenset[str]
    changes: tuple[ClockChange, ...]


def local_by_change(series: Sequence[Series], groups: Sequence[Group], zone: str | None) -> ByChange:
    """Return the tags that are in local time of a zone, and those that are not, by the changes of its clock.

    A tag whose stamps fall back at the change is local; one with stamps in the hour that is left out is not. Of the
    others the number of samples decides: for all of an interface that they are not, and for all of the store that
    they are. Single tags and interfaces in local time that store in the order of their stamps are left to
    `clocks`, which compares them with the rest.

    Parameters
    ----------
    series
        Samples in the order of storing.
    groups
        Tags by interface.
    zone
        Of the station, IANA; None finds nothing.
    """
    there = [one for one in series if len(one.time_s)]
    if zone is None or not there:
        return ByChange(frozenset(), frozenset(), ())
    low, high = min(one.time_s.min() for one in there), max(one.time_s.max() for one in there)
    changes = clock_changes(zone, float(low), float(high))
    local, fixed, evidence = set(), set(), {}
    for one in there:
        name, stamp = one.tag.name, np.sort(one.time_s)
        if any(change.back and second_pass(one.time_s, change) is not None for change in changes):
            local.add(name)
        elif any(not change.back and _inside(stamp, change) > 0 for change in changes):
            fixed.add(name)
        else:
            evidence[name] = sum(_evidence(one, change) for change in changes)
    by_group = [(group, [n for n in group.tags if n in evidence]) for group in groups]
    sums = [sum(evidence[name] for name in names) for _, names in by_group]
    for (group, names), total in zip(by_group, sums, strict=True):
        if total <= -SURE:
            fixed.update(names)
        elif total >= 0.0 and local & set(group.tags) and not fixed & set(group.tags):
            local.update(names)
    rest = [name for name in evidence if name not in local | fixed]
    total = sum(evidence[name] for name in rest)
    if not fixed and all(one > -STRONG for one in sums) and (total >= SURE or (local and total >= 0.0)):
        local.update(rest)
    return ByChange(frozenset(local), frozenset(fixed), tuple(changes))


def _inside(stamp_s: Array, change: ClockChange) -> int:
    low, high = np.searchsorted(stamp_s, change.stamps, side="left")
    return int(high - low)


def _evidence(series: Series, change: ClockChange) -> float:
    """Return the log-likelihood ratio of local to fixed stamps by the number of samples in the hour, as Poisson's."""
    stamp = np.sort(series.time_s)
    low, high = change.stamps
    span = high - low
    before = float(np.diff(np.searchsorted(stamp, (low - AROUND_S, low)))[0]) / AROUND_S * span
    after = float(np.diff(np.searchsorted(stamp, (high, high + AROUND_S)))[0]) / AROUND_S * span
    if min(before, after) <= 0.0:
        return 0.0
    if not change.back:
        first, last = np.searchsorted(stamp, (low, high), side="left")
        longer = stamp[last] - stamp[first - 1] - span
        return min(before, after) if longer <= TIGHT * span else 0.0
    rows = (series.time_s >= low) & (series.time_s < high)
    # Samples that were stored again under their stamp are none of a second hour; regular stamps come twice by nature.
    pairs = len(np.unique(np.stack([series.time_s[rows], series.value[rows]]), axis=1).T)
    for_it = pairs * np.log(2.0) - max(before, after)  # a start within the hour goes on after it
    against = int(rows.sum()) * np.log(2.0) - 0.5 * (before + after)
    return float(for_it if for_it > 0.0 else min(against, 0.0))
