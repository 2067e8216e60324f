"""Units in the headings of a record, `Tank [°C]` or `P_heater / W`, as the suffixes that columns have."""

from __future__ import annotations

import dataclasses
import re

from drivers.signals import column_name, known_unit, split_column
from hil.record.raw import RawRecord, RecordError
from hil.record.times import SECONDS_PER, is_time_name
from twin import celsius_conversion

FAHRENHEIT = ("°f", "degf", "deg f", "fahrenheit")
"""Ways to write degrees Fahrenheit, lower case; no signal of this project is in them."""
_IN_BRACKETS = re.compile(r"(.+?)\s*[\[({<]\s*([^\[\](){}<>]+?)\s*[\])}>]")
_BEHIND_A_SIGN = re.compile(r"([^/,;]+?)\s+/\s+([^/\s]+)|([^/,;]+?)\s*,\s*([^,\s]+)(?:\s+\(.*)?|(.+?)\s+in\s+(\S+)")
_SHOWN = 6
"""Columns that a message names one by one."""


def unit_of(text: str) -> str | None:
    """Return the unit in a cell of a heading or a line of units, `degF` among them; None where it has none."""
    bare = text.strip().strip("[](){} ")
    if bare.lower() in FAHRENHEIT:
        return "degF"
    unit = known_unit(bare) if bare else None
    return None if unit == "1" else unit


def name_and_unit(heading: str) -> tuple[str, str] | None:
    """Return name and unit of a heading such as `Tank [°C]`, `Tank / °C` or `Tank, °C`; None where it gives no unit."""
    for pattern in (_IN_BRACKETS, _BEHIND_A_SIGN):
        found = pattern.fullmatch(heading.strip())
        if found is None:
            continue
        name, symbol = (part for part in found.groups() if part)
        unit = "degF" if symbol == "F" and pattern is _IN_BRACKETS else unit_of(symbol)
        if unit is not None:
            return name.strip(), unit
    return None


def suffixed(name: str, unit: str) -> str:
    """Return the column of a record for a signal `name` in `unit`, degF among them."""
    return f"{name}_F" if unit == "degF" else column_name(name, unit)


def fahrenheit_hint(column: str) -> str:
    """Return the remedy for a column in degrees Fahrenheit, "" where its name alone gets one (`celsius_conversion`)."""
    if celsius_conversion(column) is not None:
        return ""
    named = f"{column.removesuffix('_F')}_C"
    return f"{column} is in degrees Fahrenheit, and twins read degC: subtract 32 and divide by 1.8, and call it {named}"


def with_heading_units(raw: RawRecord) -> RawRecord:
    """Return `raw` with the unit suffix in the name of each column whose heading gives the unit in another form.

    Times keep their names. Letters in brackets that cannot all be units, as `zone (A)` beside `zone (B)`, are none.

    Raises
    ------
    RecordError
        A heading gives two units.
    """
    brackets = [_IN_BRACKETS.fullmatch(name.strip()) for name in raw.names]
    letters = [match[2] for match in brackets if match is not None and len(match[2]) == 1]
    are_labels = any(letter != "F" and unit_of(letter) is None for letter in letters)
    names = list(raw.names)
    units, plausible = dict(raw.units or {}), dict(raw.plausible)
    said: list[str] = []
    hints: list[str] = []
    for place, heading in enumerate(raw.names):
        found = None if is_time_name(heading) else name_and_unit(heading)
        if found is None or found[1] in SECONDS_PER:
            continue
        if are_labels and _IN_BRACKETS.fullmatch(heading.strip()) and re.search(r"[\[({<]\s*\w\s*[\])}>]$", heading):
            continue
        name, unit = found
        own = split_column(name)
        if own is not None and own[1] != unit:
            raise RecordError(f"{raw.path}: column '{heading}' is in {own[1]} and in {unit} by its name; correct it")
        new = name if own else suffixed(name, unit)
        if new in names:
            continue
        names[place] = new
        said.append(f"'{heading}' as {new}")
        hints += [fahrenheit_hint(new)] if unit == "degF" else []
        for known in (units, plausible):
            if heading in known:
                known[new] = known.pop(heading)  # type: ignore[assignment]
    if not said:
        return raw
    more = f" and {len(said) - _SHOWN} others" if len(said) > _SHOWN else ""
    messages = (f"units in headings: {', '.join(said[:_SHOWN])}{more}", *filter(None, hints))
    return dataclasses.replace(
        raw, names=tuple(names), units=units, plausible=plausible, messages=(*raw.messages, *messages)
    )
