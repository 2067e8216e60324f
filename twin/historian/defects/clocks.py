"""Tags whose time stamps are local time though they are said to be UTC.

The hypothesis is tested on the changes of a tag: shifted to UTC by the station's time zone they must go better with the
changes of tags of other interfaces than as they stand. A shift by the clock of the zone is tried and its opposite, so
that a chance peak or a slow daily course does not decide.
"""

from __future__ import annotations

import datetime
import zoneinfo
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.historian.defects.silence import Group
from twin.historian.tags import Array, Defect, Series

STEP_S = 300.0
GRID_LIMIT_S = 4500.0
"""Exception reporting stores at the latest once an hour."""
LEAST_ROWS = 500
MARGIN = 0.1
"""Least rise of the correlation; the spread between chance shifts is below 0.05 for a week of samples."""


def to_utc(series: Series, timezone: str) -> Series:
    """Return the series with time stamps that were local time of the zone as UTC, in their order."""
    zone = zoneinfo.ZoneInfo(timezone)
    time_s = series.time_s + _offset_s(series.time_s, zone)
    order = np.argsort(time_s, kind="stable")
    return replace(series, time_s=time_s[order], value=series.value[order], quality=series.quality[order])


def _offset_s(local_s: Array, zone: zoneinfo.ZoneInfo) -> Array:
    """Return what is to be added to local time, by the hour, s. The hour that comes twice is taken as its first."""
    hours = np.floor(local_s / 3600.0)
    found = np.empty(len(local_s))
    for hour in np.unique(hours):
        moment = datetime.datetime.fromtimestamp(float(hour) * 3600.0, datetime.UTC).replace(tzinfo=zone)
        offset = moment.utcoffset()
        found[hours == hour] = -(offset.total_seconds() if offset is not None else 0.0)
    return found


def shifted_clocks(series: Sequence[Series], groups: Sequence[Group], timezone: str) -> list[Defect]:
    """Return a defect for each group of tags that are in local time."""
    zone = zoneinfo.ZoneInfo(timezone)
    by_name = {one.tag.name: one for one in series}
    found = []
    for group in groups:
        members = [by_name[name] for name in group.tags]
        others = [one for one in series if one.tag.name not in group.tags]
        votes = [vote for one in members if (vote := _vote(one, others, zone)) is not None]
        if votes and sum(votes) >= max(1, 0.6 * len(votes)):
            start = min(float(one.time_s[0]) for one in members if len(one.time_s))
            end = max(float(one.time_s[-1]) for one in members if len(one.time_s))
            says = f"{len(members)} tags have time stamps in local time of {timezone}"
            found.append(Defect("local_time", group.tags, start, end, says, "shifted to UTC"))
    return found


def _vote(one: Series, others: Sequence[Series], zone: zoneinfo.ZoneInfo) -> bool | None:
    """Return whether the tag is in local time; None where it goes with no other tag either way."""
    best: tuple[float, float] | None = None
    for other in others:
        if other.tag.cell is not None and one.tag.cell is not None and other.tag.cell != one.tag.cell:
            continue
        pair = _fits(one, other, zone)
        if pair is not None and (best is None or max(pair) > max(best)):
            best = pair
    if best is None or max(best) < 2.0 * MARGIN:
        return None
    as_is, shifted = best
    return shifted > as_is + MARGIN


def _fits(one: Series, other: Series, zone: zoneinfo.ZoneInfo) -> tuple[float, float] | None:
    """Return the correlation of changes as the stamps stand, and as local time."""
    if len(one.time_s) < 50 or len(other.time_s) < 50:
        return None
    low, high = max(one.time_s[0], other.time_s[0]), min(one.time_s[-1], other.time_s[-1])
    grid = np.arange(low, high, STEP_S)
    if len(grid) < LEAST_ROWS:
        return None
    reference = other.at(grid, GRID_LIMIT_S)
    as_is = _correlation(one.at(grid, GRID_LIMIT_S), reference)
    local_of_grid = grid - _offset_s(grid, zone)
    shifted = _correlation(one.at(local_of_grid, GRID_LIMIT_S), reference)
    return None if as_is is None or shifted is None else (as_is, shifted)


def _correlation(first: Array, second: Array) -> float | None:
    """Return the largest absolute correlation of half-hourly changes at lags of up to 20 minutes either way."""
    span = int(1800.0 / STEP_S)
    a, b = first[span:] - first[:-span], second[span:] - second[:-span]
    best = None
    for lag in range(-4, 5):
        x, y = (a[lag:], b[: len(b) - lag]) if lag >= 0 else (a[:lag], b[-lag:])
        rows = np.isfinite(x) & np.isfinite(y)
        if rows.sum() < LEAST_ROWS // 2:
            continue
        # Ranks bound the weight of start-ups and trips.
        u, v = _bounded(x[rows]), _bounded(y[rows])
        if u.std() == 0.0 or v.std() == 0.0:
            continue
        value = abs(float(np.corrcoef(u, v)[0, 1]))
        best = value if best is None else max(best, value)
    return best


def _bounded(x: Array) -> Array:
    """Return the changes, none larger than three times the 75 % quantile of those that are any."""
    size = np.abs(x[x != 0.0])
    if len(size) == 0:
        return x
    limit = 3.0 * float(np.quantile(size, 0.75))
    return np.asarray(np.clip(x, -limit, limit))
