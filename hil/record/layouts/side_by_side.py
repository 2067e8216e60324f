"""Tables that stand side by side in one file, each with a column of times of its own: `Time,A,Time,B`."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from hil.files import require_cells
from hil.record.raw import RawRecord, RecordError, repeat_message
from hil.record.times import is_time_name

_REPEATED = re.compile(r"(.+)_(\d+)")


def one_below_the_other(raw: RawRecord) -> RawRecord:
    """Return `raw` with tables of different times below each other; the columns of the others are empty there.

    A repeated column of times that holds the same times is left out.

    Raises
    ------
    RecordError
        It is not clear to which times a column belongs.
    """
    import pyarrow as pa

    copies: dict[str, list[int]] = {}
    for place, name in enumerate(raw.names):
        found = _REPEATED.fullmatch(name)
        base = found[1] if found and repeat_message(found[1], name) in raw.messages else name
        if is_time_name(base):
            copies.setdefault(base, []).append(place)
    copies = {base: places for base, places in copies.items() if len(places) > 1}
    if not copies:
        return raw
    renamed = {repeat_message(base, raw.names[place]) for base, places in copies.items() for place in places[1:]}
    raw = dataclasses.replace(raw, messages=tuple(said for said in raw.messages if said not in renamed))
    raw = dataclasses.replace(raw, cells=tuple(_decoded(cells) for cells in raw.cells))
    if all(raw.cells[place].equals(raw.cells[places[0]]) for places in copies.values() for place in places):
        return _without(raw, [place for places in copies.values() for place in places[1:]])
    counts = {len(places) for places in copies.values()}
    first = min(copies, key=lambda base: copies[base][0])
    starts = copies[first]
    ends = [*starts[1:], len(raw.names)]
    times = {place for places in copies.values() for place in places}
    mixed = any(raw.cells[place].type != raw.cells[places[0]].type for places in copies.values() for place in places)
    if mixed or len(counts) > 1 or any(set(range(a, b)) <= times for a, b in zip(starts, ends, strict=True)):
        raise RecordError(
            f"{raw.path}: the times '{first}' stand {len(starts)} times with different cells, and it is not clear to "
            "which of them each column belongs; give a file for each"
        )
    rows = len(raw.cells[0])
    kept = [place for place in range(len(raw.names)) if place not in times or place in [p[0] for p in copies.values()]]
    require_cells(raw.path, rows * len(starts), len(kept), RecordError)
    columns: dict[int, list[pa.ChunkedArray]] = {place: [] for place in kept}
    lines: list[int] = []
    for number, (begin, end) in enumerate(zip(starts, ends, strict=True)):
        begin = 0 if number == 0 else begin
        own = {base: places[number] for base, places in copies.items()}
        held = raw.cells[own[first]].is_valid()
        for place in kept:
            base = next((base for base, places in copies.items() if places[0] == place), None)
            source = own[base] if base is not None else place
            cells = raw.cells[source].filter(held)
            if base is None and not begin <= place < end:
                cells = pa.chunked_array([pa.nulls(len(cells), raw.cells[place].type)])
            columns[place].append(cells)
        at = [row for row, is_held in enumerate(held.to_pylist()) if is_held]
        lines += [int(raw.place(row).split()[-1]) for row in at]
    joined = tuple(
        pa.chunked_array([chunk for piece in columns[place] for chunk in piece.chunks], raw.cells[place].type)
        for place in kept
    )
    said = f"{len(starts)} tables with times of their own stand side by side ('{first}'): each column has its own times"
    return dataclasses.replace(
        raw,
        names=tuple(raw.names[place] for place in kept),
        cells=joined,
        messages=(*raw.messages, said),
        lines=tuple(lines) if raw.header_line else (),
    )


def _decoded(cells: Any) -> Any:
    import pyarrow as pa

    return cells.cast(cells.type.value_type) if pa.types.is_dictionary(cells.type) else cells


def _without(raw: RawRecord, places: list[int]) -> RawRecord:
    kept = [place for place in range(len(raw.names)) if place not in places]
    said = f"column '{raw.names[places[0]]}' repeats the times: left out"
    return dataclasses.replace(
        raw,
        names=tuple(raw.names[place] for place in kept),
        cells=tuple(raw.cells[place] for place in kept),
        messages=(*raw.messages, said),
    )
