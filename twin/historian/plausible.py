"""Tags that cannot be in the unit of the dictionary, from the first sample to the last.

Nothing is guessed: such a tag is left out, and the remark names the unit in which its values would be usual.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array, Series, Tag
from twin.historian.units import SPEEDS, UNITS, Unit, alternatives, full_speed_of, unit_of

USUAL: dict[str, tuple[float, float]] = {
    "water_inlet_temperature": (2.0, 60.0),
    "water_outlet_temperature": (2.0, 50.0),
    "basin_temperature": (0.0, 50.0),
    "return_header_temperature": (2.0, 60.0),
    "supply_temperature": (0.0, 50.0),
    "dry_bulb_temperature": (-40.0, 50.0),
    "wet_bulb_temperature": (-40.0, 35.0),
    "relative_humidity": (3.0, 101.0),
    "relative_humidity_redundant": (3.0, 101.0),
    "barometric_pressure": (55.0, 110.0),
    "fan_speed": (-1.0, 120.0),
    "fan_speed_command": (-1.0, 120.0),
}
"""Canonical values between which most samples of a tower in operation lie, by role."""
FANS = ("fan_speed", "fan_speed_command")
SHARE = (0.4, 1.3)
"""High and highest values of a fan that is given as a share of full: one that stands reads less, one in % more."""
TURNING = (5.0, 120.0)
"""Speed of a fan that turns, %."""
LEAST_SHARE = 0.2
"""Share of the samples in the usual range; a unit switch leaves more on one side."""
FLOW = (0.1, 3.0)
"""Times the design flow between which most samples of a running cell lie."""
USUAL_FLOW = (0.25, 1.5)
"""Times the design flow between which a cell is run: below, the fill is not wetted; above, nozzles and basin overflow.
Another unit in which the flow is usual is taken as its right one."""
SILENT_DAYS = 3.0
FEWEST = 20
"""Samples of a tag below which nothing is judged by them."""
DAY_S = 86400.0


def in_usual_units(
    series: Sequence[Series],
    places: dict[str, str],
    design_flow_kg_s: float | None = None,
    full_speed: str = "60 Hz",
) -> tuple[list[Series], list[str]]:
    """Return the tags whose values are possible in their unit, and a sentence for each of the others.

    Parameters
    ----------
    series
        Raw samples.
    places
        File and line of each tag in the dictionary, for the sentences.
    design_flow_kg_s
        Of a cell, by the datasheet.
    full_speed
        Speed of 100 %, as a number with its unit.

    Raises
    ------
    UnitError
        `full_speed` is no speed.
    """
    kept, remarks = [], []
    for one in series:
        usual = USUAL.get(one.tag.role)
        values = one.value[one.good]
        if one.tag.role == "water_flow" and design_flow_kg_s:
            usual = FLOW[0] * design_flow_kg_s, FLOW[1] * design_flow_kg_s
        if one.tag.role == "water_flow" and len(values):
            values = values[values > 0.1 * np.quantile(values, 0.95)]
        unit = _in_percent(one.tag.unit, full_speed)
        top = float(np.quantile(values, 0.95)) if len(values) else 0.0
        if one.tag.role in FANS and SHARE[0] < top and values.max() < SHARE[1]:
            usual, values = TURNING, values[values > 0.1 * top]
        if usual is None or len(values) < FEWEST:
            kept.append(one)
            continue
        fitting = _fitting(one.tag, values, usual, full_speed)
        if one.tag.role == "water_flow" and design_flow_kg_s:
            run = USUAL_FLOW[0] * design_flow_kg_s, USUAL_FLOW[1] * design_flow_kg_s
            if _share(values, unit, run) < LEAST_SHARE and (better := _fitting(one.tag, values, run, full_speed)):
                usual, fitting = run, better
        if _share(values, unit, usual) >= LEAST_SHARE:
            kept.append(one)
            continue
        remedy = f"give it the unit {' or '.join(fitting)} there" if fitting else "look at the instrument"
        middle = float(np.median(values))
        remarks.append(
            f"{places.get(one.tag.name, 'the dictionary')}: {one.tag.name} has a median of {middle:g} {one.tag.unit}, "
            f"which no {one.tag.role} has; it is left out; {remedy}"
        )
    return kept, remarks


def _in_percent(name: str, full_speed: str) -> Unit:
    """Return a unit; one of speed as that of per cent of the speed at 100 %."""
    unit = unit_of(name)
    return Unit(unit.dimension, 100.0 * unit.scale / full_speed_of(full_speed)[0]) if unit.dimension in SPEEDS else unit


def _fitting(tag: Tag, values: Array, usual: tuple[float, float], full_speed: str) -> list[str]:
    """Return the units, one name of each, in which most of the values are usual."""
    others = list(alternatives(tag.unit))
    if tag.role in FANS:
        others += [name for name, unit in UNITS.items() if unit.dimension in ("share", *SPEEDS) and name != tag.unit]
    found: dict[tuple[float, float], str] = {}
    for name in others:
        unit = _in_percent(name, full_speed)
        speed = full_speed_of(full_speed)[1]
        if unit.dimension in SPEEDS and unit.dimension != speed.dimension:
            continue
        if _share(values, unit, usual) > 1.0 - LEAST_SHARE:
            found.setdefault((unit.scale, unit.offset), name)
    return list(found.values())


def _share(values: Array, unit: Unit, usual: tuple[float, float]) -> float:
    canonical = unit.scale * values + unit.offset
    return float(((canonical >= usual[0]) & (canonical <= usual[1])).mean())


def without_strays(series: Sequence[Series], places: dict[str, str]) -> tuple[list[Series], list[str]]:
    """Return the series without samples at times that are not of the record, and a sentence for each tag with some.

    Such samples are few, and lie further from the others than these span: the clock of a logger that began anew in
    1970, or a stamp with digits too many. Each minute up to them would be a row of the record.

    Parameters
    ----------
    series
        Raw samples.
    places
        File and line of each tag in the dictionary, for the sentences.
    """
    times = np.sort(np.concatenate([one.time_s for one in series])) if series else np.zeros(0)
    low, high = 0, len(times)
    while high - low > 1:
        gap = np.diff(times[low:high])
        at = low + int(np.argmax(gap)) + 1
        keep_late = high - at >= at - low
        kept = (at, high) if keep_late else (low, at)
        few = (times[low], times[at - 1]) if keep_late else (times[at], times[high - 1])
        apart = float(gap.max()) > times[kept[1] - 1] - times[kept[0]]
        most = max(int(((one.time_s >= few[0]) & (one.time_s <= few[1])).sum()) for one in series)
        if not apart or most >= FEWEST:
            break
        low, high = kept
    if high - low in (0, len(times)):
        return list(series), []
    found, remarks = [], []
    for one in series:
        inside = (one.time_s >= times[low]) & (one.time_s <= times[high - 1])
        found.append(one.rows(inside))
        if not inside.all():
            first = one.time_s[~inside][0]
            remarks.append(
                f"{places.get(one.tag.name, 'the dictionary')}: {(~inside).sum()} samples of {one.tag.name} lie "
                f"further from the others than these span, first at {np.datetime64(int(first), 's')}Z; they are left "
                f"out: check the logger's clock"
            )
    return found, remarks


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
    import datetime

    def day(time_s: float) -> str:
        return datetime.datetime.fromtimestamp(time_s, datetime.UTC).strftime("%Y-%m-%d")

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
            silent.setdefault((day(times[k]), day(times[k + 1])), []).append(one.tag.name)
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
    return np.asarray(rows[:-1][(step < 0.0) & ~(local & _hour(-step))], dtype=np.intp)


def _hour(fall_s: Array) -> NDArray[np.bool_]:
    """Return which falls are of the hour of a clock change, less the interval of the samples."""
    return np.asarray((fall_s >= 1800.0) & (fall_s <= 3600.0))
