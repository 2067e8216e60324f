"""Tags that cannot be in the unit of the dictionary, from the first sample to the last.

Nothing is guessed: such a tag is left out, and the remark names the unit in which its values would be usual.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.historian.tags import Array, Series
from twin.historian.units import alternatives, unit_of

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
SILENT_DAYS = 3.0
DAY_S = 86400.0


def in_usual_units(
    series: Sequence[Series], places: dict[str, str], design_flow_kg_s: float | None = None
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
    """
    kept, remarks = [], []
    for one in series:
        usual = USUAL.get(one.tag.role)
        if one.tag.role == "water_flow" and design_flow_kg_s:
            usual = FLOW[0] * design_flow_kg_s, FLOW[1] * design_flow_kg_s
        values = one.value[one.good]
        if one.tag.role == "water_flow" and len(values):
            values = values[values > 0.1 * np.quantile(values, 0.95)]
        if one.tag.role in FANS and len(values) and SHARE[0] < np.quantile(values, 0.95) and values.max() < SHARE[1]:
            usual, values = TURNING, values[values > 0.1 * np.quantile(values, 0.95)]
        unit = unit_of(one.tag.unit)
        if usual is None or len(values) < 20 or _share(values, unit.scale, unit.offset, usual) >= LEAST_SHARE:
            kept.append(one)
            continue
        if unit.dimension == "frequency":
            kept.append(one)
            continue
        fitting = _fitting(one.tag.unit, values, usual)
        remedy = f"give it the unit {' or '.join(fitting)} there" if fitting else "look at the instrument"
        middle = float(np.median(values))
        remarks.append(
            f"{places.get(one.tag.name, 'the dictionary')}: {one.tag.name} has a median of {middle:g} {one.tag.unit}, "
            f"which no {one.tag.role} has; it is left out; {remedy}"
        )
    return kept, remarks


def _fitting(unit: str, values: Array, usual: tuple[float, float]) -> list[str]:
    """Return the units, one name of each, in which most of the values are usual."""
    found: dict[tuple[float, float], str] = {}
    for name, other in alternatives(unit).items():
        if _share(values, other.scale, other.offset, usual) > 1.0 - LEAST_SHARE:
            found.setdefault((other.scale, other.offset), name)
    return list(found.values())


def _share(values: Array, scale: float, offset: float, usual: tuple[float, float]) -> float:
    canonical = scale * values + offset
    return float(((canonical >= usual[0]) & (canonical <= usual[1])).mean())


def order_and_silence(series: Sequence[Series], places: dict[str, str]) -> list[str]:
    """Return a sentence for each tag whose stored times go back, or that is silent for days."""
    import datetime

    def day(time_s: float) -> str:
        return datetime.datetime.fromtimestamp(time_s, datetime.UTC).strftime("%Y-%m-%d")

    remarks, turned = [], [one for one in series if (np.diff(one.time_s) < 0.0).any()]
    if turned:
        first = turned[0]
        back = np.flatnonzero(np.diff(first.time_s) < 0.0)
        others = f", as do those of {len(turned) - 1} further tags" if len(turned) > 1 else ""
        remarks.append(
            f"{places.get(first.tag.name, 'the dictionary')}: the times of {first.tag.name} go back {len(back)} times "
            f"in the store, first in row {back[0] + 2} of its samples{others}; they were sorted: check the "
            f"logger's clock"
        )
    for one in series:
        place = places.get(one.tag.name, "the dictionary")
        times = np.sort(one.time_s)
        for k in np.flatnonzero(np.diff(times) > SILENT_DAYS * DAY_S):
            remarks.append(f"{place}: {one.tag.name} has no sample from {day(times[k])} to {day(times[k + 1])}")
    return remarks
