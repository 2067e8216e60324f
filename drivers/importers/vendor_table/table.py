"""Importer of vendors' register tables: names, addresses, tables, types, scales, units and access."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from drivers.importers.draft import (
    Collector,
    Draft,
    DraftBus,
    DraftPoint,
    ImportFileError,
    placeholder_in,
    read_any_text,
)
from drivers.importers.vendor_table.cells import (
    Addressing,
    access_of,
    address_of,
    bits_of,
    number_of,
    order_of,
    table_of,
    type_of,
)
from drivers.importers.vendor_table.columns import (
    ColumnError,
    ambiguous_thousand,
    has_decimal_comma,
    has_decimal_point,
    is_hexadecimal,
    order_of_swaps,
    raw_ends,
)
from drivers.importers.vendor_table.scale import (
    ScaleError,
    divisor_of,
    factor_in_words,
    factor_of,
    is_exponent_like,
    unit_and_factor,
)
from drivers.importers.vendor_table.words import heading_key
from drivers.signals import RegisterType

_DELIMITERS = (";", "\t", ",", "|")
_REMEDY = "rename it scale (value = raw x scale) or divisor (value = raw / divisor), or take it out"


@dataclass(slots=True)
class _VendorColumns:
    """Columns of a table by key; `inside` are the words in brackets behind their headings."""

    at: dict[str, int] = field(default_factory=dict)
    inside: dict[str, str] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    is_exponent: bool = False
    is_hex: bool = False
    decimal_comma: set[str] = field(default_factory=set)


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
    text = read_any_text(path, encoding, collector.notes)
    rows = _rows(path, text)
    if not rows:
        raise ImportFileError(path, None, "has no line with a heading and values; is this the register table?")
    head_line, head = rows[0]
    if head_line > 1 and "".join(text.splitlines()[: head_line - 1]).strip():
        collector.note(head_line, "is taken for the heading; the lines above it were not used")
    columns = _columns(path, head_line, head, rows[1:])
    draft = Draft(path, [DraftBus("plc", bus)], collector.notes)
    if columns.unused:
        collector.note(head_line, f"columns that were not used: {', '.join(columns.unused)}")
    _number_base(path, head_line, columns, rows[1:], addressing, collector)
    _decimal_signs(columns, rows[1:])
    table = _VendorTable(path, columns, addressing, order, collector)
    for line, row in rows[1:]:
        cells = {key: row[index].strip() if index < len(row) else "" for key, index in columns.at.items()}
        with collector.item(line, cells["name"] or "a line"):
            if len(row) > len(head) and any(cell.strip() for cell in row[len(head) :]):
                said = f"has {len(row)} cells and the heading {len(head)}; quote cells that hold a delimiter"
                raise ImportFileError(path, line, said)
            if any(cells.values()):
                point = collector.point("plc", cells["name"], line, table.keys(line, cells))
                draft.buses[0].points.append(point)
                table.range_of(point, cells)
    table.settle_ranges()
    if addressing != "modicon":
        _note_entity_numbers(draft, collector)
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
        first, known = _heading_of(found)
        if known > most:
            best, most = found[first:], known
    if most < 2 and mistake is not None:  # no heading was found, and quotes that do not close may be the reason
        likely = max(_DELIMITERS, key=text.count)
        raise _parse_error(path, text, likely) or mistake[1]
    return best


_MOST_ABOVE = 20
"""Records above the heading that may hold the title of a sheet and the state of a revision."""


def _heading_of(found: list[tuple[int, list[str]]]) -> tuple[int, int]:
    """Return the place of the first record that names a point and an address, else 0, and how many headings it has."""
    for place, (_, row) in enumerate(found[:_MOST_ABOVE]):
        keys = {heading_key(cell)[0] for cell in row} - {None}
        if {"name", "address"} <= keys:
            return place, len(keys)
    return 0, len({heading_key(cell)[0] for cell in found[0][1]} - {None}) if found else 0


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


def _columns(path: Path, line: int, head: list[str], rows: list[tuple[int, list[str]]]) -> _VendorColumns:
    found = _VendorColumns()
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


_ENTITY_NUMBERS = {"holding": 40000, "input": 30000, "discrete": 10000}


def _note_entity_numbers(draft: Draft, collector: Collector) -> None:
    """Note the first point of every table whose address looks as if the table were its leading digit."""
    noted: set[str] = set()
    for point in draft.buses[0].points:
        table, address = str(point.keys["table"]), int(point.keys["address"])
        first = _ENTITY_NUMBERS.get(table)
        if first is not None and table not in noted and 0 <= address - first < 10000:
            noted.add(table)
            said = f"address {address} in table {table} looks like a Modicon number; is the table --addressing modicon?"
            collector.note(point.line, f"{point.name}: {said}")


def _cells_of(columns: _VendorColumns, key: str, rows: list[tuple[int, list[str]]]) -> list[str]:
    index = columns.at[key]
    return [row[index].strip() for _, row in rows if index < len(row)]


def _number_base(
    path: Path,
    line: int,
    columns: _VendorColumns,
    rows: list[tuple[int, list[str]]],
    addressing: Addressing,
    collector: Collector,
) -> None:
    """Set the base of all addresses, by the heading or else by their digits; raise ImportFileError."""
    inside = columns.inside.get("address", "")
    columns.is_hex = "hex" in inside
    if columns.is_hex or "dec" in inside or addressing == "modicon":
        return
    try:
        columns.is_hex = is_hexadecimal(_cells_of(columns, "address", rows))
    except ColumnError as error:
        raise ImportFileError(path, line, str(error)) from None
    if columns.is_hex:
        collector.note(line, "addresses hold the letters A to F: all of them were read as hexadecimal")


def _decimal_signs(columns: _VendorColumns, rows: list[tuple[int, list[str]]]) -> None:
    """Set the columns whose numbers have a decimal comma: by their own cells, or else by those of the other columns."""
    numeric = [key for key in ("scale", "divisor", "offset", "min", "max") if key in columns.at]
    own = {key for key in numeric if has_decimal_comma(_cells_of(columns, key, rows))}
    unclear = {key for key in numeric if not has_decimal_point(_cells_of(columns, key, rows))}
    columns.decimal_comma = own | (unclear if own else set())


@dataclass(slots=True)
class _VendorTable:
    path: Path
    columns: _VendorColumns
    addressing: Addressing
    order: str
    collector: Collector
    ranges: list[tuple[DraftPoint, str, dict[str, str]]] = field(default_factory=list)

    def keys(self, line: int, cells: dict[str, str]) -> dict[str, Any]:
        """Return the keys of a line's point; raise ImportFileError."""
        path = self.path
        if not cells["name"]:
            raise ImportFileError(path, line, "has no name; give one or take the line out")
        for key, cell in cells.items():
            if key != "doc" and (placeholder := placeholder_in(cell)) is not None:
                raise ImportFileError(path, line, f"{key} is {placeholder}; write what that stands for")
        table, access = table_of(path, line, cells)
        self._decimal_signs_agree(line, cells, ("scale", "divisor", "offset"))
        given, address = address_of(path, line, cells["address"], self.addressing, is_hex=self.columns.is_hex)
        if table is not None and given is not None and table != given:
            raise ImportFileError(
                path, line, f"address {cells['address']} is of table {given} and the line says {table}; correct one"
            )
        table = table or given
        if table is None:
            raise ImportFileError(path, line, "no table; add a column table or function, or use --addressing modicon")
        kind, length = type_of(path, line, cells, table)
        keys: dict[str, Any] = {"table": table, "address": address}
        if table in ("holding", "input"):
            keys["type"] = kind
            keys["order"] = self._order_of(line, cells, kind)
            keys["length"] = length
        keys["bits"] = bits_of(path, line, cells)
        keys["access"] = access_of(path, line, cells) or access
        if keys["access"] == "r" or keys["bits"] is not None or kind == "string":
            keys["access"] = None
        keys["kind"] = "status" if kind in ("bool", "string") or keys["bits"] is not None else None
        keys["unit"] = cells.get("unit", "")
        if kind not in ("bool", "string"):
            keys |= self._scaling(line, cells, address, is_whole="int" in kind and keys["bits"] is None)
        keys["plausible"] = self._plausible(line, cells, kind)
        keys["doc"] = cells.get("doc") or None
        return keys

    def _order_of(self, line: int, cells: dict[str, str], kind: str) -> str | None:
        """Return the order of bytes by the columns order and swap; raise ImportFileError where it is not certain."""
        try:
            swapped = order_of_swaps(cells)
        except ValueError as error:
            raise ImportFileError(self.path, line, str(error)) from None
        if swapped is None:
            return order_of(self.path, line, cells, kind, self.order)
        if swapped in ("BADC", "DCBA") and kind in ("int16", "uint16", "string"):
            raise ImportFileError(self.path, line, f"the bytes of {kind} are swapped, which is not read here")
        if swapped != "ABCD" and (cells.get("order") or self.order != "ABCD"):
            raise ImportFileError(self.path, line, "has an order and a swap besides; leave one of them out")
        return order_of(self.path, line, cells, kind, swapped)

    def _decimal_signs_agree(self, line: int, cells: dict[str, str], names: tuple[str, ...]) -> None:
        """Raise ImportFileError for a number that is a thousand or a fraction by the sign of its column."""
        for key in names:
            text = cells.get(key, "")
            if ambiguous_thousand(text, decimal_comma=key in self.columns.decimal_comma):
                said = f"{key} {text!r} may be a thousand or a fraction beside decimal commas; write 1 or 1000"
                raise ImportFileError(self.path, line, said)

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
        offset = number_of(self.path, line, "offset", text)
        if offset and offset in (address, address + 1):
            said = f"offset {text} is its address; rename the column, or take it out"
            raise ImportFileError(self.path, line, said)
        return offset

    def _plausible(self, line: int, cells: dict[str, str], kind: str) -> list[float] | None:
        low, high = cells.get("min", ""), cells.get("max", "")
        if low in ("", "-") or high in ("", "-") or kind in ("bool", "string"):
            return None
        try:
            self._decimal_signs_agree(line, cells, ("min", "max"))
            return [number_of(self.path, line, "min", low), number_of(self.path, line, "max", high)]
        except ImportFileError as error:
            self.collector.note(line, f"{cells['name']}: {error.what}; no plausible range was taken")
            return None

    def range_of(self, point: DraftPoint, cells: dict[str, str]) -> None:
        """Keep the possible meanings of a point's range until the whole table is known."""
        ends, keys = point.keys.get("plausible"), point.keys
        if ends is not None:
            scale, offset = keys.get("scale", 1.0), keys.get("offset", 0.0)
            meant = raw_ends(ends, scale, offset, cells.get("unit", ""), cast(RegisterType, keys.get("type", "int16")))
            self.ranges.append((point, meant, cells))

    def settle_ranges(self) -> None:
        """Settle the ranges that may be raw counts: a table writes all of them in one way, which some lines show.

        If no line shows it, a point that is only read gets the range that holds both meanings. A point that can be
        written gets a range only if its own line shows that the range is in its unit.
        """
        shown = {meant for _, meant, _ in self.ranges} & {"raw", "unit"}
        for point, meant, cells in self.ranges:
            written = point.keys.get("access") in ("w", "rw")
            if meant in ("unit", "same") or (meant == "either" and shown == {"unit"} and not written):
                continue
            low, high = point.keys.pop("plausible")
            said = "no range was taken, give it in the point's unit"
            if meant == "neither":
                what = "fit neither as values nor as raw counts"
            elif meant == "raw" or shown == {"raw"}:
                what = "are raw counts"
            elif written:
                what = "may be raw counts or values, and the point can be written"
            else:
                what = "may be raw counts or values"
                scale, offset = point.keys.get("scale", 1.0), point.keys.get("offset", 0.0)
                ends = (low, high, low * scale + offset, high * scale + offset)
                point.keys["plausible"] = [min(ends), max(ends)]
                said = "the range that holds both was taken, give the right one in the point's unit"
            self.collector.note(
                point.line, f"{cells['name']}: min {cells['min']} and max {cells['max']} {what}; {said}"
            )
