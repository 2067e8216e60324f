"""Registers to numbers and back: pure functions, no I/O.

A value of w registers travels as 2w bytes. `order` names the sequence of the bytes A (most significant) to D on the
wire, as Telegraf and most gateways do: ABCD is the Modbus standard, CDAB has the low word first, BADC and DCBA have
their bytes swapped within each register. For 64-bit values the same rule is applied to words and bytes.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Literal

RegisterType = Literal["bool", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
ByteOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]

_FORMAT: dict[str, str] = {
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
WIDTH: dict[str, int] = {"bool": 1} | {kind: struct.calcsize(">" + code) // 2 for kind, code in _FORMAT.items()}


def _arranged(registers: Sequence[int], order: ByteOrder) -> list[int]:
    words = list(registers)
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA"):
        words = [(word & 0xFF) << 8 | word >> 8 for word in words]
    return words


def decode(registers: Sequence[int], kind: RegisterType, order: ByteOrder = "ABCD") -> float:
    """The raw number in `registers` (each 0..65535, as many as `WIDTH[kind]`); raises ValueError on another count."""
    if len(registers) != WIDTH[kind]:
        raise ValueError(f"{kind} takes {WIDTH[kind]} registers, got {len(registers)}")
    if kind == "bool":
        return float(registers[0] != 0)
    words = _arranged(registers, order)
    raw = struct.pack(f">{len(words)}H", *words)
    return float(struct.unpack(">" + _FORMAT[kind], raw)[0])


def encode(value: float, kind: RegisterType, order: ByteOrder = "ABCD") -> list[int]:
    """Registers of the raw number `value`, rounded for integers; raises ValueError where it does not fit."""
    if kind == "bool":
        return [int(bool(value))]
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be written")
    try:
        number: float | int = value if kind.startswith("float") else round(value)
        raw = struct.pack(">" + _FORMAT[kind], number)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{value:g} does not fit in {kind}") from error
    return _arranged(struct.unpack(f">{WIDTH[kind]}H", raw), order)
