"""Aligned record of a station, read for calibration: minutes of a cell, events and labels."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hil.files import parse_json, require_complete
from hil.record import RecordError
from hil.tower.file_kinds import cells_of
from hil.tower.station.alignment import event_entry
from hil.tower.station.description import read_events
from hil.tower.station.errors import Mistakes
from hil.tower.station.input_files import DATASHEET, read_object, read_rows
from hil.tower.station.json_shape import Shape
from hil.tower.station.plausibility import refuse_implausible
from hil.tower.station.times import iso, seconds
from twin.historian import Event
from twin.tower import BOUNDS, Array
from twin.tower.cell_observations import Label

NEEDED = ("t_in_C", "t_out_C", "m_w_kg_s", "dry_C")
"""Columns without which no outlet can be predicted; the fan's speed or its command, and a wet bulb, are needed as
well."""
EMPTY = 0.005
"""Share of minutes below which a column counts as missing throughout."""

EVENT_SHAPE: Shape = {
    "time": str,
    "by_day": bool,
    "cell": int,
    "kind": str,
    "source": str,
    "text?": str,
    "from": str,
    "to": str,
    "parameters": [frozenset(BOUNDS)],
}
"""An event in `station.json`."""
LABEL_COLUMNS = ("time", "cell", "parameter", "kind")
_NOTES: Shape = {"datasheet": DATASHEET, "events": [EVENT_SHAPE]}
"""Content of `station.json`."""


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


def station_of(record: Path, cell: int) -> str:
    """Return the station that a cell's file names; "" where it names none or is damaged."""
    try:
        about = _about(pq.read_schema(record / f"cell{cell}.parquet"))
    except (OSError, ValueError, pa.ArrowException):
        return ""
    return str(about.get("station", ""))


def _about(schema: pa.Schema) -> dict[str, Any]:
    """Return what a cell's file says of itself; raises ValueError."""
    found = parse_json((schema.metadata or {}).get(b"hil.tower", b"{}"))
    if not isinstance(found, dict):
        raise ValueError("its metadata are no object")
    return found


def _read_table(path: Path, columns: list[str] | None = None) -> tuple[pa.Table, str]:
    """Return the table of a cell's file, with times in ms, and the file's SHA-256.

    Raises
    ------
    RecordError
        It cannot be read, or has no times.
    """
    try:
        content = path.read_bytes()
        schema = pq.read_schema(pa.BufferReader(content))
        _about(schema)
        if "time" not in schema.names or not pa.types.is_timestamp(schema.field("time").type):
            raise ValueError("it has no column of times")
        table = pq.read_table(pa.BufferReader(content), columns=columns)
        if table["time"].null_count:
            raise ValueError("it has minutes without a time")
        at = table.schema.get_field_index("time")
        table = table.set_column(at, "time", table["time"].cast(pa.timestamp("ms", tz="UTC"), safe=False))
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = (str(error).splitlines() or ["no reason is given"])[0]
        raise RecordError(f"{path}: cannot be read as an aligned record ({reason}); align the store again") from error
    if table.num_rows == 0:
        raise RecordError(f"{path}: has no minute; align the store again")
    return table, hashlib.sha256(content).hexdigest()


def read_cell(record: Path, cell: int) -> CellRecord:
    """Return the minutes of a cell.

    Raises
    ------
    RecordError
        The record has no such cell, its file is damaged, a needed column is missing throughout, or it is no record of
        a plant.
    """
    require_complete(record, RecordError)
    path = record / f"cell{cell}.parquet"
    if not path.is_file():
        there = ", ".join(f"cell {n}" for n in cells_of(record)) or "no cell"
        raise RecordError(f"{record}: has no cell {cell}; it has {there}: align the store again or name another twin")
    table, digest = _read_table(path)
    about = _about(table.schema)
    if about.get("cell") != cell:
        raise RecordError(f"{path}: says that it is of cell {about.get('cell')}, not {cell}; align the store again")
    columns = {n: np.asarray(table[n].to_numpy(), dtype=np.float64) for n in table.schema.names if _is_number(table, n)}
    origin = {n: table[f"{n}_how"].to_numpy().astype(np.uint8) for n in columns if f"{n}_how" in table.schema.names}
    columns = {n: v for n, v in columns.items() if not n.endswith(("_how", "_age_min"))}
    time_s = table["time"].cast(pa.int64()).to_numpy().astype(np.float64) / 1e3
    _refuse_empty(path, columns)
    refuse_implausible(path, time_s, columns, origin)
    return CellRecord(cell, time_s, columns, origin, digest, path)


def span_of(record: Path, cell: int) -> tuple[float, float, str]:
    """Return the first and last minute of a cell's file, s since 1970, and the file's SHA-256.

    Raises
    ------
    RecordError
        The file cannot be read.
    """
    require_complete(record, RecordError)
    table, digest = _read_table(record / f"cell{cell}.parquet", ["time"])
    ends = pc.min_max(table["time"].cast(pa.int64()))
    return ends["min"].as_py() / 1e3, ends["max"].as_py() / 1e3, digest


def read_channels(path: Path) -> dict[str, NDArray[Any]]:
    """Return all numeric columns of a cell's file, origins and ages of the values too.

    Raises
    ------
    RecordError
        The file cannot be read.
    """
    table, _ = _read_table(path)
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
    """Return datasheet and events of a record.

    Raises
    ------
    RecordError
        The file is missing or damaged, or of another shape than the alignment writes.
    """
    require_complete(record, RecordError)
    path = record / "station.json"
    remedy = "align the store again"
    if not path.exists():
        raise RecordError(f"{path}: is missing; {remedy}")
    found = read_object(path, _NOTES, remedy)
    return StationNotes(found["datasheet"], tuple(timed_events(path, found["events"], remedy)))


def timed_events(path: Path, events: Sequence[dict[str, Any]], remedy: str) -> Sequence[dict[str, Any]]:
    """Return the events of a JSON file, all of whose times can be read.

    Raises
    ------
    RecordError
        A time cannot be read.
    """
    for k, event in enumerate(events):
        for key in ("time", "from", "to"):
            try:
                seconds(event[key])
            except ValueError:
                raise RecordError(f"{path}: events[{k}].{key} is {event[key]!r}, which is no time; {remedy}") from None
    return events


def events_of(entries: Sequence[dict[str, Any]]) -> tuple[Event, ...]:
    """Return the events of entries in the form of `station.json`."""
    return tuple(
        Event(seconds(row["time"]), row["by_day"], row["cell"], row["kind"], row["source"], row.get("text") or "")
        for row in entries
    )


def event_entries(path: Path) -> tuple[dict[str, Any], ...]:
    """Return the events of a file as the record's `station.json` holds them; raises what `read_events` raises."""
    return tuple(event_entry(event) for event in read_events(path))


def read_labels(path: Path, cells: tuple[int, ...]) -> tuple[Label, ...]:
    """Return the labels of these cells: inspections as intervals, traverses and certificates as points.

    Raises
    ------
    RecordError
        A column is missing, or a line has no time, an unknown parameter or kind, bounds the wrong way round, or a
        value outside the bounds of the deviation.
    """
    found = []
    mistakes = Mistakes(path)
    for line, row in read_rows(path, LABEL_COLUMNS):
        with mistakes.noted():
            found.append(_label(path, line, row))
    mistakes.refuse()
    return tuple(label for label in found if label.cell in cells)


def unused_labels(path: Path, cells: tuple[int, ...], span_s: tuple[float, float]) -> list[str]:
    """Return a sentence for each label of a cell or a time that the record has not.

    Parameters
    ----------
    path
        File that `read_labels` reads.
    cells
        Cells of the record.
    span_s
        First and last minute of the record, s since 1970.
    """
    remarks = []
    for line, row in read_rows(path, LABEL_COLUMNS):
        label = _label(path, line, row)
        if label.cell not in cells:
            there = ", ".join(map(str, cells))
            remarks.append(f"{path}:{line}: cell {label.cell} is none of the record's ({there}); the label is not used")
        elif not span_s[0] <= label.time_s <= span_s[1] + 60.0:
            low, high = (_day(time_s) for time_s in span_s)
            remarks.append(
                f"{path}:{line}: {_day(label.time_s)} is outside the record ({low} to {high}); check the date"
            )
    return remarks


def _day(time_s: float) -> str:
    return iso(time_s)[:10]


def _label(path: Path, line: int, row: dict[str, str]) -> Label:
    where = f"{path}:{line}"
    mistakes = Mistakes(path)
    with mistakes.noted():
        try:
            time_s = seconds(row["time"])
        except ValueError:
            raise RecordError(f"{where}: {row['time']!r} is no time; write it as 2022-10-06T15:00:00Z") from None
    with mistakes.noted():
        try:
            cell = int(row["cell"])
        except ValueError:
            raise RecordError(f"{where}: cell is {row['cell']!r}; give a whole number") from None
    parameter, kind = row["parameter"], row["kind"]
    with mistakes.noted():
        if parameter not in BOUNDS:
            raise RecordError(f"{where}: parameter {parameter!r} is unknown; it is one of {', '.join(BOUNDS)}")
    with mistakes.noted():
        if kind not in ("interval", "point"):
            raise RecordError(f"{where}: kind {kind!r} is unknown; it is interval (lo, hi) or point (value, sd)")
    mistakes.refuse()
    clean = 0.0 if parameter == "bias" else 1.0
    a, b = (_cell_number(where, row, n) for n in (("lo", "hi") if kind == "interval" else ("value", "sd")))
    _refuse_far(where, parameter, clean, (a, b) if kind == "interval" else (a,))
    if kind == "interval":
        if not a < b:
            raise RecordError(f"{where}: lo {a:g} is not below hi {b:g}; correct them")
        return Label(time_s, cell, parameter, a - clean, b - clean, None, row.get("source", "") or "")
    if b <= 0.0:
        raise RecordError(f"{where}: sd {b:g} is not above 0; give the standard uncertainty of the measurement")
    if b > BOUNDS[parameter]:
        raise RecordError(
            f"{where}: sd {b:g} is above the bound of {parameter} itself, {BOUNDS[parameter]:g}; give the standard "
            f"uncertainty in the unit of value, not in %"
        )
    return Label(time_s, cell, parameter, a - clean, a - clean, b, row.get("source", "") or "")


def _refuse_far(where: str, parameter: str, clean: float, values: tuple[float, ...]) -> None:
    """Raise RecordError for a label that is wholly outside the bounds that a twin file gives the deviation."""
    bound = BOUNDS[parameter]
    low, high = clean - bound, clean + bound
    if max(values) >= low and min(values) <= high:
        return
    meaning = (
        "the reading less the true temperature, K"
        if parameter == "bias"
        else "a multiplier of the clean cell, about 1, not in % and not less one"
    )
    given = " to ".join(f"{value:g}" for value in values)
    raise RecordError(
        f"{where}: {parameter} is {given}, outside {low:g} to {high:g}; a label of {parameter} is {meaning}"
    )


def _cell_number(where: str, row: dict[str, str], name: str) -> float:
    try:
        value = float(row.get(name) or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordError(f"{where}: {name} is {row.get(name) or 'empty'!r}, which is no number; correct it")
    return value
