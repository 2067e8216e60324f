"""Tags that are possible in their unit and yet contradict the datasheet or another tag of the plant throughout.

A fan's power in hp, a speed in Hz that is called per cent, a heat load in tons: each value by itself could be in the
unit of the dictionary. The law of the fan, the command of its drive and the heat that the water loses tell that it is
not. A tag is left out where it is off by more than the plant's own faults and another unit brings it right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.historian.checks import FAN_APART
from twin.historian.defects.panel import known_median
from twin.historian.regimes import FOLLOWS_PCT, STANDSTILL_PCT
from twin.historian.tags import Array, Series, longest_interval_s
from twin.historian.units import SPEEDS, UNITS, WATER_DENSITY, Unit, full_speed_of, possible_units, unit_of
from twin.tower.air import SEA_LEVEL_KPA, wet_bulb

AT_WORK = 0.4
"""Share of full speed from which the power of a fan is compared: below, losses at any speed count."""
CERTAIN = 2.0
"""Factor beyond which no density, pitch or belt makes a fan's power, nor the meters of a plant its heat."""
LATENT_KJ_KG = 2430.0
"""Heat of evaporation of water at 30 degC (IAPWS-IF97)."""
CP_KJ_KG_K = 4.18
PARTS = 8
"""Parts of a record in which a ratio must be alike: four days of a month, which average over a day and a filling of the
basin."""
MOSTLY = 0.8
"""Share of the hours in which temperatures of the air are possible in a unit, and of the parts of a record that a wrong
unit spoils: a changed range or a fault spoils fewer."""
NO_CLOSURE_K, CLOSURE_SHARE = 1.0, 0.25
"""Distance of the wet bulb from that of dry bulb and humidity, in the median, that is twice what humidities good to 3 %
leave; and the largest share of it that the right unit leaves."""
EFFICIENCY = (0.02, 1.0)
"""Work of the water in the header over the power of the pumps: below it, as friction and lift before the gauge take
some; above one no pump is."""
FEWEST = 100
"""Samples or hours at work by which a tag is judged."""
HOUR_S = 3600.0


@dataclass(frozen=True)
class Ratings:
    """Datasheet of a station: water flow of a cell kg/s, pressure of the site kPa, a fan's power at full speed and that
    of its motor kW, its speed at 100 % with its unit, number of cells; None where it is not stated."""

    water_flow_kg_s: float | None = None
    pressure_kPa: float | None = None
    fan_kW: float | None = None
    motor_kW: float | None = None
    full_speed: str = "60 Hz"
    cells: int | None = None


@dataclass(frozen=True)
class Contradiction:
    """A tag that contradicts another quantity: what is seen, units in which it would not, whether it is left out."""

    tag: str
    says: str
    units: tuple[str, ...]
    left_out: bool


def contradictions(series: Sequence[Series], ratings: Ratings) -> list[Contradiction]:
    """Return the tags that contradict the datasheet or other tags.

    Parameters
    ----------
    series
        Raw samples of tags that are possible in their units.
    ratings
        Of the datasheet.
    """
    of = {(one.tag.role, one.tag.cell): one.rows(one.good) for one in series}
    of = {key: one.rows(np.argsort(one.time_s, kind="stable")) for key, one in of.items() if one.good.sum() >= FEWEST}
    cells = sorted({cell for _, cell in of if cell is not None})
    found = [one for cell in cells if (one := _of_fan(of, cell, ratings)) is not None]
    return [*found, *_of_heat(of, cells, ratings), *_of_pumps(of, cells, ratings), *_of_weather(of, ratings)]


def _of_fan(of: Mapping[tuple[str, int | None], Series], cell: int, ratings: Ratings) -> Contradiction | None:
    """Return the speed or the power of a cell's fan if it contradicts the fan's law or its command."""
    speed, command, power = (of.get((f"fan_{name}", cell)) for name in ("speed", "speed_command", "power"))
    turning = speed or command
    full = None if power is None or turning is None else _at_full_speed(power, turning, ratings.full_speed)
    if full is not None and (rated := ratings.fan_kW or ratings.motor_kW):
        low = 1.0 - FAN_APART if ratings.fan_kW else 1.0 / (CERTAIN * CERTAIN)
        ratio, band = full / rated, (low, 1.0 + FAN_APART)
        if not band[0] <= ratio <= band[1]:
            return _of_power(of, cell, ratio, band, ratings)
    if speed is None or command is None:
        return None
    follows = _followed(speed, command, ratings.full_speed)
    near = 1.0 - FOLLOWS_PCT / 100.0, 1.0 + FOLLOWS_PCT / 100.0
    if follows is None or near[0] <= follows <= near[1]:
        return None
    units = _units_of_speed(speed, ratings.full_speed, lambda factor: near[0] <= factor * follows <= near[1])
    says = f"{speed.tag.name} is {follows:.2g} times its command {command.tag.name} throughout"
    return Contradiction(speed.tag.name, says, units, left_out=False)


def _of_power(
    of: Mapping[tuple[str, int | None], Series],
    cell: int,
    ratio: float,
    band: tuple[float, float],
    ratings: Ratings,
) -> Contradiction:
    """Return the tag of a fan whose power at full speed is `ratio` times that of the datasheet."""
    speed, command, power = (of.get((f"fan_{name}", cell)) for name in ("speed", "speed_command", "power"))
    assert power is not None
    turning = speed or command
    assert turning is not None
    own = unit_of(power.tag.unit)
    fitting = _fitting(power.tag.unit, lambda unit: band[0] <= ratio * unit.scale / own.scale <= band[1])
    fast = _units_of_speed(turning, ratings.full_speed, lambda factor: band[0] <= ratio / factor**3 <= band[1])
    follows = None if speed is None or command is None else _followed(speed, command, ratings.full_speed)
    apart = follows is not None and abs(follows - 1.0) > FOLLOWS_PCT / 100.0
    wrong, units = (turning, fast) if fast and (apart or not fitting) else (power, fitting)
    says = (
        f"{power.tag.name} is {ratio:.3g} times the power of the datasheet at full speed, by the cube of "
        f"{turning.tag.name}"
    )
    certain = bool(units) and not band[0] / CERTAIN <= ratio <= band[1] * CERTAIN
    return Contradiction(wrong.tag.name, says, units, left_out=certain)


def _at_full_speed(power: Series, turning: Series, full_speed: str) -> float | None:
    """Return the power of a fan at full speed by the cube of its speed, kW; None where it is seldom at work."""
    share = _share_of_full(turning, turning.at(power.time_s, 1.2 * longest_interval_s(turning)), full_speed)
    drawn = unit_of(power.tag.unit).scale * power.value
    rows = np.flatnonzero((share > AT_WORK) & (drawn > 0.0))
    return _alike(drawn[rows] / share[rows] ** 3)


def _followed(speed: Series, command: Series, full_speed: str) -> float | None:
    """Return the speed of a fan over its command, in the median of those above standstill."""
    at = np.clip(np.searchsorted(command.time_s, speed.time_s, side="right") - 1, 0, None)
    turning = _share_of_full(speed, speed.value, full_speed)
    asked = _share_of_full(command, command.value[at], full_speed)
    rows = (turning > STANDSTILL_PCT / 100.0) & (asked > STANDSTILL_PCT / 100.0)
    return _alike(turning[rows] / asked[rows])


def _alike(ratios: Array) -> float | None:
    """Return the median of ratios in the order of time; None of few, or where that of a part differs much."""
    if len(ratios) < FEWEST:
        return None
    parts, whole = [float(np.median(part)) for part in np.array_split(ratios, PARTS)], float(np.median(ratios))
    # What changed in the middle of the record is no unit of all of it.
    return whole if max(parts) <= (1.0 + FAN_APART) * min(parts) else None


def _share_of_full(series: Series, value: Array, full_speed: str) -> Array:
    unit = unit_of(series.tag.unit)
    scale = unit.scale / full_speed_of(full_speed)[0] if unit.dimension in SPEEDS else unit.scale / 100.0
    return np.asarray(scale * value)


def _units_of_speed(series: Series, full_speed: str, fits: Callable[[float], bool]) -> tuple[str, ...]:
    """Return the units in which a fan's speed would be that many times higher as fits."""
    full, unit = full_speed_of(full_speed)
    own = float(_share_of_full(series, np.ones(1), full_speed)[0])
    usable = {name: one.scale / full for name, one in UNITS.items() if one == unit}
    usable |= {"%": 0.01, "1": 1.0}
    return tuple(name for name, share in usable.items() if share != own and fits(share / own))


def _fitting(text: str, fits: Callable[[Unit], bool]) -> tuple[str, ...]:
    """Return the likeliest units, one name of each, that fit."""
    for units in possible_units(text):
        found: dict[float, str] = {}
        for name, unit in units.items():
            if fits(unit):
                found.setdefault(round(float(np.log(unit.scale)), 3), name)
        if found:
            return tuple(found.values())
    return ()


def _of_heat(
    of: Mapping[tuple[str, int | None], Series], cells: Sequence[int], ratings: Ratings
) -> list[Contradiction]:
    """Return what contradicts the heat that the water loses: heat load, flows, make-up."""
    wanted = ("water_inlet_temperature", "water_outlet_temperature", "water_flow")
    whole = [cell for cell in cells if all((role, cell) in of for role in wanted)]
    if not whole:
        return []
    ends = [of[role, cell].time_s[[0, -1]] for cell in whole for role in wanted]
    grid = np.arange(min(low for low, _ in ends), max(high for _, high in ends), HOUR_S)
    heat = np.zeros(len(grid))
    for cell in whole:
        hot, cold, flow = (_hourly(of[role, cell], grid) for role in wanted)
        heat = heat + CP_KJ_KG_K * flow * (hot - cold)
    # Cells that are not recorded may carry nothing, or as much each.
    low, high = 1.0 / CERTAIN, CERTAIN * max((ratings.cells or 0) / len(whole), 1.0)
    flows = [of["water_flow", cell] for cell in whole]
    near = _near_design(flows, ratings)
    if any(near) and not all(near):
        return []  # the flows contradict each other, so that the heat is not known
    found = []
    if (load := of.get(("station_heat_load", None))) is not None:
        ratio = _ratio(_hourly(load, grid), heat)
        of_flows = (flows, -1.0) if near and not any(near) else None
        found += _blamed(ratio, (low, high), ((load,), 1.0), of_flows, LOAD)
    water = [of.get((f"{name}_flow", None)) for name in ("makeup", "blowdown")]
    makeup, blowdown = water
    if makeup is not None and not any(one.units for one in found):
        gone = _hourly_mean(makeup, grid) - (0.0 if blowdown is None else np.nan_to_num(_hourly_mean(blowdown, grid)))
        ratio = LATENT_KJ_KG * _ratio(gone, heat)
        # A part of the heat is sensible, more of it in the cold; without its own meter, blowdown is in the make-up.
        band = low / CERTAIN, high if blowdown is not None else CERTAIN * high
        if not np.isfinite(ratio):
            ratio = _beyond(LATENT_KJ_KG * gone, heat, band)
        both = [one for one in water if one is not None and one.tag.unit == makeup.tag.unit]
        found += _blamed(ratio, band, (both, 1.0), None, WATER)
    return found


def _of_pumps(
    of: Mapping[tuple[str, int | None], Series], cells: Sequence[int], ratings: Ratings
) -> list[Contradiction]:
    """Return the power of the pumps, or the pressure, where the water would carry more or far less than the pumps
    draw; and a blowdown above the make-up."""
    found = []
    power, pressure = of.get(("pump_power", None)), of.get(("header_pressure", None))
    flows = [of["water_flow", cell] for cell in cells if ("water_flow", cell) in of]
    near = _near_design(flows, ratings)
    if power is not None and pressure is not None and flows and any(near) == all(near):
        grid = np.arange(power.time_s[0], power.time_s[-1], HOUR_S)
        flow = np.sum([_hourly(one, grid) for one in flows], axis=0)
        work = _hourly(pressure, grid) * flow / WATER_DENSITY
        ratio = _ratio(work, _hourly(power, grid))
        low, high = EFFICIENCY[0] / max((ratings.cells or 0) / len(flows), 1.0), EFFICIENCY[1]
        if np.isfinite(ratio) and not low <= ratio <= high:
            own = unit_of(power.tag.unit), unit_of(pressure.tag.unit)
            units = (
                _fitting(power.tag.unit, lambda unit: low <= ratio * own[0].scale / unit.scale <= high),
                _fitting(pressure.tag.unit, lambda unit: low <= ratio * unit.scale / own[1].scale <= high),
            )
            says = (
                f"by flow and {pressure.tag.name} the water takes {ratio:.3g} times the power of the pumps, "
                f"{power.tag.name}"
            )
            wrong, fitting = (power, units[0]) if units[0] else (pressure, units[1])
            found.append(Contradiction(wrong.tag.name, says, fitting, left_out=False))
    makeup, blowdown = (of.get((f"{name}_flow", None)) for name in ("makeup", "blowdown"))
    if makeup is not None and blowdown is not None:
        grid = np.arange(makeup.time_s[0], makeup.time_s[-1], HOUR_S)
        ratio = _ratio(_hourly(blowdown, grid), _hourly(makeup, grid))
        if ratio > CERTAIN:
            own_unit = unit_of(blowdown.tag.unit)
            fitting = _fitting(
                blowdown.tag.unit, lambda unit: 0.01 < ratio * unit.scale / own_unit.scale < 1.0 / CERTAIN
            )
            says = f"{blowdown.tag.name} is {ratio:.3g} times the make-up {makeup.tag.name} that replaces it"
            found.append(Contradiction(blowdown.tag.name, says, fitting, left_out=False))
    return found


LOAD = "the heat that the water of the cells loses"
WATER = "that of the evaporation which the heat of the cells asks for"


def _blamed(
    ratio: float,
    band: tuple[float, float],
    first: tuple[Sequence[Series], float],
    second: tuple[Sequence[Series], float] | None,
    what: str,
) -> list[Contradiction]:
    """Return the tags whose other unit brings a ratio between its bounds.

    Parameters
    ----------
    ratio, band
        The ratio, and its bounds; NaN where nothing is known.
    first, second
        Tags, and the power with which their values enter the ratio.
    what
        Quantity that the first tags are held against, for the sentence.
    """
    if not np.isfinite(ratio) or band[0] <= ratio <= band[1]:
        return []
    middle = float(np.sqrt(band[0] * band[1]))
    inner = np.sqrt(band[0] * middle), np.sqrt(band[1] * middle)
    for tags, power in (second, first) if second is not None else (first,):
        own = unit_of(tags[0].tag.unit)
        if ratio <= 0.0 or any(one.tag.unit != tags[0].tag.unit for one in tags):
            continue
        bounds = inner if power > 0.0 else (1.0 / inner[1], 1.0 / inner[0])
        shown = ratio if power > 0.0 else 1.0 / ratio
        units = _fitting(tags[0].tag.unit, _within(shown, own, bounds))
        if units:
            return [Contradiction(one.tag.name, _says(one, shown, what, first, power), units, True) for one in tags]
    one = first[0][0]
    return [Contradiction(one.tag.name, _says(one, ratio, what, first, 1.0), (), left_out=False)]


def _within(ratio: float, own: Unit, bounds: tuple[float, float]) -> Callable[[Unit], bool]:
    """Return the test of a unit: a ratio in proportion to a tag is between bounds if the tag is in it."""
    return lambda unit: bounds[0] <= ratio * unit.scale / own.scale <= bounds[1]


def _says(one: Series, ratio: float, what: str, first: tuple[Sequence[Series], float], power: float) -> str:
    against = what if power > 0.0 else f"what {first[0][0].tag.name} asks for"
    return f"{one.tag.name} is {ratio:.3g} times {against}"


def _near_design(flows: Sequence[Series], ratings: Ratings) -> list[bool]:
    """Return whether each flow that is not at rest throughout is near the design flow: another unit is far below or
    above. Nothing without a design flow."""
    if ratings.water_flow_kg_s is None:
        return []
    at_work = [np.quantile(unit_of(one.tag.unit).scale * one.value, 0.9) / ratings.water_flow_kg_s for one in flows]
    return [bool(1.0 / CERTAIN <= share <= CERTAIN) for share in at_work if share > 0.0]


def _parts_and_whole(value: Array, heat: Array) -> tuple[Array, float]:
    """Return the sum of a quantity over that of the heat in each part (`PARTS`,) of the record, and in all of it; NaN
    where few hours have both, or a part has no heat.
    """
    rows = np.flatnonzero(np.isfinite(value) & np.isfinite(heat))
    sums = np.array([[value[part].sum(), heat[part].sum()] for part in np.array_split(rows, PARTS)])
    if len(rows) < FEWEST or not (sums[:, 1] > 0.0).all():
        return np.full(PARTS, np.nan), float("nan")
    return sums[:, 0] / sums[:, 1], float(sums[:, 0].sum() / sums[:, 1].sum())


def _ratio(value: Array, heat: Array) -> float:
    """Return the sum of a quantity over that of the heat; NaN where few hours have both, or a part of them differs.

    A unit is wrong in all parts alike; in one of them a meter's range changed.
    """
    parts, ratio = _parts_and_whole(value, heat)
    if ratio > 0.0:
        # Between two parts no plant's own faults make this factor, so that one unit in both would.
        return ratio if 0.0 < parts.max() <= CERTAIN * parts.min() else float("nan")
    return ratio if (np.abs(parts - ratio) <= (CERTAIN - 1.0) * abs(ratio)).all() else float("nan")


def _beyond(value: Array, heat: Array, band: tuple[float, float]) -> float:
    """Return the sum of a quantity over that of the heat where most parts of the record are beyond one end of a band,
    NaN otherwise.

    The cells of which nothing is recorded work by turns, so that the ratio of a right meter differs from part to part.
    """
    parts, ratio = _parts_and_whole(value, heat)
    most_are = max((parts > band[1]).mean(), (parts < band[0]).mean()) >= MOSTLY
    return ratio if most_are else float("nan")


def _hourly_mean(series: Series, grid: Array) -> Array:
    """Return the means over the hours about times (m,), in the record's unit: a valve that opens by turns is seldom
    met by single values. NaN in hours that reach into a hole."""
    time_s, first = np.unique(series.time_s, return_index=True)
    value = series.value[first]
    if len(time_s) < 2:
        return np.full(len(grid), np.nan)
    gap = np.diff(time_s)
    joined = gap <= 1.2 * longest_interval_s(series)
    area = np.concatenate([[0.0], np.cumsum(np.where(joined, 0.5 * gap * (value[1:] + value[:-1]), 0.0))])
    known = np.concatenate([[0.0], np.cumsum(np.where(joined, gap, 0.0))])
    ends = [np.clip(grid + part * HOUR_S, time_s[0], time_s[-1]) for part in (-0.5, 0.5)]
    area_of, known_of = (np.interp(ends[1], time_s, one) - np.interp(ends[0], time_s, one) for one in (area, known))
    unit = unit_of(series.tag.unit)
    whole = known_of > 0.5 * HOUR_S
    return np.asarray(np.where(whole, unit.scale * area_of / np.where(whole, known_of, 1.0) + unit.offset, np.nan))


def _hourly(series: Series, grid: Array) -> Array:
    unit = unit_of(series.tag.unit)
    return np.asarray(unit.scale * series.at(grid, 1.2 * longest_interval_s(series)) + unit.offset)


def _of_weather(of: Mapping[tuple[str, int | None], Series], ratings: Ratings) -> list[Contradiction]:
    """Return a dry or wet bulb, or both, that another unit brings to the humidity."""
    dry, wet = (of.get((f"{name}_bulb_temperature", None)) for name in ("dry", "wet"))
    share = of.get(("relative_humidity", None)) or of.get(("relative_humidity_redundant", None))
    if dry is None or wet is None or share is None:
        return []
    grid = np.arange(dry.time_s[0], dry.time_s[-1], HOUR_S)
    part = np.clip(_hourly(share, grid) / 100.0, 0.01, 1.0)
    values = [one.at(grid, 1.2 * longest_interval_s(one)) for one in (dry, wet)]
    rows = np.isfinite(part) & np.isfinite(values[0]) & np.isfinite(values[1])
    if rows.sum() < FEWEST:
        return []
    parts = np.array_split(np.flatnonzero(rows), PARTS)

    def closure(units: tuple[Unit, Unit]) -> tuple[float, float]:
        """Return the distance that most parts of the record exceed, K, and the one that most keep, as a share of the
        dry bulb's standard deviation: a unit that shrinks the temperatures shrinks their distance as well."""
        t_dry, t_wet = (unit.scale * value + unit.offset for unit, value in zip(units, values, strict=True))
        pressure = np.full(len(t_dry), ratings.pressure_kPa or SEA_LEVEL_KPA)
        possible = rows & (t_dry > -40.0) & (t_dry < 50.0)
        if not possible[rows].mean() > MOSTLY:
            return float("inf"), float("inf")
        off = np.full(len(t_dry), np.nan)
        off[possible] = np.abs(t_wet[possible] - wet_bulb(t_dry[possible], part[possible], pressure[possible]))
        found = [one for one in (known_median(off[k]) for k in parts) if np.isfinite(one)]
        exceeded, kept = (float(np.quantile(found, level)) for level in (1.0 - MOSTLY, MOSTLY))
        return exceeded, kept / max(float(np.std(t_dry[possible])), 1e-9)

    own = unit_of(dry.tag.unit), unit_of(wet.tag.unit)
    now, share_now = closure(own)
    # A unit is wrong in all parts alike; in one of them an instrument's range changed.
    if now < NO_CLOSURE_K:
        return []
    others = [
        {name: unit for units in possible_units(one.tag.unit) for name, unit in units.items()} for one in (dry, wet)
    ]
    changes: list[tuple[tuple[Series, ...], str, tuple[Unit, Unit]]] = []
    changes += [((dry,), name, (unit, own[1])) for name, unit in others[0].items()]
    changes += [((wet,), name, (own[0], unit)) for name, unit in others[1].items()]
    if own[0] == own[1]:
        changes += [((dry, wet), name, (unit, unit)) for name, unit in others[0].items()]
    left, at = min((closure(units)[1], k) for k, (_, _, units) in enumerate(changes))
    if not left < CLOSURE_SHARE * share_now:
        return []
    tags, name, _ = changes[at]
    says = f"by the humidity of {share.tag.name} the wet bulb {wet.tag.name} is {now:.2g} K off that of {dry.tag.name}"
    return [Contradiction(one.tag.name, says, (name,), left_out=True) for one in tags]
