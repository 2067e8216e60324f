"""Registers to numbers: golden vectors, and round trips over everything that fits."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.codec import WIDTH, decode, encode

ORDERS = ["ABCD", "CDAB", "BADC", "DCBA"]
RANGES = {
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**53), 2**53),
    "uint64": (0, 2**53),
}


@pytest.mark.parametrize(
    ("order", "registers"),
    [
        ("ABCD", [0x42F6, 0xE979]),
        ("CDAB", [0xE979, 0x42F6]),
        ("BADC", [0xF642, 0x79E9]),
        ("DCBA", [0x79E9, 0xF642]),
    ],
)
def test_float_123_456_in_the_four_orders(order, registers):
    assert decode(registers, "float32", order) == struct.unpack(">f", bytes.fromhex("42f6e979"))[0]
    assert encode(123.456, "float32", order) == registers


@pytest.mark.parametrize(
    ("kind", "registers", "value"),
    [
        ("int16", [0x8000], -32768),
        ("uint16", [0xFFFF], 65535),
        ("int32", [0xFFFF, 0xFFFE], -2),
        ("uint32", [0x0001, 0x0000], 65536),
        ("int64", [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF], -1),
        ("float64", [0x3FF8, 0, 0, 0], 1.5),
        ("bool", [7], 1.0),
    ],
)
def test_golden_vectors(kind, registers, value):
    assert decode(registers, kind) == value


@given(data=st.data(), kind=st.sampled_from(sorted(RANGES)), order=st.sampled_from(ORDERS))
def test_integers_come_back(data, kind, order):
    value = data.draw(st.integers(*RANGES[kind]))
    registers = encode(value, kind, order)
    assert len(registers) == WIDTH[kind]
    assert all(0 <= register <= 0xFFFF for register in registers)
    assert decode(registers, kind, order) == value


@given(value=st.floats(width=32, allow_nan=False, allow_infinity=False), order=st.sampled_from(ORDERS))
def test_floats_come_back(value, order):
    assert decode(encode(value, "float32", order), "float32", order) == value


@given(value=st.one_of(st.integers(65536, 2**40), st.integers(-(2**40), -1)))
def test_what_does_not_fit_is_refused(value):
    with pytest.raises(ValueError, match="does not fit in uint16"):
        encode(value, "uint16")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_not_a_number_is_never_written(value):
    with pytest.raises(ValueError, match="cannot be written"):
        encode(value, "float32")


def test_a_wrong_count_of_registers_is_refused():
    with pytest.raises(ValueError, match="takes 2 registers, got 1"):
        decode([1], "float32")
