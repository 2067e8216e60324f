"""Engineering units that a rig file, a profile or a record may use.

A record's column is the signal's name and the unit's suffix (`heater_power` in W -> `heater_power_W`), so that a file
can be read without its rig. Symbols follow UCUM where ASCII allows it, as DBC files and Modbus tables do.
"""

from __future__ import annotations

import difflib

SUFFIX_OF_UNIT: dict[str, str] = {
    "W": "W",
    "kW": "kW",
    "%": "pct",
    "degC": "C",
    "K": "K",
    "L/min": "L_per_min",
    "m3/h": "m3_per_h",
    "kg/s": "kg_per_s",
    "rpm": "rpm",
    "V": "V",
    "A": "A",
    "Hz": "Hz",
    "Pa": "Pa",
    "kPa": "kPa",
    "bar": "bar",
    "mbar": "mbar",
    "MPa": "MPa",
    "L/s": "L_per_s",
    "L/h": "L_per_h",
    "m/s": "m_per_s",
    "mV": "mV",
    "kV": "kV",
    "mA": "mA",
    "VA": "VA",
    "var": "var",
    "kJ": "kJ",
    "Wh": "Wh",
    "kWh": "kWh",
    "ohm": "ohm",
    "s": "s",
    "ms": "ms",
    "1": "",
}
_ALIASES = {
    "°C": "degC",
    "C": "degC",
    "l/min": "L/min",
    "LPM": "L/min",
    "pct": "%",
    "-": "1",
    "": "1",
    "Ω": "ohm",
    "deg C": "degC",
    "m³/h": "m3/h",
}
_SPELT_OUT = {
    "watt": "W",
    "kilowatt": "kW",
    "percent": "%",
    "celsiu": "degC",
    "kelvin": "K",
    "lpm": "L/min",
    "second": "s",
    "volt": "V",
    "amp": "A",
}


def canonical_unit(unit: str) -> str:
    """The symbol this project uses for `unit`; raises ValueError with the nearest known symbol."""
    symbol = _ALIASES.get(unit, unit)
    if symbol in SUFFIX_OF_UNIT:
        return symbol
    longhand = unit.lower().rstrip("s")
    near = [_SPELT_OUT[longhand]] if longhand in _SPELT_OUT else difflib.get_close_matches(unit, SUFFIX_OF_UNIT, n=1)
    hint = f"did you mean {near[0]}?" if near else f"the known ones are {', '.join(SUFFIX_OF_UNIT)}"
    raise ValueError(f"unit {unit!r} is not known; {hint}")


def column_name(name: str, unit: str) -> str:
    """Column of a record for a signal called `name` in `unit`, e.g. `("flow", "L/min")` -> `flow_L_per_min`."""
    suffix = SUFFIX_OF_UNIT[canonical_unit(unit)]
    return f"{name}_{suffix}" if suffix else name


def split_column(column: str) -> tuple[str, str] | None:
    """Name and unit of a record's column, or None where it ends in no known suffix."""
    for unit, suffix in sorted(SUFFIX_OF_UNIT.items(), key=lambda item: -len(item[1])):
        if suffix and column.endswith("_" + suffix) and len(column) > len(suffix) + 1:
            return column[: -len(suffix) - 1], unit
    return None
