"""Registers to numbers: golden vectors, and round trips over everything that fits."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus.contract import judge
from drivers.rig_file.model import Point
from drivers.signals.codec import (
    NUMBER_TYPES,
    WIDTH,
    CodecError,
    decode,
    decode_exact,
    decode_text,
    decoder,
    encode,
    encode_text,
    field_of,
    raw_bounds,
)
from drivers.signals.points import Quality

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


# Published vectors ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "registers"),
    [
        ("ABCD", [0x47F1, 0x2000]),
        ("DCBA", [0x0020, 0xF147]),
        ("BADC", [0xF147, 0x0020]),
        ("CDAB", [0x2000, 0x47F1]),
    ],
)
def test_the_float_of_libmodbus_own_tests_in_its_four_orders(order, registers):
    """123456.0, the value that libmodbus' test programs send through modbus_set_float_abcd and its three sisters."""
    assert decode(registers, "float32", order) == 123456.0
    assert encode(123456.0, "float32", order) == registers


@pytest.mark.parametrize(
    ("registers", "values"),
    [
        ([0x022B, 0x0000, 0x0064], [555, 0, 100]),  # Modbus application protocol V1.1b3, 6.3: registers 108 to 110
        ([0x000A], [10]),  # 6.4: input register 9
        ([0x000A, 0x0102], [10, 258]),  # 6.12: what is written to registers 2 and 3
        ([0x0003], [3]),  # 6.6: what is written to register 2
    ],
)
def test_the_registers_of_the_specifications_examples(registers, values):
    assert [decode([register], "uint16") for register in registers] == values
    assert [encode(value, "uint16")[0] for value in values] == registers


@pytest.mark.parametrize(
    ("kind", "order", "registers", "value"),
    [
        ("int64", "ABCD", [0x0102, 0x0304, 0x0506, 0x0708], 0x0102030405060708),
        ("int64", "CDAB", [0x0708, 0x0506, 0x0304, 0x0102], 0x0102030405060708),
        ("int64", "BADC", [0x0201, 0x0403, 0x0605, 0x0807], 0x0102030405060708),
        ("int64", "DCBA", [0x0807, 0x0605, 0x0403, 0x0201], 0x0102030405060708),
        ("uint64", "ABCD", [0xFFFF] * 4, 2**64 - 1),
        ("int32", "CDAB", [0x5678, 0x1234], 0x12345678),
        ("int16", "BADC", [0x0080], -32768),
        ("float64", "CDAB", [0x2D18, 0x5444, 0x21FB, 0x4009], math.pi),
    ],
)
def test_wide_values_in_every_order_are_exact(kind, order, registers, value):
    assert decode_exact(registers, kind, order) == value
    assert encode(value, kind, order) == registers


# Properties ----------------------------------------------------------------------------------------------------------


@given(data=st.data(), kind=st.sampled_from(NUMBER_TYPES), order=st.sampled_from(ORDERS))
def test_whatever_registers_hold_is_written_back_the_same_or_refused(data, kind, order):
    registers = data.draw(st.lists(st.integers(0, 0xFFFF), min_size=WIDTH[kind], max_size=WIDTH[kind]))
    number = decode_exact(registers, kind, order)
    if not math.isfinite(number):
        with pytest.raises(CodecError):
            encode(number, kind, order)
    elif kind != "bool":
        assert encode(number, kind, order) == registers


@given(data=st.data(), kind=st.sampled_from([k for k in NUMBER_TYPES if not k.startswith("float")]))
def test_an_integer_that_does_not_fit_never_wraps(data, kind):
    low, high = (int(bound) for bound in raw_bounds(kind))
    if kind in ("int64", "uint64"):
        high = 2**64 - 1 if kind == "uint64" else 2**63 - 1
    value = data.draw(st.integers(high + 1, 2**70) | st.integers(-(2**70), low - 1))
    with pytest.raises(CodecError, match="does not fit in"):
        encode(value, kind)


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_a_float_is_written_near_to_what_was_asked_or_refused(value):
    try:
        back = decode(encode(value, "float32"), "float32")
    except CodecError:
        assert abs(value) > 3.4028234e38
    else:
        assert back == pytest.approx(value, rel=1e-7, abs=1e-45)


@given(kind=st.sampled_from(["uint16", "uint32", "uint64"]), data=st.data(), order=st.sampled_from(ORDERS))
def test_bit_fields_are_the_bits_and_no_others(kind, data, order):
    size = 16 * WIDTH[kind]
    lowest = data.draw(st.integers(0, size - 1))
    highest = data.draw(st.integers(lowest, min(size - 1, lowest + 31)))
    number = data.draw(st.integers(0, 2**size - 1))
    text = format(number, f"0{size}b")[::-1]
    registers = struct.unpack(f">{WIDTH[kind]}H", number.to_bytes(size // 8, "big"))
    arranged = encode(number, kind, order)
    assert decode_exact(registers, kind) == number
    assert decode(arranged, kind, order, (lowest, highest)) == int(text[lowest : highest + 1][::-1], 2)


@pytest.mark.parametrize(("number", "lowest", "highest"), [(1.0, 0, 1), (-1, 0, 1), (5, 3, 2), (5, -1, 2)])
def test_bits_of_what_has_none_are_refused(number, lowest, highest):
    with pytest.raises(CodecError, match="has no bits"):
        field_of(number, lowest, highest)


@given(text=st.text(max_size=12), length=st.integers(1, 20), order=st.sampled_from(["ABCD", "BADC"]))
def test_texts_come_back_or_are_refused(text, length, order):
    try:
        registers = encode_text(text, length, order)
    except CodecError:
        assert len(text.encode()) > 2 * length or not text.isprintable() or text.endswith(" ")
    else:
        assert len(registers) == length
        assert decode_text(registers, order) == text


@given(registers=st.lists(st.integers(0, 0xFFFF), max_size=10))
def test_any_registers_are_a_printable_text_or_refused(registers):
    try:
        assert decode_text(registers).isprintable()
    except CodecError as error:
        assert "correct address, length or order" in str(error)


def test_a_text_is_in_register_order_with_its_bytes_swapped_where_the_device_does():
    assert decode_text([0x5031, 0x3700]) == "P17"
    assert decode_text([0x3150, 0x0037], "BADC") == "P17"
    assert decode_text([0x5031, 0x3720, 0x2020]) == "P17"
    with pytest.raises(CodecError, match="has no word order CDAB"):
        decode_text([0x5031], "CDAB")


@pytest.mark.parametrize("registers", [[70000], [-1], [1.5], ["1"], [None]])
def test_what_is_no_register_is_refused(registers):
    with pytest.raises(CodecError, match="no registers"):
        decode(registers, "uint16")


@pytest.mark.parametrize("value", [2, -1, 0.5])
def test_a_bit_is_zero_or_one(value):
    with pytest.raises(CodecError, match="write 0 or 1"):
        encode(value, "bool")


# Sentinels -----------------------------------------------------------------------------------------------------------


def sensor(kind: str, invalid: tuple[float, ...], **more: object) -> Point:
    return Point(name="T", bus="b", unit="degC", table="input", address=0, type=kind, invalid=invalid, **more)


@pytest.mark.parametrize(
    ("kind", "invalid", "registers"),
    [
        ("int16", (0x8000,), [0x8000]),
        ("int16", (-32768,), [0x8000]),
        ("int16", (32767,), [0x7FFF]),
        ("uint16", (0xFFFF,), [0xFFFF]),
        ("int32", (0x80000000,), [0x8000, 0]),
        ("float32", (9999.9,), [0x461C, 0x3F9A]),  # in float32 it is 9999.900390625
        ("float32", (math.nan,), [0x7FC0, 0]),
        ("float32", (), [0x7FC0, 0]),
        ("float32", (), [0x7F80, 0]),
        ("float64", (), [0xFFF8, 0, 0, 0]),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_what_a_device_says_instead_of_a_value_is_a_fault_and_never_a_value(kind, invalid, registers, scale):
    value, quality = judge(sensor(kind, invalid, scale=scale), decode(registers, kind))
    assert quality == Quality.SENSOR_FAULT
    assert math.isnan(value)


def test_the_neighbours_of_a_sentinel_are_values():
    point = sensor("int16", (0x8000, 32767), scale=0.1, plausible=(-4000.0, 4000.0))
    assert judge(point, decode([0x8001], "int16")) == (pytest.approx(-3276.7), Quality.GOOD)
    assert judge(point, decode([0x7FFE], "int16")) == (pytest.approx(3276.6), Quality.GOOD)
    assert judge(point, decode([0], "int16")) == (0.0, Quality.GOOD)


def test_a_sentinel_may_be_given_in_the_unit_of_the_point():
    assert judge(sensor("int16", (327.67,), scale=0.01), 32767.0)[1] == Quality.SENSOR_FAULT
    assert judge(sensor("uint16", (215.0,), scale=0.1, offset=-40.0), 2550.0)[1] == Quality.SENSOR_FAULT


def test_a_number_without_a_label_is_out_of_range():
    point = Point(name="mode", bus="b", unit="1", table="input", address=0, labels={"0": "off", "3": "on"})
    assert [judge(point, raw)[1] for raw in (0.0, 3.0, 1.0)] == [Quality.GOOD, Quality.GOOD, Quality.OUT_OF_RANGE]
    assert point.label_of == {0: "off", 3: "on"}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"type": "int16", "bits": (0, 3)}, "an unsigned integer"),
        ({"bits": (3, 16)}, "uint16 has 16"),
        ({"bits": (4, 3)}, "the lowest and the highest bit"),
        ({"bits": (4, 5), "access": "rw"}, "can only be read here"),
        ({"type": "string"}, "length is the number of registers"),
        ({"length": 4}, "length is the number of registers"),
        ({"type": "string", "length": 4, "order": "CDAB"}, "in order 'ABCD' or 'BADC'"),
        ({"expect": "P17"}, "must have; take it out"),
        ({"labels": {"on": "1"}}, "labels name whole numbers"),
        ({"labels": {"1": "on"}, "scale": 0.1}, "take scale and offset out"),
        ({"table": "coil", "type": "uint16"}, "is one bit and has no type uint16"),
        ({"invalid": (70000,)}, "never comes out of a uint16"),
        ({"invalid": (0x8000,), "type": "bool"}, "never comes out of a bool"),
        ({"table": "holding", "access": "rw", "limits": (0, 7000), "safe_value": 0, "scale": 0.1}, "does not fit"),
        ({"table": "holding", "access": "rw", "limits": (-5, 5), "safe_value": 0}, "-5 1 cannot be written"),
    ],
)
def test_a_point_that_contradicts_itself_is_refused(changes, said):
    given = {"name": "p", "bus": "b", "unit": "1", "table": "input", "address": 0} | changes
    with pytest.raises(ValueError, match=said):
        Point(**given)


@given(
    registers=st.lists(st.integers(0, 65535), min_size=4, max_size=12),
    kind=st.sampled_from(list(WIDTH)),
    order=st.sampled_from(["ABCD", "CDAB", "BADC", "DCBA"]),
    field=st.none() | st.tuples(st.integers(0, 7), st.integers(8, 15)),
    data=st.data(),
)
def test_a_decoder_made_once_reads_what_decode_reads(registers, kind, order, field, data):
    bits = field if kind.startswith("uint") else None
    at = data.draw(st.integers(0, len(registers) - WIDTH[kind]))
    expected = decode(registers[at : at + WIDTH[kind]], kind, order, bits)
    found = decoder(kind, order, bits)(registers, at)
    assert found == expected or (math.isnan(found) and math.isnan(expected))
    assert type(found) is float
