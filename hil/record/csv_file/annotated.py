"""Annotated CSV, the export of time-series databases: `#datatype`, `#group` and `#default` lines above each table.

Source: InfluxData, "Annotated CSV syntax": tables follow each other, each with its own header line, parted by blank
lines; the first column is empty, `result` and `table` number the tables, `#default` fills empty cells.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

from hil.files import require_cells, require_columns
from hil.record.raw import RawRecord, RecordError, unique

_ANNOTATION = re.compile(r'\s*"?#(datatype|group|default)\b')
_NOT_DATA = ("", "result", "table", "_start", "_stop")


def is_annotated(text: str) -> bool:
    """Return True for a CSV whose first line that is not blank is an annotation."""
    first = next((line for line in text[:10_000].splitlines() if line.strip()), "")
    return _ANNOTATION.match(first) is not None


def read_annotated(path: Path, text: str, digest: str) -> RawRecord:
    """Return all tables of an annotated CSV as one; columns that a table lacks are empty.

    Raises
    ------
    RecordError
        There is no row, or a line does not fit its header.
    """
    import pyarrow as pa

    columns: dict[str, list[str | None]] = {}
    lines: list[int] = []
    header: list[str] | None = None
    defaults: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            header, defaults = None, []
            continue
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], strict=True))]
        except csv.Error as error:
            raise RecordError(f"{path} line {number} cannot be read ({error}); export the record again") from error
        if cells[0].startswith("#"):
            header = None
            defaults = cells if cells[0] == "#default" else defaults
            continue
        if header is None:
            require_columns(path, len(columns) + len(cells), RecordError)
            header = list(unique(cells)[0]) if cells[0] else ["", *unique(cells[1:])[0]]
            continue
        if len(cells) != len(header):
            raise RecordError(
                f"{path} line {number} has {len(cells)} fields where its table has {len(header)}; export it again"
            )
        for place, name in enumerate(header):
            if name in _NOT_DATA:
                continue
            default = defaults[place] if place < len(defaults) else ""
            column = columns.setdefault(name, [])
            column += [None] * (len(lines) - len(column))
            column.append(cells[place] or default or None)
        lines.append(number)
    if not lines or not columns:
        raise RecordError(f"{path} holds no samples, only annotations; give a record with at least one row")
    require_cells(path, len(lines), len(columns), RecordError)
    filled = [
        pa.chunked_array([column + [None] * (len(lines) - len(column))], pa.string()) for column in columns.values()
    ]
    return RawRecord(path, digest, tuple(columns), tuple(filled), header_line=1, delimiter=",", lines=tuple(lines))
