"""A vendor's register table: name, address, table or function code, type, scale, offset, unit, access."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from drivers.imports.draft import Collector, Draft, DraftBus, ImportFileError, number, placeholder_in, read_any_text
from drivers.imports.vendor_scale import (
    ScaleError,
    divisor_of,
    factor_in_words,
    factor_of,
    is_exponent_like,
    unit_and_factor,
)
from drivers.imports.vendor_words import ACCESS, OF_FUNCTION, TABLES, TYPES, WRITES, heading_key, squeezed

Addressing = Literal["zero", "one", "modicon"]

_OF_LEADING_DIGIT = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}
_DELIMITERS = (";", "\t", ",", "|")
_REMEDY = "rename it scale (value = raw x scale) or divisor (value = raw / divisor), or take it out"


@dataclass(slots=True)
class _Columns:
    """Where the columns of a table are, by key; `inside` are words in brackets behind their headings."""

    at: dict[str, int] = field(default_factory=dict)
    inside: dict[str, str] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    is_exponent: bool = False


def import_csv(
    path: Path, addressing: Addressing | None, bus: dict[str, Any], *, order: str = "ABCD", encoding: str | None = None
) -> Draft:
    """Return the draft of a vendor's table; raise ImportFileError with the line and the remedy.

    `addressing` is the table's first address: `zero` counts from 0 as the wire does, `one` from 1, `modicon` has the
    table as leading digit (40001 is the first holding register). `bus` are the keys of the bus in the rig file, `order`
    is that of values of more than one register where the table has no column for it. Without `encoding` UTF-8 and
    cp1252 are tried. A line that cannot be used is left out with a note.
    """
    if addressing is None:
        raise ImportFileError(
            path, None, "does not say what its addresses count from; give --addressing zero, one or modicon"
        )
    collector = Collector(path)
    rows = _rows(path, read_any_text(path, encoding, collector.notes))
    if not rows:
        raise ImportFileError(path, None, "has no line with a heading and values; is this the register table?")
    head_line, head = rows[0]
    columns = _columns(path, head_line, head, rows[1:])
    draft = Draft(path, [DraftBus("plc", bus)], collector.notes)
    if columns.unused:
        collector.note(head_line, f"columns that were not used: {', '.join(columns.unused)}")
    table = _Table(path, columns, addressing, order, collector)
    for line, row in rows[1:]:
        cells = {key: row[index].strip() if index < len(row) else "" for key, index in columns.at.items()}
        with collector.item(line, cells["name"] or "a line"):
            if len(row) > len(head) and any(cell.strip() for cell in row[len(head) :]):
                said = f"has {len(row)} cells and the heading {len(head)}; quote cells that hold a delimiter"
                raise ImportFileError(path, line, said)
            if any(cells.values()):
                draft.buses[0].points.append(collector.point("plc", cells["name"], line, table.keys(line, cells)))
    if not draft.buses[0].points:
        raise collector.nothing(head_line, "has a heading and no line below it; there is nothing to import")
    return draft


def _rows(path: Path, text: str) -> list[tuple[int, list[str]]]:
    """Return first line and cells of every record that is neither empty nor a comment.

    The delimiter is the one that finds most of the headings: cells of a heading may hold line breaks.
    """
    best: list[tuple[int, list[str]]] = []
    most, mistake = -1, None
    for delimiter in _DELIMITERS:
        try:
            found = _parsed(path, text, delimiter)
        except ImportFileError as error:
            mistake = mistake or (delimiter, error)
            continue
        known = {heading_key(cell)[0] for cell in found[0][1]} - {None} if found else set()
        if len(known) > most:
            best, most = found, len(known)
    if most < 2 and mistake is not None:  # no heading was found, and quotes that do not close may be the reason
        likely = max(_DELIMITERS, key=text.count)
        raise _parse_error(path, text, likely) or mistake[1]
    return best


def _parsed(path: Path, text: str, delimiter: str) -> list[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    found: list[tuple[int, list[str]]] = []
    first = 1
    try:
        for row in reader:
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#"):
                found.append((first, row))
            first = reader.line_num + 1
    except csv.Error as error:
        raise ImportFileError(path, reader.line_num, f"is no CSV ({error}); close every quote") from None
    return found


def _parse_error(path: Path, text: str, delimiter: str) -> ImportFileError | None:
    try:
        _parsed(path, text, delimiter)
    except ImportFileError as error:
        return error
    return None


def _columns(path: Path, line: int, head: list[str], rows: list[tuple[int, list[str]]]) -> _Columns:
    found = _Columns()
    for index, cell in enumerate(head):
        key, inside = heading_key(cell)
        called = " ".join(cell.split())
        values = [row[index].strip() for _, row in rows if index < len(row)]
        if key == "?":
            if any(value not in ("", "-") for value in values):
                raise ImportFileError(path, line, f"column {called.lower()!r} has no agreed meaning; {_REMEDY}")
        elif key is None:
            if called:
                found.unused.append(called)
        elif key in found.at:
            if key == "address" and {inside, found.inside[key]} == {"hex", "dec"}:  # one address, written twice
                found.unused.append(head[found.at[key]] if inside == "dec" else called)
                if inside != "dec":
                    continue
            else:
                raise ImportFileError(path, line, f"has two columns for {key}; rename the one that is not meant")
        if key not in (None, "?"):
            found.at[str(key)], found.inside[str(key)] = index, inside
            if key == "scale":
                is_factor = any(re.fullmatch(r"0[.,]\d+|1/\d+", value) for value in values)
                found.is_exponent = not is_factor and any(is_exponent_like(value) for value in values)
    for key in ("name", "address", "type"):
        if key not in found.at:
            raise ImportFileError(
                path, line, f"has no column for {key}; call one {key} (the first line must be the heading)"
            )
    return found


@dataclass(slots=True)
class _Table:
    path: Path
    columns: _Columns
    addressing: Addressing
    order: str
    collector: Collector

    def keys(self, line: int, cells: dict[str, str]) -> dict[str, Any]:
        """Return the keys of a line's point; raise ImportFileError."""
        path = self.path
        if not cells["name"]:
            raise ImportFileError(path, line, "has no name; give one or take the line out")
        for key, cell in cells.items():
            if key != "doc" and (placeholder := placeholder_in(cell)) is not None:
                raise ImportFileError(path, line, f"{key} is {placeholder}; write what that stands for")
        table, access = _table(path, line, cells)
        is_hex = "hex" in self.columns.inside.get("address", "")
        given, address = _address(path, line, cells["address"], self.addressing, is_hex=is_hex)
        if table is not None and given is not None and table != given:
            raise ImportFileError(
                path, line, f"address {cells['address']} is of table {given} and the line says {table}; correct one"
            )
        table = table or given
        if table is None:
            raise ImportFileError(path, line, "no table; add a column table or function, or use --addressing modicon")
        kind, length = _type(path, line, cells, table)
        keys: dict[str, Any] = {"table": table, "address": address}
        if table in ("holding", "input"):
            keys["type"] = kind
            keys["order"] = _order(path, line, cells, kind, self.order)
            keys["length"] = length
        keys["bits"] = _bits(path, line, cells)
        keys["access"] = _access(path, line, cells) or access
        if keys["access"] == "r" or keys["bits"] is not None or kind == "string":
            keys["access"] = None
        keys["kind"] = "status" if kind in ("bool", "string") or keys["bits"] is not None else None
        keys["unit"] = cells.get("unit", "")
        if kind not in ("bool", "string"):
            keys |= self._scaling(line, cells, address, is_whole="int" in kind and keys["bits"] is None)
        keys["plausible"] = self._plausible(line, cells)
        keys["doc"] = cells.get("doc") or None
        return keys

    def _scaling(self, line: int, cells: dict[str, str], address: int, *, is_whole: bool) -> dict[str, Any]:
        """Return scale, offset and the unit without its factor; raise ImportFileError where a factor is not certain."""
        factors: dict[str, float] = {}
        try:
            scale = factor_of(cells.get("scale", ""), is_exponent_column=self.columns.is_exponent)
            divided = divisor_of(cells.get("divisor", ""))
            unit, in_unit = unit_and_factor(cells.get("unit", ""))
        except ScaleError as error:
            raise ImportFileError(self.path, line, str(error)) from None
        for what, factor in (("a scale", scale), ("a divisor", divided), ("a factor in its unit", in_unit)):
            if factor is not None:
                factors[what] = factor
        if len(factors) > 1 and ((scale is not None and divided is not None) or set(factors.values()) != {1.0}):
            raise ImportFileError(self.path, line, f"has {' and '.join(factors)}; leave one of them empty")
        if is_whole and not factors:
            words = factor_in_words(cells["name"], cells.get("doc", ""))
            if words is not None:
                said = f"its name or remark says {words!r}; put the factor in a column scale, 1 where there is none"
                raise ImportFileError(self.path, line, said)
        keys: dict[str, Any] = {"unit": unit}
        value = next(iter(factors.values()), 1.0)
        if value != 1.0:
            keys["scale"] = value
        offset = self._offset(line, cells, address)
        if offset:
            keys["offset"] = offset
            self.collector.note(line, f"{cells['name']}: taken as raw x {value:g} + {offset:g}; see if that is meant")
        return keys

    def _offset(self, line: int, cells: dict[str, str], address: int) -> float:
        """Return the offset of a value; raise ImportFileError where it counts with the addresses."""
        text = cells.get("offset", "")
        if text in ("", "-"):
            return 0.0
        offset = _number(self.path, line, "offset", text)
        if offset and offset in (address, address + 1):
            said = f"offset {text} is its address; rename the column, or take it out"
            raise ImportFileError(self.path, line, said)
        return offset

    def _plausible(self, line: int, cells: dict[str, str]) -> list[float] | None:
        low, high = cells.get("min", ""), cells.get("max", "")
        if low in ("", "-") or high in ("", "-"):
            return None
        try:
            found = [_number(self.path, line, "min", low), _number(self.path, line, "max", high)]
        except ImportFileError as error:
            self.collector.note(line, f"{cells['name']}: {error.what}; no plausible range was taken")
            return None
        return found


def _table(path: Path, line: int, cells: dict[str, str]) -> tuple[str | None, str | None]:
    """Return table and access by the columns table and function; None where they say nothing."""
    named = squeezed(cells.get("table", ""))
    table: str | None = None
    if named:
        table = TABLES.get(named)
        if table is None:
            raise ImportFileError(
                path, line, f"table {cells['table']!r} is not known; use coil, discrete, holding or input"
            )
    codes = [int(code) for code in re.findall(r"\d{1,3}", cells.get("function", ""))]
    if cells.get("function") and not codes:
        raise ImportFileError(path, line, f"function {cells['function']!r} is no function code; use 1 to 6, 15 or 16")
    for code in codes:
        of_code = OF_FUNCTION.get(code)
        if of_code is None:
            raise ImportFileError(path, line, f"function {code} reads or writes no table; use 1 to 6, 15 or 16")
        if table is not None and of_code != table:
            raise ImportFileError(path, line, f"function {code} is not for table {table}; correct one of them")
        table = of_code
    writes, reads = bool(WRITES & set(codes)), bool(set(codes) - WRITES)
    return table, ("rw" if reads else "w") if writes else None


def _address(path: Path, line: int, text: str, addressing: Addressing, *, is_hex: bool) -> tuple[str | None, int]:
    """Return the table of a Modicon address, or None, and the zero-based address."""
    bare = text.strip().lower()
    if re.fullmatch(r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h", bare) or (is_hex and re.fullmatch(r"[0-9a-f]{1,5}", bare)):
        value, digits = int(bare.removeprefix("0x").removesuffix("h"), 16), ""
    elif re.fullmatch(r"\d{1,7}", bare):
        value, digits = int(bare), bare
    else:
        raise ImportFileError(path, line, f"address {text!r} is no address; write it as 100 or 0x64, one a line")
    if addressing == "modicon":
        if len(digits) not in (5, 6) or digits[0] not in _OF_LEADING_DIGIT or int(digits[1:]) < 1:
            raise ImportFileError(
                path,
                line,
                f"address {text!r} is no Modicon address (40001 or 400001 is the first holding register); correct it, "
                "or use --addressing zero or one",
            )
        table, value = _OF_LEADING_DIGIT[digits[0]], int(digits[1:]) - 1
    else:
        table = None
        if addressing == "one":
            if value < 1:
                raise ImportFileError(path, line, "address 0 in a table that counts from one; use --addressing zero")
            value -= 1
    if value > 65535:
        raise ImportFileError(
            path, line, f"address {text} is beyond the last one, 65535; is the table --addressing modicon?"
        )
    return table, value


def _type(path: Path, line: int, cells: dict[str, str], table: str) -> tuple[str, int | None]:
    text = cells["type"]
    bare = squeezed(text)
    signed = re.fullmatch(r"(un)?signed(?:int(?:eger)?)?(16|32|64)(?:bits?)?", bare)
    sized = re.fullmatch(r"(u?)int(?:eger)?(16|32|64)(?:bits?)?", bare)
    string = re.fullmatch(r"(?:string|str|ascii|char)(\d{1,3})", bare)
    length = _length(path, line, cells)
    if table in ("coil", "discrete"):
        if bare and TYPES.get(bare) != "bool":
            raise ImportFileError(path, line, f"type {text!r} of a {table}, which is one bit; write bool")
        return "bool", None
    if signed is not None:
        kind = f"{'u' if signed[1] else ''}int{signed[2]}"
    elif sized is not None:
        kind = f"{sized[1]}int{sized[2]}"
    elif string is not None:
        kind, length = "string", length or int(string[1])
    elif bare in TYPES:
        kind = TYPES[bare]
    else:
        raise ImportFileError(
            path,
            line,
            f"type {text!r} is not known; use bool, int16, uint16, int32, uint32, int64, uint64, float32, float64 or "
            "string",
        )
    if kind == "string" and length is None:
        raise ImportFileError(path, line, f"type {text!r} needs its number of registers; add a column length")
    width = {"32": 2, "64": 4}.get(kind[-2:], 1)
    if kind != "string" and length is not None and length != width:
        raise ImportFileError(path, line, f"{kind} takes {width} registers and the line says {length}; correct one")
    return kind, length if kind == "string" else None


def _length(path: Path, line: int, cells: dict[str, str]) -> int | None:
    text = cells.get("length", "")
    if not text:
        return None
    if not re.fullmatch(r"\d{1,3}", text) or not 1 <= int(text) <= 125:
        raise ImportFileError(path, line, f"length {text!r} is no number of registers from 1 to 125; correct it")
    return int(text)


def _order(path: Path, line: int, cells: dict[str, str], kind: str, default: str) -> str | None:
    if kind in ("bool", "int16", "uint16", "string"):
        return None
    text = cells.get("order", "").upper() or default
    if text not in ("ABCD", "CDAB", "BADC", "DCBA"):
        raise ImportFileError(path, line, f"order {text!r} is not known; use ABCD, CDAB, BADC or DCBA")
    return text


def _number(path: Path, line: int, what: str, text: str) -> float:
    """A number, also with a decimal comma or as a fraction such as 1/10."""
    bare = text.replace(" ", "")
    fraction = re.fullmatch(r"(-?\d{1,9})/(\d{1,9})", bare)
    if fraction is not None and int(fraction[2]):
        return number(path, line, what, int(fraction[1]) / int(fraction[2]))
    if re.fullmatch(r"-?\d+,\d+", bare):
        if re.fullmatch(r"-?[1-9]\d{0,2},\d{3}", bare):
            raise ImportFileError(path, line, f"{what} {text!r} may be a thousand or a fraction; write it with a point")
        bare = bare.replace(",", ".")
    return number(path, line, what, bare)


def _bits(path: Path, line: int, cells: dict[str, str]) -> list[int] | None:
    text = cells.get("bits", "")
    if not text:
        return None
    match = re.fullmatch(r"(\d{1,2})(?:\s*(?:-|\.\.|:|to)\s*(\d{1,2}))?", text)
    if match is None:
        raise ImportFileError(path, line, f"bits {text!r} are none; write 3 for bit 3 or 4-7, bit 0 being the lowest")
    ends = sorted((int(match[1]), int(match[2] or match[1])))
    return [ends[0], ends[1]]


def _access(path: Path, line: int, cells: dict[str, str]) -> str | None:
    text = cells.get("access", "")
    if not text:
        return None
    found = ACCESS.get(squeezed(text))
    if found is None:
        raise ImportFileError(path, line, f"access {text!r} is not known; use r, w or rw")
    return found
