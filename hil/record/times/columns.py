"""Columns of a record that hold its times: found by name or by content, alone or as dates and times of day."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.record.raw import RawRecord, ReadingOptions, RecordError
from hil.record.times.counts import find_counts, names_count, names_subseconds
from hil.record.times.digits import may_be_clock, may_be_dates
from hil.record.times.names import SECONDS_PER, is_time_name, names_days, names_unit, seconds_per_unit
from hil.record.times.numbers import day_count
from hil.record.times.parts import find_parts
from hil.record.times.text import is_date, is_moment, is_time_of_day
from hil.record.times.zones import zone_of
from hil.record.values import Sign, parse, trimmed

_SAMPLE = 9
"""Cells of a text column that show dates or times."""


def scale_of(raw: RawRecord, column: str) -> float:
    """Return seconds per unit of the time column: from its name, else from the file."""
    named = seconds_per_unit(column)
    if named in (None, 1.0) and (unit := (raw.units or {}).get(column)):
        return SECONDS_PER.get(unit.lower(), 1.0)
    return named or 1.0


def has_unit(raw: RawRecord, column: str) -> bool:
    """Return True where the name of the time column or the file gives its unit."""
    return names_unit(column) or (raw.units or {}).get(column, "").lower() in SECONDS_PER


def find_columns(raw: RawRecord, signs: dict[str, Sign], choice: ReadingOptions) -> tuple[str, ...]:
    """Return the column of times, those of dates and of times of day, or those of the parts of a date.

    Raises
    ------
    RecordError
        There is none, or the choice names a column that is not there.
    """
    if choice.time_column is not None:
        wanted = (choice.time_column,) if choice.time_column in raw.names else tuple(choice.time_column.split(","))
        wanted = tuple(name.strip() for name in wanted)
        for name in wanted:
            if name not in raw.names:
                raise RecordError(f"{raw.path} has no column '{name}'; it has {_shown(raw)}")
        if len(wanted) > 2:
            raise RecordError(f"{raw.path}: --time-column takes one name, or two for dates and times of day")
        return wanted if len(wanted) == 2 else _with_partner(raw, wanted[0], signs)
    if "time_s" in raw.names:
        return ("time_s",)
    if (parts := find_parts(raw.names)) is not None:
        return tuple(parts.values())
    for name in raw.names:
        if is_time_name(name):
            return _with_partner(raw, _in_utc(raw, name), signs)
    import pyarrow as pa

    for name, cells in zip(raw.names, raw.cells, strict=True):
        if pa.types.is_timestamp(cells.type) or pa.types.is_date(cells.type) or all_cells(cells, is_moment):
            return _with_partner(raw, name, signs)
    place = f" line {raw.header_line}" if raw.header_line else ""
    nameless = ", where the first column has no name" if raw.names[0] == "column_1" else ""
    if (whole := _beside_parts(raw, signs)) is not None:
        return (whole,)
    counted = next((name for name in raw.names if names_subseconds(name)), None)
    if counted is not None:
        name, seconds = counted, names_subseconds(counted)
        raise RecordError(
            f"{raw.path}{place} has no column time_s; where '{name}' counts the time from the beginning, give "
            f"--time-column {name} --time-scale {seconds:g}"
        )
    raise RecordError(
        f"{raw.path}{place} has no column time_s (it has {_shown(raw)}{nameless}); name the column of sample times "
        "time_s, in seconds, or give --time-column; where each row is a steady state, give --at-rest to hil diagnose"
    )


def _beside_parts(raw: RawRecord, signs: dict[str, Sign]) -> str | None:
    """Return a column of whole seconds beside one of parts of a second, as `secs` and `nsecs`; None where none is."""
    parts = {name for name in raw.names if names_subseconds(name) or names_subseconds(name.rsplit(".", 1)[-1])}
    cells = dict(zip(raw.names, raw.cells, strict=True))
    for name in raw.names:
        last = name.strip().lower().rsplit(".", 1)[-1]
        if name in parts or not parts or names_count(last) != 1.0:
            continue
        numbers = parse(cells[name], signs.get(name, "."))
        if numbers is not None and not numbers.bad and (np.nan_to_num(numbers.values) % 1.0 == 0.0).all():
            return name
    return None


def _in_utc(raw: RawRecord, name: str) -> str:
    """Return the column of dates and times whose name has a time zone, where that of the column `name` has none."""
    cells = dict(zip(raw.names, raw.cells, strict=True))
    if zone_of(name) is not None or not holds_moments(cells[name]):
        return name
    zoned = (one for one in raw.names if is_time_name(one) and zone_of(one) is not None and holds_moments(cells[one]))
    return next(zoned, name)


def holds_moments(cells: Any) -> bool:
    """Return True for a column of dates with times of day."""
    return all_cells(cells, is_moment) and not all_cells(cells, is_date)


def _shown(raw: RawRecord) -> str:
    return ", ".join(raw.names[:8]) + (", ..." if len(raw.names) > 8 else "")


def _with_partner(raw: RawRecord, name: str, signs: dict[str, Sign]) -> tuple[str, ...]:
    """Return the column alone, or with the one that has its dates or its times of day."""
    pairs = zip(raw.names, raw.cells, strict=True)
    kinds = {other: kind for other, cells in pairs if (kind := _kind(other, cells, signs.get(other, ".")))}
    kind = kinds.get(name, "")
    if not kind:
        dates = [other for other, its in kinds.items() if its == "date" and is_time_name(other)]
        if names_count(name) is None or len(dates) != 1:
            return (name,)
        counts, of_day = find_counts(raw, dates[0], signs)
        return (dates[0], *counts) if name in counts and of_day else (name,)
    partners = [other for other, its in kinds.items() if other != name and its and its != kind]
    named = [other for other in partners if is_time_name(other)]
    partners = named if len(named) == 1 else partners
    if not partners and kind == "date":
        counts, of_day = find_counts(raw, name, signs)
        return (name, *counts) if of_day or not counts else counts
    if not partners:
        return (name,)
    if len(partners) > 1:
        raise RecordError(
            f"{raw.path} has the columns {', '.join(partners)} besides '{name}', and each may hold its "
            f"{'times of day' if kind == 'date' else 'dates'}; name both with --time-column {name},{partners[0]}"
        )
    return (name, partners[0]) if kind == "date" else (partners[0], name)


def _kind(name: str, cells: Any, sign: Sign) -> str:
    """Return "date" for a column of dates without times, "time" for one of times of day, "" for any other."""
    import pyarrow as pa

    if pa.types.is_date(cells.type):
        return "date"
    if pa.types.is_time(cells.type):
        return "time"
    if all_cells(cells, is_date):
        return "date"
    if all_cells(cells, is_time_of_day):
        return "time"
    if not is_time_name(name):
        return ""
    numbers = parse(cells, sign)
    values = numbers.values[np.isfinite(numbers.values)] if numbers is not None else np.zeros(0)
    if len(values) and names_days(name) and day_count(float(values.min())) and day_count(float(values.max())):
        return "date" if (values == np.round(values)).all() else ""
    if may_be_dates(name, cells, sign):
        return "date"
    if may_be_clock(name, cells, sign):
        return "time"
    return "time" if len(values) and (values >= 0.0).all() and (values < 1.0).all() else ""


_BLANKS = str.maketrans(dict.fromkeys("\u00a0\u2007\u2009\u202f", " "))
"""Blanks that break no line, as browsers write them before AM and PM."""


def plain_blanks(cell: str) -> str:
    """Return a cell with plain blanks in place of those that break no line."""
    return cell.translate(_BLANKS)


def all_cells(cells: Any, test: Any) -> bool:
    """Return True where the first cells of a column of text all pass a test."""
    text = trimmed(cells)
    if text is None:
        return False
    first = text.drop_null()[:_SAMPLE].to_pylist()
    return bool(first) and all(test(plain_blanks(cell)) for cell in first)
