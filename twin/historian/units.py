"""Units of tags: to the one of each dimension that the record uses."""

from __future__ import annotations

import re
from dataclasses import dataclass

WATER_DENSITY = 997.0
"""kg/m3."""


@dataclass(frozen=True)
class Unit:
    """A unit: the canonical value is `scale` times the value plus `offset`."""

    dimension: str
    scale: float = 1.0
    offset: float = 0.0


CANONICAL = {
    "temperature": "degC",
    "mass flow": "kg/s",
    "power": "kW",
    "pressure": "kPa",
    "share": "%",
    "speed": "m/s",
    "angle": "deg",
    "state": "1",
    "frequency": "Hz",
    "rotation": "rpm",
    "length": "m",
}

_GALLON_M3 = 3.785411784e-3
UNITS: dict[str, Unit] = {
    "degC": Unit("temperature"),
    "C": Unit("temperature"),
    "°C": Unit("temperature"),
    "degF": Unit("temperature", 5.0 / 9.0, -160.0 / 9.0),
    "F": Unit("temperature", 5.0 / 9.0, -160.0 / 9.0),
    "°F": Unit("temperature", 5.0 / 9.0, -160.0 / 9.0),
    "K": Unit("temperature", 1.0, -273.15),
    "kg/s": Unit("mass flow"),
    "t/h": Unit("mass flow", 1.0 / 3.6),
    "L/s": Unit("mass flow", WATER_DENSITY * 1e-3),
    "l/s": Unit("mass flow", WATER_DENSITY * 1e-3),
    "m3/h": Unit("mass flow", WATER_DENSITY / 3600.0),
    "m³/h": Unit("mass flow", WATER_DENSITY / 3600.0),
    "m3/s": Unit("mass flow", WATER_DENSITY),
    "L/min": Unit("mass flow", WATER_DENSITY / 60e3),
    "gpm": Unit("mass flow", WATER_DENSITY * _GALLON_M3 / 60.0),
    "W": Unit("power", 1e-3),
    "kW": Unit("power"),
    "MW": Unit("power", 1e3),
    "hp": Unit("power", 0.745699872),
    "ton": Unit("power", 3.516852842),
    "BTU/h": Unit("power", 2.93071070e-4),
    "Pa": Unit("pressure", 1e-3),
    "hPa": Unit("pressure", 0.1),
    "mbar": Unit("pressure", 0.1),
    "kPa": Unit("pressure"),
    "bar": Unit("pressure", 100.0),
    "MPa": Unit("pressure", 1e3),
    "psi": Unit("pressure", 6.894757293),
    "inHg": Unit("pressure", 3.386389),
    "mmHg": Unit("pressure", 0.1333224),
    "%": Unit("share"),
    "1": Unit("share", 100.0),
    "0/1": Unit("state"),
    "Hz": Unit("frequency"),
    "rpm": Unit("rotation"),
    "m/s": Unit("speed"),
    "km/h": Unit("speed", 1.0 / 3.6),
    "mph": Unit("speed", 0.44704),
    "kn": Unit("speed", 0.514444),
    "deg": Unit("angle"),
    "rad": Unit("angle", 57.29577951308232),
    "m": Unit("length"),
    "ft": Unit("length", 0.3048),
}
"""Factors by NIST SP 811; a ton is one of refrigeration."""

SPEEDS = ("frequency", "rotation")
"""Dimensions of a fan's speed that become per cent of that at 100 %: of its drive's supply, and of its shaft."""


class UnitError(ValueError):
    """A unit that is not known; the message names it and those that are."""


def unit_of(text: str) -> Unit:
    """Return the unit of this name.

    Raises
    ------
    UnitError
        It is not in the table.
    """
    found = UNITS.get(text.strip()) or {name.lower(): unit for name, unit in UNITS.items()}.get(text.strip().lower())
    if found is None:
        raise UnitError(f"unit {text!r} is not known; use one of {', '.join(sorted(UNITS))}")
    return found


def alternatives(text: str) -> dict[str, Unit]:
    """Return the other units of the same dimension, by name, without those of the same scale and offset."""
    own = unit_of(text)
    return {
        name: unit
        for name, unit in UNITS.items()
        if unit.dimension == own.dimension and (unit.scale, unit.offset) != (own.scale, own.offset)
    }


def full_speed_of(text: str) -> tuple[float, Unit]:
    """Return number and unit of the speed that a fan has at 100 %, such as `60 Hz` or `320 rpm`; Hz without unit.

    Raises
    ------
    UnitError
        It is no number above zero with one of these units.
    """
    match = re.fullmatch(r"\s*([0-9]+(?:[.,][0-9]+)?)\s*([A-Za-z]*)\s*", text)
    if match is None or not float(match[1].replace(",", ".")) > 0.0:
        raise UnitError(f"{text!r} is no speed; write a number with Hz or rpm, such as 60 Hz")
    unit = unit_of(match[2] or "Hz")
    if unit.dimension not in SPEEDS:
        raise UnitError(f"{text!r} is no speed of a fan; write a number with Hz or rpm, such as 60 Hz")
    return float(match[1].replace(",", ".")), unit
