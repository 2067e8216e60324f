"""Cells of a vendor's register table: table and function code, address, type, order, number, bits, access."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from drivers.importers.draft import ImportFileError, number
from drivers.importers.vendor_table.words import ACCESS, OF_FUNCTION, TABLES, TYPES, WRITES, squeezed

Addressing = Literal["zero", "one", "modicon"]
_OF_LEADING_DIGIT = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}


def table_of(path: Path, line: int, cells: dict[str, str]) -> tuple[str | None, str | None]:
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


def address_of(path: Path, line: int, text: str, addressing: Addressing, *, is_hex: bool) -> tuple[str | None, int]:
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


def type_of(path: Path, line: int, cells: dict[str, str], table: str) -> tuple[str, int | None]:
    """Return type and number of registers of a string; raise ImportFileError."""
    text = cells["type"]
    bare = squeezed(text)
    signed = re.fullmatch(r"(un)?signed(?:int(?:eger)?)?(16|32|64)(?:bits?)?", bare)
    sized = re.fullmatch(r"(u?)int(?:eger)?(16|32|64)(?:bits?)?", bare)
    string = re.fullmatch(r"(?:string|str|ascii|char)(\d{1,3})", bare)
    length = length_of(path, line, cells)
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


def length_of(path: Path, line: int, cells: dict[str, str]) -> int | None:
    """Return the number of registers, None where the cell is empty; raise ImportFileError."""
    text = cells.get("length", "")
    if not text:
        return None
    if not re.fullmatch(r"\d{1,3}", text) or not 1 <= int(text) <= 125:
        raise ImportFileError(path, line, f"length {text!r} is no number of registers from 1 to 125; correct it")
    return int(text)


def order_of(path: Path, line: int, cells: dict[str, str], kind: str, default: str) -> str | None:
    """Return the order of bytes, None for values of one register and texts; raise ImportFileError."""
    if kind in ("bool", "int16", "uint16", "string"):
        return None
    text = cells.get("order", "").upper() or default
    if text not in ("ABCD", "CDAB", "BADC", "DCBA"):
        raise ImportFileError(path, line, f"order {text!r} is not known; use ABCD, CDAB, BADC or DCBA")
    return text


def number_of(path: Path, line: int, what: str, text: str) -> float:
    """Return a number, also with a decimal comma or as a fraction such as 1/10; raise ImportFileError."""
    bare = text.replace(" ", "")
    fraction = re.fullmatch(r"(-?\d{1,9})/(\d{1,9})", bare)
    if fraction is not None and int(fraction[2]):
        return number(path, line, what, int(fraction[1]) / int(fraction[2]))
    if re.fullmatch(r"-?\d+,\d+", bare):
        if re.fullmatch(r"-?[1-9]\d{0,2},\d{3}", bare):
            raise ImportFileError(path, line, f"{what} {text!r} may be a thousand or a fraction; write it with a point")
        bare = bare.replace(",", ".")
    return number(path, line, what, bare)


def bits_of(path: Path, line: int, cells: dict[str, str]) -> list[int] | None:
    """Return lowest and highest bit, None where the cell is empty; raise ImportFileError."""
    text = cells.get("bits", "")
    if not text:
        return None
    match = re.fullmatch(r"(\d{1,2})(?:\s*(?:-|\.\.|:|to)\s*(\d{1,2}))?", text)
    if match is None:
        raise ImportFileError(path, line, f"bits {text!r} are none; write 3 for bit 3 or 4-7, bit 0 being the lowest")
    ends = sorted((int(match[1]), int(match[2] or match[1])))
    return [ends[0], ends[1]]


def access_of(path: Path, line: int, cells: dict[str, str]) -> str | None:
    """Return r, w or rw, None where the cell is empty; raise ImportFileError."""
    text = cells.get("access", "")
    if not text:
        return None
    found = ACCESS.get(squeezed(text))
    if found is None:
        raise ImportFileError(path, line, f"access {text!r} is not known; use r, w or rw")
    return found
