"""Dialect of a CSV: its delimiter, the line of its column names, and its first row.

Loggers and spreadsheets write lines above the names (`sep=;`, the logger's own data) and below them (units, kinds of
processing). The rows of a table are alike; the lines above them are not. So the rows are found first, by the number of
fields that most lines have and by the columns that hold numbers or times, and the names above them.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from hil.files import require_columns
from hil.record.csv_file.labview_exports import plain_heading
from hil.record.times import SECONDS_PER, is_time_name
from hil.record.units import has_open_factor, looks_like_unit, meaning_of
from hil.record.values import MARKS, MISSING, readings

DELIMITERS = (",", ";", "\t", "|")
BLANKS = " "
"""Delimiter of a table whose columns are separated by runs of blanks."""
SAMPLE = 200
"""Lines from the beginning that the dialect is found from: far more than any logger writes above its rows."""
MOST_BELOW = 3
"""Lines between names and rows: units, kinds of processing and places of sensors, as loggers write them."""

_ON_ITS_SIDE = 4
"""Lines, and fewest cells of a line, that show a table of signals in lines and not in columns."""
_MAY_LACK = ("", "comment", "comments", "remark", "note", "notes")
"""Last name of a heading, lower case, whose cells rows may omit with their delimiter."""
_FACTORS = (
    "scale",
    "scaling",
    "scale factor",
    "factor",
    "multiplier",
    "gain",
    "faktor",
    "skalierung",
    "facteur",
    "échelle",
)
"""First cells of a line, lower case, that gives a factor for each column."""
_FACTOR = re.compile(r"[x×*]\s?\d+(?:[.,]\d+)?|\d+(?:[.,]\d+)?\s?[x×*]")
_PROCESSING = (
    "avg",
    "average",
    "mean",
    "min",
    "max",
    "minimum",
    "maximum",
    "std",
    "smp",
    "sample",
    "tot",
    "total",
    "raw",
)
"""Cells, lower case, of a line that gives the processing of each column, as loggers write one below the units."""
_CHANNEL = re.compile(r"(?:ch|channel|kanal|ai|an|tc|in)[ _.-]?\d+", re.IGNORECASE)
"""Number of a channel, for which a line below may give the tag."""
_SEPARATOR_LINE = re.compile(r'"?sep=(.)"?[,;\t|"]*', re.IGNORECASE)
_MOMENT = re.compile(r"\d{1,4}([-./])\d{1,2}\1\d{1,4}([ T].*)?|\d{1,2}:\d{2}(:\d{2})?.*|\d{4}-\d{2}-\d{2}T.*", re.ASCII)


@dataclass(frozen=True)
class Line:
    """Line of the file: its number, from 1, and its text."""

    number: int
    text: str


@dataclass(frozen=True)
class Dialect:
    """Layout of a CSV.

    Attributes
    ----------
    delimiter
        Between columns.
    names
        Of the columns, as written.
    header_line
        Number of the line that names them.
    rows_from
        Lines above the first row.
    units
        As written, by place of the column, where a line below or above the names gives them; `units_line` is its
        number.
    messages
        Lines that were left out.
    """

    delimiter: str
    names: tuple[str, ...]
    header_line: int
    rows_from: int
    units: dict[int, str] = field(default_factory=dict)
    units_line: int = 0
    messages: tuple[str, ...] = ()


class DialectError(ValueError):
    """Error of a layout that cannot be found; the message lacks only the file."""


def find_dialect(text: str) -> Dialect:
    """Return the dialect of the CSV `text`; its beginning is enough.

    Raises
    ------
    DialectError
        No line names the columns, or there are too many.
    """
    lines, commented, only = _sample(text)
    _require_upright(lines, only)
    if not lines:
        raise DialectError(" holds nothing but comments; give a record with a header and at least one row")
    found = [d for mark in only or (*DELIMITERS, BLANKS) if (d := _with(mark, lines, commented)) is not None]
    if found:
        return max(found, key=lambda d: (d.delimiter != BLANKS, len(d.names)))
    return _first_line(lines[0], only)


def _require_upright(lines: Sequence[Line], only: Sequence[str]) -> None:
    """Raise DialectError for a table on its side: the times in the first line, and a name before each row."""
    for delimiter in only or DELIMITERS:
        rows = [split(line.text, delimiter) for line in lines[:_ON_ITS_SIDE]]
        if len(rows) < 2 or any(row is None or len(row) < _ON_ITS_SIDE for row in rows):
            continue
        cells = [row for row in rows if row is not None]
        named = is_time_name(cells[0][0]) and not any(is_value(row[0]) for row in cells)
        if named and all(is_value(cell) for row in cells for cell in row[1:] if cell):
            raise DialectError(
                f" line {lines[0].number} holds times behind '{cells[0][0]}', and each line begins with a name: the "
                "table lies on its side; transpose it, so that each line is a sample"
            )


def _sample(text: str) -> tuple[list[Line], Line | None, tuple[str, ...]]:
    """Return the first lines that are neither blank nor comments, the last comment above them, the named delimiter."""
    lines: list[Line] = []
    commented: Line | None = None
    only: tuple[str, ...] = ()
    start = number = 0
    while start < len(text) and len(lines) < SAMPLE:
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        line = text[start:end].strip("\r")
        number, start = number + 1, end + 1
        if not line.strip():
            continue
        if line.startswith("#"):
            commented = commented if lines else Line(number, line.lstrip("# "))
        elif not lines and (named := _SEPARATOR_LINE.fullmatch(line.strip())):
            only = (named[1],)
        else:
            lines.append(Line(number, line))
    return lines, commented, only


def split(line: str, delimiter: str) -> list[str] | None:
    """Return the fields of a line without blanks around them, None for one with a quote that does not end."""
    if delimiter == BLANKS:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, strict=True), [""])]
    except csv.Error:
        return None


def _with(delimiter: str, lines: Sequence[Line], commented: Line | None) -> Dialect | None:
    """Return the dialect with this delimiter, None where no line can name the columns that it makes."""
    fields = [split(line.text, delimiter) for line in lines]
    width = Counter(len(row) for row in fields if row is not None).most_common(1)
    if not width or width[0][0] < 2:
        return None
    k = width[0][0]
    require_columns("", k, lambda said: DialectError(said if said.startswith(" ") else f": {said}"))
    fields = _ended_alike([None if row is None else plain_heading(row) for row in fields], k)
    table = [(line, row) for line, row in zip(lines, fields, strict=True) if row is not None and len(row) == k]
    numeric, moments = _numeric([row for _, row in table], k)
    if not numeric or len(table) < 2:
        return None
    first = next((i for i, (_, row) in enumerate(table) if _is_row(row, numeric, moments)), None)
    if first is None:
        return None
    above = table[:first]
    if not above and commented is not None:
        # numpy.savetxt and similar writers comment their heading out.
        names = split(commented.text, delimiter)
        if names is not None and len(names) == k:
            return Dialect(delimiter, tuple(names), commented.number, table[0][0].number - 1)
    if not above:
        return None
    heading = _heading(above)
    line, names = above[heading]
    names = _told_apart(names, [row for _, row in above[:heading]])
    names, own_units = _named_above(names, [row for _, row in above[:heading]])
    below = above[heading + 1 :]
    names, used = _completed(names, [(one.number, row) for one, row in above[:heading]], below)
    below = [(one, row) for one, row in below if one.number not in used]
    if len(below) > MOST_BELOW:
        return None
    _require_one_table(delimiter, lines, line)
    _require_no_factors(table[: first + MOST_BELOW], line, first_row=table[first][0].number)
    left_out = [str(one.number) for one in lines if one.number < table[first][0].number and one.number != line.number]
    over = [(one, row) for one, row in above[:heading] if _are_units(row, names)]
    units_line, units = next(
        ((one.number, found) for one, row in (*below, *over) if (found := _units(row, names))), (0, {})
    )
    if own_units:
        units_line, units = line.number, own_units
    names, tags = _tagged(names, [(one.number, row) for one, row in below if one.number != units_line])
    said: tuple[str, ...] = () if not tags else (f"line {tags} names the channels",)
    left_out = [number for number in left_out if number not in (str(tags), str(units_line), *map(str, used))]
    if used:
        said = (*said, f"names of line {line.number} are completed by line {' and '.join(map(str, used))}")
    elif lost := _lost_names(names, [row for one, row in table if str(one.number) in left_out]):
        said = (*said, f"line {line.number} names no column {', '.join(lost)}: write the names into that line")
    if left_out or (units and not own_units):
        which = "line" if len(left_out) == 1 else "lines"
        told = f", and line {units_line} gives units" if units and not own_units else ""
        rest = f"; {which} {', '.join(left_out)} left out" if left_out else ""
        said = (*said, f"line {line.number} is taken for the heading{told}{rest}")
    return Dialect(delimiter, tuple(names), line.number, max(above[-1][0].number, line.number), units, units_line, said)


def _told_apart(names: list[str], over: Sequence[Sequence[str]]) -> list[str]:
    """Return the names with those that several columns share replaced by a line above that names each of them.

    Loggers write `Value` for every channel below the line of their tags.
    """
    shared = [place for place, name in enumerate(names) if names.count(name) > 1 and name and not is_time_name(name)]
    for row in reversed(over):
        cells = [row[place] for place in shared]
        known = sum(place in shared for place in known_units(row, names))
        if all(cells) and len(set(cells)) == len(cells) > 1 and known < len(cells) and not any(map(is_value, cells)):
            return [row[place] if place in shared else name for place, name in enumerate(names)]
    return names


def _named_above(names: list[str], over: Sequence[Sequence[str]]) -> tuple[list[str], dict[int, str]]:
    """Return the names with those of the line above where all but the times are units; and these units by column."""
    units = {place: name for place, name in enumerate(names) if not _may_be_time(name)}
    if not units or not all(meaning_of(name) is not None for name in units.values()):
        return names, {}
    for row in reversed(over):
        cells = [row[place] for place in units]
        if (
            all(cells)
            and len(set(cells)) == len(cells)
            and not any(map(is_value, cells))
            and cells != list(units.values())
        ):
            return [row[place] if place in units else name for place, name in enumerate(names)], units
    return names, {}


def _completed(
    names: list[str], over: Sequence[tuple[int, Sequence[str]]], below: Sequence[tuple[Line, Sequence[str]]]
) -> tuple[list[str], list[int]]:
    """Return the names with those that the heading lacks, and the numbers of the lines that they are from.

    They stand in a line of tags above it (loggers), in several that tell columns apart together (pandas), or below
    names that span several columns (merged cells of a spreadsheet).
    """
    empty = [place for place, name in enumerate(names) if not name]
    parts = [""] * len(empty)
    used: list[int] = []
    for number, row in reversed(over):
        cells = [row[place] for place in empty]
        if not all(cells) or any(map(is_value, cells)) or 2 * sum(map(looks_like_unit, cells)) > len(cells):
            continue
        is_group = len(set(cells)) < len(cells) and not any(row[place] for place, name in enumerate(names) if name)
        if len(set(parts)) < len(parts) or not all(parts) or is_group:
            parts = [f"{cell}_{part}".rstrip("_") for cell, part in zip(cells, parts, strict=True)]
            used = [number, *used]
    if used and len(set(parts)) == len(parts):
        named = dict(zip(empty, parts, strict=True))
        return [named.get(place, name) for place, name in enumerate(names)], used
    spanned = list(names)
    for place in empty:
        spanned[place] = spanned[place - 1] if place and not is_time_name(spanned[place - 1]) else ""
    spans = [place for place, name in enumerate(spanned) if spanned.count(name) > 1 and name]
    for line, row in below:
        full = {place: f"{spanned[place]} {row[place]}" for place in spans if row[place]}
        if empty and set(empty) <= set(spans) == set(full) and len(set(full.values())) == len(full):
            if all(looks_like_unit(row[place]) for place in spans):
                return spanned, []
            return [full.get(place, name) for place, name in enumerate(names)], [line.number]
    return names, []


def _lost_names(names: Sequence[str], left_out: Sequence[Sequence[str]]) -> list[str]:
    """Return the numbers of columns without a name for which a line that is left out has one."""
    places = [place for place, name in enumerate(names) if not name]
    return [str(place + 1) for place in places if any(row[place] and not is_value(row[place]) for row in left_out)]


def _tagged(names: list[str], below: Sequence[tuple[int, Sequence[str]]]) -> tuple[list[str], int]:
    """Return the names with those of a line of tags below them in place of the numbers of channels.

    The second result is the number of that line, 0 where there is none.
    """
    channels = [place for place, name in enumerate(names) if _CHANNEL.fullmatch(name)]
    for number, row in below:
        tags = {place: row[place] for place in channels if row[place]}
        apart = len(set(tags.values())) == len(tags) == sum(map(bool, row))
        known = any(meaning_of(tag) is not None for tag in tags.values())
        if tags and apart and not known and not any(map(is_value, tags.values())):
            return [tags.get(place, name) for place, name in enumerate(names)], number
    return names, 0


def _may_be_time(name: str) -> bool:
    return is_time_name(name) or "epoch" in name.lower()


def _ended_alike(fields: Sequence[list[str] | None], k: int) -> list[list[str] | None]:
    """Return the fields of lines with those of a heading made `k`, where only a delimiter at the ends of lines differs.

    Loggers end rows with a delimiter and not the heading, or the heading and not the rows; LabVIEW names a column for
    comments that rows without one leave out.
    """
    rows = [row for row in fields if row is not None and len(row) == k]
    out = list(fields)
    for place, row in enumerate(fields):
        if row is None or not any(is_time_name(cell) for cell in row):
            continue
        if len(row) == k - 1 and all(not one[-1] for one in rows):
            out[place] = [*row, ""]
        elif len(row) == k + 1 and row[-1].lower() in _MAY_LACK:
            out[place] = row[:-1]
    return out


def heading_cells(text: str, delimiter: str) -> list[str] | None:
    """Return the fields of a line that names columns, one of them a time; None for any other line."""
    row = split(text, delimiter)
    cells = [cell for cell in row or [] if cell]
    if row is None or len(cells) < 2 or len(set(cells)) < len(cells) or any(is_value(cell) for cell in cells):
        return None
    return row if any(is_time_name(cell) for cell in cells) else None


def _require_one_table(delimiter: str, lines: Sequence[Line], heading: Line) -> None:
    """Raise DialectError where rows of another table, with a heading of their own, stand above the heading."""
    for place, line in enumerate(lines):
        if line.number >= heading.number:
            return
        row = heading_cells(line.text, delimiter)
        after = split(lines[place + 1].text, delimiter) if place + 1 < len(lines) else None
        if row is not None and after is not None and len(after) == len(row) and all(map(is_value, filter(None, after))):
            raise DialectError(
                f" line {heading.number} is a heading of other columns than line {line.number}, and rows follow both; "
                "split the file there"
            )


def _require_no_factors(table: Sequence[tuple[Line, list[str]]], heading: Line, first_row: int) -> None:
    """Raise DialectError for a line of factors below the names: it changes all numbers and is not applied."""
    for line, row in table:
        if line.number <= heading.number:
            continue
        word = next((cell for cell in row if cell.lower().strip(": ") in _FACTORS), None)
        factor = next((cell for cell in row if _FACTOR.fullmatch(cell)), None) if line.number < first_row else None
        if word is not None or factor is not None:
            raise DialectError(
                f" line {line.number} gives factors of the columns ('{word or factor}'), which are not applied; "
                "multiply the numbers, or give the units as multiples (0.1 °C), and take the line out"
            )


def _numeric(rows: Sequence[Sequence[str]], k: int) -> tuple[list[int], list[int]]:
    """Return the columns of numbers or times by most cells of the later half of the sample, and those of times."""
    later = rows[len(rows) // 2 :]
    found, moments = [], []
    for column in range(k):
        cells = [row[column] for row in later if row[column].lower() not in MISSING]
        if cells and sum(is_value(cell) for cell in cells) > len(cells) / 2:
            found.append(column)
        if cells and sum(_MOMENT.fullmatch(cell) is not None for cell in cells) > len(cells) / 2:
            moments.append(column)
    return found, moments


def _is_row(row: Sequence[str], numeric: Sequence[int], moments: Sequence[int]) -> bool:
    """Return True for a line with values in at least half of the cells that it has there, and no word for a time."""
    if any(row[column] and not is_value(row[column]) for column in moments):
        return False
    if any(is_time_name(row[column]) for column in numeric):  # A heading of channels by number: `x-axis,1,2`.
        return False
    cells = [row[column] for column in numeric if row[column].lower() not in (*MISSING, *MARKS)]
    return bool(cells) and sum(is_value(cell) for cell in cells) >= len(cells) / 2


def is_value(cell: str) -> bool:
    """Return True for a cell of a number, a date or a time of day."""
    return readings(cell) != (None, None) or _MOMENT.fullmatch(cell) is not None


def _heading(above: Sequence[tuple[Line, list[str]]]) -> int:
    """Return which of the lines above the rows names the columns: one with a time, else one that leaves no name out.

    A line in which more cells are units than not gives units, though `s` or `ms` among them may name a time.
    """
    named = [i for i, (_, row) in enumerate(above) if any(is_time_name(cell) for cell in row)]
    for i in named:
        row = above[i][1]
        if i == named[-1] or not (
            known_units(row, row) and 2 * len(known_units(row, row, also_foreign=True)) >= sum(map(bool, row))
        ):
            return i
    for i, (_, row) in enumerate(above):
        if all(row) and len(set(row)) == len(row):
            return i
    return 0


def _are_units(row: Sequence[str], names: Sequence[str]) -> bool:
    return len(known_units(row, names, also_foreign=True)) > sum(map(bool, row)) / 2


def _units(row: Sequence[str], names: Sequence[str]) -> dict[int, str]:
    """Return the units that a line below the names gives, as written, by column; empty where it gives none.

    Cells that are no units are among them where at least as many are, or where the line gives the unit of the times.
    """
    there = {place: cell for place, cell in enumerate(row) if cell.lower() not in (*MISSING, "1")}
    found = known_units(row, names, also_foreign=True)
    is_timed = any(is_time_name(names[place]) for place in found)
    if not is_timed and 2 * len(found) < len(there):
        return found
    own = {place for place, cell in there.items() if cell == names[place] or cell.lower() in _PROCESSING}
    return {place: cell for place, cell in there.items() if place in found or place not in own} if found else {}


def known_units(row: Sequence[str], names: Sequence[str], *, also_foreign: bool = False) -> dict[int, str]:
    """Return the cells of a line that are known units, or units that no signal is in as well, by column."""
    return {
        place: cell
        for place, cell in enumerate(row)
        if cell and (_is_unit(cell, names[place]) or (also_foreign and looks_like_unit(cell)))
    }


def _is_unit(cell: str, name: str) -> bool:
    if is_time_name(name) and cell.strip("[]() ").lower() in SECONDS_PER:
        return True
    return meaning_of(cell) is not None or has_open_factor(cell)


def _first_line(line: Line, only: Sequence[str]) -> Dialect:
    """Return the dialect that the first line shows alone: a file of a heading, or one whose rows do not fit it."""
    delimiter = only[0] if only else max(DELIMITERS, key=line.text.count)
    try:
        names = [cell.strip() for cell in next(csv.reader([line.text], delimiter=delimiter, strict=True))]
    except csv.Error as error:
        raise DialectError(f" line {line.number} is no header ({error}); name the columns there") from error
    if all(readings(name) != (None, None) for name in names):
        raise DialectError(f" line {line.number} holds numbers where column names should stand; add a header line")
    return Dialect(delimiter, tuple(names), line.number, line.number)
