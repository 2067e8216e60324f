"""Detection of the defects that plant historians have, from the raw samples alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from twin.historian.defects.clocks import shifted_clocks, to_utc
from twin.historian.defects.humidity import humidity_defects
from twin.historian.defects.quality import bad_quality
from twin.historian.defects.repeats import repeated_stamps
from twin.historian.defects.silence import silent_groups
from twin.historian.defects.stuck import stuck_values
from twin.historian.defects.swaps import swapped, undo_swap
from twin.historian.defects.unit_switch import converted, unit_switches
from twin.historian.events import Event
from twin.historian.tags import Defect, Series

__all__ = ["Repaired", "find_and_repair"]


@dataclass(frozen=True)
class Repaired:
    """Series in order of time and in their own units, good samples only, and the defects that were found."""

    series: tuple[Series, ...]
    defects: tuple[Defect, ...]
    remarks: tuple[str, ...] = ()


def find_and_repair(
    raw: Sequence[Series], *, timezone: str | None = None, pressure_kPa: float = 101.325, events: Sequence[Event] = ()
) -> Repaired:
    """Return the series without what their defects spoil, and the defects.

    Each step sees the series as the steps before it left them: quality, repeated stamps, silence, clocks, units, stuck
    values, humidity, swaps. What can be undone is undone (clock, unit, swap); the rest is left out.

    Parameters:
        raw: samples as the historian gives them.
        timezone: of the station, IANA; clocks in local time are looked for only where it is known.
        pressure_kPa: of the site, for the wet bulb where no barometer is recorded.
    """
    found: list[Defect] = []
    for one in raw:
        found += bad_quality(one)
    found += repeated_stamps(raw)
    series = [one.usable() for one in raw]
    gaps, groups = silent_groups(series)
    found += gaps
    if timezone is not None:
        clocks = shifted_clocks(series, groups, timezone)
        late = {name for defect in clocks for name in defect.tags}
        series = [to_utc(one, timezone) if one.tag.name in late else one for one in series]
        found += clocks
    for index, one in enumerate(series):
        switches = unit_switches(one)
        for defect, unit in switches:
            series[index] = converted(series[index], defect, unit)
        found += [defect for defect, _ in switches]
    wet = humidity_defects(series, pressure_kPa)
    series = _without(series, wet)
    found += wet
    stuck = [defect for one in series for defect in stuck_values(one, gaps)]
    series = _without(series, stuck)
    found += stuck
    swaps = swapped(series)
    for defect in swaps:
        series = undo_swap(series, defect)
    found += swaps
    return Repaired(tuple(series), tuple(sorted(found, key=lambda d: (d.start_s, d.kind, d.tags))))


def _without(series: list[Series], defects: Sequence[Defect]) -> list[Series]:
    """Return the series without the samples inside the defects of their tags."""
    left = []
    for one in series:
        keep = one.quality >= 0
        for defect in defects:
            if one.tag.name in defect.tags:
                keep &= (one.time_s < defect.start_s) | (one.time_s > defect.end_s)
        left.append(replace(one, time_s=one.time_s[keep], value=one.value[keep], quality=one.quality[keep]))
    return left
