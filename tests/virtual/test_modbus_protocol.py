"""The PLC's Modbus server and its safety logic, without a socket."""

import asyncio
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.virtual.devices.modbus_protocol import ModbusConnection, answer
from drivers.virtual.devices.registers import ARM, ARMED, HEATER_SET, Registers


def words(function: int, *values: int) -> bytes:
    return struct.pack(f">B{len(values)}H", function, *values)


def write_many(first: int, *values: int) -> bytes:
    return struct.pack(f">BHHB{len(values)}H", 16, first, len(values), 2 * len(values), *values)


def beat(registers: Registers) -> None:
    assert registers.write(3, [(registers.holding[3] + 1) & 0xFFFF])


@pytest.mark.parametrize(
    ("request_pdu", "expected"),
    [
        (words(3, 0, 6), bytes((3, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 100, 0, 0))),
        (words(3, 4, 1), bytes((3, 2, 0, 100))),
        (words(4, 0, 12), bytes((4, 24)) + bytes(24)),
        (words(1, 0, 1), bytes((1, 1, 0))),
        (words(2, 0, 3), bytes((2, 1, 0))),
        (words(3, 0, 7), bytes((0x83, 2))),
        (words(3, 6, 1), bytes((0x83, 2))),
        (words(4, 11, 2), bytes((0x84, 2))),
        (words(4, 0, 126), bytes((0x84, 3))),
        (words(3, 0, 0), bytes((0x83, 3))),
        (words(1, 1, 1), bytes((0x81, 2))),
        (words(2, 0, 2001), bytes((0x82, 3))),
        (words(6, 6, 1), bytes((0x86, 2))),
        (words(6, 0, 10001), bytes((0x86, 3))),
        (words(6, 1, 1001), bytes((0x86, 3))),
        (words(6, 4, 0), bytes((0x86, 3))),
        (words(6, 5, 2), bytes((0x86, 3))),
        (words(6, 0, 10000), words(6, 0, 10000)),
        (words(5, 0, 0xFF00), words(5, 0, 0xFF00)),
        (words(5, 0, 1), bytes((0x85, 3))),
        (words(22, 1, 0, 700), words(22, 1, 0, 700)),
        (words(7, 0, 0), bytes((0x87, 1))),
        (b"\x2b\x0e\x01\x00", bytes((0xAB, 1))),
        (b"\x03\x00", bytes((0x83, 3))),
        (b"\x10\x00\x00\x00\x02\x04\x00", bytes((0x90, 3))),
        (write_many(0, 1, 2, 3, 4), words(16, 0, 4)),
        (write_many(5, 1, 2), bytes((0x90, 2))),
        (b"\x0f\x00\x00\x00\x01\x01\x01", words(15, 0, 1)),
        (
            struct.pack(">BHHHHB2H", 23, 0, 2, 1, 2, 4, 500, 600),
            bytes((23, 4)) + struct.pack(">2H", 0, 500),
        ),
    ],
)
def test_requests_get_the_answer_that_the_specification_gives(request_pdu: bytes, expected: bytes) -> None:
    assert answer(Registers(), request_pdu) == expected


def test_a_refused_write_applies_nothing() -> None:
    registers = Registers()
    assert answer(registers, write_many(0, 5000, 500, 1001)) == b"\x90\x03"
    assert registers.holding == [0, 0, 0, 0, 100, 0]


@given(st.binary(min_size=1, max_size=253))
@example(b"\x03\x00\x00\x00\x80")  # more registers than the count of bytes can tell
def test_any_request_gets_one_well_formed_answer(pdu: bytes) -> None:
    registers = Registers()
    reply = answer(registers, pdu)
    assert 2 <= len(reply) <= 253
    assert reply[0] & 0x7F == pdu[0] & 0x7F
    if reply[0] & 0x80 and not pdu[0] & 0x80:
        assert reply[1] in (1, 2, 3)
        assert registers.holding == [0, 0, 0, 0, 100, 0]


class Wire(asyncio.Transport):
    """Collects what a connection writes."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[bytes] = []
        self.closed = False

    def write(self, data: bytes) -> None:
        self.sent.append(bytes(data))

    def close(self) -> None:
        self.closed = True


def connection() -> tuple[ModbusConnection, Wire]:
    wire, modbus = Wire(), ModbusConnection({1: Registers()}, set())
    modbus.connection_made(wire)
    return modbus, wire


def frame(transaction: int, pdu: bytes, device: int = 1) -> bytes:
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, device) + pdu


REQUESTS = b"".join(frame(n, words(4, n % 12, 1)) for n in range(1, 30)) + frame(30, write_many(0, 1, 2))


@given(st.lists(st.integers(1, len(REQUESTS) - 1), max_size=12))
def test_pipelined_requests_are_answered_in_order_however_the_stream_is_cut(cuts: list[int]) -> None:
    modbus, wire = connection()
    edges = [0, *sorted(cuts), len(REQUESTS)]
    for start, stop in zip(edges, edges[1:], strict=False):
        modbus.data_received(REQUESTS[start:stop])
    stream, seen = b"".join(wire.sent), []
    while stream:
        transaction, _, length, device = struct.unpack(">HHHB", stream[:7])
        seen.append((transaction, device))
        stream = stream[6 + length :]
    assert seen == [(n, 1) for n in range(1, 31)]


@pytest.mark.parametrize("device", [0, 2, 255])
def test_other_devices_do_not_exist(device: int) -> None:
    modbus, wire = connection()
    modbus.data_received(frame(7, words(3, 0, 1), device))
    assert wire.sent == [struct.pack(">HHHBBB", 7, 0, 3, device, 0x83, 0x0B)]


@pytest.mark.parametrize("garbage", [b"GET / HTTP/1.1\r\n\r\n", struct.pack(">HHHBB", 1, 0, 300, 1, 3), bytes(8)])
def test_a_stream_without_framing_is_closed(garbage: bytes) -> None:
    modbus, wire = connection()
    modbus.data_received(garbage)
    assert wire.closed


def test_heater_gets_nothing_until_armed_and_keeps_its_set_point() -> None:
    registers = Registers()
    registers.write(0, [7000])
    assert (registers.heater_W, registers.holding[HEATER_SET]) == (0.0, 7000)
    registers.write(ARM, [1])
    assert registers.heater_W == pytest.approx(700.0)
    registers.write(ARM, [0])
    assert registers.heater_W == 0.0


def test_watchdog_trips_and_wants_a_heartbeat_and_an_arm() -> None:
    registers = Registers()
    registers.write(0, [7000, 1000, 1000, 1, 20, 1])
    for now in (1.0, 2.0):
        registers.supervise(now, 30.0)
        assert registers.status == ARMED
    registers.supervise(2.1, 30.0)
    assert registers.status == 2
    assert registers.holding == [0, 1000, 1000, 1, 20, 0]
    assert not registers.write(ARM, [1])
    assert not registers.write(3, [1, 20, 1])
    beat(registers)
    registers.write(0, [6000])
    assert registers.heater_W == 0.0
    assert registers.write(ARM, [1])
    assert (registers.status, registers.heater_W) == (ARMED, 600.0)


def test_one_request_may_carry_heartbeat_and_arm_after_a_trip() -> None:
    registers = Registers()
    registers.write(3, [1, 20, 1])
    registers.supervise(9.0, 30.0)
    assert registers.status == 2
    assert registers.write(3, [2, 20, 1])
    assert registers.status == ARMED


def test_only_a_changed_heartbeat_counts() -> None:
    registers = Registers()
    registers.write(3, [5, 20, 1])
    for now in (1.0, 2.0, 3.0):
        registers.write(3, [5])
        registers.supervise(now, 30.0)
    assert registers.status == 2


def test_heartbeats_hold_the_watchdog_off() -> None:
    registers = Registers()
    registers.write(3, [1, 10, 1])
    for tick in range(1, 100):
        beat(registers)
        registers.supervise(float(tick), 30.0)
    assert registers.status == ARMED


def test_thermostat_trips_likewise() -> None:
    registers = Registers()
    registers.write(0, [9000, 0, 0, 1, 100, 1])
    registers.supervise(1.0, 75.5)
    assert registers.status == 4
    assert registers.holding[HEATER_SET] == 0
    assert not registers.write(ARM, [1])


def test_input_registers_have_their_documented_layout() -> None:
    registers = Registers()
    registers.write(3, [77, 100, 1])
    registers.supervise(70000.5, 30.0)
    registers.write(4, [0xFFFF])
    registers.publish([-3.25, 123.456, 3.785, 99.96, 40.04], 65537)
    data = registers.inputs
    power, flow = (struct.unpack(">f", data[k + 2 : k + 4] + data[k : k + 2])[0] for k in (0, 4))
    assert (power, flow) == (pytest.approx(123.456), pytest.approx(3.785))
    assert struct.unpack(">HHhHIHH", data[8:]) == (1000, 400, -325, registers.status, 70000500, 77, 1)
