"""Tags that cannot be in the unit of the dictionary, from the first sample to the last.

Nothing is guessed: such a tag is left out, and the remark names the unit in which its values would be usual.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from twin.historian.exchanges import Exchange, exchanged_meter
from twin.historian.ratings import Ratings, contradictions
from twin.historian.tags import Array, Defect, Series, Tag
from twin.historian.units import SPEEDS, UNITS, Unit, full_speed_of, possible_units, unit_of

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
    "header_pressure": (1.0, 2000.0),
    "basin_level": (5.0, 105.0),
    "wind_speed": (-1.0, 20.0),
    "fan_speed": (-1.0, 120.0),
    "fan_speed_command": (-1.0, 120.0),
}
"""Canonical values between which most samples of a tower in operation lie, by role."""
FANS = ("fan_speed", "fan_speed_command")
OF_WATER = (
    "water_inlet_temperature",
    "water_outlet_temperature",
    "basin_temperature",
    "return_header_temperature",
    "supply_temperature",
)
WHOLE, NEVER = 0.98, (np.inf, np.inf)
"""Share of the samples that are usual in a unit in which all of the record is; and a range in which none is."""
SITE_PRESSURE = 0.1
"""Share by which the air pressure of a site may be off that of its datasheet: the lowest and the highest at sea level
are 14 % and 7 % off the mean, and 20 min of a storm are not most of a record."""
SHARE = (0.4, 1.3)
"""High and highest values of a fan that is given as a share of full: one that stands reads less, one in % more."""
TURNING = (5.0, 120.0)
"""Speed of a fan that turns, %."""
LEAST_SHARE = 0.2
"""Share of the samples in the usual range; a unit switch leaves more on one side."""
FLOW = (0.1, 3.0)
"""Times the design flow between which most samples of a running cell lie."""
OF_MOTOR = (0.01, 1.5)
"""Power of a fan at work over that of its motor: at a fifth of the speed, and with the service factor of motors."""
USUAL_FLOW = (0.25, 1.5)
"""Times the design flow between which a cell is run: below, the fill is not wetted; above, nozzles and basin overflow.
Another unit in which the flow is usual is taken as its right one."""
METERED = ("water_flow", "makeup_flow", "blowdown_flow")
"""Roles of flow meters whose level of a day is alike from one day to the next."""
COUNTED = ("mass flow", "power")
"""Dimensions whose meters have a totaliser, of water or energy."""
PARTS, FEWEST_STEPS, MOST_WRAPS = 4, 50, 0.25
"""Parts of a record, changes in one, and share of falls in a counter that begins anew: noise has as many falls as
rises, fifty rises in a row by chance once in 1e15."""
SEGMENTS = 20
"""Segments of a record, of the same number of samples at work: a flow that is usual in one of them was in its unit
then, so that all of the record is in no other."""
LIKELY_FLOW = (0.5, 1.5)
"""The same of most plants: beyond, a flow is named where another unit brings it there."""
SHOWN = 3
"""Units that a remedy names at most, the usual ones first."""
FEWEST = 20
"""Samples of a tag below which nothing is judged by them."""


def in_usual_units(
    series: Sequence[Series], places: dict[str, str], ratings: Ratings | None = None
) -> tuple[list[Series], list[str]]:
    """Return the tags whose values are possible in their unit, and a sentence for each of the others.

    A tag that contradicts the datasheet or other tags as little as the plant's own faults do is named and kept.

    Parameters
    ----------
    series
        Raw samples.
    places
        File and line of each tag in the dictionary, for the sentences.
    ratings
        Of the datasheet.

    Raises
    ------
    UnitError
        The speed of 100 % is no speed.
    """
    ratings = ratings or Ratings()
    design_flow_kg_s, full_speed = ratings.water_flow_kg_s, ratings.full_speed
    kept, remarks = [], []
    for whole in series:
        one, remark = _of_one_meter(whole, design_flow_kg_s)
        if remark:
            remarks.append(f"{places.get(whole.tag.name, 'the dictionary')}: {remark}")
        if one is None:
            continue
        usual = USUAL.get(one.tag.role)
        values = one.value[one.good]
        if one.tag.role == "water_flow" and design_flow_kg_s:
            usual = FLOW[0] * design_flow_kg_s, FLOW[1] * design_flow_kg_s
        if one.tag.role == "water_flow" and len(values):
            values = _at_work(values)
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
            in_time = _at_work(_in_time(one))
            segments = np.array_split(in_time, SEGMENTS) if len(in_time) >= SEGMENTS * FEWEST else []
            if any(_share(part, unit, run) > 1.0 - LEAST_SHARE for part in segments):
                kept.append(one)
                continue
            if _share(values, unit, run) < LEAST_SHARE and (better := _fitting(one.tag, values, run, full_speed)):
                usual, fitting = run, better
            elif doubt := _flow_in_doubt(one.tag, values, unit, design_flow_kg_s):
                remarks.append(f"{places.get(one.tag.name, 'the dictionary')}: {doubt}")
        if one.tag.role in OF_WATER and _share(values, unit, usual) < 1.0 - LEAST_SHARE and fitting:
            # Not a part of the record in another unit: all of it is usual in that one.
            all_of_it = [name for name in fitting if _share(values, _in_percent(name, full_speed), usual) > WHOLE]
            if all_of_it and not _for_one_span(~_between(_in_time(one), unit, usual)):
                usual, fitting = NEVER, all_of_it
        if one.tag.role == "barometric_pressure" and ratings.pressure_kPa:
            run = (1.0 - SITE_PRESSURE) * ratings.pressure_kPa, (1.0 + SITE_PRESSURE) * ratings.pressure_kPa
            if _share(values, unit, run) < LEAST_SHARE and (better := _fitting(one.tag, values, run, full_speed)):
                usual, fitting = run, better
        if _share(values, unit, usual) >= LEAST_SHARE:
            kept.append(one)
            continue
        remedy = f"give it the unit {' or '.join(fitting[:SHOWN])} there" if fitting else "look at the instrument"
        middle = float(np.median(values))
        remarks.append(
            f"{places.get(one.tag.name, 'the dictionary')}: {one.tag.name} has a median of {middle:g} {one.tag.unit}, "
            f"which no {one.tag.role} has; it is left out; {remedy}"
        )
    for found in contradictions(kept, ratings):
        remedy = (
            f"give it the unit {' or '.join(found.units[:SHOWN])}"
            if found.units
            else "check its unit and its instrument"
        )
        what = f"{found.tag} is left out" if found.left_out else "it is used as it stands"
        remarks.append(f"{places.get(found.tag, 'the dictionary')}: {found.says}; {what}; {remedy}")
        kept = [one for one in kept if one.tag.name != found.tag or not found.left_out]
    return kept, remarks


def usual_at_work(tags: Iterable[Tag], ratings: Ratings) -> dict[str, tuple[float, float]]:
    """Return the values at work of the tags that the datasheet rates, in the record's unit, by tag."""
    found = {}
    for tag in tags:
        if tag.role == "water_flow" and ratings.water_flow_kg_s:
            found[tag.name] = FLOW[0] * ratings.water_flow_kg_s, FLOW[1] * ratings.water_flow_kg_s
        elif tag.role == "fan_power" and (rated := ratings.motor_kW or ratings.fan_kW):
            found[tag.name] = OF_MOTOR[0] * rated, OF_MOTOR[1] * rated
        elif tag.role == "barometric_pressure" and ratings.pressure_kPa:
            found[tag.name] = (1.0 - SITE_PRESSURE) * ratings.pressure_kPa, (1.0 + SITE_PRESSURE) * ratings.pressure_kPa
    return found


def _of_one_meter(series: Series, design_kg_s: float | None) -> tuple[Series | None, str]:
    """Return the samples of a meter that are one rate, None of a totaliser, and a sentence on what is left out."""
    name, unit = series.tag.name, series.tag.unit
    if unit_of(unit).dimension in COUNTED and _counts(series):
        return None, (
            f"{name} only rises, but for falls over most of its range, as a totaliser does; it is left out: map the "
            f"tag of the rate, or store its increase per time"
        )
    change = _exchange(series, design_kg_s)
    return (series, "") if change is None else (change.right(series), _says_exchanged(series, change))


def _exchange(series: Series, design_kg_s: float | None) -> Exchange | None:
    """Return the exchange of a meter of a flow, None of one without; only cells have a design flow."""
    if series.tag.role not in METERED:
        return None
    return exchanged_meter(series, design_kg_s if series.tag.role == "water_flow" else None)


def _says_exchanged(series: Series, change: Exchange) -> str:
    return (
        f"{series.tag.name} goes from {change.before:.4g} to {change.after:.4g} {series.tag.unit} at "
        f"{np.datetime64(int(change.time_s), 's')}Z and stays there, as of a meter that was exchanged; its samples "
        f"{'from then on' if change.late_is_wrong else 'before'} are left out: correct them in the store"
    )


def exchanged_meters(series: Iterable[Series], ratings: Ratings) -> list[Defect]:
    """Return the parts of the record whose samples `in_usual_units` leaves out, as of meters that were exchanged.

    Parameters
    ----------
    series
        Raw samples.
    ratings
        Of the datasheet.
    """
    found = []
    for one in series:
        if unit_of(one.tag.unit).dimension in COUNTED and _counts(one):
            continue
        if (change := _exchange(one, ratings.water_flow_kg_s)) is not None:
            times = one.time_s[one.good]
            span = (change.time_s, float(times.max())) if change.late_is_wrong else (float(times.min()), change.time_s)
            found.append(Defect("range_change", (one.tag.name,), *span, _says_exchanged(one, change), "left out"))
    return found


def _counts(series: Series) -> bool:
    """Return whether the samples of a part of the record are those of a counter."""
    order = np.argsort(series.time_s, kind="stable")
    values = series.value[order][series.good[order]]
    for part in np.array_split(values, PARTS):
        step = np.diff(part)
        step = step[step != 0.0]
        falls = -step[step < 0.0]
        if len(step) < FEWEST_STEPS or len(falls) > MOST_WRAPS * len(step):
            continue
        if not len(falls) or float((falls > 0.5 * np.ptp(part)).mean()) > 1.0 - LEAST_SHARE:
            return True
    return False


def _at_work(values: Array) -> Array:
    """Return the values without those at rest, also where a part of them is another range of ten times as much."""
    top = float(np.quantile(values, 0.95))
    above = values[values > 0.01 * top]
    return values[values > 0.1 * min(top, float(np.median(above)) if len(above) else top)]


def _flow_in_doubt(tag: Tag, values: Array, unit: Unit, design_kg_s: float) -> str:
    """Return a sentence on a flow that is possible in its unit and near the design flow in another one, else ""."""
    run = LIKELY_FLOW[0] * design_kg_s, LIKELY_FLOW[1] * design_kg_s
    fitting = [] if _share(values, unit, run) >= LEAST_SHARE else _fitting(tag, values, run, "60 Hz")
    if not fitting:
        return ""
    share = (unit.scale * float(np.median(values)) + unit.offset) / design_kg_s
    return (
        f"{tag.name} has a median of {share:.2g} times the design flow; it is used as it stands; if it is in "
        f"{' or '.join(fitting[:SHOWN])}, give it that unit"
    )


def _in_percent(name: str, full_speed: str) -> Unit:
    """Return a unit; one of speed as that of per cent of the speed at 100 %."""
    unit = unit_of(name)
    return Unit(unit.dimension, 100.0 * unit.scale / full_speed_of(full_speed)[0]) if unit.dimension in SPEEDS else unit


def _fitting(tag: Tag, values: Array, usual: tuple[float, float], full_speed: str) -> list[str]:
    """Return the units, one name of each, in which most of the values are usual."""
    by_rank = (_usual_in(list(units), tag, values, usual, full_speed) for units in possible_units(tag.unit))
    return next((found for found in by_rank if found), [])


def _usual_in(others: list[str], tag: Tag, values: Array, usual: tuple[float, float], full_speed: str) -> list[str]:
    """Return which of some units, one name of each, the values are usual in."""
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
    return float(_between(values, unit, usual).mean())


def _between(values: Array, unit: Unit, usual: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the values (n,) that are usual in a unit."""
    canonical = unit.scale * values + unit.offset
    return np.asarray((canonical >= usual[0]) & (canonical <= usual[1]))


def _in_time(series: Series) -> Array:
    """Return the good values in the order of their stamps."""
    return np.asarray(series.value[series.good][np.argsort(series.time_s[series.good], kind="stable")])


def _for_one_span(off: NDArray[np.bool_]) -> bool:
    """Return True if the samples that are off (n,) are nearly all of one span, and none of the others.

    That is a change of the unit at a time: what is off with the weather comes and goes.
    """
    rows = np.flatnonzero(off)
    few = int((1.0 - WHOLE) * len(rows))
    first, last = rows[few], rows[len(rows) - 1 - few]
    others = len(off) - (last + 1 - first)
    return bool(others >= FEWEST and off[first : last + 1].mean() >= WHOLE)
