"""Aligned record of a station, read for calibration: minutes of a cell, events and labels."""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hil.record import RecordError
from hil.tower.station.alignment import event_entry
from hil.tower.station.description import read_events
from hil.tower.station.input_files import read_rows
from hil.tower.station.plausibility import refuse_implausible
from twin.historian import Event
from twin.tower import BOUNDS, Array
from twin.tower.cell_observations import Label

NEEDED = ("t_in_C", "t_out_C", "m_w_kg_s", "dry_C")
"""Columns without which no outlet can be predicted; the fan's speed or its command, and a wet bulb, are needed as
well."""
EMPTY = 0.005
"""Share of minutes below which a column counts as missing throughout."""


@dataclass(frozen=True)
class CellRecord:
    """Minutes of one cell: seconds since 1970 (n,), columns and the origin of their values, and the file's SHA-256."""

    cell: int
    time_s: Array
    columns: dict[str, Array]
    origin: dict[str, NDArray[np.uint8]]
    digest: str
    path: Path


@dataclass(frozen=True)
class StationNotes:
    """Datasheet and events of a station as the alignment wrote them."""

    datasheet: dict[str, Any] = field(default_factory=dict)
    events: tuple[dict[str, Any], ...] = ()


def cells_of(record: Path) -> tuple[int, ...]:
    """Return the numbers of the cells that a record holds."""
    found = (re.fullmatch(r"cell(\d+)\.parquet", path.name) for path in record.glob("cell*.parquet"))
    return tuple(sorted(int(match[1]) for match in found if match))


def station_of(record: Path, cell: int) -> str:
    """Return the station that a cell's file names; "" where it names none or is damaged."""
    try:
        about = json.loads((pq.read_schema(record / f"cell{cell}.parquet").metadata or {}).get(b"hil.tower", b"{}"))
    except (OSError, ValueError, pa.ArrowInvalid):
        return ""
    return str(about.get("station", ""))


def read_cell(record: Path, cell: int) -> CellRecord:
    """Return the minutes of a cell.

    Raises
    ------
    RecordError
        The record has no such cell, its file is damaged, a needed column is missing throughout, or it is no record of
        a plant.
    """
    path = record / f"cell{cell}.parquet"
    if not path.is_file():
        there = ", ".join(f"cell {n}" for n in cells_of(record)) or "no cell"
        raise RecordError(f"{record}: has no cell {cell}; it has {there}: align the store again or name another twin")
    try:
        table = pq.read_table(path)
        about = json.loads((table.schema.metadata or {}).get(b"hil.tower", b"{}"))
    except (OSError, ValueError, pa.ArrowInvalid) as error:
        raise RecordError(f"{path}: cannot be read as an aligned record ({error}); align the store again") from error
    if about.get("cell") != cell:
        raise RecordError(f"{path}: says that it is of cell {about.get('cell')}, not {cell}; align the store again")
    if table.num_rows == 0:
        raise RecordError(f"{path}: has no minute; align the store again")
    columns = {n: np.asarray(table[n].to_numpy(), dtype=np.float64) for n in table.schema.names if _is_number(table, n)}
    origin = {n: table[f"{n}_how"].to_numpy().astype(np.uint8) for n in columns if f"{n}_how" in table.schema.names}
    columns = {n: v for n, v in columns.items() if not n.endswith(("_how", "_age_min"))}
    time_s = table["time"].cast(pa.int64()).to_numpy().astype(np.float64) / 1e3
    _refuse_empty(path, columns)
    refuse_implausible(path, time_s, columns, origin)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return CellRecord(cell, time_s, columns, origin, digest, path)


def read_channels(path: Path) -> dict[str, NDArray[Any]]:
    """Return all numeric columns of a cell's file, origins and ages of the values too.

    Raises
    ------
    RecordError
        The file cannot be read.
    """
    try:
        table = pq.read_table(path)
    except (OSError, ValueError, pa.ArrowInvalid) as error:
        raise RecordError(f"{path}: cannot be read as an aligned record ({error}); align the store again") from error
    return {name: table[name].to_numpy() for name in table.schema.names if _is_number(table, name)}


def _is_number(table: pa.Table, name: str) -> bool:
    kind = table.schema.field(name).type
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))


def _refuse_empty(path: Path, columns: dict[str, Array]) -> None:
    """Raise RecordError where a quantity that the prediction needs is missing throughout."""

    def there(name: str) -> bool:
        return name in columns and float(np.isfinite(columns[name]).mean()) > EMPTY

    for name in NEEDED:
        if not there(name):
            raise RecordError(
                f"{path}: {name} is missing throughout; map its tag in the tag dictionary and align again"
            )
    for either in (("fan_speed_pct", "fan_command_pct"), ("wet_C", "wet_rh_C")):
        if not any(there(name) for name in either):
            raise RecordError(f"{path}: {' and '.join(either)} are missing throughout; map one's tag and align again")


def read_notes(record: Path) -> StationNotes:
    """Return datasheet and events of a record; nothing where it has none.

    Raises
    ------
    RecordError
        The file is damaged.
    """
    path = record / "station.json"
    if not path.is_file():
        return StationNotes()
    try:
        found = json.loads(path.read_text())
        return StationNotes(dict(found.get("datasheet", {})), tuple(found.get("events", ())))
    except (OSError, ValueError, AttributeError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); align the store again") from error


def events_of(notes: StationNotes) -> tuple[Event, ...]:
    """Return the events of a record.

    Raises
    ------
    RecordError
        An event lacks a key or has no time that can be read.
    """
    try:
        return tuple(
            Event(
                seconds(row["time"]),
                bool(row["by_day"]),
                int(row["cell"]),
                row["kind"],
                row["source"],
                row.get("text", ""),
            )
            for row in notes.events
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordError(
            f"station.json: holds no events that can be read ({error}); align the record again"
        ) from error


def seconds(text: str) -> float:
    """Return a time in ISO 8601 as seconds since 1970; without an offset it is UTC.

    Raises
    ------
    ValueError
        It is no time.
    """
    found = datetime.datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    return (found if found.tzinfo else found.replace(tzinfo=datetime.UTC)).timestamp()


def event_entries(path: Path) -> tuple[dict[str, Any], ...]:
    """Return the events of a file as the record's `station.json` holds them; raises what `read_events` raises."""
    return tuple(event_entry(event) for event in read_events(path))


def read_labels(path: Path, cells: tuple[int, ...]) -> tuple[Label, ...]:
    """Return the labels of these cells: inspections as intervals, traverses and certificates as points.

    Raises
    ------
    RecordError
        A column is missing, or a line has no time, an unknown parameter or kind, or bounds the wrong way round.
    """
    found = [_label(path, line, row) for line, row in read_rows(path, ("time", "cell", "parameter", "kind"))]
    return tuple(label for label in found if label.cell in cells)


def _label(path: Path, line: int, row: dict[str, str]) -> Label:
    where = f"{path}:{line}"
    try:
        time_s, cell = seconds(row["time"] or ""), int(row["cell"])
    except ValueError as error:
        raise RecordError(
            f"{where}: time or cell cannot be read ({error}); write a time as 2022-10-06T15:00:00Z"
        ) from error
    parameter, kind = row["parameter"], row["kind"]
    if parameter not in BOUNDS:
        raise RecordError(f"{where}: parameter {parameter!r} is unknown; it is one of {', '.join(BOUNDS)}")
    if kind not in ("interval", "point"):
        raise RecordError(f"{where}: kind {kind!r} is unknown; it is interval (lo, hi) or point (value, sd)")
    clean = 0.0 if parameter == "bias" else 1.0
    a, b = (_cell_number(where, row, n) for n in (("lo", "hi") if kind == "interval" else ("value", "sd")))
    if kind == "interval":
        if not a < b:
            raise RecordError(f"{where}: lo {a:g} is not below hi {b:g}; correct them")
        return Label(time_s, cell, parameter, a - clean, b - clean, None, row.get("source", "") or "")
    if b <= 0.0:
        raise RecordError(f"{where}: sd {b:g} is not above 0; give the standard uncertainty of the measurement")
    return Label(time_s, cell, parameter, a - clean, a - clean, b, row.get("source", "") or "")


def _cell_number(where: str, row: dict[str, str], name: str) -> float:
    try:
        value = float(row.get(name) or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordError(f"{where}: {name} is {row.get(name) or 'empty'!r}, which is no number; correct it")
    return value
