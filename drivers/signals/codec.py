"""Codec of registers: numbers and texts to registers and back. Pure functions, no I/O.

A value of w registers travels as 2w bytes. `order` names the sequence of the bytes A (most significant) to D on the
wire, as Telegraf and most gateways do: ABCD is the Modbus standard (Modbus application protocol V1.1b3, 4.2), CDAB has
the low word first, BADC and DCBA have their bytes swapped within each register. For 64-bit values the same rule is
applied to words and bytes. Texts may only have the bytes within each register swapped.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Literal, get_args

from drivers.signals.points import DriverError

NumberType = Literal["bool", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
RegisterType = Literal["bool", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "string"]
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
"""Registers of each type of number. A text has as many as its point says."""
NUMBER_TYPES: tuple[str, ...] = get_args(NumberType)
UNSIGNED = ("uint16", "uint32", "uint64")
SIGNED = ("int16", "int32", "int64")


class CodecError(DriverError, ValueError):
    """Registers that are no value of the type, or a value that the type cannot hold."""


def _arranged(registers: Sequence[int], order: ByteOrder) -> list[int]:
    words = list(registers)
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA"):
        words = [(word & 0xFF) << 8 | word >> 8 for word in words]
    return words


def _packed(registers: Sequence[int], order: ByteOrder) -> bytes:
    try:
        return struct.pack(f">{len(registers)}H", *_arranged(registers, order))
    except (struct.error, TypeError) as error:
        raise CodecError(f"{list(registers)} are no registers of 0 to 65535") from error


def decode_exact(registers: Sequence[int], kind: str, order: ByteOrder = "ABCD") -> int | float:
    """Return the raw number in `registers` (0..65535, as many as `WIDTH[kind]`), integers exact; raise CodecError."""
    if kind not in WIDTH:
        raise CodecError(f"{kind} is no type of number")
    if len(registers) != WIDTH[kind]:
        raise CodecError(f"{kind} takes {WIDTH[kind]} registers, got {len(registers)}")
    raw = _packed(registers, order)
    if kind == "bool":
        return int(any(raw))
    number: int | float = struct.unpack(">" + _FORMAT[kind], raw)[0]
    return number


def decode(
    registers: Sequence[int], kind: str, order: ByteOrder = "ABCD", bits: tuple[int, int] | None = None
) -> float:
    """Return the raw number in `registers`, or that in its `bits` (lowest and highest, bit 0 the least significant).

    It is a float, as all readings are: the nearest one for a 64-bit integer beyond 2^53. Raises CodecError.
    """
    number = decode_exact(registers, kind, order)
    return float(number if bits is None else field_of(number, *bits))


@lru_cache(maxsize=256)
def decoder(
    kind: str, order: ByteOrder = "ABCD", bits: tuple[int, int] | None = None
) -> Callable[[Sequence[int], int], float]:
    """Return `decode` for one type, as a function of a reply's registers (0..65535) and the value's index in them."""
    width = WIDTH[kind]
    if bits is not None or kind == "bool":
        return lambda registers, at: decode(registers[at : at + width], kind, order, bits)
    if kind == "uint16" and order in ("ABCD", "CDAB"):
        return lambda registers, at: float(registers[at])
    pack = struct.Struct(f"{'<' if order in ('BADC', 'DCBA') else '>'}{width}H").pack
    unpack = struct.Struct(">" + _FORMAT[kind]).unpack
    if width == 1:
        return lambda registers, at: float(unpack(pack(registers[at]))[0])
    step = -1 if order in ("CDAB", "DCBA") else 1
    return lambda registers, at: float(unpack(pack(*registers[at : at + width][::step]))[0])


def field_of(number: int | float, lowest: int, highest: int) -> int:
    """Return the unsigned number in bits `lowest` to `highest` of an integer; raise CodecError for any other number."""
    if not isinstance(number, int) or number < 0 or not 0 <= lowest <= highest:
        raise CodecError(f"{number} has no bits {lowest} to {highest}")
    return number >> lowest & (1 << (highest - lowest + 1)) - 1


def encode(value: float, kind: str, order: ByteOrder = "ABCD") -> list[int]:
    """Return the registers of the raw number `value`, rounded for integers; raise CodecError where it does not fit."""
    if kind not in WIDTH:
        raise CodecError(f"{kind} is no type of number")
    return encoder(kind, order)(value)


@lru_cache(maxsize=64)
def encoder(kind: str, order: ByteOrder = "ABCD") -> Callable[[float], list[int]]:
    """Return `encode` for one type as a function of the raw number; it raises CodecError for one that does not fit."""
    if kind == "bool":
        return lambda value: _arranged([_bit(value)], order)
    pack, unpack = struct.Struct(">" + _FORMAT[kind]).pack, struct.Struct(f">{WIDTH[kind]}H").unpack
    is_float, is_plain = kind.startswith("float"), order == "ABCD"

    def encoded(value: float) -> list[int]:
        if not math.isfinite(value):
            raise CodecError(f"{value} cannot be written")
        try:
            raw = pack(value if is_float else round(value))
        except (struct.error, OverflowError) as error:
            raise CodecError(f"{value:g} does not fit in {kind}") from error
        words = list(unpack(raw))
        return words if is_plain else _arranged(words, order)

    return encoded


def _bit(value: float) -> int:
    if not math.isfinite(value):
        raise CodecError(f"{value} cannot be written")
    if value not in (0, 1):
        raise CodecError(f"{value:g} does not fit in bool; write 0 or 1")
    return int(value)


def decode_text(registers: Sequence[int], order: ByteOrder = "ABCD") -> str:
    """Return the UTF-8 text in `registers`, without the zeros or blanks that fill it up; raise CodecError."""
    raw = _packed(registers, _text_order(order)).split(b"\0", 1)[0]
    try:
        text = raw.decode("utf-8").rstrip(" ")
    except UnicodeDecodeError as error:
        raise CodecError(f"the bytes {raw.hex(' ')} are no text; correct address, length or order") from error
    if not text.isprintable():
        raise CodecError(f"the bytes {raw.hex(' ')} are no printable text; correct address, length or order")
    return text


def encode_text(text: str, length: int, order: ByteOrder = "ABCD") -> list[int]:
    """Return `length` registers with `text` in UTF-8, filled up with zeros; raise CodecError where it does not fit."""
    raw = text.encode("utf-8")
    if not text.isprintable() or text != text.rstrip(" "):
        raise CodecError(f"{text!r} is no printable text, or ends in blanks, which would not come back")
    if len(raw) > 2 * length:
        raise CodecError(f"{text!r} takes {len(raw)} bytes and {length} registers hold {2 * length}")
    words = struct.unpack(f">{length}H", raw.ljust(2 * length, b"\0"))
    return _arranged(words, _text_order(order))


def _text_order(order: ByteOrder) -> ByteOrder:
    if order not in ("ABCD", "BADC"):
        raise CodecError(f"a text has no word order {order}; use ABCD, or BADC where its letters come in swapped pairs")
    return order


def raw_bounds(kind: str, bits: tuple[int, int] | None = None) -> tuple[float, float]:
    """Return the least and the greatest finite raw number of a type, or of its `bits`."""
    if bits is not None:
        return 0.0, float((1 << (bits[1] - bits[0] + 1)) - 1)
    if kind == "bool":
        return 0.0, 1.0
    size = 16 * WIDTH[kind]
    if kind in UNSIGNED:
        return 0.0, float(2**size - 1)
    if kind in SIGNED:
        return -float(2 ** (size - 1)), float(2 ** (size - 1) - 1)
    greatest = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0] if kind == "float32" else math.ldexp(1.0 - 2.0**-53, 1024)
    return -greatest, greatest


def raw_sentinels(declared: Iterable[float], kind: str) -> frozenset[float]:
    """Return the raw numbers of a rig file's sentinels, as `decode` gives them.

    0x8000 in an int16 decodes to -32768, and 9999.9 in a float32 to the nearest float32: no reading would equal the
    number as it is written.
    """
    found: set[float] = set()
    for sentinel in declared:
        found.add(sentinel)
        size = 16 * WIDTH.get(kind, 1)
        if kind in SIGNED and sentinel == math.floor(sentinel) and 2 ** (size - 1) <= sentinel < 2**size:
            found.add(float(int(sentinel) - 2**size))
        elif kind == "float32" and abs(sentinel) <= raw_bounds("float32")[1]:
            found.add(struct.unpack(">f", struct.pack(">f", sentinel))[0])
    return frozenset(found)
