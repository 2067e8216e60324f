"""Records with one reading in each row (series, time, value), as databases export them, to columns."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from drivers.signals import split_column
from hil.files import require_cells
from hil.record.quality import usable_by
from hil.record.raw import RawRecord, RecordError
from hil.record.times import is_time_name
from hil.record.units import suffixed, unit_of
from hil.record.values import evidence_of, may_be_lost, parse, trimmed

VALUES = ("value", "_value", "state", "reading", "val", "wert", "payload", "varvalue", "messwert")
SERIES = (
    *("_field", "series", "entity_id", "name", "variable", "signal", "tag", "tagname", "tag_name", "point", "channel"),
    *("sensor", "metric", "parameter", "item", "quantity", "topic", "key", "column", "_measurement"),
    *("itemid", "item id", "nodeid", "node id", "varname", "displayname", "display name", "pointid", "bezeichnung"),
)
UNITS = ("unit", "units", "unit_of_measurement", "einheit")
QUALITIES = ("quality", "qualitycode", "quality_code", "status", "statuscode", "status code", "validity", "qualität")
MOST_SERIES = 2000
"""Most names of signals of one rig; a table with more is refused."""


def one_column_a_series(raw: RawRecord) -> RawRecord:
    """Return `raw` with a column for each series if it holds one reading in each row; any other record unchanged.

    A table is of that kind where it has one column of values, a column of times, and columns of text that name the
    series, but no further numbers.

    Raises:
        RecordError: readings would be lost, or there are more names than a rig has signals.
    """
    low = [name.strip().lower() for name in raw.names]
    values = [i for i, name in enumerate(low) if name in VALUES]
    times = [i for i, name in enumerate(low) if name != "time_s" and is_time_name(name)] or [
        i for i, name in enumerate(low) if name == "time_s"
    ]
    if len(values) != 1 or not times or not raw.cells or not len(raw.cells[0]):
        return raw
    value, time = values[0], times[0]
    rest = [i for i in range(len(low)) if i != value and i not in times and low[i] not in (*UNITS, *QUALITIES)]
    labels = [
        i
        for i in rest
        if (text := trimmed(raw.cells[i])) is not None
        and not _numeric(raw.cells[i])
        and text.null_count <= may_be_lost(len(text))
    ]
    if not labels or len(labels) < len(rest) or not _numeric(raw.cells[value], 0.0):
        return raw
    texts = [_strings(raw.cells[i]) for i in labels]
    moments = _strings(raw.cells[time])
    known = [at for at, i in enumerate(labels) if low[i] in SERIES]
    if not known and len(set(moments)) == len(moments):
        return raw
    naming = _naming(texts, known)
    series = ["_".join(parts) for parts in zip(*(texts[at] for at in naming), strict=True)]
    unit = next((_strings(raw.cells[i]) for i, name in enumerate(low) if name in UNITS), None)
    if unit is not None:
        series = [_with_unit(name, symbol) for name, symbol in zip(series, unit, strict=True)]
    rated = next((i for i, name in enumerate(low) if name in QUALITIES), None)
    usable, said = (None, "") if rated is None else usable_by(raw.names[rated], _strings(raw.cells[rated]))
    raw = dataclasses.replace(raw, messages=(*raw.messages, said)) if said else raw
    return _spread(raw, time, moments, series, _cells(raw.cells[value]), usable)


def _numeric(cells: Any, share: float = 0.5) -> bool:
    seen = evidence_of(cells)
    if seen is None:
        return parse(cells) is not None
    return seen.numbers > share * seen.present


def _cells(cells: Any) -> list[str | None]:
    import pyarrow as pa
    import pyarrow.types as kinds

    if kinds.is_floating(cells.type):
        return [None if cell is None else repr(cell) for cell in cells.to_pylist()]
    text: list[str | None] = cells.cast(pa.string()).to_pylist()
    return text


def _strings(cells: Any) -> list[str]:
    return [cell or "" for cell in _cells(cells)]


def _naming(texts: Sequence[Sequence[str]], known: Sequence[int]) -> list[int]:
    """Return which columns of text name a series: one that tells all combinations apart, else all that vary."""
    combinations = len(set(zip(*texts, strict=True)))
    for at in (*known, *range(len(texts))):
        if len(set(texts[at])) == combinations:
            return [at]
    return [at for at in range(len(texts)) if len(set(texts[at])) > 1]


def _with_unit(name: str, symbol: str) -> str:
    unit = unit_of(symbol)
    return name if unit is None or split_column(name) else suffixed(name, unit)


def _spread(
    raw: RawRecord,
    time: int,
    moments: list[str],
    series: list[str],
    values: list[str | None],
    usable: list[bool] | None,
) -> RawRecord:
    import pyarrow as pa

    names = list(dict.fromkeys(name for name in series if name))
    if len(names) > MOST_SERIES:
        raise RecordError(
            f"{raw.path} has {len(names)} series, more than a rig has signals; give a record with a column for each"
        )
    row_of = {moment: row for row, moment in enumerate(dict.fromkeys(moments))}
    require_cells(raw.path, len(row_of), len(names), RecordError)
    columns: dict[str, list[str | None]] = {name: [None] * len(row_of) for name in names}
    first: dict[str, int] = {}
    lost = doubtful = 0
    for i, (moment, name, value) in enumerate(zip(moments, series, values, strict=True)):
        first.setdefault(moment, i)
        if not name or value is None:
            continue
        if usable is not None and not usable[i]:
            doubtful += 1
            continue
        cell = columns[name][row_of[moment]]
        lost += cell is not None and cell != value
        columns[name][row_of[moment]] = value
    if lost > may_be_lost(len(values)):
        raise RecordError(
            f"{raw.path} has {lost} readings of a series at a time that it has already; write times with fractions of "
            "a second, or a column for each series"
        )
    said = [f"one reading a row: {len(values)} readings of {len(names)} series, a column for each"]
    said += [f"{doubtful} readings are not of good quality: missing"] if doubtful else []
    said += [f"{lost} readings of a series at a time that it has already: the last is kept"] if lost else []
    taken = raw.cells[time].take(pa.array(list(first.values()), pa.int64()))
    named = [name if name != raw.names[time] else f"{name}_2" for name in names]
    return dataclasses.replace(
        raw,
        names=(raw.names[time], *named),
        cells=(taken, *(pa.chunked_array([columns[name]], pa.string()) for name in names)),
        messages=(*raw.messages, *said),
        units=None,
        lines=tuple(int(raw.place(i).removeprefix("line ")) for i in first.values()) if raw.header_line else (),
        plausible={},
    )
