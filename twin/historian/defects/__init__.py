"""Detection of the defects that plant historians have, from the raw samples and the plant's events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.defects.clocks import (
    Shift,
    changed_clocks,
    corrected,
    local_by_change,
    moved_clocks,
    repeated_hours,
    shifted_clocks,
)
from twin.historian.defects.humidity import latched, named_impossible, wet_bulb_defects
from twin.historian.defects.quality import bad_quality
from twin.historian.defects.range_changes import range_changes
from twin.historian.defects.repeats import repeated_stamps
from twin.historian.defects.silence import communication_gaps, interface_groups
from twin.historian.defects.stuck import constant_value, stuck_values
from twin.historian.defects.swaps import swapped, undo_swap
from twin.historian.defects.unit_switch import Switch, TagEdges, converted, turned, unit_switches
from twin.historian.events import Event
from twin.historian.tags import Defect, Series, longest_interval_s
from twin.tower.air import SEA_LEVEL_KPA

__all__ = ["Repaired", "find_and_repair"]

SEASON_S = 60.0 * 86400.0
"""Length of the parts of a long record in which stuck values are looked for: weather and operation are alike."""

DRY = frozenset({"dry_bulb_temperature"})

ROUNDS = 3
"""Times that changes are sought anew after some were found."""


@dataclass(frozen=True)
class Repaired:
    """Series in order of time and in their own units, good samples only, and the defects that were found."""

    series: tuple[Series, ...]
    defects: tuple[Defect, ...]
    remarks: tuple[str, ...] = ()


def find_and_repair(
    raw: Sequence[Series],
    *,
    timezone: str | None = None,
    stamps: str | None = None,
    pressure_kPa: float = SEA_LEVEL_KPA,
    events: Sequence[Event] = (),
    full_speed: str = "60 Hz",
    usual: Mapping[str, tuple[float, float]] | None = None,
) -> Repaired:
    """Return the series without what their defects spoil, and the defects, all times in UTC.

    Clocks come first, so that every later finding is in UTC. Each step sees the series as the steps before it left
    them: clocks, quality, repeated stamps, silence, units, stuck values, latched humidities, ranges of dry bulbs,
    wet bulbs, swaps, ranges. What can be undone is undone (clock, unit, swap); the rest is left out. One cause is one
    defect: what a step has left out is a hole to the next ones.

    Parameters
    ----------
    raw
        Samples as the historian gives them.
    timezone
        Of the station, IANA; clocks in local time are looked for only where it is known.
    stamps
        Zone of all time stamps, IANA, where it is known; the tags are then compared as converted from it.
    pressure_kPa
        Of the site, for the wet bulb where no barometer is recorded.
    events
        Of the plant; entries of maintenance support a swap.
    full_speed
        Speed of a fan at 100 %, with its unit: its share and its frequency are units of one quantity.
    usual
        Values at work by tag, in the record's unit, as the datasheet gives them.
    """
    found: list[Defect] = []
    contradicted: list[str] = []
    if stamps is not None:
        contradicted = _no_local_time(raw, stamps)
        raw = [corrected(one, Shift(stamps)) for one in raw]
    usable = [one.usable() for one in raw]
    groups = interface_groups(usable)
    by_change = local_by_change(raw, groups, timezone if stamps is None else None)
    clocks = changed_clocks(by_change, usable, timezone) if timezone is not None else []
    raw = _on_time(raw, clocks)
    others = shifted_clocks([one.usable() for one in raw], groups, timezone, by_change.local | by_change.fixed)
    raw = _on_time(raw, others.found)
    clocks += others.found
    usable = [one.usable() for one in raw]
    courses = [one.says for one in moved_clocks(usable)]
    found += [defect for defect, _ in clocks]
    found += [defect for one in raw for defect in bad_quality(one)]
    found += repeated_stamps(raw)
    doubled = {
        name: repeated_hours(defect.start_s, defect.end_s, shift.zone)
        for defect, shift in clocks
        if shift.zone is not None
        for name in defect.tags
    }
    gaps = communication_gaps(usable, groups, doubled)
    found += gaps
    series = _without(usable, gaps)
    edges = TagEdges(full_speed)
    by_name = {one.tag.name: one for one in series}
    switches = [
        turned(one, by_name[one.defect.tags[0]], (usual or {}).get(one.defect.tags[0]))
        for one in unit_switches(series, full_speed, edges)
    ]
    found += [switch.defect for switch in switches]
    stuck = [defect for one in series for defect in _stuck(one, switches, series)]
    constant = _constant(series, stuck)
    series = [_converted(one, switches) for one in series]
    latches, stuck = latched(series, stuck)
    found += latches + stuck
    series = _without(series, [*latches, *stuck])
    # A dry bulb of another range contradicts the wet bulb for as long as it reads so.
    of_dry = range_changes(series, DRY)
    dry = list(of_dry.ranges)
    found += dry
    series = _without(series, dry)
    wet = wet_bulb_defects(series, pressure_kPa)
    found += wet
    series = _without(series, wet)
    before = series
    series, new = _swaps_and_ranges(series, events, full_speed)
    found += named_impossible(new, before, of_dry.mapped, pressure_kPa)
    for _ in range(ROUNDS):
        if not new:
            break
        # A witness that was swapped or in another range hid changes of the tags that it predicts.
        more = unit_switches(series, full_speed, edges)
        series, new = _swaps_and_ranges([_converted(one, more) for one in series], events, full_speed, found)
        new = [*(switch.defect for switch in more), *new]
        found += new
    return Repaired(
        tuple(series),
        tuple(sorted(found, key=lambda d: (d.start_s, d.kind, d.tags))),
        (*contradicted, *others.remarks, *courses, *constant),
    )


def _swaps_and_ranges(
    series: list[Series], events: Sequence[Event], full_speed: str, before: Sequence[Defect] = ()
) -> tuple[list[Series], list[Defect]]:
    """Return the series with swaps and changes of unit undone and without changed ranges, and these defects."""
    swaps = swapped(series, events, [one for one in before if one.kind == "swap"])
    for defect in swaps:
        series = undo_swap(series, defect)
    changes = range_changes(series, full_speed=full_speed)
    series = _without([_converted(one, changes.units) for one in series], changes.ranges)
    return series, [*swaps, *changes.defects]


def _no_local_time(raw: Sequence[Series], zone: str) -> list[str]:
    """Return a sentence if the stamps of tags do not do what local time does when the zone's clock changes."""
    groups = interface_groups([one.usable() for one in raw])
    fixed = sorted(local_by_change(raw, groups, zone).fixed)
    if not fixed:
        return []
    return [
        f"the time stamps of {len(fixed)} of {len(raw)} tags, such as {fixed[0]}, are no local time of {zone}: where "
        f"its clock changes, theirs does not; they were taken as such all the same: check the zone"
    ]


def _on_time(raw: Sequence[Series], clocks: Sequence[tuple[Defect, Shift]]) -> list[Series]:
    """Return the series with the clocks corrected."""
    shift_of = {name: shift for defect, shift in clocks for name in defect.tags}
    return [corrected(one, shift_of[one.tag.name]) if one.tag.name in shift_of else one for one in raw]


def _constant(series: Sequence[Series], stuck: Sequence[Defect]) -> list[str]:
    """Return a sentence for each tag of one value that no other tag contradicts."""
    left_out = {name for defect in stuck for name in defect.tags}
    return [
        f"{one.tag.name} stands at {value:g} {one.tag.unit} unless at rest; no other tag shows that it must "
        f"have moved, so it is taken as constant"
        for one in series
        if one.tag.name not in left_out and (value := constant_value(one)) is not None
    ]


def _stuck(series: Series, switches: Sequence[Switch], others: Sequence[Series]) -> list[Defect]:
    """Return the stuck values of each season and of each part between unit switches.

    The deviation of exception reporting is per unit. How long a healthy tag stands still, and how many values stick,
    is per season: a year has long calms, and as many faults that these would hide.
    """
    if not len(series.time_s):
        return []
    first, last = float(series.time_s[0]), float(series.time_s[-1])
    seasons = np.linspace(first, last, max(round((last - first) / SEASON_S), 1) + 1)[1:-1]
    edges = [t for s in switches if series.tag.name in s.defect.tags for t in (s.defect.start_s, s.defect.end_s)]
    bounds = [-np.inf, *sorted([*edges, *seasons.tolist()]), np.inf]
    parts = [(series.time_s >= low) & (series.time_s < high) for low, high in zip(bounds, bounds[1:], strict=False)]
    found: list[Defect] = []
    for defect in (defect for rows in parts for defect in sorted(stuck_values(series.rows(rows), others), key=_start)):
        # A value that stands across the edge of a season is one defect.
        if found and 0.0 <= defect.start_s - found[-1].end_s <= longest_interval_s(series):
            found[-1] = replace(found[-1], end_s=defect.end_s)
        else:
            found.append(defect)
    return found


def _start(defect: Defect) -> float:
    return defect.start_s


def _converted(series: Series, switches: Sequence[Switch]) -> Series:
    for switch in switches:
        if series.tag.name in switch.defect.tags:
            series = converted(series, switch)
            edges = [[switch.defect.start_s] * 2, [switch.defect.end_s] * 2]
            series = replace(series, holes=np.concatenate([series.holes, edges]))
    return series


def _without(series: Sequence[Series], defects: Sequence[Defect]) -> list[Series]:
    """Return the series without the samples inside the defects of their tags."""
    spans: dict[str, list[tuple[float, float]]] = {}
    for defect in defects:
        for name in defect.tags:
            spans.setdefault(name, []).append((defect.start_s, defect.end_s))
    return [one.without(spans.get(one.tag.name, [])) for one in series]
