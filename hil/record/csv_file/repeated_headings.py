"""Repeated headings among the rows of a record, as in joined files."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from hil.record.csv_file.dialect import is_value
from hil.record.raw import RawRecord, RecordError
from hil.record.times import is_time_name
from hil.record.values import trimmed


def by_later_headings(raw: RawRecord, written: Sequence[str]) -> RawRecord:
    """Return `raw` with the rows below a heading in another order read by its names; `written` are those at the top.

    The line of the heading stays, as a row without any number.

    Raises
    ------
    RecordError
        A later heading has other names or units.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    columns = [trimmed(cells) for cells in raw.cells]
    names = pa.array(list(written), pa.string())
    rows: set[int] = set()
    for column in columns:
        if column is not None:
            rows.update(pc.indices_nonzero(pc.fill_null(pc.is_in(column, value_set=names), False)).to_pylist())
    orders: list[tuple[int, list[int]]] = []
    for row in sorted(rows):
        cells = [None if column is None else column[row].as_py() for column in columns]
        present = [cell for cell in cells if cell is not None]
        if not _is_heading(present, len(cells)) or [cell or "" for cell in cells] == list(written):
            if present and [cell or "" for cell in cells] == list(written):
                orders.append((row, list(range(len(cells)))))
            continue
        if len(set(written)) < len(written) or sorted(present) != sorted(written):
            other = next((cell for cell in present if cell not in written), present[0])
            raise RecordError(
                f"{raw.path} {raw.place(row)} is a heading with other columns than that at the top (the first is "
                f"'{other}'); split the file there"
            )
        orders.append((row, [cells.index(name) for name in written]))
    if all(order == list(range(len(written))) for _, order in orders):
        return raw
    starts = [(0, list(range(len(written)))), *orders]
    ends = [row for row, _ in orders] + [len(raw.cells[0])]
    found = []
    for place in range(len(written)):
        pieces = [raw.cells[order[place]].slice(row, end - row) for (row, order), end in zip(starts, ends, strict=True)]
        found.append(pa.chunked_array([chunk for piece in pieces for chunk in piece.chunks], raw.cells[place].type))
    first = next(row for row, order in orders if order != list(range(len(written))))
    said = f"{raw.place(first)} names the columns in another order: the rows below it are read by their names"
    return dataclasses.replace(raw, cells=tuple(found), messages=(*raw.messages, said))


def _is_heading(cells: Sequence[str], width: int) -> bool:
    """Return True for different words in more than half of the columns, one of them the name of a time."""
    distinct = len(set(cells)) == len(cells) > width / 2
    return distinct and not any(is_value(cell) for cell in cells) and any(is_time_name(cell) for cell in cells)
