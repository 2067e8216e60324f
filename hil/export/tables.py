"""Exports as tables: CSV with a line of units, and Parquet with units in the metadata of its fields."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from hil.export.content import QUALITY_CODES, Channel, RunContent

QUALITY_SUFFIX = "_quality"
EVENT_COLUMNS = ("time_s", "level", "text")
EVENT_UNITS = ("s", "", "")


def csv_files(content: RunContent, path: Path) -> dict[Path, Callable[[BinaryIO], None]]:
    """Return path -> writer of the CSV at `path`, and of `<stem>.events.csv` beside it where the run has events.

    The first line names the columns, the second has their units. A value that is missing or not GOOD is an empty cell;
    `<column>_quality` has the code of every row for signals that were not always GOOD. Numbers read back exactly.
    """
    files: dict[Path, Callable[[BinaryIO], None]] = {path: lambda file: _write_csv(content, file)}
    if content.events:
        files[path.with_name(f"{path.stem}.events.csv")] = lambda file: _write_events(content, file)
    return files


def write_parquet(content: RunContent, file: BinaryIO) -> None:
    """Write a Parquet file: unit, kind, role, bus and range of each column in its field's metadata.

    The schema's metadata has the run's identity and its events as JSON, under `hil`. Qualities stand in columns
    `<column>_quality`, as in the record of a run.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field("time_s", pa.float64(), nullable=False, metadata={"unit": "s"})]
    arrays = [pa.array(content.time_s)]
    for channel in content.channels:
        fields.append(pa.field(channel.column, pa.float64(), metadata=_field_metadata(channel)))
        arrays.append(_cells(channel))
    codes = json.dumps(QUALITY_CODES)
    for channel in _rated(content):
        fields.append(pa.field(channel.column + QUALITY_SUFFIX, pa.uint8(), metadata={"codes": codes}))
        arrays.append(pa.array(channel.quality))
    events = [dict(zip(EVENT_COLUMNS, (e.time_s, e.level, e.text), strict=True)) for e in content.events]
    about = json.dumps({**content.about, "events": events})
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={"hil": about}))
    pq.write_table(table, file, compression="zstd")


def _write_csv(content: RunContent, file: BinaryIO) -> None:
    import pyarrow as pa
    import pyarrow.csv as pacsv

    rated = _rated(content)
    names = ["time_s", *(c.column for c in content.channels), *(c.column + QUALITY_SUFFIX for c in rated)]
    units = ["s", *(c.unit for c in content.channels), *("" for _ in rated)]
    file.write(_lines([names, units]))
    arrays = [pa.array(content.time_s), *(_cells(c) for c in content.channels), *(pa.array(c.quality) for c in rated)]
    options = pacsv.WriteOptions(include_header=False, quoting_style="none")
    pacsv.write_csv(pa.Table.from_arrays(arrays, names=names), file, options)


def _write_events(content: RunContent, file: BinaryIO) -> None:
    rows = [[repr(e.time_s), e.level, e.text] for e in content.events]
    file.write(_lines([list(EVENT_COLUMNS), list(EVENT_UNITS), *rows]))


def _lines(rows: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "replace")


def _cells(channel: Channel) -> Any:
    import pyarrow as pa

    return pa.array(channel.values, mask=np.isnan(channel.values))


def _rated(content: RunContent) -> list[Channel]:
    return [channel for channel in content.channels if channel.bad.any()]


def _field_metadata(channel: Channel) -> dict[str, str]:
    found = {"unit": channel.unit, "kind": channel.kind, "role": channel.role, "bus": channel.bus}
    if channel.doc:
        found["doc"] = channel.doc
    if channel.plausible is not None:
        found["plausible"] = json.dumps(list(channel.plausible))
    return found
