"""Engineering units that a rig file, a profile or a record may use.

A record's column is the signal's name and the unit's suffix (`heater_power` in W -> `heater_power_W`), so that a file
can be read without its rig. Symbols follow UCUM where ASCII allows it, as DBC files and Modbus tables do.
"""

from __future__ import annotations

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
PLAUSIBLE: dict[str, tuple[float, float]] = {
    "W": (-1e7, 1e7),
    "kW": (-1e4, 1e4),
    "%": (-500.0, 500.0),
    "degC": (-272.0, 2315.0),
    "K": (-2588.15, 2588.15),
    "L/min": (-1e6, 1e6),
    "m3/h": (-6e4, 6e4),
    "kg/s": (-2e4, 2e4),
    "rpm": (-1e6, 1e6),
    "V": (-1.2e6, 1.2e6),
    "A": (-1e6, 1e6),
    "Hz": (-1e7, 1e7),
    "Pa": (-1e9, 1e9),
    "kPa": (-1e6, 1e6),
    "bar": (-1e4, 1e4),
    "mbar": (-1e7, 1e7),
    "MPa": (-1e3, 1e3),
    "L/s": (-2e4, 2e4),
    "L/h": (-6e7, 6e7),
    "m/s": (-1500.0, 1500.0),
    "mV": (-1.2e9, 1.2e9),
    "kV": (-1.2e3, 1.2e3),
    "mA": (-1e9, 1e9),
    "VA": (-1e7, 1e7),
    "var": (-1e7, 1e7),
    "kJ": (-3.2e12, 3.2e12),
    "Wh": (-8.8e11, 8.8e11),
    "kWh": (-8.8e8, 8.8e8),
    "ohm": (-1e13, 1e13),
    "s": (-1e11, 1e11),
    "ms": (-1e14, 1e14),
    "1": (-(2.0**64), 2.0**64),
}
"""Range of each unit, in that unit, outside which no instrument of a laboratory or plant reads: such a number is an
overload mark, an error code or a decoding mistake, and no reading. The ranges are wide on purpose, since a point may
declare its own.

- degC: 1.15 K, below which no thermometer of a rig works, and 2315 degC, the end of thermocouple type C, the highest of
  IEC 60584-1. K: differences.
- W, VA, var and their multiples: 10 MW, both signs (cooling, generation). Energies: 10 MW for ten years.
- %: five times full scale; IEC 60034-1 and servo drives stay below four times rated, heat pumps below 500 %.
- V: 1.2 MV, the highest voltage of equipment in IEC 60038. A: 1 MA, above any furnace or electrolysis line.
- Pressures: 1 GPa, ten times the strongest water-jet pumps. ohm: 10 Tohm, the end of common insulation testers.
- Flows: 1000 m3/min, about 17 m3/s, a large pumping station. m/s: the speed of sound in water. rpm: 1e6, above the
  fastest turbines. Hz: 10 MHz, above any pulse output.
- s, ms: some 3000 years, so that stamps since 1970 pass. 1 (counters, codes, columns without a unit): 64 bits.
"""

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
    "ampere": "A",
    "hertz": "Hz",
    "u/min": "rpm",
    "1/min": "rpm",
    "r/min": "rpm",
    "rev/min": "rpm",
    "tr/min": "rpm",
    "min-1": "rpm",
    "min^-1": "rpm",
    "min⁻¹": "rpm",
    "m3/hr": "m3/h",
    "m^3/h": "m3/h",
    "l/hr": "L/h",
    "l/sec": "L/s",
    "degree": "degC",
    "degrees c": "degC",
    "ohms": "ohm",
    "sec": "s",
    "msec": "ms",
}
"""Other names of a unit, in small letters: each is one of it, so that no value changes."""
_PREFIXES = {"n": 1e-9, "µ": 1e-6, "μ": 1e-6, "u": 1e-6, "m": 1e-3, "h": 1e2, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
"""Decimal prefixes of the SI; K is a common misspelling of k. Small and capital letters differ by powers of ten."""
_BASES = {
    symbol.lower(): symbol for symbol in ("W", "V", "A", "VA", "var", "Pa", "Hz", "Wh", "ohm", "s", "bar", "K", "m/s")
} | {"ω": "ohm"}
_IN_MEGA = ("W", "Wh", "VA", "var", "Pa", "Hz", "ohm")
"""Units with mega in a laboratory or a plant; `MV` and `MA` may be mV and mA in a heading of capital letters."""
_FAHRENHEIT = ("f", "°f", "degf", "deg f", "fahrenheit")


_SAME = {
    "degc": "degC",
    "°c": "degC",
    "ºc": "degC",
    "℃": "degC",
    "'c": "degC",
    "celsius": "degC",
    "gradc": "degC",
    "%rh": "%",
    "%rf": "%",
    "%hr": "%",
    "%r.h.": "%",
    "vdc": "V",
    "vac": "V",
    "adc": "A",
    "aac": "A",
}
"""Further spellings without blanks, in small letters: of loggers (HIOKI's 'C, Keysight's VDC) and of humidity."""
_ANGLE = "degree"


def known_unit(text: str) -> str | None:
    """Return the symbol of a unit in any spelling of one meaning, None for any other text.

    `DEG C`, `U/min`, `l/h` and `KW` have one meaning; `degrees`, which may be an angle, has not.
    """
    bare = text.strip()
    try:
        return canonical_unit(bare)
    except ValueError:
        pass
    low = "".join(bare.lower().split())
    if low in _SAME:
        return _SAME[low]
    return None if low.rstrip("s") == _ANGLE else _meant(bare)


def prefixed_unit(text: str) -> tuple[str, float] | None:
    """Return the known unit that `text` is a decimal multiple of, and the factor to it: `mK` is 0.001 K.

    None for every other text, and for known units themselves. A prefix is one of the SI, in its own case of letters.
    """
    bare = text.strip()
    for prefix, factor in _PREFIXES.items():
        base = bare[len(prefix) :]
        symbol = _BASES.get(base.lower()) if bare.startswith(prefix) else None
        if symbol is None or (prefix == "M" and symbol not in _IN_MEGA) or known_unit(bare) is not None:
            continue
        if base == symbol or symbol == "ohm":
            return symbol, factor
    return None


def canonical_unit(unit: str) -> str:
    """Return this project's symbol for `unit`; raise ValueError with the nearest known symbol."""
    symbol = _ALIASES.get(unit, unit)
    if symbol in SUFFIX_OF_UNIT:
        return symbol
    raise ValueError(f"unit {unit!r} is not known; {_hint(unit)}")


def _hint(unit: str) -> str:
    """Return the remedy for a unit that is not known: a symbol of the same size, or the factor to a known one."""
    bare = unit.strip()
    meant = _meant(bare)
    if meant is not None:
        return f"did you mean {meant}?"
    for prefix, factor in _PREFIXES.items():
        base = _BASES.get(bare.removeprefix(prefix).lower()) if bare.startswith(prefix) else None
        if base is not None:
            return f"1 {bare} is {factor:g} {base}; convert the values and write {base}"
    if bare.lower() in _FAHRENHEIT:
        return "convert the values to degC"
    return f"the known ones are {', '.join(SUFFIX_OF_UNIT)}"


def _meant(bare: str) -> str | None:
    """Return the symbol that a longhand or another case of letters stands for, None where there is none."""
    longhand = bare.lower().rstrip("s")
    for spelling in (bare.lower(), longhand):
        if spelling in _SPELT_OUT:
            return _SPELT_OUT[spelling]
    same = [symbol for symbol in SUFFIX_OF_UNIT if symbol.lower() == bare.lower()]
    if same and not (bare[0] in "mM" and same[0][0] in "mM" and bare[0] != same[0][0]):  # milli is not mega
        return same[0]
    return None


def plausible_range(unit: str) -> tuple[float, float]:
    """Return the default plausible range of readings in `unit`, in that unit."""
    return PLAUSIBLE.get(unit, PLAUSIBLE["1"])


def column_name(name: str, unit: str) -> str:
    """Return the record column of signal `name` in `unit`, e.g. `("flow", "L/min")` -> `flow_L_per_min`."""
    suffix = SUFFIX_OF_UNIT[canonical_unit(unit)]
    return f"{name}_{suffix}" if suffix else name


def split_column(column: str) -> tuple[str, str] | None:
    """Return name and unit of a record's column, or None where it ends in no known suffix."""
    for unit, suffix in sorted(SUFFIX_OF_UNIT.items(), key=lambda item: -len(item[1])):
        if suffix and column.endswith("_" + suffix) and len(column) > len(suffix) + 1:
            return column[: -len(suffix) - 1], unit
    return None
