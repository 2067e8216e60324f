"""Records with one reading in each row (series, time, value), as databases export them, to columns."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import split_column
from hil.files import require_cells
from hil.record.quality import holds_flags, is_rating_name, is_remark_name, rating, texts_of
from hil.record.raw import RawRecord, RecordError
from hil.record.times import is_time_name
from hil.record.units import fahrenheit_hint, row_units, suffixed, unit_name
from hil.record.values import evidence_of, may_be_lost, parse, trimmed

VALUES = ("value", "_value", "state", "reading", "val", "wert", "payload", "varvalue", "messwert")
SERIES = (
    *("_field", "series", "entity_id", "name", "variable", "signal", "tag", "tagname", "tag_name", "point", "channel"),
    *("sensor", "metric", "parameter", "item", "quantity", "topic", "key", "column", "_measurement"),
    *("itemid", "item id", "nodeid", "node id", "varname", "displayname", "display name", "pointid", "bezeichnung"),
)
Array = NDArray[np.float64]
MOST_SERIES = 2000
"""Most names of signals of one rig; a table with more is refused."""


def one_column_a_series(raw: RawRecord) -> RawRecord:
    """Return `raw` with a column for each series if it holds one reading in each row; any other record unchanged.

    A table is of that kind where it has one column of values, a column of times, and columns of text that name the
    series, but no further numbers.

    Raises
    ------
    RecordError
        Readings would be lost, or there are more names than a rig has signals.
    """
    low = [name.strip().lower() for name in raw.names]
    values = [i for i, name in enumerate(low) if name in VALUES]
    times = [i for i, name in enumerate(low) if name != "time_s" and is_time_name(name)] or [
        i for i, name in enumerate(low) if name == "time_s"
    ]
    if len(values) != 1 or not times or not raw.cells or not len(raw.cells[0]):
        return raw
    value, time = values[0], times[0]
    rated = [i for i, name in enumerate(raw.names) if is_rating_name(name)]
    flags = [i for i, name in enumerate(raw.names) if is_remark_name(name) or holds_flags(texts_of(raw.cells[i][:200]))]
    rest = [
        i for i in range(len(low)) if i != value and i not in (*times, *rated, *flags) and not unit_name(raw.names[i])
    ]
    labels = [
        i
        for i in rest
        if (text := trimmed(raw.cells[i])) is not None
        and not is_numeric(raw.cells[i])
        and text.null_count <= may_be_lost(len(text))
    ]
    if not labels or len(labels) < len(rest) or not is_numeric(raw.cells[value], 0.0):
        return raw
    texts = [_strings(raw.cells[i]) for i in labels]
    moments = _strings(raw.cells[time])
    known = [at for at, i in enumerate(labels) if low[i] in SERIES]
    if not known and len(set(moments)) == len(moments):
        return raw
    naming = _naming(texts, known)
    series = ["_".join(parts) for parts in zip(*(texts[at] for at in naming), strict=True)]
    cells = _cells(raw.cells[value])
    unit = next((i for i, name in enumerate(raw.names) if unit_name(name)), None)
    conversions: dict[str, tuple[Array, Array]] = {}
    if unit is not None:
        series, conversions, told = _with_units(raw, raw.names[unit], series, _strings(raw.cells[unit]), cells)
        raw = dataclasses.replace(raw, messages=(*raw.messages, *told))
    unused = [raw.names[i] for i in flags if i not in rated and not is_remark_name(raw.names[i])]
    bad, said = _bad_readings(raw, rated)
    said = [*(f"column '{name}' holds True and False alone: not used" for name in unused), *said]
    raw = dataclasses.replace(raw, messages=(*raw.messages, *said))
    return _spread(raw, time, moments, series, cells, bad, conversions)


def _bad_readings(raw: RawRecord, rated: Sequence[int]) -> tuple[NDArray[np.bool_], list[str]]:
    """Return the readings (n,) that a column of ratings calls bad, and messages on the rest."""
    bad = np.zeros(len(raw.cells[0]), dtype=np.bool_)
    said = []
    for i in rated:
        name = raw.names[i]
        found = rating(name, texts_of(raw.cells[i]))
        if found is None:
            if raw.cells[i].null_count < len(bad):
                said.append(f"column '{name}' has codes of no known kind: not used")
            continue
        bad |= found.bad
        if found.uncertain.any():
            first = raw.place(int(np.argmax(found.uncertain)))
            said.append(f"{int(found.uncertain.sum())} readings are uncertain by '{name}' (the first is {first}): kept")
        if found.unknown is not None:
            row, text = found.unknown
            said.append(
                f"column '{name}' has '{text}' ({raw.place(row)}; {found.unknown_count} rows), no "
                "known rating: these readings are taken without it"
            )
    return bad, said


def is_numeric(cells: Any, share: float = 0.5) -> bool:
    """Return True for a column of numbers, with either decimal sign, in more than `share` of its cells."""
    seen = evidence_of(cells)
    if seen is None:
        return parse(cells) is not None
    return seen.numbers > share * seen.present


def _cells(cells: Any) -> list[str | None]:
    import pyarrow as pa
    import pyarrow.types as kinds

    if kinds.is_floating(cells.type):
        return [None if cell is None else repr(cell) for cell in cells.to_pylist()]
    if kinds.is_nested(cells.type):  # a structure or a list names no series
        return [None] * len(cells)
    text: list[str | None] = cells.cast(pa.string()).to_pylist()
    return text


def _strings(cells: Any) -> list[str]:
    return [cell or "" for cell in _cells(cells)]


def _naming(texts: Sequence[Sequence[str]], known: Sequence[int]) -> list[int]:
    """Return which columns of text name a series: one that tells all combinations apart, else all that vary.

    Where a column of another name (a device) tells them apart, the first that names series (a sensor) is added.
    """
    combinations = len(set(zip(*texts, strict=True)))
    for at in (*known, *range(len(texts))):
        if len(set(texts[at])) == combinations:
            return [at] if at in known or not known else sorted((known[0], at))
    return [at for at in range(len(texts)) if len(set(texts[at])) > 1]


def _with_units(
    raw: RawRecord, column: str, series: list[str], symbols: list[str], cells: list[str | None]
) -> tuple[list[str], dict[str, tuple[Array, Array]], list[str]]:
    """Return the names of the series with their units, factor and offset of each reading by series, and messages.

    Raises
    ------
    RecordError
        The unit of a series contradicts its name, or changes to another quantity.
    """
    rows_of: dict[str, list[int]] = {}
    for row, name in enumerate(series):
        rows_of.setdefault(name, []).append(row)
    named = list(series)
    conversions: dict[str, tuple[Array, Array]] = {}
    said: list[str] = []
    for name, rows in rows_of.items():
        own = split_column(name)
        held = [cells[row] is not None for row in rows]
        head = f"{raw.path}: column '{column}' of the units of '{name}'"
        found = row_units(head, [symbols[row] for row in rows], held, _place_among(raw, rows), own and own[1])
        if found.unit is None:
            unknown = f" [{found.unknown}]" if found.unknown and own is None else ""
            new = f"{name}{unknown}"
            said += [f"column '{column}' gives '{found.unknown}' for '{name}', no known unit"] if found.unknown else []
        else:
            new = name if own else suffixed(name, found.unit)
            said += [f"{new}: {found.said}"] if found.said else []
            said += filter(None, [fahrenheit_hint(new)] if found.unit == "degF" else [])
        for row in rows:
            named[row] = new
        if found.is_converted:
            factor, offset = np.ones(len(series)), np.zeros(len(series))
            factor[rows], offset[rows] = found.factor, found.offset
            conversions[new] = (factor, offset)
    return named, conversions, said


def _place_among(raw: RawRecord, rows: Sequence[int]) -> Callable[[int], str]:
    return lambda k: raw.place(rows[k])


def _spread(
    raw: RawRecord,
    time: int,
    moments: list[str],
    series: list[str],
    values: list[str | None],
    bad: NDArray[np.bool_],
    conversions: dict[str, tuple[Array, Array]],
) -> RawRecord:
    import pyarrow as pa

    timed = [name if moment else "" for name, moment in zip(series, moments, strict=True)]  # A trailer has no time.
    names = list(dict.fromkeys(name for name in timed if name))
    if len(names) > MOST_SERIES:
        raise RecordError(
            f"{raw.path} has {len(names)} series, more than a rig has signals; give a record with a column for each"
        )
    row_of = {moment: row for row, moment in enumerate(dict.fromkeys(moments))}
    require_cells(raw.path, len(row_of), len(names), RecordError)
    columns: dict[str, list[str | None]] = {name: [None] * len(row_of) for name in names}
    first: dict[str, int] = {}
    spread = {name: (np.ones(len(row_of)), np.zeros(len(row_of))) for name in conversions}
    lost = 0
    doubtful: list[int] = []
    for i, (moment, name, value) in enumerate(zip(moments, timed, values, strict=True)):
        first.setdefault(moment, i)
        if not name or value is None:
            continue
        if bad[i]:
            doubtful.append(i)
            continue
        cell = columns[name][row_of[moment]]
        lost += cell is not None and cell != value
        columns[name][row_of[moment]] = value
        if name in spread:
            for kept, by_reading in zip(spread[name], conversions[name], strict=True):
                kept[row_of[moment]] = by_reading[i]
    if lost > may_be_lost(len(values)):
        raise RecordError(
            f"{raw.path} has {lost} readings of a series at a time that it has already; write times with fractions of "
            "a second, or a column for each series"
        )
    said = [f"one reading a row: {len(values)} readings of {len(names)} series, a column for each"]
    if doubtful:
        count = "1 reading is" if len(doubtful) == 1 else f"{len(doubtful)} readings are"
        said.append(f"{count} not of good quality (the first is {raw.place(doubtful[0])}): missing")
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
        conversions=dict(spread),
    )
