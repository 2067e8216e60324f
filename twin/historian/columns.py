"""Columns of the aligned record: the roles of the tag dictionary, the column of each, and how its samples become
minutes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from twin.historian.units import CANONICAL

Filling = Literal["mean", "held"]


@dataclass(frozen=True)
class Column:
    """A column of the record: name with unit, dimension, lowest and highest value that such a tower can have.

    `mean` columns hold the time-weighted mean of the minute between samples taken as joined by straight lines (what a
    swinging-door archive promises); `held` ones are commands and states, which keep their value until the next sample.
    """

    name: str
    dimension: str
    low: float
    high: float
    filling: Filling = "mean"


OF_CELL: dict[str, Column] = {
    "water_inlet_temperature": Column("t_in_C", "temperature", -50.0, 95.0),
    "water_outlet_temperature": Column("t_out_C", "temperature", -50.0, 80.0),
    "basin_temperature": Column("basin_C", "temperature", -50.0, 80.0),
    "water_flow": Column("m_w_kg_s", "mass flow", -50.0, 20000.0),
    "riser_valve_position": Column("riser_valve_pct", "share", -5.0, 110.0),
    "bypass_position": Column("bypass_pct", "share", -5.0, 110.0),
    "fan_speed_command": Column("fan_command_pct", "share", -5.0, 130.0, "held"),
    "fan_speed": Column("fan_speed_pct", "share", -5.0, 130.0),
    "fan_power": Column("fan_power_kW", "power", -10.0, 5000.0),
    "fan_fault": Column("fan_fault", "state", 0.0, 1.0, "held"),
    "cell_in_service": Column("in_service", "state", 0.0, 1.0, "held"),
}
"""Columns that each cell has of its own, by role. A thermometer in a drained pipe or basin is as cold as the air."""

OF_STATION: dict[str, Column] = {
    "return_header_temperature": Column("return_C", "temperature", -50.0, 95.0),
    "supply_temperature": Column("supply_C", "temperature", -50.0, 80.0),
    "header_pressure": Column("header_kPa", "pressure", -50.0, 3000.0),
    "pump_power": Column("pump_kW", "power", -10.0, 50000.0),
    "makeup_flow": Column("makeup_kg_s", "mass flow", -50.0, 5000.0),
    "blowdown_flow": Column("blowdown_kg_s", "mass flow", -50.0, 5000.0),
    "basin_level": Column("level_pct", "share", -5.0, 110.0),
    "station_heat_load": Column("load_kW", "power", -1e4, 2e6),
    "dry_bulb_temperature": Column("dry_C", "temperature", -50.0, 60.0),
    "relative_humidity": Column("rh_pct", "share", 0.0, 104.0),
    "relative_humidity_redundant": Column("rh2_pct", "share", 0.0, 104.0),
    "wet_bulb_temperature": Column("wet_C", "temperature", -50.0, 45.0),
    "barometric_pressure": Column("pressure_kPa", "pressure", 50.0, 110.0),
    "wind_speed": Column("wind_m_s", "speed", -1.0, 75.0),
    "wind_direction": Column("wind_deg", "angle", -1.0, 362.0),
}
"""Columns that all cells share, by role."""

DERIVED = ("wet_rh_C", "closure_K", "neighbours_speed_pct")
"""Columns without a tag: wet bulb of dry bulb and humidity, its difference to the measured one, mean speed of the
other fans."""


def column_unit(column: Column) -> str:
    """Return the unit of a column."""
    return CANONICAL[column.dimension]
