"""LabVIEW measurement files (.lvm): a header of the file, then segments with headers of their own.

Source: NI, "Specification for the LabVIEW Measurement File (.lvm)". Each call of the writer makes a segment: a header
with date, time, unit, first x and step of each channel, a line of names, then rows. The x stand before each channel
(`X_Columns Multi`), once (`One`) or nowhere (`No`), and count from the date and time of their segment. Files that were
appended to each other have further headers of the file, each with a layout of its own.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.files import require_cells, require_columns
from hil.record.csv_file.dialect import Dialect, is_value
from hil.record.csv_file.units_line import named_columns
from hil.record.raw import RawRecord, RecordError, unique
from hil.record.values import MISSING

_MAGIC = "LabVIEW Measurement"
_END = "***End_of_Header***"
_SPECIAL_BEGIN, _SPECIAL_END = "***Start_Special***", "***End_Special***"
_X, _COMMENT = "X_Value", "Comment"
_NUMBER = re.compile(r"[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?|[+-]?(?:NaN|Inf)", re.ASCII | re.IGNORECASE)
_DATE = re.compile(r"(\d{4})/(\d{1,2})/(\d{1,2})", re.ASCII)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d+))?", re.ASCII)
_EPOCH = datetime.datetime(1904, 1, 1)
"""Zero of LabVIEW's clock."""
_UNSET = datetime.datetime(1905, 1, 1)
"""Dates before are those of a waveform without a time: zero, in some time zone."""
_ABSOLUTE_S = 1e9
"""Smallest x in s that counts from 1904 and not from the date of its segment, which would be 31 years long."""
_LONGEST_S = 5e9
"""Span in s, of 158 years, that fits into nanoseconds since 1970 from any date of LabVIEW."""
_SAME = 0.1
"""Relative difference of two spans of time that are one: no clock is that wrong."""


@dataclass(frozen=True)
class _Layout:
    """Properties of a file by its header: separator and decimal sign, x columns (`one`, `multi`, `no`), and moment."""

    separator: str
    sign: str
    x_columns: str
    begin: datetime.datetime | None = None

    def number(self, cell: str) -> float | None:
        """Return the number of a cell, None where it is none."""
        text = cell.strip().replace(self.sign, ".")
        return float(text) if _NUMBER.fullmatch(text) else None

    def pointed(self, cell: str) -> str:
        """Return a cell with a decimal point, where it is a number."""
        return cell if self.number(cell) is None else cell.strip().replace(self.sign, ".")


_FIRST_TAG = re.compile(
    r"(?:Writer|Reader)_Version([\t,;|])|(?:Separator|Decimal_Separator|Multi_Headings|X_Columns)([\t,;|])"
)


@dataclass
class _Segment:
    """Layout and header of one segment, by tag, each with its line; names of its columns and their line; its rows."""

    layout: _Layout
    header: dict[str, tuple[int, list[str]]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    line: int = 0
    rows: list[tuple[int, list[str]]] = field(default_factory=list)

    def cell(self, tag: str, place: int) -> str:
        """Return the cell of a tag for one channel, else that of the first; empty where there is none."""
        cells = self.header.get(tag, (0, []))[1]
        return cells[place] if place < len(cells) and cells[place] else cells[0] if cells else ""


def is_labview(text: str) -> bool:
    """Return True for the beginning of a LabVIEW measurement file."""
    return text.lstrip("\ufeff\r\n\t ").startswith(_MAGIC)


def read_labview(path: Path, text: str, digest: str, messages: tuple[str, ...] = ()) -> RawRecord:
    """Return all segments of a LabVIEW measurement file as one table; a channel that a segment lacks is empty there.

    Raises
    ------
    RecordError
        A header does not end, the x of a segment are no times, a channel changes its unit, or the dates of the segments
        contradict their x.
    """
    segments = _segments(path, text)
    unit_of, units_line = _units(path, segments)
    blocks = [_blocks(segment) for segment in segments]
    if not any(block.x for found in blocks for block in found):
        raise RecordError(f"{path} holds no samples, only headers; give a record with at least one row")
    origin = _put_in_time(path, segments, blocks)
    columns: dict[str, list[str | None]] = {}
    times: list[float | None] = []
    lines: list[int] = []
    for segment, found in zip(segments, blocks, strict=True):
        require_columns(path, len(columns) + len(segment.names), RecordError)
        for block in found:
            for name, cells in block.cells.items():
                column = columns.setdefault(name, [])
                column += [None] * (len(times) - len(column))
                column += cells
            times += block.x
            lines += [number for number, _ in segment.rows]
    require_cells(path, len(times), len(columns) + 1, RecordError)
    names = (_X, *columns)
    units = {place: unit_of[name] for place, name in enumerate(names) if unit_of.get(name)}
    named = named_columns(path, Dialect("\t", names, segments[0].line, 0, units, units_line))
    cells = [_typed(column + [None] * (len(times) - len(column))) for column in columns.values()]
    count = "1 segment" if len(segments) == 1 else f"{len(segments)} segments, each at its own date and time"
    return RawRecord(
        path,
        digest,
        tuple(named.names),
        (_stamps(times, origin), *cells),
        (*messages, f"LabVIEW measurement file of {count}", *named.messages),
        units=named.units,
        conversions=named.conversions,
        header_line=segments[0].line,
        delimiter=segments[0].layout.separator,
        lines=tuple(lines),
    )


def _segments(path: Path, text: str) -> list[_Segment]:
    """Return the segments of all files in `text`, each with the layout that the header above it states.

    Raises RecordError where a header does not end, or where rows stand without names above them.
    """
    head: dict[str, str] = {}
    layout: _Layout | None = None
    found: list[_Segment] = []
    current: _Segment | None = None
    begun, mark, is_special = 1, "\t", False
    for number, line in enumerate(text.split("\n"), start=1):
        bare = line.strip("\r\ufeff")
        if bare.lstrip().startswith(_MAGIC):  # also that of a further file, which was appended
            head, layout, current, begun, is_special = {}, None, None, number, False
            mark = bare.lstrip()[len(_MAGIC) :][:1] or "\t"
            continue
        if layout is None and not head and (begins := _FIRST_TAG.match(bare)) is not None:
            mark = begins[1] or begins[2]  # The first line may end without a separator, or with another one.
        separator = layout.separator if layout else mark
        separator = mark if separator not in bare and mark in bare and not is_value(bare) else separator
        cells = [cell.strip() for cell in bare.split(separator)]
        tag = cells[0]
        if tag in (_SPECIAL_BEGIN, _SPECIAL_END):
            is_special = tag == _SPECIAL_BEGIN
        elif is_special or not any(cells):
            continue
        elif layout is None:
            if tag == _END:
                layout = _layout(head, mark)
            elif len(cells) > 1:
                head[tag] = cells[1]
        elif current is not None and current.names and (not tag or is_value(tag) or tag.lower() in MISSING):
            current.rows.append((number, cells))
        elif current is not None and not current.names and tag == _X:
            current.names, current.line = _channels(cells, layout), number
        elif tag and not is_value(tag):
            if current is None or current.names:
                current, begun = _Segment(layout), number
                found.append(current)
                if tag == _X:
                    current.names, current.line = _channels(cells, layout), number
            if tag not in (_END, _X):
                step = 2 if layout.x_columns == "multi" else 1
                current.header[tag] = number, cells[1::step]
        else:
            raise RecordError(
                f"{path} line {number} holds numbers where a segment begins; write a line {_X} with the names of the "
                "channels above them"
            )
    if layout is None or not found or not found[-1].names:
        raise RecordError(
            f"{path} line {begun} begins a header of LabVIEW that no line '{_X}' with names follows; write the file "
            "again, or export its table as CSV"
        )
    return found


def _layout(head: dict[str, str], mark: str) -> _Layout:
    separator = {"tab": "\t", "comma": ","}.get(head.get("Separator", "").lower(), mark)
    sign = head.get("Decimal_Separator", "") or ("," if "," in head.get("Time", "") else ".")
    begin = _moment(head.get("Date", ""), head.get("Time", ""))
    return _Layout(separator, sign, head.get("X_Columns", "One").lower(), begin)


def _channels(cells: Sequence[str], layout: _Layout) -> list[str]:
    """Return the names of the channels in a line of names, without its last column, of comments."""
    names = list(cells[1::2] if layout.x_columns == "multi" else cells[1:])
    last = cells[-1] if cells[-1] else cells[-2]
    names = [name for name in names if name]
    return list(unique(names[:-1] if names and names[-1] == last == _COMMENT else names)[0])


def _units(path: Path, segments: Sequence[_Segment]) -> tuple[dict[str, str], int]:
    """Return the units of the channels, and the line of the first; raise RecordError where one changes."""
    found: dict[str, tuple[str, int]] = {}
    for segment in segments:
        line, units = segment.header.get("Y_Unit_Label", (0, []))
        for name, unit in zip(segment.names, units, strict=False):
            known, at = found.setdefault(name, (unit, line))
            if known != unit:
                raise RecordError(
                    f"{path} line {line} gives the unit '{unit}' for channel '{name}', and line {at} gives '{known}'; "
                    "split the file there"
                )
    return {name: unit for name, (unit, _) in found.items()}, next((line for _, line in found.values()), 0)


@dataclass
class _Block:
    """Rows of channels with the same `x`, in s from `begin`; `begin` is None without a date."""

    x: list[float | None]
    begin: datetime.datetime | None
    cells: dict[str, list[str | None]]

    def holds(self, other: _Block) -> bool:
        """Return True where another block has the same times: channels of one device begin a few us apart."""
        if self.x != other.x or (self.begin is None) != (other.begin is None):
            return False
        if self.begin is None or other.begin is None or self.begin == other.begin:
            return True
        known = [value for value in self.x if value is not None]
        step = (known[-1] - known[0]) / max(len(known) - 1, 1) if known else 0.0
        return abs((self.begin - other.begin).total_seconds()) < 0.5 * step


def _blocks(segment: _Segment) -> list[_Block]:
    """Return the rows of a segment, in a block for each group of channels with the same times."""
    found: list[_Block] = []
    layout = segment.layout
    for place, name in enumerate(segment.names):
        at = 2 * place + 1 if layout.x_columns == "multi" else place + 1
        cells = [layout.pointed(row[at]) or None if at < len(row) else None for _, row in segment.rows]
        timed = 0 if layout.x_columns == "one" else place
        own = _moment(segment.cell("Date", timed), segment.cell("Time", timed))
        block = _Block(_x(segment, place), own if "Date" in segment.header else layout.begin, {})
        same = next((one for one in found if one.holds(block)), None)
        if same is None and found and not any(cells):  # A channel without samples has a step of its own.
            same = found[0]
        if same is None:
            found.append(block)
        (same or block).cells[name] = cells
    return found


def _x(segment: _Segment, place: int) -> list[float | None]:
    """Return the x of a channel's rows: as written, or from its first x and its step."""
    layout = segment.layout
    if layout.x_columns in ("one", "multi"):
        at = 2 * place if layout.x_columns == "multi" else 0
        return [layout.number(row[at]) if at < len(row) else None for _, row in segment.rows]
    first, step = (layout.number(segment.cell(tag, place)) for tag in ("X0", "Delta_X"))
    if step is None:
        return [None] * len(segment.rows)
    return [(first or 0.0) + step * row for row in range(len(segment.rows))]


def _moment(date: str, clock: str) -> datetime.datetime | None:
    """Return the moment of a header, None where it has none or LabVIEW's zero."""
    day, time = _DATE.fullmatch(date), _CLOCK.fullmatch(clock)
    if day is None or time is None:
        return None
    try:
        found = datetime.datetime(*map(int, (*day.groups(), *time.groups()[:3])))  # type: ignore[arg-type]
    except ValueError:
        return None
    found += datetime.timedelta(microseconds=int((time[4] or "0")[:6].ljust(6, "0")))
    return found if found >= _UNSET else None


def _put_in_time(
    path: Path, segments: Sequence[_Segment], blocks: Sequence[Sequence[_Block]]
) -> datetime.datetime | None:
    """Make the x of all blocks seconds from one moment, which is returned; None where a segment has no date.

    The x count from the date of their segment. Where they go on from segment to segment as the dates do, they count
    from the first date; large ones count from 1904.

    Raises RecordError where x and dates go on by different spans, or where the x of a segment are no times.
    """
    for segment in segments:
        line, kinds = segment.header.get("X_Dimension", (0, []))
        other = next((kind for kind in kinds if kind.lower() not in ("", "time")), None)
        if other is not None:
            raise RecordError(
                f"{path} line {line} gives '{other}' for the x of the rows, where a record has times; write the "
                "channels against time"
            )
    every = [block for found in blocks for block in found if any(x is not None for x in block.x)]
    first = [next(x for x in block.x if x is not None) for block in every]
    if first and min(first) >= _ABSOLUTE_S:
        for block in every:
            block.x = [None if x is None else x - first[0] for x in block.x]
        return _EPOCH + datetime.timedelta(seconds=first[0])
    begins = [block.begin for block in every]
    if not begins or None in begins:
        return None
    later = [(begin - begins[0]).total_seconds() for begin in begins]  # type: ignore[operator]
    goes_on = [x - first[0] for x in first]
    if any(x > _SAME * by > 0.0 for x, by in zip(goes_on, later, strict=True)):
        if all(abs(x - by) <= _SAME * max(by, 0.0) for x, by in zip(goes_on, later, strict=True)):
            return begins[0]
        worst = next(i for i, (x, by) in enumerate(zip(goes_on, later, strict=True)) if x > _SAME * by > 0.0)
        raise RecordError(
            f"{path}: the x of a later segment begin {goes_on[worst]:.6g} s and its date {later[worst]:.6g} s after "
            "those of the first, so that its times are not certain; split the file at its segments"
        )
    for block, by in zip(every, later, strict=True):
        block.x = [None if x is None else x + by for x in block.x]
    return begins[0]


def _stamps(times: Sequence[float | None], origin: datetime.datetime | None) -> Any:
    """Return the times as an Arrow column: moments, or seconds where there is no date."""
    import pyarrow as pa

    if origin is None:
        return pa.chunked_array([pa.array(times, pa.float64())])
    zero = (origin - datetime.datetime(1970, 1, 1)) // datetime.timedelta(microseconds=1) * 1000
    nanos = [None if x is None or not abs(x) < _LONGEST_S else zero + round(1e9 * x) for x in times]
    return pa.chunked_array([pa.array(nanos, pa.int64()).cast(pa.timestamp("ns"))])


def _typed(cells: Sequence[str | None]) -> Any:
    """Return a column of cells with decimal points as numbers; as text where a cell is none."""
    import pyarrow as pa

    if all(cell is None or _NUMBER.fullmatch(cell) for cell in cells):
        return pa.chunked_array([pa.array([None if cell is None else float(cell) for cell in cells], pa.float64())])
    return pa.chunked_array([pa.array(cells, pa.string())])
