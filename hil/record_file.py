"""Bytes of a record, Parquet or CSV, to named columns of cells; what the numbers mean is decided in `hil.record`."""

from __future__ import annotations

import csv
import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.record_limits import TEXT_COPIES, read_parquet, require_columns, require_size

if TYPE_CHECKING:
    import pyarrow as pa

MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "nat")
"""Cells of a CSV, lower case, that mean: no value."""

_FOREIGN = (
    (b"SQLite format 3", "is a journal, not a record; `hil export` makes the record from it"),
    (b"PK\x03\x04", "is a zip file or a spreadsheet; unpack it or save the sheet as CSV"),
    (b"\x1f\x8b", "is gzip-compressed; unpack it first"),
    (b"\x89HDF", "is an HDF5 file; export it as Parquet or CSV"),
    (b"TDSm", "is a TDMS file; export it as Parquet or CSV"),
    (b"ARROW1", "is a Feather file; save it as Parquet or CSV"),
    (b"\xff\xfe", "is UTF-16 text; save it as CSV in UTF-8"),
    (b"\xfe\xff", "is UTF-16 text; save it as CSV in UTF-8"),
)


class RecordError(ValueError):
    """A record cannot be read or written; one sentence that names the file, the line where there is one, the remedy."""


@dataclass(frozen=True, eq=False)
class RawRecord:
    """Columns as stored: `cells` are Arrow arrays of any type, all of one length, named by `names`.

    `units` is what the file itself says of a column's unit; `header_line` and `skipped_lines` map rows to lines of a
    CSV (0 and empty for Parquet).
    """

    path: Path
    sha256: str
    names: tuple[str, ...]
    cells: tuple[Any, ...]
    messages: tuple[str, ...] = ()
    metadata: dict[str, str] | None = None
    units: dict[str, str] | None = None
    header_line: int = 0
    skipped_lines: tuple[int, ...] = ()

    def place(self, row: int) -> str:
        """Where `row` (from 0) stands in the file, for a message."""
        if not self.header_line:
            return f"row {row + 1}"
        line = self.header_line + 1 + row
        for skipped in self.skipped_lines:
            line += skipped <= line
        return f"line {line}"


@dataclass(frozen=True, eq=False)
class Numbers:
    """Cells as `values (n,)`, NaN where there is none; `bad` cells of `present` were no numbers, the first in `row`."""

    values: NDArray[np.float64]
    present: int
    bad: int = 0
    row: int = 0
    text: str = ""
    commas: int = 0


def read_raw(path: Path) -> RawRecord:
    """The columns of the file at `path`, told Parquet or CSV by its content; raises RecordError."""
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
        return _with_rows(_parquet(path, content, digest))
    for magic, what in _FOREIGN:
        if content.startswith(magic):
            raise RecordError(f"{path} {what}")
    if path.suffix == ".parquet":
        raise RecordError(f"{path} is not a Parquet file; if it is text, give it the suffix .csv")
    if b"\0" in content[:65536]:
        raise RecordError(f"{path} is neither Parquet nor text; export the record as Parquet or CSV")
    return _with_rows(_csv(path, content, digest))


def _with_rows(raw: RawRecord) -> RawRecord:
    if not raw.cells or not len(raw.cells[0]):
        raise RecordError(f"{raw.path} holds no samples, only a header; give a record with at least one row")
    return raw


def _parquet(path: Path, content: bytes, digest: str) -> RawRecord:
    import pyarrow as pa

    if not content.endswith(b"PAR1"):
        raise RecordError(
            f"{path} is cut off (its Parquet footer is missing); copy it again, or export it again from its journal"
        )
    try:
        table = read_parquet(path, pa.BufferReader(content), RecordError)
        given = table.column_names
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise RecordError(f"{path} is a damaged Parquet file ({str(error).splitlines()[0]}); copy it again") from error
    units = {
        field.name: field.metadata[b"unit"].decode() for field in table.schema if b"unit" in (field.metadata or {})
    }
    metadata = {
        key.decode(errors="replace"): value.decode(errors="replace")
        for key, value in (table.schema.metadata or {}).items()
    }
    names, messages = _unique(given)
    return RawRecord(path, digest, names, tuple(table.columns), messages, metadata, units)


def _csv(path: Path, content: bytes, digest: str) -> RawRecord:
    import pyarrow as pa
    import pyarrow.csv as pacsv

    messages = []
    encoding = "utf-8"
    if b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        encoding = "latin-1"
        text = content.decode(encoding)
        messages.append(f"line {content.count(bytes([10]), 0, error.start) + 1} is not UTF-8; read as Latin-1")
    header_line, header, rows_from = _find_header(path, text)
    delimiter = max(",;\t", key=header.count)
    try:
        given = next(csv.reader([header], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise RecordError(f"{path} line {header_line} is no header ({error}); name the columns there") from error
    require_columns(path, len(given), RecordError)
    names, repeated = _unique([name.strip() for name in given])
    messages += repeated
    if all(_is_number(name) for name in names):
        raise RecordError(f"{path} line {header_line} holds numbers where column names should stand; add a header line")
    skipped: list[tuple[int, str]] = []

    def skip(row: Any) -> str:
        skipped.append((row.number, row.text))
        return "skip"

    try:
        table = pacsv.read_csv(
            io.BytesIO(content),
            read_options=pacsv.ReadOptions(
                use_threads=False, skip_rows=rows_from, column_names=names, encoding=encoding
            ),
            parse_options=pacsv.ParseOptions(
                delimiter=delimiter, invalid_row_handler=skip, ignore_empty_lines=False, newlines_in_values=False
            ),
            convert_options=pacsv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=True, null_values=[""]
            ),
        )
    except pa.ArrowInvalid as error:
        if "Empty CSV" not in str(error) and "Could not skip" not in str(error):
            raise RecordError(f"{path} cannot be read as CSV ({error}); check its quotes and separators") from error
        table = pa.table({name: pa.array([], pa.string()) for name in names})
    if skipped:
        line, row_text = skipped[0]
        if len(skipped) > table.num_rows:
            raise RecordError(
                f"{path} line {line} does not have the {len(names)} fields of the header, like most lines ("
                f"'{row_text[:40]}'); write decimal points, or separate columns by semicolons"
            )
        what = "1 line has" if len(skipped) == 1 else f"{len(skipped)} lines have"
        where = (
            "the last one, cut off" if text.endswith(row_text) and len(skipped) == 1 else f"the first is line {line}"
        )
        messages.append(f"{what} not the {len(names)} fields of the header ({where}): dropped")
    return RawRecord(
        path,
        digest,
        names,
        tuple(table.columns),
        tuple(messages),
        header_line=rows_from,
        skipped_lines=tuple(line for line, _ in skipped),
    )


def _find_header(path: Path, text: str) -> tuple[int, str, int]:
    """Line number and text of the header, and how many lines stand above the first row."""
    comment = (0, "")
    start = number = 0
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        line = text[start:end].strip("\r")
        number += 1
        if line.startswith("#"):
            comment = (number, line.lstrip("# "))
        elif line.strip():
            cells = [cell.strip() for cell in line.replace(";", ",").replace("\t", ",").split(",")]
            is_row = all(_is_number(cell) for cell in cells)
            # numpy.savetxt and its like comment their header out
            if is_row and comment[0] and comment[1].count(",") == line.count(",") > 0:
                return comment[0], comment[1], number - 1
            return number, line, number
        start = end + 1
    raise RecordError(f"{path} holds nothing but comments; give a record with a header and at least one row")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _unique(names: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """`names` with repeats renamed so that the first keeps its name; and what was renamed."""
    unique: list[str] = []
    messages = []
    for place, given in enumerate(names, start=1):
        name = given or f"column_{place}"
        if name in unique:
            count = 2
            while f"{name}_{count}" in unique or f"{name}_{count}" in names:
                count += 1
            messages.append(f"column '{name}' stands twice: the second is read as '{name}_{count}'")
            name = f"{name}_{count}"
        unique.append(name)
    return tuple(unique), tuple(messages)


def parse(cells: pa.ChunkedArray) -> Numbers | None:
    """`cells` as float64, or None for a type that holds no numbers."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = cells.type
    if pa.types.is_dictionary(kind):
        return parse(cells.cast(kind.value_type))
    if (
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_boolean(kind)
        or pa.types.is_decimal(kind)
    ):
        values = pc.cast(cells, pa.float64(), safe=False).to_numpy()
        return Numbers(np.array(values, dtype=np.float64), len(cells) - cells.null_count)
    if pa.types.is_null(kind):
        return Numbers(np.full(len(cells), np.nan), 0)
    if not pa.types.is_string(kind) and not pa.types.is_large_string(kind):
        return None
    trimmed = pc.utf8_trim_whitespace(cells)
    empty = pc.is_in(pc.utf8_lower(trimmed), value_set=pa.array(MISSING, kind))
    trimmed = pc.if_else(empty, pa.scalar(None, kind), trimmed)
    present = len(trimmed) - trimmed.null_count
    try:
        return Numbers(np.array(trimmed.cast(pa.float64()).to_numpy(), dtype=np.float64), present)
    except pa.ArrowInvalid:
        return _cell_by_cell(trimmed.to_pylist(), present)


def _cell_by_cell(cells: list[str | None], present: int) -> Numbers:
    values = np.full(len(cells), np.nan)
    bad, row, text, commas = 0, 0, "", 0
    for index, cell in enumerate(cells):
        if cell is None:
            continue
        number = cell
        if cell.count(",") == 1 and "." not in cell:
            number = cell.replace(",", ".")
        try:
            values[index] = float(number.replace("_", "x"))
            commas += number != cell
        except ValueError:
            if not bad:
                row, text = index, cell
            bad += 1
    return Numbers(values, present, bad, row, text, commas)
