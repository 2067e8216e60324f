"""Units in the headings of a record, `Tank [°C]` or `P_heater / W`, as the suffixes that columns have."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from drivers.signals import column_name, split_column
from hil.record.raw import RawRecord, RecordError, repeat_message
from hil.record.times import SECONDS_PER, is_time_name
from hil.record.units.meanings import broken_sign, has_open_factor, meaning_of, names_factor, unit_of
from twin import celsius_conversion

_IN_BRACKETS = re.compile(r"(.+?)\s*[\[({<]\s*([^\[\](){}<>]+?)\s*[\])}>]")
_BEHIND_A_SIGN = re.compile(r"([^/,;]+?)\s+/\s+([^/\s]+)|([^/,;]+?)\s*,\s*([^,\s]+)(?:\s+\(.*)?|(.+?)\s+in\s+(\S+)")
_LABEL = re.compile(r"\(.*\bLBL:\s*([^,)]+)")
"""Label of a sensor behind what it measures: `Temp, °C (LGR S/N: 1, SEN S/N: 2, LBL: Tank)`."""
_NESTED = re.compile(r"(.+?)\s*\[\s*([^\[\]]+?)\s*\]")
_NUMBERED = re.compile(r"(.+)(_\d+)")
_SHOWN = 6
"""Columns that a message names one by one."""


def name_and_unit(heading: str) -> tuple[str, str] | None:
    """Return name and unit of a heading such as `Tank [°C]`, `Tank / °C` or `Tank, °C`; None where it gives no unit."""
    for pattern in (_IN_BRACKETS, _BEHIND_A_SIGN):
        found = pattern.fullmatch(heading.strip())
        if found is None:
            continue
        name, symbol = (part for part in found.groups() if part)
        unit = "degF" if symbol == "F" and pattern is _IN_BRACKETS else unit_of(symbol)
        if unit is not None:
            label = _LABEL.search(heading)
            return name.strip() if label is None else label[1].strip(), unit
    return None


def scaled_heading(heading: str) -> tuple[str, str, float] | None:
    """Return name, unit and factor of a heading that gives a multiple of a unit, as `Tank [0.1 °C]`; else None."""
    for name, symbol in _name_and_symbol(heading):
        found = meaning_of(symbol)
        if found is not None and found[1] != 1.0:
            return name, *found
    return None


def _name_and_symbol(heading: str) -> list[tuple[str, str]]:
    found = (pattern.fullmatch(heading.strip()) for pattern in (_IN_BRACKETS, _NESTED, _BEHIND_A_SIGN))
    pairs = ([part.strip() for part in match.groups() if part] for match in found if match is not None)
    return [(pair[0], pair[1]) for pair in pairs]


def _is_open(heading: str) -> bool:
    """Return True for a heading with a unit and a factor whose meaning is open, in the unit or in the name."""
    pairs = _name_and_symbol(heading)
    return any(has_open_factor(symbol) or (unit_of(symbol) and names_factor(name)) for name, symbol in pairs)


def _repeated(heading: str, messages: Sequence[str]) -> tuple[str, str]:
    """Return the heading as the file has it, and the end that tells a repeated one from the first, `_2`, or ""."""
    found = _NUMBERED.fullmatch(heading)
    if found is None or repeat_message(found[1], heading) not in messages:
        return heading, ""
    return found[1], found[2]


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
    units, plausible, conversions = dict(raw.units or {}), dict(raw.plausible), dict(raw.conversions)
    said: list[str] = []
    hints: list[str] = []
    for place, heading in enumerate(raw.names):
        if is_time_name(heading):
            continue
        if _is_open(heading):
            hints.append(
                f"column '{heading}' has a factor that may be applied already or not: kept under this name without a "
                "unit; write the value of one count, such as 0.1 °C, or numbers in the unit itself"
            )
            continue
        broken = next((one for _, symbol in _name_and_symbol(heading) if (one := broken_sign(symbol))), None)
        if broken is not None:
            hints.append(
                f"column '{heading}' has '{broken[0]}' in its unit, {broken[1]}: kept under this name without a unit"
            )
        if names_factor(heading) and split_column(heading) is not None:
            hints.append(f"column '{heading}' has a factor in its name: its numbers are kept as they are")
        base, number = _repeated(heading, raw.messages)
        found, factor = name_and_unit(base), 1.0
        if found is None and (scaled := scaled_heading(base)) is not None:
            found, factor = scaled[:2], scaled[2]
        if found is not None:
            found = f"{found[0]}{number}", found[1]
        if found is None or (found[1] in SECONDS_PER and factor == 1.0):
            continue
        if are_labels and _IN_BRACKETS.fullmatch(heading.strip()) and re.search(r"[\[({<]\s*\w\s*[\])}>]$", heading):
            continue
        name, unit = found
        own = split_column(name)
        if own is not None and (own[1] != unit or factor != 1.0):
            other = unit if factor == 1.0 else f"{factor:.10g} {unit}"
            raise RecordError(f"{raw.path}: column '{heading}' is in {own[1]} and in {other} by its name; correct it")
        new = name if own else suffixed(name, unit)
        if new in names:
            hints.append(f"column '{heading}' is kept under this name without a unit, since there is a column {new}")
            continue
        names[place] = new
        said.append(f"'{heading}' as {new}" + ("" if factor == 1.0 else f", its numbers times {factor:.10g}"))
        hints += [fahrenheit_hint(new)] if unit == "degF" else []
        for known in (units, plausible, conversions):
            if heading in known:
                known[new] = known.pop(heading)  # type: ignore[assignment]
        if factor != 1.0:
            conversions[new] = (factor, 0.0)
    if not said:
        return dataclasses.replace(raw, messages=(*raw.messages, *hints)) if hints else raw
    more = f" and {len(said) - _SHOWN} others" if len(said) > _SHOWN else ""
    messages = (f"units in headings: {', '.join(said[:_SHOWN])}{more}", *filter(None, hints))
    return dataclasses.replace(
        raw,
        names=tuple(names),
        units=units,
        plausible=plausible,
        conversions=conversions,
        messages=(*raw.messages, *messages),
    )
