"""Addresses of a register table: numbers, registers with a bit (`10.3`), ranges (`100-101`), and their base."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drivers.importers.draft import ImportFileError

Addressing = Literal["zero", "one", "modicon"]
_OF_LEADING_DIGIT = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}
_NUMBER = r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h|[0-9a-f]{1,7}|[0134]x\d{1,5}"
_WITH_BIT = re.compile(rf"({_NUMBER})\s*(?:[.,:/]|\.?bit\s*|\.b)\s*(\d{{1,2}})", re.IGNORECASE)
_RANGE = re.compile(rf"({_NUMBER})\s*(?:-|\u2013|\.\.\.?|to|bis|\+|/|,)\s*({_NUMBER})", re.IGNORECASE)
_LETTERS = re.compile(r"(%?[a-z]{1,4})[ _.]?\d.*", re.IGNORECASE)
_LAST = 65535
_LAST_BIT = 15


@dataclass(frozen=True)
class Address:
    """Place in a device, counted from zero; `table` by its leading digit, `bit` and `last` where the cell has them."""

    table: str | None
    address: int
    bit: int | None = None
    last: int | None = None
    text: str = ""


class Addresses:
    """Addresses of one column, which are written in one way.

    `10.1` is bit 1, and may be bit 10 whose zero a spreadsheet took for the end of a fraction; `are_fractions`: all
    cells are as `10.0`, whole numbers that a spreadsheet wrote as fractions.
    """

    def __init__(self, path: Path, cells: Sequence[str], addressing: Addressing, is_hex: bool) -> None:
        self._path, self._addressing, self._is_hex = path, addressing, is_hex
        given = [cell for cell in cells if cell]
        self.are_fractions = bool(given) and all(re.fullmatch(r"\d+[.,]0", cell) for cell in given)
        with_bit = [] if self.are_fractions else [cell for cell in given if re.fullmatch(r"[^.,]+[.,]\d{1,2}", cell)]
        bits = [re.split("[.,]", cell)[1] for cell in with_bit]
        self._from_one = str(_LAST_BIT + 1) in bits and "0" not in bits
        has_zeros = any(len(bit) > 1 and "0" in (bit[0], bit[1]) for bit in bits)
        self._cut = set() if has_zeros else {cell for cell in with_bit if cell.endswith((".1", ",1"))}
        self._twice = {cell for cell in self._cut if with_bit.count(cell) > 1}

    def read(self, line: int, text: str) -> Address:
        """Return the place of a cell.

        Raises
        ------
        ImportFileError
            It is no address, or one that can be read in two ways; with the remedy.
        """
        bare = text.strip()
        if self.are_fractions:
            bare = re.split("[.,]", bare)[0]
        if self._plain(bare):
            return self._based(line, bare, text)
        place, bit, last = None, None, None
        if (found := _WITH_BIT.fullmatch(bare)) is not None and self._plain(found[1]):
            place, bit = self._based(line, found[1], text), int(found[2])
        if (found := _RANGE.fullmatch(bare)) is not None and self._plain(found[1]) and self._plain(found[2]):
            with contextlib.suppress(ImportFileError):  # `40011/3` is no range, since 3 is no Modicon address.
                first, end = (self._based(line, part, text) for part in found.groups())
                if end.address > first.address:
                    place, last = first, end.address
        if place is not None:
            return Address(place.table, place.address, bit, last, text)
        if (letters := _LETTERS.fullmatch(bare)) is not None and not bare.lower().startswith("0x"):
            what = (
                "the place in the memory of a PLC; write the Modbus address that its manual gives for it"
                if letters[1].startswith("%")
                or letters[1].upper() in ("D", "M", "DB", "MW", "MD", "MX", "VW", "QW", "IW")
                else f"a number behind letters; write the number alone, and what {letters[1]!r} means in a column table"
            )
            raise ImportFileError(self._path, line, f"address {text!r} is {what}")
        raise ImportFileError(
            self._path,
            line,
            f"address {text!r} is no address; write it as 100 or 0x64, a bit as 100.3 and the registers of a value as "
            "100-101",
        )

    def bits(self, line: int, where: Address, kind: str, table: str, column: list[int] | None) -> list[int] | None:
        """Return lowest and highest bit by the address and by the columns of bits; raise ImportFileError.

        `kind` is the type of the value, bool for a bit.
        """
        if where.bit is None or (where.last is not None and kind != "bool"):
            return column
        said = f"address {where.text!r} has bit {where.bit}"
        if table in ("coil", "discrete"):
            raise ImportFileError(self._path, line, f"{said}, and a {table} is one bit; write its number alone")
        if kind != "bool":
            remedy = "write the type bool, or the number of the register alone"
            raise ImportFileError(self._path, line, f"{said} and type {kind} takes whole registers; {remedy}")
        remedy = "give the bits in a column bits, bit 0 being the lowest"
        if self._from_one or where.bit > _LAST_BIT:
            raise ImportFileError(
                self._path, line, f"{said}, and the bits of the table do not count from 0 to {_LAST_BIT}; {remedy}"
            )
        if column is not None and column != [where.bit, where.bit]:
            raise ImportFileError(self._path, line, f"{said} and its column bits another; correct one of them")
        if where.text.strip() in self._twice and column is None:
            said = f"address {where.text!r} stands twice, as bit 1 and as bit 10 whose zero a spreadsheet cut"
            raise ImportFileError(self._path, line, f"{said}; {remedy}")
        return [where.bit, where.bit]

    def doubt(self, where: Address) -> str | None:
        """Return a sentence where the bit of an address may be another; None where it is certain."""
        if where.text.strip() not in self._cut:
            return None
        return f"address {where.text!r} was read as bit 1; if a spreadsheet made it of '{where.text}0', it is bit 10"

    def require_width(self, line: int, where: Address, kind: str, registers: int) -> None:
        """Raise ImportFileError where a range of addresses has another number of registers than the value."""
        if where.last is None or (where.bit is not None and kind == "bool"):
            return
        count = where.last - where.address + 1
        if count != registers:
            said = f"addresses {where.text!r} are {count} registers and its type takes {registers}"
            raise ImportFileError(self._path, line, f"{said}; correct one of them, or write a line for each value")

    def _plain(self, text: str) -> bool:
        """Return True for one number: decimal, or hexadecimal with its mark or in such a column, or Modicon's 4x."""
        hexadecimal = r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h" + ("|[0-9a-f]{1,5}" if self._is_hex else "")
        modicon = r"|[0134]x\d{1,5}" if self._addressing == "modicon" else ""
        return re.fullmatch(rf"{hexadecimal}|\d{{1,7}}{modicon}", text, re.IGNORECASE) is not None

    def _based(self, line: int, number: str, text: str) -> Address:
        """Return the place of one number, by the base of the column."""
        path, bare, digits = self._path, number.lower(), ""
        if re.fullmatch(r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h", bare) and not re.fullmatch(r"0x\d{4}", bare):
            value = int(bare.removeprefix("0x").removesuffix("h"), 16)
        elif self._is_hex:
            value = int(bare.removeprefix("0x"), 16)
        elif re.fullmatch(r"[0134]x\d{1,5}", bare) and self._addressing == "modicon":
            digits = bare[0] + bare[2:].zfill(4)
            value = int(digits)
        elif bare.startswith("0x"):
            value = int(bare.removeprefix("0x"), 16)
        else:
            value, digits = int(bare), bare
        table = None
        if self._addressing == "modicon":
            if len(digits) not in (5, 6) or digits[0] not in _OF_LEADING_DIGIT or int(digits[1:]) < 1:
                raise ImportFileError(
                    path,
                    line,
                    f"address {text!r} is no Modicon address (40001 or 400001 is the first holding register); correct "
                    "it, or use --addressing zero or one",
                )
            table, value = _OF_LEADING_DIGIT[digits[0]], int(digits[1:]) - 1
        elif self._addressing == "one":
            if value < 1:
                raise ImportFileError(path, line, "address 0 in a table that counts from one; use --addressing zero")
            value -= 1
        if value > _LAST:
            raise ImportFileError(
                path, line, f"address {text} is beyond the last one, {_LAST}; is the table --addressing modicon?"
            )
        return Address(table, value, text=text)
