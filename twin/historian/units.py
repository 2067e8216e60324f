"""Units of tags: to the one of each dimension that the record uses."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

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

_GALLON_M3, _IMPERIAL_GALLON_M3 = 3.785411784e-3, 4.54609e-3
_POUND_KG = 0.45359237
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
"""Factors by NIST SP 811; a ton is one of refrigeration. A meter may change from one of them to another."""

FURTHER_UNITS: dict[str, Unit] = {
    "kg/h": Unit("mass flow", 1.0 / 3600.0),
    "lb/h": Unit("mass flow", _POUND_KG / 3600.0),
    "lb/min": Unit("mass flow", _POUND_KG / 60.0),
    "lb/s": Unit("mass flow", _POUND_KG),
    "L/h": Unit("mass flow", WATER_DENSITY * 1e-3 / 3600.0),
    "m3/min": Unit("mass flow", WATER_DENSITY / 60.0),
    "m3/d": Unit("mass flow", WATER_DENSITY / 86400.0),
    "igpm": Unit("mass flow", WATER_DENSITY * _IMPERIAL_GALLON_M3 / 60.0),
    "kBTU/h": Unit("power", 0.293071070),
    "MMBTU/h": Unit("power", 293.071070),
    "PS": Unit("power", 0.73549875),
    "kcal/h": Unit("power", 1.163e-3),
    "atm": Unit("pressure", 101.325),
    "mH2O": Unit("pressure", 9.80665),
    "inH2O": Unit("pressure", 0.2490889),
    "ftH2O": Unit("pressure", 2.989067),
    "ft/s": Unit("speed", 0.3048),
    "ft/min": Unit("speed", 0.00508),
}
"""Units of the same source that a dictionary may state. No change of unit is looked for among them: as many more of
them would fit a change of range by chance."""

ALIASES = {
    "degK": "K",
    "celsius": "degC",
    "fahrenheit": "degF",
    "kelvin": "K",
    "lbs/h": "lb/h",
    "lbs/min": "lb/min",
    "lbs/s": "lb/s",
    "pph": "lb/h",
    "lpm": "L/min",
    "cmh": "m3/h",
    "gal/min": "gpm",
    "usgpm": "gpm",
    "gpmus": "gpm",
    "gpm(us)": "gpm",
    "tons": "ton",
    "tonr": "ton",
    "TR": "ton",
    "RT": "ton",
    "USRT": "ton",
    "bhp": "hp",
    "MBH": "kBTU/h",
    "CV": "PS",
    "torr": "mmHg",
    "mWC": "mH2O",
    "inWC": "inH2O",
    "ftWC": "ftH2O",
    "psia": "psi",
    "psig": "psi",
    "bara": "bar",
    "barg": "bar",
    "kPaa": "kPa",
    "kPag": "kPa",
    "%RH": "%",
    "pct": "%",
    "percent": "%",
    "r/min": "rpm",
    "1/min": "rpm",
    "kph": "km/h",
    "knots": "kn",
    "kt": "kn",
    "°": "deg",
    "degrees": "deg",
}
"""Other spellings of units; MBH is a thousand BTU/h. Gauge pressure is not told from absolute. MBTU is none of them: it
is a thousand to some and a million to others."""
_ALL = UNITS | FURTHER_UNITS | {alias: (UNITS | FURTHER_UNITS)[name] for alias, name in ALIASES.items()}
_LOWER = {name.lower(): name for name in reversed(_ALL)}

MULTIPLES = (0.1, 0.01, 10.0)
"""Units of raw counts: controllers hold whole numbers, of a tenth or a hundredth, and large quantities in tens."""

SPEEDS = ("frequency", "rotation")
"""Dimensions of a fan's speed that become per cent of that at 100 %: of its drive's supply, and of its shaft."""


class UnitError(ValueError):
    """A unit that is not known; the message names it and those that are."""


@cache
def unit_of(text: str, dimensions: tuple[str, ...] = ()) -> Unit:
    """Return the unit of this name, with a number before it of that multiple: `0.1 degC` of raw tenths.

    Parameters
    ----------
    text
        Name of the unit, as a dictionary writes it.
    dimensions
        Dimensions whose units a message lists; all of none.

    Raises
    ------
    UnitError
        It is not in the table.
    """
    found = _named(text)
    if found is None and (match := _MULTIPLE.fullmatch(text)) and float(match[1].replace(",", ".")) > 0.0:
        times, one = float(match[1].replace(",", ".")), _named(match[2])
        if one is not None and one.dimension != "state":
            found = Unit(one.dimension, times * one.scale, one.offset)
    if found is None:
        usable = sorted(name for name, unit in UNITS.items() if not dimensions or unit.dimension in dimensions)
        what = f"unit {text!r} is not known" if text.strip() else "has no unit"
        raise UnitError(f"{what}; use one of {', '.join(usable)}")
    return found


_MULTIPLE = re.compile(r"\s*([0-9]*[.,]?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*[x*×·]?\s*([^0-9\s].*)")
"""Number and unit; a decimal comma is one, as of a dictionary in a language that has it."""
_PER = {"/hr": "/h", "/hour": "/h", "/sec": "/s", "/second": "/s", "/minute": "/min"}


def _named(text: str) -> Unit | None:
    """Return the unit of a name, None where it is not known.

    Blanks, raised digits and the case of letters are free. But of small and capital letters m is milli, and M is mega:
    mW is no MW.
    """
    plain = text.strip()
    if plain in _ALL:
        return _ALL[plain]
    plain = unicodedata.normalize("NFKC", plain.replace("º", "°")).replace("^", "").replace(" ", "")
    for long, short in _PER.items():
        plain = plain.removesuffix(long) + short if plain.lower().endswith(long) else plain
    name = plain if plain in _ALL else _LOWER.get(plain.lower())
    if name is None:
        return None
    is_mixed = plain != plain.lower() and plain != plain.upper()
    other_prefix = plain[0] != name[0] and plain[0] in "mM" and name[1:] in _ALL
    return None if is_mixed and other_prefix else _ALL[name]


def alternatives(text: str) -> dict[str, Unit]:
    """Return the other usual units of the same dimension, by name, without those of the same scale and offset."""
    return _others(text, UNITS)


def tens(text: str) -> dict[str, Unit]:
    """Return the units of a decimal place more or less than a unit, by name: `0.1 kW` and `10 kW` of `kW`."""
    named = _named(text) is not None and text.strip() not in ("1", "0/1")
    return {name: unit_of(name) for name in (f"{times:g} {text}" for times in (0.1, 10.0))} if named else {}


def possible_units(text: str) -> list[dict[str, Unit]]:
    """Return the units that a tag may be in instead, by name, the likelier ones first.

    They are the usual and the further ones of its dimension, and the multiples of its unit that raw counts of a
    controller are: tenths, hundredths and tens.
    """
    named = _named(text) is not None and text.strip() not in ("1", "0/1")
    counts = [f"{times:g} {text}" for times in MULTIPLES if named]
    return [alternatives(text), _others(text, FURTHER_UNITS), {name: unit_of(name) for name in counts}]


def _others(text: str, units: Mapping[str, Unit]) -> dict[str, Unit]:
    own = unit_of(text)
    return {
        name: unit
        for name, unit in units.items()
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
