"""Cells of a column to numbers: one decimal sign and one thousands separator for all of them.

`1.234` is a little more than one, or more than a thousand, depending on the writer. A single cell does not show which,
but a column does, or the other columns of the file: the sign is decided from cells that can be read in one way only.
Where nothing decides and the two readings differ, the record is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.signals import plausible_range, split_column
from hil.record.times import is_time_name

if TYPE_CHECKING:
    import pyarrow as pa

Sign = Literal[".", ","]

MISSING = (
    *("", "nan", "na", "n/a", "null", "none", "-", "--", "---", "#n/a", "nat", "n.a.", "#n/v", "1.#qnan", "-1.#ind"),
    *("nodata", "no data", "no value", "unavailable", "unknown", "invalid", "not available", "#value!", "#div/0!"),
)
"""Cells of a CSV, lower case, that mean no value."""

MARKS = (
    *("err", "error", "err!", "bad", "bad input", "fail", "failed", "fault", "open", "short", "timeout", "offline"),
    *("ol", "o.l", "o.l.", "0.l", "ovl", "ovld", "over", "overload", "overflow", "ovr", "+over", "-over", "under"),
    *("i/o timeout", "calc failed", "shutdown", "comm fail", "configure", "out of range", "n.c.", "nc"),
)
"""Cells, lower case, by which instruments and historians mark a missing reading; they are counted."""

LOST = 0.05
"""Share of the rows, or of a column's cells, that a step of reading may drop; more is refused."""
ALWAYS_LOST = 2
"""Rows that may be dropped from any record: its first and its last may be cut."""

_GROUPING = re.compile(r"(?<=[0-9])[ \u00a0\u2009\u202f'\u2019](?=[0-9]{3}(?![0-9]))")
"""Thousands separators: spaces and apostrophes, which are never decimal signs."""
_USUAL = re.compile(r"[-+.,eE\d]*", re.ASCII)
_APART = re.compile(r"^([+-])\s+(?=[\d.,])")
"""Sign with blanks behind it, as loggers with columns of one width write it."""
_FORTRAN = re.compile(r"^([+-]?\s*(?:\d+[.,]?\d*|[.,]\d+))[dD]([+-]?\d{1,3})$", re.ASCII)
"""Number with the exponent of a double in Fortran, 2.21D+01."""
_PLAIN = re.compile(r"[+-]?\d+([eE][+-]?\d+)?", re.ASCII)
_ONE = re.compile(r"([+-]?)(\d*)([.,])(\d*)([eE][+-]?\d+)?", re.ASCII)
_SEVERAL = re.compile(r"[+-]?[1-9]\d{0,2}(?:([.,])\d{2,3})*([.,])\d{3}", re.ASCII)
_BOTH = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{2,3})*\.\d{3},\d*|[+-]?[1-9]\d{0,2}(?:,\d{2,3})*,\d{3}\.\d*", re.ASCII)
_ENDLESS = re.compile(r"[+-]?inf(inity)?", re.IGNORECASE)
_HUNDREDS = re.compile(r"[+-]?[1-9]\d\d", re.ASCII)
_OF_THOUSANDS = (
    "W",
    "VA",
    "var",
    "rpm",
    "Pa",
    "Hz",
    "ohm",
    "L/h",
    "mV",
    "mA",
    "mbar",
    "ms",
    "Wh",
    "kWh",
    "kJ",
    "J",
    "1",
)
"""Units in which readings of a laboratory are in the thousands; the others have a prefix that avoids it."""
_UNDECIDED = r"^[+-]?[1-9][0-9]{0,2}\.[0-9]{3}$"


def may_be_lost(total: int) -> int:
    """Return the number of `total` rows or cells that reading may drop before it must refuse."""
    return max(ALWAYS_LOST, int(LOST * total))


@dataclass(frozen=True, eq=False)
class Numbers:
    """Cells as `values (n,)`, NaN if there is none; `bad` cells of `present` were no numbers, the first in `row`.
    `commas` cells had a decimal comma, `thousands` had thousands separators. `marked` of the bad cells are `MARKS`.

    `commas` cells had a decimal comma, `thousands` had marks between thousands. `marked` of the bad cells are `MARKS`.
    """

    values: NDArray[np.float64]
    present: int
    bad: int = 0
    row: int = 0
    text: str = ""
    commas: int = 0
    thousands: int = 0
    marked: int = 0


@dataclass(frozen=True)
class DecimalSignEvidence:
    """Cells of a column that are readable with one decimal sign only, and those that differ by the sign.

    `point`, `comma` and `either` are the row and the text of the first such cell, None where there is none; the counts
    follow. `numbers` cells can be read at all, of `present`.
    """

    present: int
    numbers: int
    points: int = 0
    commas: int = 0
    undecided: int = 0
    point: tuple[int, str] | None = None
    comma: tuple[int, str] | None = None
    either: tuple[int, str] | None = None


def readings(cell: str) -> tuple[float | None, float | None]:
    """Return the number in `cell` with a decimal point and with a decimal comma; None if it is no such number."""
    cell = _GROUPING.sub("", cell.replace("\u2212", "-"))
    if not _USUAL.fullmatch(cell):
        cell = _APART.sub(r"\1", _FORTRAN.sub(r"\1e\2", cell))
    if _PLAIN.fullmatch(cell):
        return float(cell), float(cell)
    if _ENDLESS.fullmatch(cell):
        return float(cell), float(cell)
    if (one := _ONE.fullmatch(cell)) and (one[2] or one[4]):
        sign, whole, mark, rest, power = one.groups(default="")
        decimal = float(f"{sign}{whole}.{rest}{power}")
        grouped = None
        if not power and len(rest) == 3 and 1 <= len(whole) <= 3 and whole[0] != "0":
            grouped = float(sign + whole + rest)
        return (decimal, grouped) if mark == "." else (grouped, decimal)
    if _SEVERAL.fullmatch(cell) and not ("." in cell and "," in cell):
        grouped = float(cell.replace(".", "").replace(",", ""))
        return (grouped, None) if "," in cell else (None, grouped)
    if _BOTH.fullmatch(cell):
        comma = cell.rfind(",") > cell.rfind(".")
        value = float(cell.replace(".", "").replace(",", ".") if comma else cell.replace(",", ""))
        return (None, value) if comma else (value, None)
    return None, None


def trimmed(cells: Any) -> pa.ChunkedArray | None:
    """Return text cells without surrounding blanks and with null for no value; None for other types."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = cells.type
    if pa.types.is_dictionary(kind):
        return trimmed(cells.cast(kind.value_type))
    if not pa.types.is_string(kind) and not pa.types.is_large_string(kind):
        return None
    text = pc.utf8_trim_whitespace(cells)
    empty = pc.is_in(pc.utf8_lower(text), value_set=pa.array(MISSING, kind))
    return pc.if_else(empty, pa.scalar(None, kind), text)


def evidence_of(cells: Any) -> DecimalSignEvidence | None:
    """Return the evidence of text `cells` on their decimal sign; None for cells that are stored as numbers."""
    import pyarrow as pa
    import pyarrow.compute as pc

    text = trimmed(cells)
    if text is None:
        return None
    present = len(text) - text.null_count
    try:
        text.cast(pa.float64())
    except pa.ArrowInvalid:
        return _by_cell(text, present)
    undecided = pc.match_substring_regex(text, _UNDECIDED)
    points = pc.and_(pc.match_substring(text, "."), pc.invert(undecided))
    return DecimalSignEvidence(
        present,
        present,
        points=pc.sum(points).as_py() or 0,
        undecided=pc.sum(undecided).as_py() or 0,
        point=_first(text, points),
        either=_first(text, undecided),
    )


def _first(text: Any, where: Any) -> tuple[int, str] | None:
    import pyarrow.compute as pc

    row = pc.index(where, True).as_py()
    return None if row < 0 else (row, text[row].as_py())


@dataclass(frozen=True, eq=False)
class _Texts:
    """Different texts of a column in the order of their first rows, the number of rows of each, and the number of the
    text in each row (n,), -1 for none. A column of names or of times in a long table has few."""

    texts: list[str]
    first: NDArray[np.intp]
    count: NDArray[np.intp]
    code: NDArray[np.intp]


def _different(cells: pa.ChunkedArray) -> _Texts:
    """Return the different texts of `cells`, so that each is read once."""
    import pyarrow as pa

    encoded = pa.concat_arrays(cells.chunks) if isinstance(cells, pa.ChunkedArray) and cells.num_chunks else cells
    encoded = pa.array([], cells.type).dictionary_encode() if not len(cells) else encoded.dictionary_encode()
    code = np.asarray(encoded.indices.fill_null(-1).to_numpy(zero_copy_only=False), dtype=np.intp)
    there = np.flatnonzero(code >= 0)
    _, at = np.unique(code[there], return_index=True)
    count = np.bincount(code[there], minlength=len(encoded.dictionary))
    return _Texts(encoded.dictionary.to_pylist(), there[at], count, code)


def _by_cell(cells: pa.ChunkedArray, present: int) -> DecimalSignEvidence:
    numbers = points = commas = undecided = 0
    point = comma = either = None
    found = _different(cells)
    for cell, row, count in zip(found.texts, found.first.tolist(), found.count.tolist(), strict=True):
        with_point, with_comma = readings(cell)
        if with_point is None and with_comma is None:
            continue
        numbers += count
        if with_comma is None:
            points += count
            point = point or (row, cell)
        elif with_point is None:
            commas += count
            comma = comma or (row, cell)
        elif with_point != with_comma:
            undecided += count
            either = either or (row, cell)
    return DecimalSignEvidence(present, numbers, points, commas, undecided, point, comma, either)


class DecimalSignError(ValueError):
    """Error of an undecided decimal sign of a column; the message lacks only the file."""


def decimal_signs(
    columns: Mapping[str, Any], place: Callable[[int], str], *, delimiter: str = "", given: Sign | None = None
) -> dict[str, Sign]:
    """Return the decimal sign of each column of text `columns`, by name.

    Parameters
    ----------
    columns
        Cells by name of column.
    place
        Names a row of the file.
    delimiter
        Of the file's columns, if any.
    given
        The sign that the user names, which then holds for all.

    Raises
    ------
    DecimalSignError
        A column mixes signs, or may be read in two ways.
    """
    found = {name: evidence for name, cells in columns.items() if (evidence := evidence_of(cells)) is not None}
    found = {name: evidence for name, evidence in found.items() if evidence.numbers > evidence.present / 2}
    if given:
        return dict.fromkeys(found, given)
    signs: dict[str, Sign] = {}
    for name, seen in found.items():
        if seen.points and seen.commas and min(seen.points, seen.commas) > may_be_lost(seen.present):
            raise DecimalSignError(_mixed(name, seen, place))
        if seen.points or seen.commas:
            signs[name] = "." if seen.points >= seen.commas else ","
    open_columns = [name for name, seen in found.items() if name not in signs and seen.undecided]
    for name in open_columns if len(set(signs.values())) != 1 else ():
        if (sign := _by_unit(name, columns[name])) is not None:
            signs[name] = sign
    said = set(signs.values())
    for name in open_columns:
        seen = found[name]
        if name in signs or seen.either is None:
            continue
        if len(said) == 1:
            signs[name] = next(iter(said))
            if readings(seen.either[1])[signs[name] == ","] != readings(seen.either[1])[signs[name] != ","]:
                _require_thousands(name, columns[name], seen, signs[name], place)
        elif not said and delimiter == "," and "," not in seen.either[1]:
            # A writer with a decimal comma separates columns by another sign, or quotes every number.
            signs[name] = "."
        else:
            raise DecimalSignError(_undecided(name, seen, place))
    return {name: signs.get(name, ".") for name in found}


def _require_thousands(
    name: str, cells: Any, seen: DecimalSignEvidence, sign: Sign, place: Callable[[int], str]
) -> None:
    """Raise DecimalSignError for marks between thousands, by the other columns alone, in a unit that has no thousands.

    A number from 100 to 999 without a mark shows that the column's marks stand between thousands.
    """
    row, cell = seen.either or (0, "")
    if sign in cell:
        return
    parts = split_column(name)
    if not is_time_name(name) and (parts is None or parts[1] in _OF_THOUSANDS):
        return
    text = trimmed(cells)
    if text is not None and not any(one and _HUNDREDS.fullmatch(one) for one in text.to_pylist()):
        grouped, decimal = readings(cell)[sign == ","], readings(cell)[sign != ","]
        raise DecimalSignError(
            f"column '{name}' can be read in two ways: {place(row)}, '{cell}', is {decimal:.10g}, or {grouped:.10g} by "
            "the decimal sign of the other columns; write all columns with the same sign, and thousands without a mark"
        )


def _by_unit(name: str, cells: Any) -> Sign | None:
    """Return the only sign with which the column's numbers are plausible in its unit, or None."""
    parts = split_column(name)
    if parts is None:
        return None
    low, high = plausible_range(parts[1])
    possible: list[Sign] = []
    signs: tuple[Sign, Sign] = (".", ",")
    for sign in signs:
        numbers = parse(cells, sign)
        values = numbers.values[np.isfinite(numbers.values)] if numbers is not None else np.zeros(0)
        if len(values) and np.mean((values >= low) & (values <= high)) >= 1.0 - LOST:
            possible.append(sign)
    return possible[0] if len(possible) == 1 else None


def _mixed(name: str, seen: DecimalSignEvidence, place: Callable[[int], str]) -> str:
    (point_row, point), (comma_row, comma) = seen.point or (0, ""), seen.comma or (0, "")
    return (
        f"column '{name}' has decimal points ({place(point_row)}, '{point}') and decimal commas ({place(comma_row)}, "
        f"'{comma}'); write all its numbers with the same sign"
    )


def _undecided(name: str, seen: DecimalSignEvidence, place: Callable[[int], str]) -> str:
    row, cell = seen.either or (0, "")
    with_point, with_comma = readings(cell)
    return (
        f"column '{name}' can be read in two ways: {place(row)}, '{cell}', is {with_point:.10g} with a decimal point "
        f"and {with_comma:.10g} with a decimal comma; give --decimal . or --decimal ,"
    )


def parse(cells: Any, sign: Sign = ".") -> Numbers | None:
    """Return `cells` as float64, text with the decimal `sign`; None for a type that holds no numbers."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = cells.type
    if pa.types.is_dictionary(kind):
        return parse(cells.cast(kind.value_type), sign)
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
    text = trimmed(cells)
    if text is None:
        return None
    present = len(text) - text.null_count
    if sign == "." or not pc.any(pc.match_substring_regex(text, "[.,]")).as_py():
        try:
            return Numbers(np.array(text.cast(pa.float64()).to_numpy(), dtype=np.float64), present)
        except pa.ArrowInvalid:
            pass
    return _parsed(text, present, sign)


def _parsed(cells: pa.ChunkedArray, present: int, sign: Sign) -> Numbers:
    found = _different(cells)
    values = np.full(len(found.texts) + 1, np.nan)  # the last is that of a row without text
    bad = row = commas = thousands = marked = 0
    text = ""
    for index, (cell, first, count) in enumerate(
        zip(found.texts, found.first.tolist(), found.count.tolist(), strict=True)
    ):
        value = readings(cell)[sign == ","]
        if value is None:
            if not bad:
                row, text = first, cell
            bad += count
            marked += count * (cell.lower() in MARKS)
            continue
        values[index] = value
        commas += count * (sign in cell and sign == ",")
        thousands += count * (len(_GROUPING.sub("", cell)) < len(cell) or (("," if sign == "." else ".") in cell))
    return Numbers(values[found.code], present, bad, row, text, commas, thousands, marked)
