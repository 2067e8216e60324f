"""Instruments of the station and their tags: what each measures, its unit, noise, resolution and compression.

Two plants, two habits: loop numbers in SI units, and words in units of the United States.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower.degradation import Life
from drivers.virtual.tower.physics import OF_CELL, OF_STATION
from drivers.virtual.tower.sites import StationDesign
from drivers.virtual.tower.weather import WeatherMinutes

Array = NDArray[np.float64]
MINUTE_S = 60.0
M3_H = 3.6 / 0.997
"""m3/h of a kg/s of water."""
UNITS: dict[str, tuple[float, float]] = {
    "degC": (1.0, 0.0),
    "degF": (1.8, 32.0),
    "m3/h": (M3_H, 0.0),
    "L/s": (1.0 / 0.997, 0.0),
    "kg/s": (1.0, 0.0),
    "%": (1.0, 0.0),
    "Hz": (0.6, 0.0),
    "kW": (1.0, 0.0),
    "MW": (1e-3, 0.0),
    "kPa": (1.0, 0.0),
    "psi": (1.0 / 6.894757, 0.0),
    "hPa": (10.0, 0.0),
    "m/s": (1.0, 0.0),
    "mph": (1.0 / 0.44704, 0.0),
    "deg": (1.0, 0.0),
    "0/1": (1.0, 0.0),
}
"""Value in a tag's unit: factor times the value of the simulation (degC, kg/s, %, kW, kPa, m/s, deg) plus an offset."""


@dataclass(frozen=True)
class Kind:
    """A kind of instrument: role, description, name in loop numbers and in words, unit of each, interface, standard
    deviation of the noise (absolute, and relative to the value), resolution and deviation of compression in the
    simulation's unit."""

    role: str
    description: str
    loop: str
    word: str
    units: tuple[str, str]
    interface: str
    noise: float
    relative: float
    resolution: float
    deviation: float
    scans: tuple[int, ...] = (120, 120, 180, 300)


OF_EACH_CELL = (
    Kind(
        "water_inlet_temperature",
        "hot water inlet temperature",
        "TI-1{c}01.PV",
        "CT{c}_INTEMP",
        ("degC", "degF"),
        "plc",
        0.04,
        0,
        0.01,
        0.1,
    ),
    Kind(
        "water_outlet_temperature",
        "cold water outlet temperature (flume)",
        "TI-1{c}03.PV",
        "CT{c}_OUTTEMP",
        ("degC", "degF"),
        "plc",
        0.04,
        0,
        0.01,
        0.1,
    ),
    Kind(
        "basin_temperature",
        "basin temperature",
        "TI-1{c}05.PV",
        "CT{c}_SUMPTEMP",
        ("degC", "degF"),
        "plc",
        0.04,
        0,
        0.01,
        0.1,
    ),
    Kind(
        "water_flow",
        "circulating water flow, riser",
        "FI-1{c}02.PV",
        "CT{c}_WFLOW",
        ("m3/h", "L/s"),
        "plc",
        0.3,
        0.006,
        0.25,
        1.5,
    ),
    Kind(
        "riser_valve_position",
        "riser valve position",
        "ZI-1{c}02.PV",
        "CT{c}_INVLV",
        ("%", "%"),
        "plc",
        0.1,
        0,
        0.1,
        0.6,
    ),
    Kind(
        "fan_speed_command", "fan speed command", "SC-1{c}10.OP", "CT{c}_FANREF", ("%", "Hz"), "mcc", 0.0, 0, 0.1, 0.5
    ),
    Kind("fan_power", "fan motor power", "JI-1{c}11.PV", "CT{c}_FANKW", ("kW", "kW"), "mcc", 0.05, 0.006, 0.05, 0.25),
    Kind(
        "bypass_position", "bypass valve position", "ZI-1{c}20.PV", "CT{c}_BYPPOS", ("%", "%"), "plc", 0.1, 0, 0.1, 0.6
    ),
    Kind("fan_fault", "fan fault", "XA-1{c}10.ST", "CT{c}_FANFLT", ("0/1", "0/1"), "mcc", 0.0, 0, 1.0, 0.4),
)
ALSO_UNRECORDED = (
    Kind("fan_speed", "fan motor speed", "SI-1{c}10.PV", "CT{c}_FANHZ", ("%", "Hz"), "mcc", 0.1, 0, 0.1, 0.5),
    Kind("cell_in_service", "water on", "XS-1{c}00.ST", "CT{c}_ONLINE", ("0/1", "0/1"), "plc", 0.0, 0, 1.0, 0.4),
)
"""Instruments of every cell of the station, also of one whose temperatures are not recorded."""
OF_ALL = (
    Kind(
        "return_header_temperature",
        "return header temperature, process outlet",
        "TI-1001.PV",
        "CW_RETURN",
        ("degC", "degF"),
        "utility",
        0.04,
        0,
        0.01,
        0.15,
    ),
    Kind(
        "supply_temperature",
        "cold water supply temperature, pump suction",
        "TI-1002.PV",
        "CW_SUPPLY",
        ("degC", "degF"),
        "utility",
        0.04,
        0,
        0.01,
        0.1,
    ),
    Kind(
        "header_pressure",
        "riser header pressure, gauge",
        "PI-1001.PV",
        "CW_HDRPRESS",
        ("kPa", "psi"),
        "utility",
        0.5,
        0.002,
        0.1,
        1.0,
    ),
    Kind(
        "pump_power",
        "circulation pumps, electric power",
        "JI-1051.PV",
        "CWP_KW",
        ("kW", "kW"),
        "mcc",
        0.3,
        0.005,
        0.1,
        1.5,
    ),
    Kind("makeup_flow", "makeup flow", "FI-1060.PV", "CT_MAKEUP", ("m3/h", "L/s"), "utility", 0.02, 0.01, 0.05, 0.3),
    Kind(
        "blowdown_flow", "blowdown flow", "FI-1061.PV", "CT_BLOWDN", ("m3/h", "L/s"), "utility", 0.01, 0.01, 0.02, 0.1
    ),
    Kind("basin_level", "basin level", "LI-1062.PV", "CT_LEVEL", ("%", "%"), "utility", 0.1, 0, 0.1, 0.3),
    Kind(
        "station_heat_load",
        "process heat load, calculated by the units' DCS",
        "QI-1080.PV",
        "PROC_HEAT",
        ("MW", "kW"),
        "utility",
        20.0,
        0.008,
        10.0,
        180.0,
    ),
    Kind(
        "dry_bulb_temperature",
        "ambient dry bulb, weather mast",
        "TI-1901.PV",
        "WX_TEMP",
        ("degC", "degF"),
        "met",
        0.06,
        0,
        0.01,
        0.1,
    ),
    Kind("relative_humidity", "relative humidity A, mast", "MI-1902.PV", "WX_RH", ("%", "%"), "met", 0.25, 0, 0.1, 0.6),
    Kind(
        "relative_humidity_redundant",
        "relative humidity B, mast (redundant)",
        "MI-1903.PV",
        "WX_RH2",
        ("%", "%"),
        "met",
        0.25,
        0,
        0.1,
        0.6,
    ),
    Kind(
        "wet_bulb_temperature",
        "wet bulb, aspirated psychrometer",
        "TI-1904.PV",
        "WX_WETB",
        ("degC", "degF"),
        "met",
        0.05,
        0,
        0.01,
        0.1,
    ),
    Kind(
        "barometric_pressure",
        "barometric pressure, station",
        "PI-1905.PV",
        "WX_BARO",
        ("kPa", "hPa"),
        "met",
        0.01,
        0,
        0.01,
        0.04,
    ),
    Kind("wind_speed", "wind speed, mast", "SI-1906.PV", "WX_WSPD", ("m/s", "mph"), "met", 0.15, 0.03, 0.1, 0.5),
    Kind(
        "wind_direction",
        "wind direction, mast, from, degrees",
        "ZI-1907.PV",
        "WX_WDIR",
        ("deg", "deg"),
        "met",
        3.0,
        0,
        1.0,
        8.0,
    ),
)
COLUMN = {
    "water_inlet_temperature": "t_in",
    "water_outlet_temperature": "t_rtd",
    "basin_temperature": "t_basin",
    "water_flow": "m_w",
    "riser_valve_position": "valve",
    "fan_speed_command": "command",
    "fan_power": "power",
    "bypass_position": "bypass",
    "fan_fault": "fault",
    "fan_speed": "speed",
    "cell_in_service": "on",
    "return_header_temperature": "t_return",
    "supply_temperature": "t_supply",
    "header_pressure": "header",
    "pump_power": "pump_power",
    "makeup_flow": "makeup",
    "blowdown_flow": "blowdown",
    "basin_level": "level",
    "station_heat_load": "load",
}
HUMIDITY_OFFSET = 0.6
"""Standard deviation of the humidity probes' offsets, %: a wet bulb within 0.15 K."""


@dataclass(frozen=True)
class Instrument:
    """An instrument with its tag: name, kind, cell (0: station), unit, seconds between scans."""

    tag: str
    kind: Kind
    cell: int
    unit: str
    scan_s: int

    @property
    def factor(self) -> float:
        """Size of the simulation's unit in that of the tag."""
        return UNITS[self.unit][0]

    @property
    def interface(self) -> str:
        """Part of the plant's network that it is on: interfaces fall silent as a whole."""
        return f"plc{self.cell}" if self.kind.interface == "plc" else self.kind.interface

    @property
    def description(self) -> str:
        """Description as in the tag dictionary."""
        return f"cell {self.cell} {self.kind.description}" if self.cell else self.kind.description


def tag_name(site: StationDesign, role: str, cell: int) -> str:
    """Return the tag of a role and cell.

    Raises
    ------
    KeyError
        No instrument has the role.
    """
    for kind in (*OF_EACH_CELL, *ALSO_UNRECORDED, *OF_ALL):
        if kind.role == role:
            return "21-" + kind.loop.format(c=cell) if site.style == "loops" else kind.word.format(c=cell)
    raise KeyError(role)


def instruments(site: StationDesign, recorded: int, rng: np.random.Generator) -> tuple[Instrument, ...]:
    """Return the instruments of a station whose first `recorded` cells are recorded, in the order of the tag
    dictionary."""
    wanted = []
    for cell in range(1, site.cells + 1):
        kinds = (*OF_EACH_CELL, *ALSO_UNRECORDED) if cell <= recorded else ALSO_UNRECORDED
        wanted += [(kind, cell) for kind in kinds]
    wanted += [(kind, 0) for kind in OF_ALL]
    style = 0 if site.style == "loops" else 1
    return tuple(
        Instrument(tag_name(site, kind.role, cell), kind, cell, kind.units[style], int(rng.choice(kind.scans)))
        for kind, cell in wanted
    )


@dataclass(frozen=True)
class StationTruth:
    """The simulated station by minute: cells (n, cells, columns), station (n, columns), weather, degradation."""

    cells: NDArray[np.float32]
    station: NDArray[np.float32]
    weather: WeatherMinutes
    wet: Array
    humidity: Array
    life: Life

    def cell(self, name: str, cell: int) -> Array:
        """Return a column of a cell, numbered from 1."""
        return np.asarray(self.cells[:, cell - 1, OF_CELL.index(name)], dtype=np.float64)

    def held(self, daily: Array) -> Array:
        """Return daily values by the minute: each holds for its day."""
        return np.asarray(daily[np.arange(len(self.wet)) // 1440])

    def seen(self, one: Instrument) -> Array:
        """Return by the minute what an instrument without noise would show, in the simulation's unit."""
        role, cell = one.kind.role, one.cell
        if role == "water_outlet_temperature":
            return self.cell("t_rtd", cell) + self.held(self.life.bias[:, cell - 1])
        if role == "water_flow":
            return self.cell("m_w", cell) * self.held(self.life.flow_gain[:, cell - 1])
        if cell:
            return self.cell(COLUMN[role], cell)
        if role in COLUMN:
            return np.asarray(self.station[:, OF_STATION.index(COLUMN[role])], dtype=np.float64)
        of_weather: dict[str, Callable[[], Array]] = {
            "dry_bulb_temperature": lambda: self.weather.dry,
            "relative_humidity": lambda: 100.0 * self.humidity,
            "relative_humidity_redundant": lambda: 100.0 * self.humidity,
            "wet_bulb_temperature": lambda: self.wet,
            "barometric_pressure": lambda: self.weather.pressure,
            "wind_speed": lambda: self.weather.wind,
            "wind_direction": lambda: self.weather.direction,
        }
        return of_weather[role]()


def scanned(one: Instrument, truth: StationTruth, scan_s: Array, rng: np.random.Generator) -> Array:
    """Return the readings (n,) of an instrument at scans, in its tag's unit, with noise and resolution.

    `scan_s` (n,) are seconds since the beginning.
    """
    values = truth.seen(one)
    minute = scan_s / MINUTE_S
    if one.unit == "0/1" or one.kind.role in ("wind_direction", "fan_speed_command"):
        read = values[np.minimum(minute.astype(np.int64), len(values) - 1)]
    else:
        read = np.interp(minute, np.arange(len(values)), values)
    noise = rng.normal(size=len(read))
    read = read + noise * (one.kind.noise + one.kind.relative * np.abs(read)) * (one.unit != "0/1")
    if one.kind.interface == "met" and one.kind.role.startswith("relative"):
        read = np.clip(read + rng.normal(0.0, HUMIDITY_OFFSET), 0.0, 100.0)
    if one.kind.role == "wind_direction":
        read %= 360.0
    elif one.kind.role in (
        "wind_speed",
        "makeup_flow",
        "blowdown_flow",
        "water_flow",
        "fan_power",
        "station_heat_load",
    ):
        read = np.maximum(read, 0.0)
    factor, offset = UNITS[one.unit]
    return quantised(read * factor + offset, one)


def quantised(value: Array, one: Instrument) -> Array:
    """Return values of a tag, in its unit, in steps of a power of ten near the instrument's resolution."""
    if one.unit == "0/1":
        return value
    step = 10.0 ** round(np.log10(one.kind.resolution * one.factor))
    return np.asarray(np.round(value / step) * step)
