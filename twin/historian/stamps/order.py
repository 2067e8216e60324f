"""Time stamps of a store before its defects are looked for: strays, order and silence."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array, Series

FEWEST = 20
"""Samples of a tag below which they are strays."""
SILENT_DAYS = 3.0
HOUR_S, DAY_S, YEAR_S = 3600.0, 86400.0, 365.25 * 86400.0
OF_CELL = (
    ("water_inlet_temperature",),
    ("water_outlet_temperature",),
    ("water_flow",),
    ("fan_speed", "fan_speed_command"),
)
OF_STATION = (
    ("dry_bulb_temperature",),
    ("wet_bulb_temperature", "relative_humidity", "relative_humidity_redundant"),
)
"""Roles, of each one or another, without which no minute of a cell is complete."""
PART = 0.1
"""Share of the span of the others by which a tag that lies beyond them begins later, or ends earlier, than they do."""


def without_strays(series: Sequence[Series], places: dict[str, str]) -> tuple[list[Series], list[str]]:
    """Return the series without samples at times that are not of the record, and a sentence for each tag with some.

    Such samples are of a clock that is years off, of a logger that began anew in 1970 or of a tag from the future. Each
    minute up to them would be a row of the record. They lie further from the others than these span, or after (before)
    all others by days; and they are few, or of tags that make no minute complete.

    Parameters
    ----------
    series
        Raw samples.
    places
        File and line of each tag in the dictionary, for the sentences.
    """
    there = [one for one in series if len(one.time_s)]
    if not there:
        return list(series), []
    ends = _joined_span(there)
    found, remarks = [], []
    for one in series:
        inside = (one.time_s >= ends[0]) & (one.time_s <= ends[1])
        found.append(one.rows(inside))
        if not inside.all():
            first = one.time_s[~inside][0]
            remarks.append(
                f"{places.get(one.tag.name, 'the dictionary')}: {(~inside).sum()} samples of {one.tag.name} lie "
                f"further from the others than these span, first at {np.datetime64(int(first), 's')}Z; they are left "
                f"out: check the logger's clock"
            )
    for late in (True, False):
        found, more = _within_the_others(found, places, late=late)
        remarks += more
    return found, remarks


def _joined_span(series: Sequence[Series]) -> tuple[float, float]:
    """Return the first and last time of the samples that no gap longer than their span parts."""
    times = np.sort(np.concatenate([one.time_s for one in series]))
    low, high = 0, len(times)
    while high - low > 1:
        gap = np.diff(times[low:high])
        at = low + int(np.argmax(gap)) + 1
        keep_late = high - at >= at - low
        kept = (at, high) if keep_late else (low, at)
        few = (times[low], times[at - 1]) if keep_late else (times[at], times[high - 1])
        apart = float(gap.max()) > times[kept[1] - 1] - times[kept[0]]
        most = {one.tag.name: int(((one.time_s >= few[0]) & (one.time_s <= few[1])).sum()) for one in series}
        strays = [one for one in series if most[one.tag.name]]
        if not apart or (max(most.values()) >= FEWEST and _complete(strays, series)):
            break
        low, high = kept
    return float(times[low]), float(times[high - 1])


@dataclass(frozen=True)
class _Beyond:
    """Tags with samples beyond the last (or before the first) one of all others, and that time."""

    tags: tuple[str, ...]
    end_s: float


def _within_the_others(series: list[Series], places: dict[str, str], *, late: bool) -> tuple[list[Series], list[str]]:
    """Return the series without samples days after (`late`) or before all tags that could make a minute complete.

    A tag that in turn lacks a part of their span has a wrong clock, and is left out as a whole.
    """
    beyond = _beyond(series, late=late)
    if beyond is None:
        return series, []
    others = [one for one in series if one.tag.name not in beyond.tags and len(one.time_s)]
    span = min(float(one.time_s.min()) for one in others), max(float(one.time_s.max()) for one in others)
    part = PART * (span[1] - span[0])
    found, remarks, cut = [], [], []
    for one in series:
        if one.tag.name not in beyond.tags:
            found.append(one)
            continue
        first, last = float(one.time_s.min()), float(one.time_s.max())
        outside = one.time_s > span[1] if late else one.time_s < span[0]
        lacking = first > span[0] + part if late else last < span[1] - part
        place = places.get(one.tag.name, "the dictionary")
        if lacking and outside.sum() >= FEWEST:
            found.append(one.rows(np.zeros(len(one.time_s), dtype=bool)))
            remarks.append(
                f"{place}: {one.tag.name} has samples from {_day(first)} to {_day(last)}, those of the others are from "
                f"{_day(span[0])} to {_day(span[1])}; it is left out: check the logger's clock"
            )
        else:
            found.append(one.rows(~outside))
            cut.append(one.tag.name)
    if cut:
        more = f" and {len(cut) - 1} further tags" if len(cut) > 1 else ""
        when = f"after {_day(span[1])}" if late else f"before {_day(span[0])}"
        place = places.get(cut[0], "the dictionary")
        remarks.append(
            f"{place}: samples of {cut[0]}{more} lie {when}, where no other tag has any; "
            f"they are left out: check the logger's clock, or export the other tags for these days"
        )
    return found, remarks


def _beyond(series: Sequence[Series], *, late: bool) -> _Beyond | None:
    """Return the most tags that lie days beyond all others and make no minute complete; None for none."""
    there = [one for one in series if len(one.time_s)]
    sign = 1.0 if late else -1.0
    ends = sorted(((sign * float((sign * one.time_s).max()), one) for one in there), key=lambda e: -sign * e[0])
    found = None
    for k in range(1, len(ends)):
        tags = [one for _, one in ends[:k]]
        if _complete(tags, there):
            break
        if abs(ends[k - 1][0] - ends[k][0]) > SILENT_DAYS * DAY_S:
            found = _Beyond(tuple(one.tag.name for one in tags), ends[k][0])
    return found


def _complete(tags: Sequence[Series], series: Sequence[Series]) -> bool:
    """Return whether some tags have all roles that a minute needs, of those that the series have at all."""

    def lacks(needed: Sequence[tuple[str, ...]], cell: int | None) -> bool:
        return any(
            any(one.tag.role in roles and one.tag.cell == cell for one in series)
            and not any(one.tag.role in roles and one.tag.cell == cell for one in tags)
            for roles in needed
        )

    cells = {one.tag.cell for one in tags if one.tag.cell is not None}
    return not lacks(OF_STATION, None) and any(not lacks(OF_CELL, cell) for cell in cells)


def _day(time_s: float) -> str:
    return datetime.datetime.fromtimestamp(time_s, datetime.UTC).strftime("%Y-%m-%d")


def order_and_silence(
    series: Sequence[Series], places: dict[str, str], in_local_time: frozenset[str] = frozenset()
) -> list[str]:
    """Return a sentence for each tag whose stored times go back, or that is silent for days.

    Parameters
    ----------
    series
        Raw samples in the order of storing.
    places
        File and line of each tag in the dictionary, for the sentences.
    in_local_time
        Tags that were found to be in local time: their times go back an hour where its clock does.
    """
    falls = {one.tag.name: _falls(one, one.tag.name in in_local_time) for one in series}
    remarks, turned = [], [one for one in series if len(falls[one.tag.name])]
    if turned:
        first = turned[0]
        back = falls[first.tag.name]
        others = f", as do those of {len(turned) - 1} further tags" if len(turned) > 1 else ""
        hours = sum(bool(_hour(-np.diff(one.time_s)[falls[one.tag.name]]).all()) for one in turned)
        remedy = (
            "as local time does where summer time ends: name the station's zone as timezone in the datasheet"
            if hours > max(1, 0.5 * len(turned))
            else "check the logger's clock"
        )
        remarks.append(
            f"{places.get(first.tag.name, 'the dictionary')}: the times of {first.tag.name} go back {len(back)} times "
            f"in the store, first in row {back[0] + 2} of its samples{others}; they were sorted: {remedy}"
        )
    silent: dict[tuple[str, str], list[str]] = {}
    for one in series:
        times = np.sort(one.time_s)
        for k in np.flatnonzero(np.diff(times) > SILENT_DAYS * DAY_S):
            silent.setdefault((_day(times[k]), _day(times[k + 1])), []).append(one.tag.name)
    for (last, first_again), names in silent.items():
        place = places.get(names[0], "the dictionary")
        others = f", as have {len(names) - 1} further tags" if len(names) > 1 else ""
        remarks.append(
            f"{place}: {names[0]} has no sample from {last} to {first_again}{others}; ask the archive for these days, "
            f"or take it that nothing is known of them"
        )
    return remarks


def _falls(series: Series, local: bool) -> NDArray[np.intp]:
    """Return the samples after which the stored times go back, without those of a clock in local time.

    Samples without a number tell nothing: a reading that failed is stored at the time of the asking.
    """
    rows = np.flatnonzero(np.isfinite(series.value))
    step = np.diff(series.time_s[rows])
    back = step < 0.0
    if local:
        # A tag that stood about the change falls by less than half an hour; it does so once a year.
        years = np.ceil(float(np.ptp(series.time_s)) / YEAR_S) if len(rows) else 0.0
        back &= ~_hour(-step) & ~((step >= -HOUR_S) & (back.sum() <= years))
    return np.asarray(rows[:-1][back], dtype=np.intp)


def _hour(fall_s: Array) -> NDArray[np.bool_]:
    """Return which falls are of the hour of a clock change, less the interval of the samples."""
    return np.asarray((fall_s >= 1800.0) & (fall_s <= HOUR_S))
