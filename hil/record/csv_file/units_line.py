"""Names of columns with the units that a line of units gives for them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from drivers.signals import split_column
from hil.record.csv_file.dialect import Dialect
from hil.record.raw import RecordError
from hil.record.times import SECONDS_PER, is_time_name, names_unit, seconds_per_unit, zone_of
from hil.record.units import fahrenheit_hint, has_open_factor, meaning_of, name_and_unit, suffixed

_ENCLOSED = re.compile(r"^[\[({]\s*(.*?)\s*[\])}]$")


@dataclass(frozen=True)
class NamedColumns:
    """Names of the columns with the suffixes of the units that the file gives, and what follows from these units.

    `units` are by column, `conversions` factor and offset of its numbers, `messages` remarks and hints.
    """

    names: list[str]
    units: dict[str, str]
    conversions: dict[str, tuple[float, float]]
    messages: list[str]


def named_columns(path: Path, dialect: Dialect) -> NamedColumns:
    """Return the names of the columns with the units of the dialect.

    Raises
    ------
    RecordError
        A name ends in the suffix of another unit than the line of units gives, or that line has a factor for it that
        cannot be read.
    """
    found = NamedColumns(list(dialect.names), {}, {}, [])
    for place, cell in dialect.units.items():
        name = found.names[place]
        if cell.lower() == name.lower():  # `ms` below `ms`, parts of a second
            continue
        meaning = meaning_of(cell)
        if is_time_name(name) and (meaning is None or meaning[0] in SECONDS_PER or names_unit(name)):
            _name_time(path, dialect, place, found)
            continue
        own = _unit_of(name)
        if own is not None and meaning != (own, 1.0):
            raise RecordError(_contradiction(path, name, own, meaning, cell, dialect.units_line))
        if not name or own is not None:
            continue
        if meaning is None:
            symbol = _ENCLOSED.sub(r"\1", cell)
            found.names[place] = f"{name} [{symbol}]"
            if not has_open_factor(cell):  # `with_heading_units` reports one.
                found.messages.append(
                    f"line {dialect.units_line} gives '{cell}' for column '{name}', no known unit: kept as "
                    f"'{found.names[place]}' without a unit"
                )
            continue
        unit, factor = meaning
        found.names[place] = named = suffixed(name, unit)
        if unit == "degF":
            found.names[place] = named = name if name.lower().endswith(("_f", "_degf")) else named
            found.messages.extend(filter(None, [fahrenheit_hint(named)]))
        else:
            found.units[named] = unit
        if factor != 1.0:
            found.conversions[named] = (factor, 0.0)
            found.messages.append(
                f"line {dialect.units_line} gives '{cell}' for column '{name}': read as {named}, its numbers times "
                f"{factor:.10g}"
            )
    return found


def _name_time(path: Path, dialect: Dialect, place: int, found: NamedColumns) -> None:
    """Take the unit or the zone that a line of units gives for a column of times into its name or its unit."""
    name, symbol = found.names[place], dialect.units[place].strip("[]() ")
    if symbol.lower() in SECONDS_PER:
        if names_unit(name) and SECONDS_PER[symbol.lower()] != seconds_per_unit(name):
            raise RecordError(
                f"{path}: column '{name}' is in {_unit_of(name)} by its name and in {symbol} by line "
                f"{dialect.units_line}; correct one of them"
            )
        found.units[name] = symbol.lower()
    elif any(letter.isdigit() for letter in symbol) and (symbol.lower().split() or [""])[-1] in SECONDS_PER:
        raise RecordError(
            f"{path} line {dialect.units_line} gives the unit '{symbol}' for the times '{name}'; write seconds"
        )
    elif zone_of(f"({symbol})") is not None:
        found.names[place] = f"{name} ({symbol})"


def _contradiction(path: Path, name: str, own: str, meaning: tuple[str, float] | None, cell: str, line: int) -> str:
    if meaning is None:
        return (
            f"{path}: column '{name}' is in {own} by its name, and line {line} gives '{cell}' for it, which is another "
            f"unit or has a factor; write {own} there and the numbers in {own}"
        )
    other = meaning[0] if meaning[1] == 1.0 else f"{meaning[1]:.10g} {meaning[0]}"
    remedy = "correct one of them"
    if meaning[0] == own:
        remedy = f"write {own} there, or take the unit out of the name where the numbers are to be multiplied"
    return f"{path}: column '{name}' is in {own} by its name and in {other} by line {line}; {remedy}"


def _unit_of(name: str) -> str | None:
    """Return the unit that a name ends in; None where it gives none."""
    if is_time_name(name):
        per = seconds_per_unit(name)
        return next(unit for unit, seconds in SECONDS_PER.items() if seconds == per) if names_unit(name) else None
    parts = split_column(name) or name_and_unit(name)
    return None if parts is None else parts[1]
