"""Lines among the rows of a table that are no rows: second headings, second lines of units, and comments.

Loggers that begin again append such lines to their file. Below a second line of units the numbers are in its units, so
they are converted to those of the column, or the file is refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import split_column
from hil.record.csv_file.dialect import MOST_BELOW, Dialect, is_value, known_units, split
from hil.record.raw import RawRecord, RecordError
from hil.record.times import SECONDS_PER, is_time_name, seconds_per_unit
from hil.record.units import conversion, meaning_of, name_and_unit, scaled_heading
from hil.record.values import MARKS, MISSING, trimmed

_NUMBER = r"^[+-]?[.,]?\d[\d.,:;/ TZeE+-]*$"
"""Cells that are numbers or times at a first look."""
_SHOWN = 60
"""Characters of a comment that a message quotes."""


def without_other_lines(raw: RawRecord, dialect: Dialect, skipped: Sequence[tuple[int, str]] = ()) -> RawRecord:
    """Return `raw` without the lines among its rows that are no rows, its numbers in the units of its columns.

    Parameters
    ----------
    raw
        Columns of text, in the order of the names of `dialect`.
    skipped
        Number and text of each line that was left out because of its number of fields.

    Raises
    ------
    RecordError
        Below a line of units a column is in another quantity, in a unit that is not known, or its unit above that line
        is not known; or the unit of the times changes.
    """
    found = _rows_without_values(raw)
    cells = {row: [cell or "" for cell in line] for row, line in found.items()}
    written = list(dialect.names[: len(raw.names)])
    headings = [row for row, line in cells.items() if line == written]
    below = {
        row + k for row in headings for k in range(1, MOST_BELOW + 1) if _all_in(range(row + 1, row + k + 1), cells)
    }
    comments = {row: ", ".join(filter(None, line)) for row, line in cells.items() if line[0].startswith("#")}
    units = [row for row, line in cells.items() if row not in comments and _gives_units(line, written, row in below)]
    conversions = _converted(raw, dialect, [(row, cells[row]) for row in units])
    commented = [(number, text) for number, text in skipped if text.lstrip('"').startswith("#")]
    commented += [(int(raw.place(row).split()[-1]), text) for row, text in comments.items()]
    said = [f"line {number} is a comment among the rows: '{_short(text)}'" for number, text in sorted(commented)[:3]]
    said += [f"{len(commented) - 3} further comments stand among the rows"] if len(commented) > 3 else []
    said += _headings_said(raw, headings)
    left_out = sorted({*headings, *below, *units, *comments})
    if not left_out and not said:
        return raw
    kept = np.setdiff1d(np.arange(len(raw.cells[0])), left_out)
    for name, (factor, offset, first) in conversions.items():
        changed = int(np.count_nonzero(((factor != factor[0]) | (offset != offset[0]))[kept]))
        unit = cells[first][raw.names.index(name)]
        said.append(f"{name}: {raw.place(first)} gives the unit {unit}: {changed} values below it are converted")
    by_row = {name: (factor[kept], offset[kept]) for name, (factor, offset, _) in conversions.items()}
    if left_out:
        lines = tuple(int(raw.place(int(row)).split()[-1]) for row in kept)
        raw = dataclasses.replace(raw, cells=tuple(column.take(kept) for column in raw.cells), lines=lines)
    return dataclasses.replace(raw, messages=(*raw.messages, *said), conversions={**raw.conversions, **by_row})


def is_other_line(number: int, text: str, dialect: Dialect, headings: Sequence[int]) -> bool:
    """Return True for a line with another number of fields that is no broken row.

    It is a comment, or the line of a logger's own data above one of the `headings` (numbers of lines).
    """
    if text.lstrip('"').startswith("#"):
        return True
    cells = split(text, dialect.delimiter)
    is_row = not cells or is_value(cells[0])  # A row that was cut off when the logger stopped.
    return not is_row and any(0 < heading - number <= MOST_BELOW for heading in headings)


def heading_lines(raw: RawRecord, written: Sequence[str]) -> list[int]:
    """Return the numbers of the lines among the rows that hold the names of the columns."""
    first = trimmed(raw.cells[0])
    if first is None or not written[0]:
        return []
    import pyarrow.compute as pc

    rows = pc.indices_nonzero(pc.fill_null(pc.equal(first, written[0]), False)).to_pylist()
    columns = [trimmed(cells) for cells in raw.cells]
    same = [row for row in rows if [(c[row].as_py() or "") if c is not None else "" for c in columns] == list(written)]
    return [int(raw.place(row).split()[-1]) for row in same]


def _rows_without_values(raw: RawRecord) -> dict[int, list[str | None]]:
    """Return the rows with text and without any number, date or time of day, by row."""
    import pyarrow.compute as pc

    if not raw.cells or not len(raw.cells[0]):
        return {}
    columns = [column for cells in raw.cells if (column := trimmed(cells)) is not None]
    if len(columns) < len(raw.cells):
        return {}
    present: NDArray[np.bool_] = np.zeros(len(raw.cells[0]), dtype=np.bool_)
    numeric = present.copy()
    for column in columns:
        present |= column.is_valid().to_numpy()
        numeric |= pc.fill_null(pc.match_substring_regex(column, _NUMBER), False).to_numpy()
    rows = np.flatnonzero(present & ~numeric).tolist()
    if len(rows) > len(present) / 2:
        return {}
    lines = {row: [column[row].as_py() for column in columns] for row in rows}
    return {
        row: line
        for row, line in lines.items()
        if not any(cell is not None and is_value(cell) for cell in line)
        and any(cell is not None and cell.lower() not in (*MISSING, *MARKS) for cell in line)
    }


def _all_in(rows: range, cells: dict[int, Any]) -> bool:
    return all(row in cells for row in rows)


def _gives_units(line: Sequence[str], names: Sequence[str], is_below_heading: bool) -> bool:
    """Return True for a line of units: by any unit below a heading, by most of its cells elsewhere."""
    known = known_units(line, names)
    return bool(known) and (is_below_heading or 2 * len(known) >= sum(map(bool, line)))


def _converted(
    raw: RawRecord, dialect: Dialect, lines: Sequence[tuple[int, list[str]]]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64], int]]:
    """Return factors (n,), offsets (n,) and first row of change of each column whose unit a later line changes."""
    count = len(raw.cells[0]) if raw.cells else 0
    found: dict[str, tuple[NDArray[np.float64], NDArray[np.float64], int]] = {}
    for row, line in lines:
        for place, cell in enumerate(line):
            top = dialect.units.get(place, "")
            if cell.lower() in MISSING:
                continue
            name = raw.names[place]
            base = raw.conversions.get(name, (1.0, 0.0))
            by = base if cell.lower() == top.lower() else _way(raw, dialect, place, cell, row)
            if by is None:
                continue
            if name not in found:
                if by == base:
                    continue
                found[name] = np.full(count, float(base[0])), np.full(count, float(base[1])), row
            factor, offset, _ = found[name]
            factor[row:], offset[row:] = by
    return found


def _way(raw: RawRecord, dialect: Dialect, place: int, cell: str, row: int) -> tuple[float, float] | None:
    """Return factor and offset from the unit in `cell` to that of the column; None for a cell that gives none."""
    name, top = dialect.names[place], dialect.units.get(place, "")
    here = raw.place(row)
    split = "split the file there"
    if is_time_name(name):
        per = SECONDS_PER.get(top.strip("[]() ").lower()) if top else seconds_per_unit(name)
        if per is None or SECONDS_PER.get(cell.strip("[]() ").lower()) != per:
            raise RecordError(
                f"{raw.path} {here} gives '{cell}' for the times '{name}' where the top of the file has "
                f"'{top or 'no unit'}'; {split}"
            )
        return None
    meaning, own = meaning_of(cell), _meaning(name, top)
    if meaning is None and own is None and not top:
        return None
    before = top or ("no unit" if own is None else own[0])
    way = None if meaning is None or own is None else conversion(*meaning, own[0])
    if way is None or (scaled_heading(name) is not None and meaning != own):
        raise RecordError(
            f"{raw.path} {here} gives '{cell}' for column '{name}' where the top of the file has '{before}', and its "
            f"numbers below cannot be converted; {split}, or write one unit"
        )
    return way


def _meaning(name: str, top: str) -> tuple[str, float] | None:
    """Return the unit of a column at the top of the file and its factor, by its name or by the line of units."""
    own = split_column(name) or name_and_unit(name)
    if own is not None:
        return own[1], 1.0
    scaled = scaled_heading(name)
    return scaled[1:] if scaled is not None else meaning_of(top) if top else None


def _headings_said(raw: RawRecord, headings: Sequence[int]) -> list[str]:
    if not headings:
        return []
    more = f" (and {len(headings) - 1} more)" if len(headings) > 1 else ""
    return [f"a second heading at {raw.place(headings[0])}{more}"]


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
