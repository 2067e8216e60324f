"""Bytes of a record, Parquet or CSV, to named columns of cells; `hil.record.reader` interprets the numbers."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

from hil.files import TEXT_COPIES, parse_json, read_parquet, require_size
from hil.record.csv_file import EncodingError, read_csv, utf8
from hil.record.layouts import one_below_the_other, one_column_a_series, one_column_a_source
from hil.record.raw import RawRecord, RecordError, unique
from hil.record.times import is_time_name
from hil.record.units import with_heading_units, with_unit_columns

_FOREIGN = (
    (b"SQLite format 3", "is a journal, not a record; `hil export` makes the record from it"),
    (b"PK\x03\x04", "is a zip file or a spreadsheet; unpack it or save the sheet as CSV"),
    (b"\x1f\x8b", "is gzip-compressed; unpack it first"),
    (b"\x89HDF", "is an HDF5 file; export it as Parquet or CSV"),
    (b"TDSm", "is a TDMS file; export it as Parquet or CSV"),
    (b"\xd0\xcf\x11\xe0", "is a spreadsheet of old Excel; save the sheet as CSV"),
    (b"MDF  ", "is an MDF file; export its channels as CSV or Parquet"),
    (b"MATLAB ", "is a MATLAB file; save its table as CSV (writetable)"),
    (b"\x93NUMPY", "is a NumPy file; save it as CSV with the names of its columns"),
    (b"\x80\x04", "is a Python pickle, which is not opened; save its table as CSV or Parquet"),
    (b"%PDF", "is a PDF; export its table as CSV"),
    (b"7z\xbc\xaf", "is a 7z archive; unpack it first"),
    (b"Rar!", "is a RAR archive; unpack it first"),
    (b"(\xb5/\xfd", "is compressed with zstd; unpack it first"),
    (b"BZh", "is compressed with bzip2; unpack it first"),
    (b"ARROW1", "is a Feather file; save it as Parquet or CSV"),
)
_SNIFFED = 1000
"""Bytes of a text that show its kind."""
_FRAMES = "is a log of CAN frames; decode it by its DBC, and save the signals as CSV with a column for each"
_FOREIGN_TEXT = (
    (re.compile(rb"\(\d+\.\d+\)\s+\w+\s+[0-9a-f]+#"), _FRAMES),
    (re.compile(rb"date .*\nbase (?:hex|dec)|;\$fileversion=|\*\*\*busmaster"), _FRAMES),
    (re.compile(rb"(?=[^\n]*\b(?:arbitration_)?id\b)(?=[^\n]*\b(?:len|dlc)\b)(?=[^\n]*\b(?:d1|data)\b)"), _FRAMES),
    (
        re.compile(rb"[\w.-]+(?:,[\w.-]+=[^,\s]+)* [\w.-]+=\S+ \d{10,19}\r?\n"),
        "is line protocol of InfluxDB; query the data as CSV",
    ),
    (re.compile(rb"<(!doctype|\?xml|html|head|body|table)\b"), "is HTML or XML; save its table as CSV"),
    (re.compile(rb'\{\s*"|\[\s*[\[{]\s*["\d]'), "is JSON; export it as CSV, with a column for each signal"),
)


def read_raw(path: Path) -> RawRecord:
    """Return the columns of the file at `path`, Parquet or CSV by its content; raise RecordError."""
    return _with_rows(_with_units(read_cells(path)))


def read_cells(path: Path) -> RawRecord:
    """Return the columns of the file at `path` as it stores them, whatever its layout; raise RecordError."""
    try:
        require_size(path, RecordError, 1 if path.suffix == ".parquet" else TEXT_COPIES)
        content = path.read_bytes()
    except OSError as error:
        raise RecordError(
            f"{path} cannot be read ({error.strerror}); give the path of a Parquet or CSV file"
        ) from error
    if not content:
        raise RecordError(f"{path} is empty; give a record with a header and at least one row")
    digest = hashlib.sha256(content).hexdigest()
    if content.startswith(b"PAR1"):
        return _parquet(path, content, digest)
    if (what := foreign_kind(content)) is not None:
        raise RecordError(f"{path} {what}")
    if path.suffix == ".parquet":
        raise RecordError(f"{path} is not a Parquet file; if it is text, give it the suffix .csv")
    try:
        content = utf8(content)
    except EncodingError as error:
        raise RecordError(f"{path} {error}") from error
    if b"\0" in content:
        raise RecordError(f"{path}{_zero_bytes(content)}")
    return read_csv(path, content, digest)


def foreign_kind(content: bytes) -> str | None:
    """Return the kind of a file that is neither Parquet nor a table of text, with the remedy; None for these."""
    for magic, what in _FOREIGN:
        if content.startswith(magic):
            return what
    beginning = content[:_SNIFFED].removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    return next((what for pattern, what in _FOREIGN_TEXT if pattern.match(beginning)), None)


def _zero_bytes(content: bytes) -> str:
    """Return the message on zero bytes: of another kind of file, or in a few lines of a text."""
    lines = content.split(b"\n")
    bad = [number for number, line in enumerate(lines, start=1) if b"\0" in line]
    if bad[0] == 1 or len(bad) > len(lines) / 2:
        return " is neither Parquet nor text; export the record as Parquet or CSV"
    more = "" if len(bad) == 1 else f" ({len(bad)} lines in all)"
    return (
        f" line {bad[0]} holds {lines[bad[0] - 1].count(0)} zero bytes{more}, as a logger leaves them that lost its "
        "power while it wrote; take such lines out"
    )


def _with_units(raw: RawRecord) -> RawRecord:
    """Return `raw` with a column for each series, and the units that headings and columns of units give."""
    spread = one_column_a_series(one_below_the_other(raw))
    by_row = {name for name, (factor, _) in raw.conversions.items() if not isinstance(factor, float)}
    if by_row and (len(spread.cells[0]) != len(raw.cells[0]) or not by_row <= spread.conversions.keys()):
        raise RecordError(f"{raw.path}: a line among its rows gives other units than the top; split the file there")
    raw = with_heading_units(one_column_a_source(spread) if len(spread.cells) == len(raw.cells) else spread)
    try:
        return with_unit_columns(raw)
    except RecordError as error:
        if any(is_time_name(name) for name in raw.names):
            raise
        # A table without times may be one of registers or tags: the reader of times then says that it is no record.
        return dataclasses.replace(raw, messages=(*raw.messages, f"units beside the values are not used: {error}"))


def _with_rows(raw: RawRecord) -> RawRecord:
    if not raw.cells or not len(raw.cells[0]):
        raise RecordError(f"{raw.path} holds no samples, only a header; give a record with at least one row")
    return raw


def _parquet(path: Path, content: bytes, digest: str) -> RawRecord:
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not content.endswith(b"PAR1"):
        raise RecordError(
            f"{path} is cut off (its Parquet footer is missing); copy it again, or export it again from its journal"
        )
    try:
        table = read_parquet(path, pa.BufferReader(content), RecordError)
        stored = pq.read_schema(pa.BufferReader(content))
        given = table.column_names
        units = {f.name: told for f in table.schema if (told := _told(f.metadata, b"unit"))}
        declared = {f.name: _range(_told(f.metadata, b"plausible")) for f in table.schema}
    except RecordError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError, OverflowError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordError(f"{path} is a damaged Parquet file ({why}); copy it again") from error
    metadata = {
        key.decode(errors="replace"): value.decode(errors="replace")
        for key, value in (table.schema.metadata or {}).items()
    }
    names, messages = unique(given)
    messages += tuple(
        f"column '{field.name}' holds {field.type}: dropped" for field in stored if field.name not in given
    )
    plausible = {name: limits for name, limits in declared.items() if limits is not None}
    return RawRecord(path, digest, names, tuple(table.columns), messages, metadata, units, plausible=plausible)


def _told(metadata: Mapping[bytes, bytes] | None, key: bytes) -> str:
    return (metadata or {}).get(key, b"").decode(errors="replace")


def _range(text: str) -> tuple[float, float] | None:
    """Return the range that a column's metadata declares as a JSON list of two numbers; None where it declares none."""
    try:
        low, high = parse_json(text)
        return float(low), float(high)
    except (ValueError, TypeError, OverflowError):
        return None
