"""Importer of vendors' register tables: names, addresses, tables, types, scales, units and access."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.importers.draft import (
    Collector,
    Draft,
    ImportFileError,
    placeholder_in,
    read_any_text,
)
from drivers.importers.sections import Sections
from drivers.importers.vendor_table.addresses import Addresses, Addressing
from drivers.importers.vendor_table.cells import (
    access_of,
    bits_of,
    device_of,
    function_codes,
    invalid_of,
    number_of,
    order_of,
    refuse_inverted,
    table_of,
    type_of,
)
from drivers.importers.vendor_table.columns import (
    ColumnError,
    Rows,
    VendorColumns,
    addressing_of,
    ambiguous_thousand,
    columns_of,
    has_decimal_comma,
    has_decimal_point,
    is_hexadecimal,
    order_of_swaps,
)
from drivers.importers.vendor_table.headings import heading_key
from drivers.importers.vendor_table.ranges import PlausibleRanges, RangeScale, require_values, scale_of_range
from drivers.importers.vendor_table.remarks import doubt_in_remark, number_in_remark
from drivers.importers.vendor_table.scale import (
    ScaleError,
    divisor_of,
    factor_of,
    unit_and_factor,
)
from drivers.signals import WIDTH

_DELIMITERS = (";", "\t", ",", "|")


def import_csv(
    path: Path,
    addressing: Addressing | None,
    bus: dict[str, Any],
    *,
    order: str | None = None,
    encoding: str | None = None,
    is_device_given: bool = False,
) -> Draft:
    """Return the draft of a vendor's table.

    A line that cannot be used is left out with a note. A column of unit ids makes a bus for each device.

    Parameters
    ----------
    path
        The table, as CSV.
    addressing
        First address of the table: ``zero`` counts from 0 as the wire does, ``one`` from 1, ``modicon`` has the table
        as leading digit (40001 is the first holding register). None is refused: no table shows it safely.
    bus
        Keys of the bus in the rig file.
    order
        Order of values of more than one register, where the table has no column for it; without it, ABCD is guessed.
    encoding
        Encoding of the file; without it, UTF-8 and cp1252 are tried.
    is_device_given
        True if the user named the device of `bus`; a column of unit ids is refused then.

    Raises
    ------
    ImportFileError
        The table cannot be used; the message has the line and the remedy.
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
    columns = columns_of(path, head_line, head, rows[1:])
    if is_device_given and "device" in columns.at:
        said = f"column {columns.called['device']!r} and --device-id both name the device; leave one of them out"
        raise ImportFileError(path, head_line, said)
    if columns.unused:
        collector.note(head_line, f"columns that were not used: {', '.join(columns.unused)}")
    _number_base(path, head_line, columns, rows[1:], addressing, collector)
    _decimal_signs(columns, rows[1:])
    ranges = PlausibleRanges(path, collector, columns.decimal_comma)
    addresses = Addresses(path, _cells_of(columns, "address", rows[1:]), addressing, columns.is_hex)
    if addresses.are_fractions:
        collector.note(
            head_line, "all addresses end in .0: they were read as whole numbers, as a spreadsheet writes them"
        )
    table = _VendorTable(path, columns, addresses, order, collector, ranges)
    buses = Sections()
    for line, row in rows[1:]:
        cells = columns.cells(row)
        with collector.item(line, cells["name"] or "a line"):
            if len(row) > len(head) and any(cell.strip() for cell in row[len(head) :]):
                said = f"has {len(row)} cells and the heading {len(head)}; quote cells that hold a delimiter"
                raise ImportFileError(path, line, said)
            if any(cells.values()):
                keys, guessed = table.keys(line, cells)
                device = device_of(path, line, cells)
                owner = buses.of(path, line, bus if device is None else bus | {"device_id": device})
                if device is None and not is_device_given:
                    owner.remarks["device_id"] = "guessed: no column and no --device-id gives it"
                point = collector.point(owner.name, cells["name"], line, keys, guessed)
                owner.points.append(point)
                if WIDTH.get(point.keys.get("type", "uint16")) == 1:  # One register, or one bit.
                    owner.written_with(line, function_codes(cells), collector)
                ranges.add(point, cells)
    ranges.settle()
    draft = Draft(path, buses.with_points(), collector.notes)
    if not draft.buses:
        raise collector.nothing(head_line, "has a heading and no line below it; there is nothing to import")
    if addressing != "modicon":
        _note_entity_numbers(draft, collector)
    if "device" in columns.at:
        devices = ", ".join(f"{found.keys['device_id']} is {found.name}" for found in draft.buses)
        collector.note(head_line, f"devices are taken from column {columns.called['device']!r}: {devices}")
    return draft


def _rows(path: Path, text: str) -> Rows:
    """Return first line and cells of every record that is neither empty nor a comment.

    The delimiter is the one that finds most of the headings: cells of a heading may hold line breaks.
    """
    best: Rows = []
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


def _heading_of(found: Rows) -> tuple[int, int]:
    """Return the place of the first record that names a point and an address, else 0, and how many headings it has."""
    for place, (_, row) in enumerate(found[:_MOST_ABOVE]):
        keys = {heading_key(cell)[0] for cell in row} - {None}
        if {"name", "address"} <= keys:
            return place, len(keys)
    return 0, len({heading_key(cell)[0] for cell in found[0][1]} - {None}) if found else 0


def _parsed(path: Path, text: str, delimiter: str) -> Rows:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    found: Rows = []
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


_ENTITY_NUMBERS = {"holding": 40000, "input": 30000, "discrete": 10000}


def _note_entity_numbers(draft: Draft, collector: Collector) -> None:
    """Note the first point of every table whose address looks as if the table were its leading digit."""
    noted: set[str] = set()
    for point in (point for bus in draft.buses for point in bus.points):
        table, address = str(point.keys["table"]), int(point.keys["address"])
        first = _ENTITY_NUMBERS.get(table)
        if first is not None and table not in noted and 0 <= address - first < 10000:
            noted.add(table)
            said = f"address {address} in table {table} looks like a Modicon number; is the table --addressing modicon?"
            collector.note(point.line, f"{point.name}: {said}")


def _cells_of(columns: VendorColumns, key: str, rows: Rows) -> list[str]:
    index = columns.at[key]
    return [row[index].strip() for _, row in rows if index < len(row)]


def _number_base(
    path: Path,
    line: int,
    columns: VendorColumns,
    rows: Rows,
    addressing: Addressing,
    collector: Collector,
) -> None:
    """Set the base of all addresses, by the heading or else by their digits; raise ImportFileError."""
    inside = columns.inside.get("address", "")
    stated = addressing_of(inside)
    if stated is not None and stated != addressing:
        said = f"column {columns.called['address']!r} does not count as --addressing {addressing}; use {stated}"
        raise ImportFileError(path, line, said)
    columns.is_hex = "hex" in inside
    if columns.is_hex or "dec" in inside or addressing == "modicon":
        return
    try:
        columns.is_hex = is_hexadecimal(_cells_of(columns, "address", rows))
    except ColumnError as error:
        raise ImportFileError(path, line, str(error)) from None
    if columns.is_hex:
        collector.note(line, "addresses hold the letters A to F: all of them were read as hexadecimal")


_NUMERIC = ("scale", "divisor", "offset", "min", "max", "raw_min", "raw_max", "eng_min", "eng_max")


def _decimal_signs(columns: VendorColumns, rows: Rows) -> None:
    """Set the columns whose numbers have a decimal comma: by their own cells, or else by those of the other columns."""
    numeric = [key for key in _NUMERIC if key in columns.at]
    own = {key for key in numeric if has_decimal_comma(_cells_of(columns, key, rows))}
    unclear = {key for key in numeric if not has_decimal_point(_cells_of(columns, key, rows))}
    columns.decimal_comma = own | (unclear if own else set())


@dataclass(slots=True)
class _VendorTable:
    path: Path
    columns: VendorColumns
    addresses: Addresses
    order: str | None
    collector: Collector
    ranges: PlausibleRanges

    def keys(self, line: int, cells: dict[str, str]) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the keys of a line's point, and the reason for each that is guessed; raise ImportFileError."""
        path = self.path
        guessed: dict[str, str] = {}
        if not cells["name"]:
            raise ImportFileError(path, line, "has no name; give one or take the line out")
        for key, cell in cells.items():
            if key != "doc" and (placeholder := placeholder_in(cell)) is not None:
                raise ImportFileError(path, line, f"{key} is {placeholder}; write what that stands for")
        table, access = table_of(path, line, cells)
        self._decimal_signs_agree(line, cells, ("scale", "divisor", "offset"))
        where = self.addresses.read(line, cells["address"])
        given, address = where.table, where.address
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
            if self.order is None and not any(cells.get(key) for key in ("order", "swap", "word_swap", "byte_swap")):
                guessed["order"] = "high word first, as the Modbus standard has it; compare a known value"
        column = bits_of(path, line, cells)
        keys["bits"] = self.addresses.bits(line, where, kind, table, column)
        registers = (length or 0) if kind == "string" else WIDTH.get(kind, 1)
        self.addresses.require_width(line, where, kind, registers)
        if keys["bits"] is not None and column is None and (doubt := self.addresses.doubt(where)) is not None:
            self.collector.note(line, f"{cells['name']}: {doubt}")
            guessed["bits"] = "see the note on this line of the source"
        if self.columns.is_hex and "hex" not in self.columns.inside.get("address", "") and "x" not in cells["address"]:
            guessed["address"] = "taken as hexadecimal"
        if kind == "bool" and keys["bits"] is not None and "type" in keys:
            keys["type"] = "uint16"  # The type of the bit; its register is read as a whole.
        keys["access"] = access_of(path, line, cells) or access
        if keys["bits"] is not None and "w" in (keys["access"] or ""):
            self.collector.note(
                line, f"{cells['name']}: a bit of a register is read only here; its access was not used"
            )
        if keys["access"] is None and table in ("holding", "coil") and keys["bits"] is None and kind != "string":
            keys["access"] = "r"
            guessed["access"] = "no column gives it, so that it is only read"
        elif keys["access"] == "r" or keys["bits"] is not None or kind == "string":
            keys["access"] = None
        keys["kind"] = "status" if kind in ("bool", "string") or keys["bits"] is not None else None
        keys["unit"] = cells.get("unit", "")
        keys["invalid"] = invalid_of(path, line, cells)
        refuse_inverted(path, line, cells)
        ranged = None
        if kind not in ("bool", "string"):
            scaled, ranged = self._scaling(line, cells, address, kind)
            keys |= scaled
            if not cells.get("unit"):
                keys["unit"] = ""
            if ranged is not None:
                guessed |= dict.fromkeys(("scale", "offset"), "by the raw range")
            elif "offset" in scaled:
                guessed["offset"] = "taken as raw x scale + offset"
            if "int" in kind and keys["unit"] and keys["bits"] is None and not self._has_factor(cells):
                keys.setdefault("scale", 1.0)
                guessed.setdefault("scale", "no factor is given")
        keys["plausible"] = self.ranges.ends(line, cells, kind, ranged)
        keys["doc"] = cells.get("doc") or None
        return keys, guessed

    def _has_factor(self, cells: dict[str, str]) -> bool:
        """Return True where a column or the unit of a line, all of them certain, gives the value of one count."""
        certain = {
            "is_exponent_column": self.columns.is_exponent,
            "is_value_of_a_count": self.columns.is_value_of_a_count,
        }
        scale = factor_of(cells.get("scale", ""), **certain)
        divided, (_, in_unit) = divisor_of(cells.get("divisor", "")), unit_and_factor(cells.get("unit", ""))
        return any(factor is not None for factor in (scale, divided, in_unit))

    def _order_of(self, line: int, cells: dict[str, str], kind: str) -> str | None:
        """Return the order of bytes by the columns order and swap; raise ImportFileError where it is not certain."""
        try:
            swapped = order_of_swaps(cells)
        except ValueError as error:
            raise ImportFileError(self.path, line, str(error)) from None
        if swapped is None:
            return order_of(self.path, line, cells, kind, self.order or "ABCD")
        if swapped in ("BADC", "DCBA") and kind in ("int16", "uint16", "string"):
            raise ImportFileError(self.path, line, f"the bytes of {kind} are swapped, which is not read here")
        if swapped != "ABCD" and (cells.get("order") or self.order not in (None, "ABCD")):
            raise ImportFileError(self.path, line, "has an order and a swap besides; leave one of them out")
        return order_of(self.path, line, cells, kind, swapped)

    def _decimal_signs_agree(self, line: int, cells: dict[str, str], names: tuple[str, ...]) -> None:
        """Raise ImportFileError for a number that is a thousand or a fraction by the sign of its column."""
        for key in names:
            text = cells.get(key, "")
            if ambiguous_thousand(text, decimal_comma=key in self.columns.decimal_comma):
                said = f"{key} {text!r} may be a thousand or a fraction beside decimal commas; write 1 or 1000"
                raise ImportFileError(self.path, line, said)

    def _scaling(
        self, line: int, cells: dict[str, str], address: int, kind: str
    ) -> tuple[dict[str, Any], RangeScale | None]:
        """Return scale, offset and the unit without its factor, and the raw range of which they are.

        Raises ImportFileError where a factor is not certain, or where two of them contradict.
        """
        factors: dict[str, float] = {}
        try:
            scale = factor_of(
                cells.get("scale", ""),
                is_exponent_column=self.columns.is_exponent,
                is_value_of_a_count=self.columns.is_value_of_a_count,
            )
            divided = divisor_of(cells.get("divisor", ""))
            unit, in_unit = unit_and_factor(cells.get("unit", ""))
        except ScaleError as error:
            raise ImportFileError(self.path, line, str(error)) from None
        for what, factor in (("a scale", scale), ("a divisor", divided), ("a factor in its unit", in_unit)):
            if factor is not None:
                factors[what] = factor
        if len(factors) > 1 and ((scale is not None and divided is not None) or set(factors.values()) != {1.0}):
            raise ImportFileError(self.path, line, f"has {' and '.join(factors)}; leave one of them empty")
        value = next(iter(factors.values()), 1.0)
        comma = self.columns.decimal_comma
        ranged = scale_of_range(self.path, line, cells, kind, comma, has_factor=bool(factors))
        if not cells.get("bits"):
            self._remark_agrees(line, cells, kind, has_factor=bool(factors) or ranged is not None)
        offset = self._offset(line, cells, address)
        called = f"{cells['name']}: taken as raw x"
        if ranged is not None:
            given = ranged.scale if not factors else value
            if not ranged.agrees(given, ranged.offset if offset is None else offset):
                low, high = ranged.raw
                said = (
                    f"its raw range {low:g} to {high:g} gives raw x {ranged.scale:g} + {ranged.offset:g}, and its "
                    f"scale or offset raw x {given:g} + {offset or 0:g}; correct one of them, or leave it empty"
                )
                raise ImportFileError(self.path, line, said)
            value, offset = ranged.scale, ranged.offset
            ends = f"{ranged.raw[0]:g} to {ranged.raw[1]:g} is {ranged.engineering[0]:g} to {ranged.engineering[1]:g}"
            self.collector.note(line, f"{called} {value:g} + {offset:g}, by its raw range: {ends} {unit}".rstrip())
        else:
            require_values(self.path, line, cells, kind, value, offset or 0.0)
        if ranged is None and offset:
            self.collector.note(line, f"{called} {value:g} + {offset:g}; see if that is meant")
        keys: dict[str, Any] = {"unit": unit}
        if value != 1.0:
            keys["scale"] = value
        if offset:
            keys["offset"] = offset
        return keys, ranged

    def _remark_agrees(self, line: int, cells: dict[str, str], kind: str, *, has_factor: bool) -> None:
        """Raise ImportFileError where a remark makes it uncertain how the value is read; note a number in it."""
        doubt = doubt_in_remark(cells, kind, WIDTH.get(kind, 1), has_factor=has_factor, order=self.order or "ABCD")
        if doubt is not None:
            raise ImportFileError(self.path, line, doubt)
        if "int" in kind and not has_factor and (number := number_in_remark(cells.get("doc", ""))) is not None:
            said = f"taken as raw x 1; its remark has {number!r}, which no column explains: see if that is a factor"
            self.collector.note(line, f"{cells['name']}: {said}")

    def _offset(self, line: int, cells: dict[str, str], address: int) -> float | None:
        """Return the offset of a value, None where there is none; raise ImportFileError where it is the address."""
        text = cells.get("offset", "")
        if text in ("", "-"):
            return None
        offset = number_of(self.path, line, "offset", text)
        if offset and offset in (address, address + 1):
            said = f"offset {text} is its address; rename the column, or take it out"
            raise ImportFileError(self.path, line, said)
        return offset
