"""Bytes of a CSV to named columns of text."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.record.csv_file.annotated import is_annotated, read_annotated
from hil.record.csv_file.cut_end import ends_cut
from hil.record.csv_file.dialect import BLANKS, Dialect, find_dialect, heading_cells, is_value, split
from hil.record.csv_file.encodings import shift_jis, unwrapped
from hil.record.csv_file.labview import is_labview, read_labview
from hil.record.csv_file.labview_exports import without_waveform_lines
from hil.record.csv_file.lines_among_rows import heading_lines, is_other_line, without_other_lines
from hil.record.csv_file.repeated_headings import by_later_headings
from hil.record.csv_file.units_line import named_columns
from hil.record.raw import RawRecord, RecordError, unique
from hil.record.values import may_be_lost, readings

if TYPE_CHECKING:
    import pyarrow as pa


def read_csv(path: Path, content: bytes, digest: str) -> RawRecord:
    """Return the columns of the CSV `content` of the file at `path`, as text.

    Raises
    ------
    RecordError
        No line names the columns, or more lines than `hil.record.values.may_be_lost` allows do not fit them.
    """
    messages = []
    encoding = "utf-8"
    if b"\n" not in content:
        content = content.replace(b"\r", b"\n")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        encoding = "latin-1"
        text = content.decode(encoding)
        name = "Latin-1"
        if (japanese := shift_jis(content)) is not None:
            text, name, encoding = japanese, "Shift-JIS", "utf-8"
        messages.append(f"line {content.count(bytes([10]), 0, error.start) + 1} is not UTF-8; read as {name}")
        content = content if japanese is None else text.encode()
    if (bare := unwrapped(text)) != text:
        text, content, encoding = bare, bare.encode(), "utf-8"
        messages.append("each line stands in quotes: read without them")
    if is_annotated(text):
        return read_annotated(path, text, digest)
    if is_labview(text):
        return read_labview(path, text, digest, tuple(messages))
    try:
        bare, said = without_waveform_lines(text)
        if bare != text:
            text, content, encoding = bare, bare.encode(), "utf-8"
        messages += said
        dialect = find_dialect(text)
    except ValueError as error:
        raise RecordError(f"{path}{error}") from error
    messages += dialect.messages
    delimiter = dialect.delimiter
    if delimiter == BLANKS:
        messages.append("columns are separated by blanks")
        text = re.sub(r"[ \t]+", "\t", re.sub(r"(?m)^[ \t]+|[ \t]+(?=\r?$)", "", text))
        content, encoding, delimiter = text.encode(), "utf-8", "\t"
    named = named_columns(path, dialect)
    messages += named.messages
    names, repeated = unique(named.names)
    messages += repeated
    table, left_out = _table(path, content, names, delimiter, encoding, dialect.rows_from)
    all_skipped = tuple(line for line, _ in left_out)
    first = RawRecord(
        path, digest, names, tuple(table.columns), header_line=dialect.rows_from, skipped_lines=all_skipped
    )
    headings = heading_lines(first, dialect.names) if left_out else []
    skipped = [(line, row_text) for line, row_text in left_out if not is_other_line(line, row_text, dialect, headings)]
    if skipped:
        _require_no_heading(path, skipped, dialect)
        line, row_text = skipped[0]
        if len(skipped) > may_be_lost(table.num_rows + len(skipped)):
            most = ", like most lines" if len(skipped) > table.num_rows else f", like {len(skipped)} lines in all"
            raise RecordError(
                f"{path} line {line} does not have the {len(names)} fields of the header{most} ('{row_text[:40]}'); "
                f"{_remedy(row_text, dialect)}"
            )
        what = "1 line has" if len(skipped) == 1 else f"{len(skipped)} lines have"
        last = text.endswith(row_text) and len(skipped) == 1
        where = "the last one, cut off" if last else f"the first is line {line}"
        messages.append(f"{what} not the {len(names)} fields of the header ({where}): dropped")
    names, table = _without_empty_end(dialect.names, names, table)
    _require_closed_quotes(path, content, table, dialect)
    last_is_left_out = bool(left_out) and text.rstrip("\r\n ").endswith(left_out[-1][1])
    if not text.endswith(("\n", "\r")) and not last_is_left_out:
        table, cut = _without_cut_end(table, names[-1], text.count("\n") + 1)
        messages += cut
    raw = RawRecord(
        path,
        digest,
        names,
        tuple(table.columns),
        tuple(messages),
        units=named.units,
        conversions=named.conversions,
        header_line=dialect.rows_from,
        skipped_lines=all_skipped,
        delimiter=delimiter,
    )
    return without_other_lines(by_later_headings(raw, dialect.names[: len(names)]), dialect, left_out)


def _require_no_heading(path: Path, skipped: list[tuple[int, str]], dialect: Dialect) -> None:
    """Raise RecordError for a line with another number of fields that names columns."""
    for line, row_text in skipped:
        row = heading_cells(row_text, dialect.delimiter)
        if row is not None:
            raise RecordError(
                f"{path} line {line} is a heading of {len(row)} columns where that at the top (line "
                f"{dialect.header_line}) has {len(dialect.names)}; split the file there"
            )


def _remedy(row_text: str, dialect: Dialect) -> str:
    """Return what to do about a row whose number of fields differs from the heading's."""
    row, width = split(row_text, dialect.delimiter), len(dialect.names)
    if row is None:
        return "close its quotes"
    if len(row) < width:
        return "give every row all its fields, empty where there is no value"
    plain = all(cell.lstrip("+-").isdigit() for cell in row)
    if dialect.delimiter == "," and plain:
        return "write decimal points, or separate columns by semicolons"
    if any(cell and not is_value(cell) for cell in row):
        return f"quote texts that hold the delimiter '{dialect.delimiter}', or name every column in the heading"
    return "name every column in the heading, and write decimal points where the delimiter is a comma"


def _without_empty_end(
    written: tuple[str, ...], names: tuple[str, ...], table: pa.Table
) -> tuple[tuple[str, ...], pa.Table]:
    """Return names and columns without a last one that has neither a name nor a cell: each line ends in a delimiter."""
    if written[-1] or len(names) < 2 or table.column(len(names) - 1).null_count < table.num_rows:
        return names, table
    return names[:-1], table.select(range(len(names) - 1))


def _without_cut_end(table: pa.Table, last: str, line: int) -> tuple[pa.Table, list[str]]:
    """Return the table without a last row whose last number was cut off, and a message; `last` names its column."""
    if not table.num_rows or not (found := ends_cut(table.column(table.num_columns - 1))):
        return table, []
    cell = f"the last number, '{table.column(table.num_columns - 1)[-1].as_py()}' of {last} (line {line}), has"
    if found == "doubtful":
        return table, [f"{cell} fewer digits than all others and no line end after it: is the file cut off there?"]
    return table.slice(0, table.num_rows - 1), [
        f"{cell} fewer digits than its column and no line end after it: the file is cut off there, and the line dropped"
    ]


def _require_closed_quotes(path: Path, content: bytes, table: pa.Table, dialect: Dialect) -> None:
    """Raise RecordError for a cell over several lines in a column of numbers: its quote does not end."""
    import pyarrow.compute as pc

    if b'"' not in content:
        return
    for cells in table.columns:
        broken = pc.fill_null(pc.match_substring(cells, "\n"), False)
        if pc.any(broken).as_py() and any(readings(cell) != (None, None) for cell in cells.to_pylist() if cell):
            line = _open_quote(content, "\t" if dialect.delimiter == BLANKS else dialect.delimiter, dialect.rows_from)
            raise RecordError(f"{path} line {line or '?'} has a quote that does not end there; close it")


def _open_quote(content: bytes, delimiter: str, rows_from: int) -> int | None:
    """Return the number of the first line below `rows_from` whose quote does not end in it, None if all end."""
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
        if number > rows_from and '"' in line and split(line, delimiter) is None:
            return number
    return None


def _table(
    path: Path, content: bytes, names: tuple[str, ...], delimiter: str, encoding: str, rows_from: int
) -> tuple[pa.Table, list[tuple[int, str]]]:
    """Return the rows as text, and number and text of each line with another number of fields."""
    import pyarrow as pa
    import pyarrow.csv as pacsv

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
    except (pa.ArrowException, UnicodeDecodeError) as error:
        if (line := _open_quote(content, delimiter, rows_from)) is not None:
            raise RecordError(
                f"{path} line {line} has a quote that does not end there; close it, and write texts without line breaks"
            ) from error
        if "Empty CSV" not in str(error) and "Could not skip" not in str(error):
            why = (str(error).splitlines() or [type(error).__name__])[0]
            raise RecordError(f"{path} cannot be read as CSV ({why}); check its quotes and separators") from error
        table = pa.table({name: pa.array([], pa.string()) for name in names})
    return table, skipped
