"""Units in the cells of a record, as in `20.5 °C`."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from drivers.signals import split_column
from hil.record.raw import RawRecord, RecordError
from hil.record.times import is_time_name
from hil.record.units.headings import fahrenheit_hint, name_and_unit, suffixed
from hil.record.units.meanings import unit_of
from hil.record.values import COLDEST_K, MARKS, may_be_lost, readings, trimmed

_CELL = re.compile(
    r"([+\-\u2212]?[\d.,' \u00a0\u2009\u202f\u2019]*\d(?:[eE][+-]?\d+)?)\s*([^\d\s.,'+-][^\d]*\d?(?:/[a-z]+)?)"
)
_PREFIXED = re.compile(r"([+-]?\d+(?:[.,]\d+)?)\s?(K|k|Mil|M|Bil|G|m|µ)")
"""Number with a prefix of a multiple behind it; `Mil` and `Bil` are Grafana's millions and billions."""
_ANY = r"[0-9]\s*[A-Za-z°%µΩ]"


def without_cell_units(raw: RawRecord) -> RawRecord:
    """Return `raw` with numbers alone in the columns whose cells contain the unit of the column's name.

    A column of a name without a unit gets the suffix of that unit.

    Raises
    ------
    RecordError
        Cells have another unit than the name of their column, or cells of a column differ in unit.
    """
    names, cells, messages = list(raw.names), list(raw.cells), list(raw.messages)
    for index, name in enumerate(raw.names):
        if not is_time_name(name):
            _require_no_prefixes(name, raw.cells[index], raw)
        if not is_time_name(name) and (found := _stripped(name, raw.cells[index], raw)) is not None:
            names[index], cells[index], said = found
            if name in raw.conversions:
                raise RecordError(
                    f"{raw.path}: column '{name}' has a multiple of its unit by the file and the unit itself in its "
                    "cells; correct one of them"
                )
            messages.append(said)
            messages += filter(None, [fahrenheit_hint(names[index])] if names[index] == f"{name}_F" else [])
    return dataclasses.replace(raw, names=tuple(names), cells=tuple(cells), messages=tuple(messages))


def _require_no_prefixes(name: str, cells: Any, raw: RawRecord) -> None:
    """Raise RecordError for cells with a prefix in place of a unit, `1.20 K` for 1200, as dashboards write them.

    K is kelvin in a column of temperatures, and where all cells of a column without a unit have it and are as large as
    temperatures in kelvin are.
    """
    import pyarrow.compute as pc

    text = trimmed(cells)
    if text is None or not pc.any(pc.match_substring_regex(text, _ANY)).as_py():
        return
    written = text.to_pylist()
    found = [(row, match) for row, cell in enumerate(written) if cell and (match := _PREFIXED.fullmatch(cell))]
    present = len(written) - text.null_count
    if len(found) <= may_be_lost(present):
        return
    own = (split_column(name) or name_and_unit(name) or ("", ""))[1]
    kelvins = all(match[2] == "K" for _, match in found)
    if own in ("degC", "degF", "K") or (own and unit_of(found[0][1][2]) == own):
        return
    middle = sorted(float(match[1].replace(",", ".")) for _, match in found)[len(found) // 2]
    if not own and (not kelvins or (len(found) == present and middle >= COLDEST_K)):
        return
    row, match = found[0]
    raise RecordError(
        f"{raw.path}: column '{name}' has '{match[0]}' ({raw.place(row)}), where '{match[2]}' may stand for a multiple "
        "of its unit, as dashboards shorten numbers; export full numbers (in Grafana: no unit, all decimals)"
    )


def _stripped(name: str, cells: Any, raw: RawRecord) -> tuple[str, Any, str] | None:
    """Return the name, numbers and message of a column whose cells have a unit, None for any other column."""
    import pyarrow as pa
    import pyarrow.compute as pc

    text = trimmed(cells)
    if text is None or not pc.any(pc.match_substring_regex(text, _ANY)).as_py():
        return None
    split = [None if cell is None else _number_and_unit(cell) for cell in text.to_pylist()]
    there = [(row, one) for row, one in enumerate(split) if one is not None]
    with_unit = [(row, unit) for row, (_, unit) in there if unit]
    present = sum(cell is not None and cell.lower() not in MARKS for cell in text.to_pylist())
    if len(with_unit) <= present / 2 or len(there) < present:
        return None
    first = with_unit[0][1]
    other = next(((row, unit) for row, unit in with_unit if unit != first), None)
    if other is not None:
        raise RecordError(
            f"{raw.path}: column '{name}' is in {first} ({raw.place(with_unit[0][0])}) and in {other[1]} "
            f"({raw.place(other[0])}) by its cells; write all in one unit"
        )
    parts = split_column(name)
    new = name
    if parts is None:
        new = suffixed(name, first)
        if new in raw.names:
            said = f"column '{name}' has the unit {first} in its cells, and there is a column {new}; rename one of them"
            return name, cells, said
    elif parts[1] != first:
        raise RecordError(
            f"{raw.path}: column '{name}' is in {parts[1]} by its name and in {first} by its cells "
            f"({raw.place(with_unit[0][0])}); correct one of them"
        )
    kept = [cell if one is None else one[0] for cell, one in zip(text.to_pylist(), split, strict=True)]
    said = f"column '{name}' has the unit {first} in its cells: it is read as {new}"
    if new == name:
        said = f"{name}: the unit {first} in its cells is left out"
    return new, pa.chunked_array([pa.array(kept, pa.string())]), said


def _number_and_unit(cell: str) -> tuple[str, str] | None:
    """Return number and unit of a cell, "" for none; None if it is no number with a known unit."""
    if readings(cell) != (None, None):
        return cell, ""
    match = _CELL.fullmatch(cell)
    if match is None or readings(match[1].strip()) == (None, None):
        return None
    unit = "degF" if match[2] == "F" else unit_of(match[2])
    return None if unit is None else (match[1].strip(), unit)
