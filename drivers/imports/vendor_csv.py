"""A vendor's register table: name, address, table or function code, type, scale, offset, unit, access."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any, Literal

from drivers.imports.draft import Collector, Draft, DraftBus, ImportFileError, number, read_text

Addressing = Literal["zero", "one", "modicon"]

_HEADINGS = {
    "name": ("name", "register name", "parameter", "signal", "point", "variable", "tag"),
    "address": ("address", "addr", "register", "register address", "reg", "register number"),
    "table": ("table", "register type", "object type", "input type", "area"),
    "function": ("function", "function code", "fc", "function codes", "modbus function"),
    "type": ("type", "data type", "datatype", "format"),
    "order": ("order", "byte order", "word order", "endianness"),
    "scale": ("scale", "factor", "multiplier", "scaling"),
    "divisor": ("divisor", "divider"),
    "offset": ("offset",),
    "unit": ("unit", "units", "unit of measurement"),
    "access": ("access", "rw", "r/w", "read/write", "permission"),
    "bits": ("bit", "bits"),
    "length": ("length", "registers", "count", "size", "quantity"),
    "min": ("min", "minimum"),
    "max": ("max", "maximum"),
    "doc": ("description", "doc", "comment", "remark", "remarks", "notes", "note"),
}
_AMBIGUOUS = {"gain": "rename it scale (value = raw x scale) or divisor (value = raw / divisor)"}
_TYPES = {
    "bool": "bool",
    "boolean": "bool",
    "bit": "bool",
    "string": "string",
    "str": "string",
    "ascii": "string",
    "char": "string",
    "float": "float32",
    "real": "float32",
    "single": "float32",
    "ieee754": "float32",
    "double": "float64",
    "lreal": "float64",
    "word": "uint16",
    "dword": "uint32",
    "qword": "uint64",
    "short": "int16",
    "ushort": "uint16",
    "enum": "uint16",
    "enum16": "uint16",
    "bitfield": "uint16",
    "bitfield16": "uint16",
    "bitfield32": "uint32",
}
for _size in (16, 32, 64):
    _TYPES |= dict.fromkeys((f"int{_size}", f"s{_size}", f"i{_size}", f"sint{_size}"), f"int{_size}")
    _TYPES |= dict.fromkeys((f"uint{_size}", f"u{_size}", f"unsigned{_size}"), f"uint{_size}")
_TYPES |= {"float32": "float32", "f32": "float32", "real32": "float32", "float64": "float64", "f64": "float64"}
_TABLES = {
    "coil": "coil",
    "coils": "coil",
    "discrete": "discrete",
    "discreteinput": "discrete",
    "discreteinputs": "discrete",
    "holding": "holding",
    "holdingregister": "holding",
    "holdingregisters": "holding",
    "input": "input",
    "inputregister": "input",
    "inputregisters": "input",
}
_OF_FUNCTION = {
    1: "coil",
    5: "coil",
    15: "coil",
    2: "discrete",
    3: "holding",
    6: "holding",
    16: "holding",
    22: "holding",
    23: "holding",
    4: "input",
}
_WRITES = {5, 6, 15, 16, 22, 23}
_ACCESS = {
    "r": "r",
    "ro": "r",
    "read": "r",
    "readonly": "r",
    "w": "w",
    "wo": "w",
    "write": "w",
    "writeonly": "w",
    "rw": "rw",
    "wr": "rw",
    "readwrite": "rw",
}
_OF_LEADING_DIGIT = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}


def import_csv(path: Path, addressing: Addressing | None, bus: dict[str, Any], *, order: str = "ABCD") -> Draft:
    """The draft of a vendor's table; raises ImportFileError with the line and what to do.

    `addressing` says what the table's addresses are: `zero` counts from 0 as the wire does, `one` from 1, `modicon`
    has the table as leading digit (40001 is the first holding register). `bus` are the keys of the bus in the rig
    file, `order` is that of values of more than one register where the table has no column for it.
    """
    if addressing is None:
        raise ImportFileError(
            path, None, "does not say what its addresses count from; give --addressing zero, one or modicon"
        )
    text = read_text(path)
    rows = list(_rows(path, text))
    if not rows:
        raise ImportFileError(path, None, "has no line with a heading and values; is this the register table?")
    head_line, head = rows[0]
    columns, ignored = _columns(path, head_line, head)
    collector = Collector(path)
    draft = Draft(path, [DraftBus("plc", bus)], collector.notes)
    if ignored:
        collector.notes.append(f"columns that were not used: {', '.join(ignored)}")
    for line, row in rows[1:]:
        if len(row) > len(head) and any(cell.strip() for cell in row[len(head) :]):
            raise ImportFileError(
                path, line, f"has {len(row)} cells and the heading {len(head)}; quote cells that hold a delimiter"
            )
        cells = {key: row[index].strip() if index < len(row) else "" for key, index in columns.items()}
        if not any(cells.values()):
            continue
        draft.buses[0].points.append(
            collector.point("plc", cells["name"], line, _keys(path, line, cells, addressing, order))
        )
    if not draft.buses[0].points:
        raise ImportFileError(path, head_line, "has a heading and no line below it; there is nothing to import")
    return draft


def _rows(path: Path, text: str) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line that is neither empty nor a comment."""
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    delimiter = max((";", "\t", ",", "|"), key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    found: list[tuple[int, list[str]]] = []
    try:
        for row in reader:
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#"):
                found.append((reader.line_num, row))
    except csv.Error as error:
        raise ImportFileError(path, reader.line_num, f"is no CSV ({error}); close every quote") from None
    return found


def _columns(path: Path, line: int, head: list[str]) -> tuple[dict[str, int], list[str]]:
    found: dict[str, int] = {}
    ignored: list[str] = []
    for index, cell in enumerate(head):
        heading = re.sub(r"[\s_]+", " ", cell).strip().lower()
        if heading in _AMBIGUOUS:
            raise ImportFileError(path, line, f"column {heading!r} has no agreed meaning; {_AMBIGUOUS[heading]}")
        key = next((key for key, names in _HEADINGS.items() if heading in names), None)
        if key is None:
            if heading:
                ignored.append(cell.strip())
        elif key in found:
            raise ImportFileError(path, line, f"has two columns for {key}; rename the one that is not meant")
        else:
            found[key] = index
    for key in ("name", "address", "type"):
        if key not in found:
            raise ImportFileError(
                path, line, f"has no column for {key}; call one {key} (the first line must be the heading)"
            )
    return found, ignored


def _keys(path: Path, line: int, cells: dict[str, str], addressing: Addressing, order: str) -> dict[str, Any]:
    if not cells["name"]:
        raise ImportFileError(path, line, "has no name; give one or take the line out")
    table, access = _table(path, line, cells)
    given, address = _address(path, line, cells["address"], addressing)
    if table is not None and given is not None and table != given:
        raise ImportFileError(
            path, line, f"address {cells['address']} is of table {given} and the line says {table}; correct one"
        )
    table = table or given
    if table is None:
        raise ImportFileError(
            path, line, f"{cells['name']}: no table; add a column table or function, or use --addressing modicon"
        )
    kind, length = _type(path, line, cells, table)
    keys: dict[str, Any] = {"table": table, "address": address}
    if table in ("holding", "input"):
        keys["type"] = kind
        keys["order"] = _order(path, line, cells, kind, order)
        keys["length"] = length
    keys |= _scaling(path, line, cells, kind)
    keys["bits"] = _bits(path, line, cells)
    low, high = cells.get("min", ""), cells.get("max", "")
    if low and high:
        keys["plausible"] = [_number(path, line, "min", low), _number(path, line, "max", high)]
    keys["access"] = _access(path, line, cells) or access
    if keys["access"] == "r" or keys["bits"] is not None or kind == "string":
        keys["access"] = None
    keys["kind"] = "status" if kind in ("bool", "string") or keys["bits"] is not None else None
    keys["unit"] = cells.get("unit", "")
    keys["doc"] = cells.get("doc") or None
    return keys


def _table(path: Path, line: int, cells: dict[str, str]) -> tuple[str | None, str | None]:
    """Table and access by the columns table and function; None where they say nothing."""
    named = _squeezed(cells.get("table", ""))
    table: str | None = None
    if named:
        table = _TABLES.get(named)
        if table is None:
            raise ImportFileError(
                path, line, f"table {cells['table']!r} is not known; use coil, discrete, holding or input"
            )
    codes = [int(code) for code in re.findall(r"\d{1,3}", cells.get("function", ""))]
    if cells.get("function") and not codes:
        raise ImportFileError(path, line, f"function {cells['function']!r} is no function code; use 1 to 6, 15 or 16")
    for code in codes:
        of_code = _OF_FUNCTION.get(code)
        if of_code is None:
            raise ImportFileError(path, line, f"function {code} reads or writes no table; use 1 to 6, 15 or 16")
        if table is not None and of_code != table:
            raise ImportFileError(path, line, f"function {code} is not for table {table}; correct one of them")
        table = of_code
    writes, reads = bool(_WRITES & set(codes)), bool(set(codes) - _WRITES)
    return table, ("rw" if reads else "w") if writes else None


def _address(path: Path, line: int, text: str, addressing: Addressing) -> tuple[str | None, int]:
    """Table (of a Modicon address) and zero-based address."""
    bare = text.strip().lower()
    if re.fullmatch(r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h", bare):
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
    bare = _squeezed(text)
    signed = re.fullmatch(r"(un)?signed(?:int(?:eger)?)?(16|32|64)(?:bits?)?", bare)
    sized = re.fullmatch(r"(u?)int(?:eger)?(16|32|64)(?:bits?)?", bare)
    string = re.fullmatch(r"(?:string|str|ascii|char)(\d{1,3})", bare)
    length = _length(path, line, cells)
    if table in ("coil", "discrete"):
        if bare and _TYPES.get(bare) != "bool":
            raise ImportFileError(path, line, f"type {text!r} of a {table}, which is one bit; write bool")
        return "bool", None
    if signed is not None:
        kind = f"{'u' if signed[1] else ''}int{signed[2]}"
    elif sized is not None:
        kind = f"{sized[1]}int{sized[2]}"
    elif string is not None:
        kind, length = "string", length or int(string[1])
    elif bare in _TYPES:
        kind = _TYPES[bare]
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


def _scaling(path: Path, line: int, cells: dict[str, str], kind: str) -> dict[str, float]:
    scale, divisor, offset = cells.get("scale", ""), cells.get("divisor", ""), cells.get("offset", "")
    if scale and divisor:
        raise ImportFileError(path, line, "has a scale and a divisor; leave one of them empty")
    found: dict[str, float] = {}
    if scale:
        found["scale"] = _number(path, line, "scale", scale)
    elif divisor:
        by = _number(path, line, "divisor", divisor)
        if by == 0:
            raise ImportFileError(path, line, "divisor 0 is none; correct it")
        found["scale"] = 1.0 / by
    if offset:
        found["offset"] = _number(path, line, "offset", offset)
    return {key: value for key, value in found.items() if value != (1.0 if key == "scale" else 0.0)}


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
    found = _ACCESS.get(_squeezed(text))
    if found is None:
        raise ImportFileError(path, line, f"access {text!r} is not known; use r, w or rw")
    return found


def _squeezed(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())
