"""Records as the columns that a twin names, with the time of day as one of them."""

from __future__ import annotations

import dataclasses
import datetime
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hil.files import parse_json
from hil.record import Parts, ReadingOptions, Record, read_record
from hil.record.times import span
from hil.record.values import beyond_declared
from twin import STAMP, InputSpec, Network, TwinFileError, chain
from twin.discovery import Columns, CommissionedRecord, require_enough

CLOCK = "time_of_day_h"


class DiagnosingError(ValueError):
    """Error of missing input of a diagnosis; the message is one plain sentence."""


def clock_of(text: str) -> float:
    """Return the hours since midnight of a time like 08:00; raise DiagnosingError if it is none."""
    try:
        moment = datetime.time.fromisoformat(text)
    except ValueError:
        raise DiagnosingError(f"--clock {text!r} is not a time of day; write it like 08:00") from None
    return moment.hour + moment.minute / 60.0 + moment.second / 3600.0


def datasheet_clock(record: Path) -> float | None:
    """Return the hour of day at 0 s from `clock_at_time_0` of a `datasheet.json` in the record's folder, or None."""
    try:
        sheet = parse_json((record.parent / "datasheet.json").read_text(encoding="utf-8"))
        return clock_of(str(sheet["clock_at_time_0"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def start_hour(record: Record) -> float | None:
    """Return the hours since midnight at 0 s, or None if the record does not state them."""
    if record.start is None:
        return None
    s = record.start
    return s.hour + s.minute / 60.0 + s.second / 3600.0


def with_clock(network: Network) -> Network:
    """Return the network with the time of day as an input, so that effects may follow it."""
    if CLOCK in network.inputs:
        return network
    spec = InputSpec(CLOCK, 12.0, 0.0, 24.0, "h", "time of day of the record")
    return dataclasses.replace(network, inputs=MappingProxyType({**network.inputs, CLOCK: spec}))


def columns_of(network: Network, record: Record, hour_at_0: float | None) -> Columns:
    """Return the columns of a record that the network needs.

    Raises
    ------
    RecordError
        An input column is missing. TwinFileError: a sensor is.
    """
    columns: dict[str, NDArray[np.float64]] = dict(record.columns)
    if CLOCK in network.inputs and CLOCK not in columns:
        columns[CLOCK] = (((hour_at_0 or 0.0) + record.time_s / 3600.0) % 24.0).astype(np.float64)
    if STAMP in network.inputs:
        columns[STAMP] = record.time_s.astype(np.float64)
    Record(record.time_s, columns, path=record.path).require(*network.input_columns)
    return Columns.of(network, record.time_s, columns)


def in_segments(record: Record) -> Record:
    """Split an interrupted run into segments, so that a twin restarts after each gap; return any other record
    unchanged.
    """
    segment = record.columns.get("segment")
    if segment is None or "profile_s" not in record.columns:  # Another logger's column may have this name, too.
        return record
    parts = Parts.of(record.time_s, segment)
    rows = parts.rows
    notes: tuple[str, ...] = ()
    if rows != slice(0, len(segment)):
        low, high = record.time_s[rows][[0, -1]]
        notes = (
            f"the run was interrupted and resumed, with gaps longer than the run: diagnosed is its longest segment, "
            f"{span(float(low))} to {span(float(high))} of the record",
        )
    return dataclasses.replace(
        record,
        time_s=record.time_s[rows],
        columns={name: np.where(parts.aside, np.nan, values[rows]) for name, values in record.columns.items()},
        quality={name: values[rows] for name, values in record.quality.items()},
        messages=(*record.messages, *notes),
    )


def read_columns(
    network: Network,
    path: Path,
    hour_at_0: float | None,
    *,
    at_rest: bool = False,
    choice: ReadingOptions | None = None,
) -> tuple[Columns, tuple[str, ...]]:
    """Return the columns of a record file, or of steady states, and the notes of its reader.

    Parameters
    ----------
    network
        Twin that names the columns.
    path
        Record file.
    hour_at_0
        Hour of the day at 0 s, or None if the record states it.
    at_rest
        True if each row is a steady state of its own.
    choice
        Options that a record needs where it does not show its form.

    Raises
    ------
    RecordError, TwinFileError
        It cannot be read, lacks a column or is too short; the message names the file.
    """
    record = read_record(path, at_rest=at_rest, choice=choice)
    if not at_rest:
        record = in_segments(record)
    hour = hour_at_0 if hour_at_0 is not None else start_hour(record)
    try:
        columns = columns_of(network, record, hour)
        if not at_rest:
            require_enough(network, columns.time_s, columns.measured)
    except TwinFileError as error:
        text = [message for message in record.messages if message.endswith("holds text: dropped")]
        raise type(error)("; ".join([f"{path}: {error}", *text])) from None
    return columns, (*record.messages, *beyond_declared(network, record.columns))


def read_healthy(
    network: Network, twin: Path, path: Path, hour_at_0: float | None, choice: ReadingOptions | None = None
) -> CommissionedRecord:
    """Return the healthy record of a twin, which may have gained effects since then.

    Parameters
    ----------
    network, twin
        The twin, and its file.
    path
        Healthy record.
    hour_at_0, choice
        As of `read_columns`.

    Raises
    ------
    RecordError, TwinFileError
        As of `read_columns`.
    """
    columns, _ = read_columns(network, path, hour_at_0, choice=choice)
    ancestors = [with_clock(entry.network) if CLOCK in network.inputs else entry.network for entry in chain(twin)[1:]]
    compatible = tuple(
        n for n in ancestors if n.input_columns == network.input_columns and n.sensor_names == network.sensor_names
    )
    return CommissionedRecord(columns.time_s, columns.inputs, columns.measured, columns.members, compatible)


def choice_for(path: Path, choice: ReadingOptions | None) -> ReadingOptions | None:
    """Return how a later record is read: as the first one, but a run's own record states its time and signs itself."""
    return None if (path.parent / "run.json").is_file() else choice


def further_columns(
    network: Network, paths: Sequence[Path], hour_at_0: float | None, choice: ReadingOptions | None = None
) -> dict[str, Columns]:
    """Return further records by a distinct name: that of the file, or its path if several files share it.

    `choice` is that of the first record; the record of a run needs none.
    """
    count = Counter(path.name for path in paths)
    return {
        path.name if count[path.name] == 1 and path.name != "record.parquet" else str(path): read_columns(
            network, path, hour_at_0, choice=choice_for(path, choice)
        )[0]
        for path in paths
    }
