"""Readings of a tag in the record's unit, the least leap that counts, and the law of a fan that ties its tags."""

from __future__ import annotations

import numpy as np

from twin.historian.checks import FAN_APART, THERMOMETER_K
from twin.historian.defects.panel import BASIN, SMALLEST_WORK, TagPanel
from twin.historian.tags import Array, Series, longest_interval_s
from twin.historian.units import unit_of

WITNESSED = frozenset(
    {
        "water_inlet_temperature",
        "water_outlet_temperature",
        "basin_temperature",
        "return_header_temperature",
        "supply_temperature",
        "water_flow",
        "header_pressure",
        "pump_power",
        "station_heat_load",
        "dry_bulb_temperature",
        "wet_bulb_temperature",
        "relative_humidity",
        "relative_humidity_redundant",
        "barometric_pressure",
    }
)
"""Roles that other tags follow. A valve, a command or the makeup is set by hand or switched, and may leap alone."""
WEATHER = frozenset(
    {
        "dry_bulb_temperature",
        "wet_bulb_temperature",
        "relative_humidity",
        "relative_humidity_redundant",
        "barometric_pressure",
    }
)

FANS = ("fan_speed", "fan_power")
LEAST = {"temperature": 1.5 * THERMOMETER_K, "share": 10.0}
"""Smallest leap by dimension, in the record's unit: beyond the largest bias that a calibration may find; of a humidity,
five times the tolerance of its measurement (2 %)."""
LEAST_SHARE = 0.15
"""Smallest leap of a flow, power or pressure as a share of the reading: flow meters drift by a third of it."""
LEAST_KPA = 2.0
"""Smallest leap of a barometer, ten times what the weather does in an hour."""


def related(table: TagPanel, k: int, j: int) -> bool:
    """Return whether a tag `k` may follow a tag `j`: of one cell, one of them of the station, or a basin of all cells.

    The water of a basin comes from all of its cells, so that any of them moves its thermometers.
    """
    cells = table.series[k].tag.cell, table.series[j].tag.cell
    return None in cells or cells[0] == cells[1] or table.series[k].tag.role == BASIN


def canonical(series: Series) -> Array:
    unit = unit_of(series.tag.unit)
    return np.asarray(unit.scale * series.value + unit.offset)


def is_ratio(series: Series) -> bool:
    """Return True for a quantity whose changes count as shares of it."""
    return unit_of(series.tag.unit).dimension not in LEAST and series.tag.role != "barometric_pressure"


def _of_its_fan(table: TagPanel, k: int) -> Array:
    """Return the logarithm of the law by which another tag of the same fan follows, at the samples of a tag (n,).

    Power goes with the cube of the speed, and the speed with its command.
    """
    own = table.series[k]
    of_fan = {one.tag.role: one for one in table.series if one.tag.cell == own.tag.cell}
    laws = (("fan_speed", 3.0), ("fan_speed_command", 3.0)) if own.tag.role == "fan_power" else _SPEED_LAWS
    other, power = next((of_fan[role], power) for role, power in laws if role in of_fan)
    limit = 1.2 * longest_interval_s(other)
    value = unit_of(other.tag.unit).scale * other.at(own.time_s, limit)
    rest = SMALLEST_WORK * float(np.quantile(np.abs(canonical(other)), 0.95))
    return np.asarray(power * np.where(value > rest, np.log(np.maximum(value, max(rest, 1e-9))), np.nan))


_SPEED_LAWS = (("fan_speed_command", 1.0), ("fan_power", 1.0 / 3.0))


def is_witnessed(table: TagPanel, k: int) -> bool:
    """Return whether other tags follow a tag; a fan's speed and power only beside another tag of the same fan."""
    tag = table.series[k].tag
    if tag.role not in FANS:
        return tag.role in WITNESSED
    of_fan = {one.tag.role for one in table.series if one.tag.cell == tag.cell}
    return len(of_fan & {*FANS, "fan_speed_command"}) > 1


def law_ratio(table: TagPanel, k: int) -> Array:
    """Return the logarithm of the readings of a fan's tag over those of the law of its fan (n,); NaN at rest."""
    x = canonical(table.series[k])
    rest = max(SMALLEST_WORK * float(np.quantile(np.abs(x), 0.95)), 1e-9)
    return np.asarray(np.where(x > rest, np.log(np.maximum(x, rest)), np.nan) - _of_its_fan(table, k))


def least_ratio(series: Series) -> float:
    return float(np.log1p(FAN_APART if series.tag.role == "fan_power" else LEAST_SHARE))


def power_ratio(table: TagPanel, k: int) -> Array | None:
    """Return the logarithm of a fan's power over the cube of its command at the samples of its speed's tag (n,); NaN at
    rest. None for another tag, and without both."""
    own = table.series[k]
    of_fan = {one.tag.role: one for one in table.series if one.tag.cell == own.tag.cell}
    if own.tag.role != "fan_speed" or not {"fan_power", "fan_speed_command"} <= set(of_fan):
        return None
    power, command = (_logarithm(of_fan[role], own.time_s) for role in ("fan_power", "fan_speed_command"))
    return np.asarray(power - 3.0 * command)


def _logarithm(one: Series, time_s: Array) -> Array:
    """Return the logarithm of a tag's readings at some times (n,), in the record's unit; NaN at rest."""
    value = unit_of(one.tag.unit).scale * one.at(time_s, 1.2 * longest_interval_s(one))
    rest = max(SMALLEST_WORK * float(np.quantile(np.abs(canonical(one)), 0.95)), 1e-9)
    return np.asarray(np.where(value > rest, np.log(np.maximum(value, rest)), np.nan))
