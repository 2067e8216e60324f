"""Records as the columns that a twin names, with the time of day as one of them."""

from __future__ import annotations

import dataclasses
import datetime
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hil.record.reader import Reading, Record, read_record
from hil.record.segments import Parts
from hil.record.times.time_axis import span
from hil.record.values.units import beyond_declared
from twin.discovery.healthy.basis import Columns, Commissioned
from twin.discovery.records.grid import require_enough
from twin.network import InputSpec, Network, TwinFileError
from twin.revisions import chain

CLOCK = "time_of_day_h"


class DiagnosingError(ValueError):
    """What is to be diagnosed is not there; the message is one plain sentence."""


def clock_of(text: str) -> float:
    """Hours since midnight of a time like 08:00."""
    try:
        moment = datetime.time.fromisoformat(text)
    except ValueError:
        raise DiagnosingError(f"--clock {text!r} is not a time of day; write it like 08:00") from None
    return moment.hour + moment.minute / 60.0 + moment.second / 3600.0


def clock_beside(record: Path) -> float | None:
    """Hours since midnight at 0 s as a `datasheet.json` beside the record tells (`clock_at_time_0`), or None."""
    try:
        sheet = json.loads((record.parent / "datasheet.json").read_text(encoding="utf-8"))
        return clock_of(str(sheet["clock_at_time_0"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def start_hour(record: Record) -> float | None:
    """Hours since midnight at 0 s, where the record tells it."""
    if record.start is None:
        return None
    s = record.start
    return s.hour + s.minute / 60.0 + s.second / 3600.0


def with_clock(network: Network) -> Network:
    """The network with the time of day as an input, so that effects may follow it."""
    if CLOCK in network.inputs:
        return network
    spec = InputSpec(CLOCK, 12.0, 0.0, 24.0, "h", "time of day of the record")
    return dataclasses.replace(network, inputs=MappingProxyType({**network.inputs, CLOCK: spec}))


def columns_of(network: Network, record: Record, hour_at_0: float | None) -> Columns:
    """What the network needs of a record.

    Raises:
        RecordError: an input column is missing. TwinFileError: a sensor is.
    """
    columns: dict[str, NDArray[np.float64]] = dict(record.columns)
    if CLOCK in network.inputs and CLOCK not in columns:
        columns[CLOCK] = (((hour_at_0 or 0.0) + record.time_s / 3600.0) % 24.0).astype(np.float64)
    Record(record.time_s, columns, path=record.path).require(*network.input_columns)
    return Columns.of(network, record.time_s, columns)


def in_parts(record: Record) -> Record:
    """A run that was cut and resumed, so that a twin begins anew after each gap; any other record as it is."""
    segment = record.columns.get("segment")
    if segment is None or "profile_s" not in record.columns:  # another logger's column may be called so too
        return record
    parts = Parts.of(record.time_s, segment)
    rows = parts.rows
    said: tuple[str, ...] = ()
    if rows != slice(0, len(segment)):
        low, high = record.time_s[rows][[0, -1]]
        said = (
            f"the run was cut and resumed, and the gaps are longer than it: diagnosed is its longest part, "
            f"{span(float(low))} to {span(float(high))} of the record",
        )
    return dataclasses.replace(
        record,
        time_s=record.time_s[rows],
        columns={name: np.where(parts.aside, np.nan, values[rows]) for name, values in record.columns.items()},
        quality={name: values[rows] for name, values in record.quality.items()},
        messages=(*record.messages, *said),
    )


def read_columns(
    network: Network, path: Path, hour_at_0: float | None, *, at_rest: bool = False, choice: Reading | None = None
) -> tuple[Columns, tuple[str, ...]]:
    """Columns of a record file, or of steady states, and what reading it met.

    Raises:
        RecordError, TwinFileError: it cannot be read, lacks a column or is too short; the message names the file.
    """
    record = read_record(path, at_rest=at_rest, choice=choice)
    if not at_rest:
        record = in_parts(record)
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
    network: Network, twin: Path, path: Path, hour_at_0: float | None, choice: Reading | None = None
) -> Commissioned:
    """The healthy record of a twin, which may have taken up effects since it was made; see `read_columns`."""
    columns, _ = read_columns(network, path, hour_at_0, choice=choice)
    told = [with_clock(entry.network) if CLOCK in network.inputs else entry.network for entry in chain(twin)[1:]]
    alike = tuple(
        n for n in told if n.input_columns == network.input_columns and n.sensor_names == network.sensor_names
    )
    return Commissioned(columns.time_s, columns.inputs, columns.measured, columns.members, alike)


def further_columns(
    network: Network, paths: Sequence[Path], hour_at_0: float | None, choice: Reading | None = None
) -> dict[str, Columns]:
    """Further records by what tells them apart: name of the file, or as much of its path as it takes."""
    alike = Counter(path.name for path in paths)
    return {
        path.name if alike[path.name] == 1 and path.name != "record.parquet" else str(path): read_columns(
            network, path, hour_at_0, choice=choice
        )[0]
        for path in paths
    }
