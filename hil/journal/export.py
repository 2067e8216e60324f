"""Export of a run's record from its journal."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.files import look_for_pandas, read_json, read_parquet, replacing
from hil.journal.profile_clock import profile_times
from hil.journal.rows import JournalError
from hil.journal.writer import JournalReader

PAGE = 16_384
"""Ticks read from the journal at a time: the rows of SQLite are Python objects, many times the size of the arrays."""

_KIND_ORDER = {"measured": 0, "setpoint": 1, "status": 2}


@dataclass(frozen=True, slots=True)
class ExportedRecord:
    """Result of an export: rows, columns besides `time_s`, size in bytes, and the signals that were not always good."""

    path: Path
    rows: int
    columns: int
    size: int
    not_always_good: tuple[str, ...]


def export_record(journal: Path, parquet: Path, metadata: Mapping[str, Any] | None = None) -> ExportedRecord:
    """Write the record `parquet` from the run's `journal`, atomically.

    Columns: `time_s`, then measured signals, set-points and status signals in the rig's order, float64. A value whose
    quality is not GOOD becomes missing (the journal keeps the received value), and the signal gets a column
    `<column>_quality`, uint8, at the end. A run that waited or was resumed gets two further columns. `profile_s` is the
    profile's clock, s, and `segment`, from 1, the number of the segment.

    The unit, kind, role and bus of each column go into its field's metadata. `metadata` (run uid, hashes, ...) goes as
    JSON into the schema's metadata under `hil`, with the journal's own header and the wall time at which rig time began
    (`start_wall_s`, s since 1970). Without `metadata` the `run.json` beside
    the journal is taken, where there is one.

    Raises
    ------
    JournalError
        The journal cannot be read. OSError: the target cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    look_for_pandas()
    reader = JournalReader(journal)
    try:
        header = reader.header
        tick, time_s, values, quality = all_samples(reader)
        states = reader.states()
        profile_s = profile_times(states, tick, header.period_s) if states else time_s
        begins = [row.tick for row in reader.segments()]
        start_s = reader.start_wall_s()
    finally:
        reader.close()
    if metadata is None:
        manifest = journal.with_name("run.json")
        metadata = read_json(manifest, JournalError) if manifest.is_file() else {}
    about = {
        "profile": header.profile,
        "period_s": header.period_s,
        "noise_K": header.noise_K,
        "start_wall_s": start_s if math.isfinite(start_s) else None,
        "run": dict(metadata),
    }
    order = sorted(range(len(header.signals)), key=lambda index: _KIND_ORDER[header.signals[index].kind])
    fields = [pa.field("time_s", pa.float64(), nullable=False, metadata={"unit": "s"})]
    arrays = [pa.array(time_s)]
    not_always_good = []
    for index in order:
        signal = header.signals[index]
        field_metadata = {"unit": signal.unit, "kind": signal.kind, "role": signal.role or "", "bus": signal.bus}
        fields.append(pa.field(signal.column, pa.float64(), metadata=field_metadata))
        bad = quality[:, index] != Quality.GOOD
        arrays.append(pa.array(values[:, index], mask=bad | np.isnan(values[:, index])))
        if bad.any():
            not_always_good.append(index)
    for index in not_always_good:
        codes = ", ".join(f"{member.value} {member.name}" for member in Quality)
        fields.append(pa.field(header.signals[index].column + "_quality", pa.uint8(), metadata={"codes": codes}))
        arrays.append(pa.array(quality[:, index]))
    if not np.allclose(profile_s, time_s):
        fields.append(pa.field("profile_s", pa.float64(), metadata={"unit": "s"}))
        arrays.append(pa.array(profile_s))
        fields.append(pa.field("segment", pa.float64(), metadata={"unit": "1"}))
        arrays.append(pa.array(1.0 + np.searchsorted(begins, tick, side="right")))
    schema = pa.schema(fields, metadata={"hil": json.dumps(about, default=str)})
    # Arrow takes paths in UTF-8 alone, an open file takes any.
    with replacing(parquet) as unfinished, unfinished.open("wb") as file:
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), file, compression="zstd")
    return ExportedRecord(
        parquet,
        len(time_s),
        len(arrays) - 1,
        parquet.stat().st_size,
        tuple(header.signals[index].column for index in not_always_good),
    )


def recorded_rows(record: Path) -> int | None:
    """Return the number of rows of a record that `export_record` wrote; None for a file of another origin."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with record.open("rb") as file:
            about = pq.ParquetFile(file)
            return int(about.metadata.num_rows) if b"hil" in (about.schema_arrow.metadata or {}) else None
    except (OSError, pa.ArrowException):
        return None


def all_samples(
    reader: JournalReader,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Return `tick (n,)`, `time_s (n,)` in s, `values (n, k)` and `quality (n, k)` of the whole journal."""
    pages = []
    after = -1
    while True:
        page = reader.samples(after_tick=after, limit=PAGE)
        pages.append((page.tick, page.time_s, page.values, page.quality))
        if len(page.tick) < PAGE:
            break
        after = int(page.tick[-1])
    tick, time_s, values, quality = (np.concatenate(parts) for parts in zip(*pages, strict=True))
    return tick, time_s, values, quality


def samples_sha256(time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]) -> str:
    """Return the SHA-256 of the samples of a run, in hexadecimal.

    Journal and record of a run have the same: it shows of which samples a result was made.

    Parameters
    ----------
    time_s
        Times of the rows (n,), s of rig time.
    columns
        Values (n,) by the columns of all signals, NaN where none is good.
    """
    digest = hashlib.sha256(np.ascontiguousarray(time_s, dtype="<f8").tobytes())
    for name in sorted(columns):
        values = np.asarray(columns[name], dtype="<f8")
        digest.update(name.encode("utf-8", "backslashreplace") + b"\n")
        digest.update(np.where(np.isnan(values), np.nan, values).tobytes())  # one NaN of the many
    return digest.hexdigest()


def record_sha256(record: Path) -> str | None:
    """Return `samples_sha256` of a record that `export_record` wrote; None for a file of another origin."""
    import pyarrow as pa

    try:
        table = read_parquet(record, pa.BufferReader(record.read_bytes()), JournalError)
    except (OSError, pa.ArrowException, JournalError):
        return None
    if b"hil" not in (table.schema.metadata or {}) or "time_s" not in table.column_names:
        return None
    signals = [field.name for field in table.schema if b"kind" in (field.metadata or {})]
    columns = {name: table.column(name).to_numpy(zero_copy_only=False) for name in signals}
    return samples_sha256(table.column("time_s").to_numpy(zero_copy_only=False), columns)
