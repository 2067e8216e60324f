"""Cells of a vendor's register table: table and function code, type, order, number, bits, access."""

from __future__ import annotations

import re
from pathlib import Path

from drivers.importers.draft import ImportFileError, number
from drivers.importers.vendor_table.words import ACCESS, NO, OF_FUNCTION, SIGNS, TABLES, TYPES, WRITES, YES, squeezed
from drivers.signals import UNSIGNED


def function_codes(cells: dict[str, str]) -> list[int]:
    """Return the function codes of a line: `03/06/16`, `FC 16`, `0x10` or `10h`."""
    text = cells.get("function", "").lower()
    found = re.findall(r"0x([0-9a-f]{1,2})\b|\b([0-9a-f]{1,2})h\b|(\d{1,3})", text)
    return [
        int(prefixed or suffixed, 16) if prefixed or suffixed else int(plain) for prefixed, suffixed, plain in found
    ]


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
    codes = function_codes(cells)
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


_WIDTH_ALONE = {
    **dict.fromkeys(("word", "16bit", "16bits", "16"), 16),
    **dict.fromkeys(("dword", "32bit", "32bits", "32"), 32),
    **dict.fromkeys(("qword", "64bit", "64bits", "64"), 64),
}
"""Types that state a width and, beside a column of signs, no sign."""


def sign_of(path: Path, line: int, cells: dict[str, str]) -> bool | None:
    """Return True for a signed number by the columns of signs, None where they are empty; raise ImportFileError."""
    found: set[bool] = set()
    for key, if_yes in (("signed", True), ("unsigned", False)):
        word = squeezed(cells.get(key, ""))
        if not word:
            continue
        if word in SIGNS:
            found.add(SIGNS[word])
        elif word in YES:
            found.add(if_yes)
        elif word in NO:
            found.add(not if_yes)
        else:
            raise ImportFileError(path, line, f"{key} {cells[key]!r} is not known; use yes or no, signed or unsigned")
    if len(found) > 1:
        raise ImportFileError(path, line, "is signed and unsigned by two columns; correct one of them")
    return next(iter(found), None)


def device_of(path: Path, line: int, cells: dict[str, str]) -> int | None:
    """Return the unit id of a line, None where the table has no column for it; raise ImportFileError."""
    if "device" not in cells:
        return None
    text = cells["device"]
    number = device_number(text)
    if number is None:
        said = f"unit id {text!r} is no device" if text else "has no unit id"
        raise ImportFileError(path, line, f"{said}; give its number, 0 to {_LAST_DEVICE}, one a line")
    return number


def device_number(text: str) -> int | None:
    """Return the unit id in a cell such as `3`, `0x0B` or `Slave 3`, None where it is none."""
    found = _DEVICE.fullmatch(text)
    if found is None:
        return None
    number = int(found["hex"], 16) if found["hex"] else int(found["number"])
    return number if number <= _LAST_DEVICE else None


_LAST_DEVICE = 255
"""Last unit id of Modbus/TCP: it has one byte."""
_DEVICE = re.compile(
    r"(?:#|(?:slave|unit|device|station|node|id|no|nr|addr|geraet|gerät|esclave)[ .:#]*)?"
    r"(?:0x(?P<hex>[0-9a-f]{1,2})|(?P<number>\d{1,3}))",
    re.I,
)


def invalid_of(path: Path, line: int, cells: dict[str, str]) -> list[float] | None:
    """Return the codes for "not available" of a line, None without a cell; raise ImportFileError."""
    text = cells.get("invalid", "")
    if text in ("", "-"):
        return None
    found: list[float] = []
    for part in re.split(r"\s*[;/|]\s*|,\s+|\s+(?:or|oder|ou)\s+", text):
        is_hexadecimal = re.fullmatch(r"0x([0-9a-f]{1,16})|([0-9a-f]{1,16})h|(?=\d*[a-f])([0-9a-f]{4,16})", part, re.I)
        if is_hexadecimal is not None:
            found.append(float(int(next(filter(None, is_hexadecimal.groups())), 16)))
        else:
            found.append(number_of(path, line, "invalid", part))
    return found


def refuse_inverted(path: Path, line: int, cells: dict[str, str]) -> None:
    """Raise ImportFileError where a line's value is inverted: a rig file has nothing for that."""
    text = cells.get("invert", "")
    if squeezed(text) not in (*NO, "normal", "positive", "positiv", "high", "activehigh", "noninverted", "notinverted"):
        said = f"its value is inverted ({text!r}), which is not read here; clear the cell and name the states in labels"
        raise ImportFileError(path, line, said)


def type_of(path: Path, line: int, cells: dict[str, str], table: str) -> tuple[str, int | None]:
    """Return type and number of registers of a string; raise ImportFileError."""
    text = cells["type"]
    bare = squeezed(text)
    signed = re.fullmatch(r"(un)?signed(?:int(?:eger)?)?(16|32|64)(?:bits?)?", bare)
    sized = re.fullmatch(r"(u?)int(?:eger)?(16|32|64)(?:bits?)?", bare)
    string = re.fullmatch(r"(?:string|str|ascii|char)(\d{1,3})", bare)
    length = length_of(path, line, cells)
    is_signed = sign_of(path, line, cells)
    if is_signed is not None and bare in _WIDTH_ALONE:
        bare, sized = "", re.fullmatch("(u?)int(\\d+)", f"{'' if is_signed else 'u'}int{_WIDTH_ALONE[bare]}")
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
    if is_signed is not None and kind not in ("bool", "string") and is_signed == (kind in UNSIGNED):
        told = "signed" if is_signed else "unsigned"
        raise ImportFileError(path, line, f"type {text!r} is {kind} and the line says {told}; correct one of them")
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
    """Return lowest and highest bit by the columns bits and mask, None where both are empty; raise ImportFileError."""
    text, masked = cells.get("bits", ""), _bits_of_mask(path, line, cells.get("mask", ""))
    if not text:
        return masked
    if masked is not None:
        raise ImportFileError(path, line, "has bits and a mask; leave one of them empty")
    match = re.fullmatch(r"(\d{1,2})(?:\s*(?:-|\.\.|:|to)\s*(\d{1,2}))?", text)
    if match is None:
        raise ImportFileError(path, line, f"bits {text!r} are none; write 3 for bit 3 or 4-7, bit 0 being the lowest")
    ends = sorted((int(match[1]), int(match[2] or match[1])))
    return [ends[0], ends[1]]


def _bits_of_mask(path: Path, line: int, text: str) -> list[int] | None:
    """Return lowest and highest bit of a mask, None where it is empty or takes the whole register."""
    if text in ("", "-"):
        return None
    is_hexadecimal = re.fullmatch(r"0x([0-9a-f]{1,4})|([0-9a-f]{1,4})h", text, re.I)
    binary = re.fullmatch(r"0b([01]{1,16})|([01]{8}|[01]{16})b?", text)
    if is_hexadecimal is not None:
        mask = int(is_hexadecimal[1] or is_hexadecimal[2], 16)
    elif binary is not None:
        mask = int(binary[1] or binary[2], 2)
    else:
        raise ImportFileError(
            path, line, f"mask {text!r} is not understood; write it as 0x00F0, or call the column bits"
        )
    low = (mask & -mask).bit_length() - 1
    if mask == 0 or (mask >> low) & ((mask >> low) + 1):
        said = f"mask {text!r} takes bits that do not follow one another; write a line for each group of bits"
        raise ImportFileError(path, line, said)
    return None if mask == _WHOLE_REGISTER else [low, mask.bit_length() - 1]


_WHOLE_REGISTER = 0xFFFF


def access_of(path: Path, line: int, cells: dict[str, str]) -> str | None:
    """Return r, w or rw, None where the cell is empty; raise ImportFileError."""
    text = cells.get("access", "")
    if not text:
        return None
    found = ACCESS.get(squeezed(text))
    if found is None:
        raise ImportFileError(path, line, f"access {text!r} is not known; use r, w or rw")
    return found
