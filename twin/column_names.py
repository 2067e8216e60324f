"""Names of record columns: the unit in a name, and the column that was probably meant."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_TO_CELSIUS = {
    "f": ("degrees Fahrenheit", "subtract 32 and divide by 1.8"),
    "degf": ("degrees Fahrenheit", "subtract 32 and divide by 1.8"),
    "k": ("kelvin", "subtract 273.15"),
}
_OTHER_UNITS = frozenset(("w", "kw", "mw", "pct", "rpm", "hz", "frac", "fraction", "l_per_min", "l_per_s", "m3_per_h"))
_AS_WORDS = (("°c", "c"), ("degc", "c"), ("%", "pct"))


UNITS_OF_SUFFIX = {
    "C": ("degC", "°C", "C", "deg C"),
    "K": ("K",),
    "W": ("W",),
    "kW": ("kW",),
    "pct": ("%", "pct"),
    "rpm": ("rpm",),
    "Hz": ("Hz",),
    "V": ("V",),
    "A": ("A",),
    "Pa": ("Pa",),
    "kPa": ("kPa",),
    "bar": ("bar",),
    "mbar": ("mbar",),
    "L_per_min": ("L/min", "l/min", "LPM"),
    "L_per_s": ("L/s", "l/s"),
    "L_per_h": ("L/h", "l/h"),
    "m3_per_h": ("m3/h", "m³/h"),
    "kg_per_s": ("kg/s",),
    "kg_s": ("kg/s",),
    "m_per_s": ("m/s",),
    "m_s": ("m/s",),
    "s": ("s",),
}
"""Suffix of a column's name -> ways to write that unit: a record's column is the signal's name and its unit."""


def contradicted_unit(column: str, unit: str) -> str | None:
    """Return the unit in a column's name where `unit` is another one, else None."""
    suffix = max((end for end in UNITS_OF_SUFFIX if column.endswith(f"_{end}")), key=len, default=None)
    if suffix is None or unit.strip() in ("", *UNITS_OF_SUFFIX[suffix]):
        return None
    return UNITS_OF_SUFFIX[suffix][0]


def suffix_of(unit: str) -> str:
    """Return the suffix of a column's name for a unit, itself where it has none."""
    return next((suffix for suffix, ways in UNITS_OF_SUFFIX.items() if unit in ways), unit)


def unit_other_than(column: str, declared: str, wanted: str) -> str | None:
    """Return the unit of a column, by its name or as declared, where it is another one than `wanted`; else None."""
    if celsius_conversion(column) is not None and wanted == "degC":
        return column.rsplit("_", 1)[-1]
    spellings = next((ways for ways in UNITS_OF_SUFFIX.values() if wanted in ways), (wanted,))
    stated = declared.strip()
    known = any(stated in ways for ways in UNITS_OF_SUFFIX.values()) and stated not in spellings
    return contradicted_unit(column, wanted) or (stated if known else None)


def celsius_conversion(column: str) -> tuple[str, str, str] | None:
    """Return unit, conversion and new name of a column whose name gives a temperature in another unit than degC, or
    None.
    """
    stem, _, tail = column.rpartition("_")
    if tail.lower() not in _TO_CELSIUS or not re.match(r"(.*_)?(t\d*|temp\w*)(_|$)", stem.lower()):
        return None
    unit, how = _TO_CELSIUS[tail.lower()]
    return unit, how, f"{stem}_C"


def column_hint(name: str, columns: Iterable[str]) -> str:
    """Return a hint which of the columns may be the missing column `name`, or ""."""
    there = list(columns)
    stem, _, tail = name.rpartition("_")
    for column in there:
        other, _, unit = column.rpartition("_")
        if not stem or other.lower() != stem.lower() or unit.lower() == tail.lower():
            continue
        if tail == "C" and unit.lower() in _TO_CELSIUS:
            written, how = _TO_CELSIUS[unit.lower()]
            return f"{column} is in {written} by its name: {how}, and call it {name}"
        if unit.lower() in _OTHER_UNITS:
            return f"{column} is in another unit by its name: convert it, and call it {name}"
    same = [column for column in there if _normalised(column) == _normalised(name)]
    near = same or difflib.get_close_matches(name, there, n=1)
    return f"did you mean {near[0]}?" if near else ""


def _normalised(column: str) -> str:
    """Return a name without variants of spelling: case, brackets, signs for units."""
    text = column.lower()
    for sign, word in _AS_WORDS:
        text = text.replace(sign, word)
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")
