"""The Modbus driver against a server that misbehaves: no wrong value is good, and a lost link comes back."""

from __future__ import annotations

import asyncio
import math
import struct
import time

import pytest

from drivers.modbus.bus import ModbusBus
from drivers.rig_file.bus_sections import ModbusTcpBus
from drivers.rig_file.model import Point
from drivers.signals.points import ConfigurationError, DeviceExceptionError, LinkError, ProtocolError, Quality
from tests.drivers.faulty_server import FaultyServer, correct

POINTS = (
    Point(
        name="power", bus="b", unit="W", table="input", address=0, type="float32", order="CDAB", plausible=(-5, 1200)
    ),
    Point(name="speed", bus="b", unit="%", table="input", address=4, scale=0.1),
    Point(
        name="temperature", bus="b", unit="degC", table="input", address=5, type="int16", scale=0.01, invalid=(-32768,)
    ),
    Point(
        name="set",
        bus="b",
        unit="W",
        table="holding",
        address=20,
        scale=0.1,
        access="rw",
        limits=(0, 1000),
        safe_value=0,
    ),
    Point(name="beat", bus="b", unit="1", table="holding", address=21, access="rw"),
)


def bus(server: FaultyServer, **changes: object) -> ModbusBus:
    config = ModbusTcpBus(transport="modbus_tcp", port=server.port, timeout_s=0.2, **changes)
    return ModbusBus("plc", config, POINTS, time.monotonic)


def fill(server: FaultyServer) -> None:
    low_first = struct.unpack(">HH", struct.pack(">f", 750.25))[::-1]
    server.registers = {0: low_first[0], 1: low_first[1], 4: 655, 5: 2134}


async def test_values_come_scaled_in_one_request():
    asked = []

    def watch(server, tid, unit, pdu):
        asked.append(pdu[:5])
        return correct(server, tid, unit, pdu)

    async with FaultyServer(watch) as server:
        fill(server)
        driver = bus(server)
        await driver.connect()
        asked.clear()
        readings = await driver.read()
        await driver.close()
    assert readings.values == pytest.approx([750.25, 65.5, 21.34])
    assert readings.quality == [Quality.GOOD] * 3
    assert asked == [struct.pack(">BHH", 4, 0, 6)]


async def test_sentinels_and_implausible_values_are_not_good():
    async with FaultyServer() as server:
        fill(server)
        server.registers |= {5: 0x8000, 1: 0x4600}
        driver = bus(server)
        await driver.connect()
        readings = await driver.read()
        await driver.close()
    assert readings.quality == [Quality.OUT_OF_RANGE, Quality.GOOD, Quality.SENSOR_FAULT]


def too_short(server, tid, unit, pdu):
    return struct.pack(">BBH", pdu[0], 2, 42)


def wrong_function(server, tid, unit, pdu):
    answer = bytearray(correct(server, tid, unit, pdu))
    answer[0] = 3 if pdu[0] == 4 else 4
    return bytes(answer)


def refused(server, tid, unit, pdu):
    return bytes([pdu[0] | 0x80, 2])


def silent(server, tid, unit, pdu):
    return None


@pytest.mark.parametrize(
    ("behaviour", "error", "words"),
    [
        (too_short, ProtocolError, "1 registers where 6 were asked"),
        (wrong_function, ProtocolError, "answered function 3 to function 4"),
        (refused, DeviceExceptionError, "exception 2, address does not exist"),
        (silent, LinkError, "no answer within 0.2 s"),
    ],
)
async def test_each_bad_reply_is_its_own_error_and_no_value_is_good(behaviour, error, words):
    async with FaultyServer() as server:
        fill(server)
        driver = bus(server)
        await driver.connect()
        server.behaviour = behaviour
        readings = await driver.read()
        assert all(math.isnan(value) for value in readings.values)
        assert readings.quality == [Quality.LINK_FAULT] * 3
        assert words in (readings.fault or "")
        with pytest.raises(error):
            await driver.read_back(("set", "beat"))
        await driver.close()


async def test_a_truncated_reply_is_never_a_value():
    async with FaultyServer() as server:
        fill(server)
        driver = bus(server)
        await driver.connect()
        server.behaviour = lambda s, tid, unit, pdu: correct(s, tid, unit, pdu)[:-3]
        readings = await driver.read()
        await driver.close()
    assert Quality.GOOD not in readings.quality


async def test_late_replies_never_become_the_next_answer():
    async with FaultyServer() as server:
        fill(server)
        driver = bus(server)
        await driver.connect()
        server.delay_s = 0.35
        late = await driver.read()
        assert Quality.GOOD not in late.quality
        server.delay_s = 0.0
        server.registers[4] = 111
        for _ in range(40):
            readings = await driver.read()
            if readings.quality[1] == Quality.GOOD:
                break
            await asyncio.sleep(0.1)
        await driver.close()
    assert readings.values[1] == pytest.approx(11.1)


async def test_the_link_comes_back_within_two_seconds_of_the_server():
    async with FaultyServer() as server:
        fill(server)
        driver = bus(server)
        await driver.connect()
        await server.stop()
        began = time.monotonic()
        assert (await driver.read()).quality == [Quality.LINK_FAULT] * 3
        assert time.monotonic() - began < 1.0
        await asyncio.sleep(1.5)
        await server.start()
        back = time.monotonic()
        while (await driver.read()).quality != [Quality.GOOD] * 3:
            assert time.monotonic() - back < 2.0
            await asyncio.sleep(0.02)
        assert driver.reconnects == 1
        await driver.close()


async def test_a_rig_that_is_off_is_said_with_its_address():
    async with FaultyServer() as server:
        port = server.port
    config = ModbusTcpBus(transport="modbus_tcp", port=port, timeout_s=0.2)
    driver = ModbusBus("plc", config, POINTS, time.monotonic)
    with pytest.raises(LinkError, match=f"plc .Modbus/TCP 127.0.0.1:{port}, device 1. cannot be reached"):
        await driver.connect()
    await driver.close()


async def test_writes_touch_only_what_was_asked_and_are_read_back():
    async with FaultyServer() as server:
        driver = bus(server)
        await driver.connect()
        await driver.write({"set": 612.34, "beat": 7})
        await driver.write({"beat": 8})
        held = await driver.read_back(("set", "beat"))
        await driver.close()
    assert server.written == [(20, [6123, 7]), (21, [8])]
    assert held == {"set": pytest.approx(612.3), "beat": 8}


WIDE = tuple(
    Point(name=f"w{a}", bus="b", unit="1", table="holding", address=4 * a, type="uint64", access="rw")
    for a in range(30)
) + tuple(Point(name=f"n{a}", bus="b", unit="1", table="holding", address=120 + a, access="rw") for a in range(3))


@pytest.mark.parametrize(("count", "codes"), [(31, [23]), (32, [16, 3])], ids=["121 registers", "122 registers"])
async def test_function_23_writes_at_most_121_registers_and_else_it_takes_two_requests(count, codes):
    asked: list[int] = []

    def with_23(server, tid, unit, pdu):
        asked.append(pdu[0])
        if pdu[0] != 23:
            return correct(server, tid, unit, pdu)
        read, many, to, number = struct.unpack(">4H", pdu[1:9])
        server.registers |= dict(enumerate(struct.unpack(f">{number}H", pdu[10:]), to))
        return bytes((23, 2 * many)) + struct.pack(
            f">{many}H", *(server.registers[a] for a in range(read, read + many))
        )

    async with FaultyServer(with_23) as server:
        config = ModbusTcpBus(transport="modbus_tcp", port=server.port, timeout_s=0.5, read_write=True)
        driver = ModbusBus("plc", config, WIDE, time.monotonic)
        await driver.connect()
        values = {point.name: float(1 + 300 * number) for number, point in enumerate(WIDE[:count])}
        held = await driver.write_and_read_back(values, tuple(values))
        await driver.close()
    assert held == values
    assert asked == codes


def without_function(*missing):
    """Return the behaviour of a device that lacks these functions."""

    def behaviour(server, tid, unit, pdu):
        return bytes((pdu[0] | 0x80, 1)) if pdu[0] in missing else correct(server, tid, unit, pdu)

    return behaviour


async def test_a_device_without_function_6_is_written_with_16_where_its_section_says_so():
    async with FaultyServer(without_function(6)) as server:
        refused, driver = bus(server), bus(server, write_multiple=True)
        await refused.connect()
        with pytest.raises(
            DeviceExceptionError, match=r"function 6: exception 1, .*write_multiple = true.*function 16"
        ):
            await refused.write({"set": 5.0})
        await refused.close()
        await driver.connect()
        await driver.write({"set": 5.0})
        held = await driver.read_back(("set",))
        await driver.close()
    assert held == {"set": 5.0} and server.written == [(20, [50])]


@pytest.mark.parametrize(
    ("missing", "keys", "values", "remedy"),
    [
        (16, {}, {"set": 5.0, "beat": 1.0}, r"give the bus max_write = 1"),
        (16, {"write_multiple": True}, {"set": 5.0}, r"take write_multiple out"),
    ],
)
async def test_a_refused_function_16_names_its_remedy(missing, keys, values, remedy):
    async with FaultyServer(without_function(missing)) as server:
        driver = bus(server, **keys)
        await driver.connect()
        with pytest.raises(DeviceExceptionError, match=rf"function 16: exception 1.*{remedy}"):
            await driver.write(values)
        await driver.close()
    assert not server.written


async def test_a_write_that_is_confirmed_wrongly_is_an_error():
    async with FaultyServer(
        lambda s, tid, unit, pdu: struct.pack(">BHH", pdu[0], 20, 9) if pdu[0] > 4 else correct(s, tid, unit, pdu)
    ) as server:
        driver = bus(server)
        await driver.connect()
        with pytest.raises(ProtocolError, match="confirmed 9 registers"):
            await driver.write({"set": 1.0, "beat": 7})
        with pytest.raises(ProtocolError, match="echoed"):
            await driver.write({"beat": 7})
        await driver.close()


# What a device has not, and what it is -------------------------------------------------------------------------------


def has(*present: int):
    """A device that has only the `present` input registers; a request that touches another is refused (6.4)."""

    def answer(server, tid, unit, pdu):
        code, address, count = struct.unpack(">BHH", pdu[:5])
        server.asked.append((code, address, count))
        if code == 4 and not set(range(address, address + count)) <= set(present):
            return bytes([0x84, 2])
        return correct(server, tid, unit, pdu)

    return answer


async def test_a_hole_that_nobody_declared_is_found_once_and_remembered():
    async with FaultyServer(has(0, 1, 4, 5)) as server:
        server.asked = []
        fill(server)
        driver = bus(server)
        await driver.connect()
        assert server.asked == [(4, 0, 6), (4, 0, 2), (4, 4, 2)]
        server.asked.clear()
        readings = await driver.read()
        await driver.close()
    assert server.asked == [(4, 0, 2), (4, 4, 2)]
    assert readings.quality == [Quality.GOOD] * 3
    assert readings.fault is None
    assert readings.values == pytest.approx([750.25, 65.5, 21.34])


async def test_a_declared_hole_is_never_asked_for():
    async with FaultyServer(has(0, 1, 4, 5)) as server:
        server.asked = []
        driver = bus(server, hole=[{"table": "input", "first": 2, "last": 3}])
        await driver.connect()
        await driver.close()
    assert server.asked == [(4, 0, 2), (4, 4, 2)]


async def test_a_value_that_the_device_has_not_is_named_when_it_is_connected():
    async with FaultyServer(has(0, 1, 5)) as server:
        server.asked = []
        driver = bus(server)
        with pytest.raises(DeviceExceptionError, match=r"points that cannot be read: speed$"):
            await driver.connect()
        await driver.close()


async def test_a_value_that_is_refused_later_is_a_fault_of_its_own_signal_only():
    async with FaultyServer() as server:
        fill(server)
        server.asked = []
        driver = bus(server)
        await driver.connect()
        server.behaviour = has(0, 1, 5)
        for _ in range(2):
            readings = await driver.read()
            assert readings.quality == [Quality.GOOD, Quality.LINK_FAULT, Quality.GOOD]
            assert "the device does not read input 4" in readings.fault or "refused input 4" in readings.fault
        asked = len(server.asked)
        await driver.read()
        assert len(server.asked) == asked + 2
        await driver.close()


MIXED = (
    Point(name="serial", bus="b", unit="1", table="input", address=40, type="string", length=3, expect="P17"),
    Point(name="alarm", bus="b", unit="1", table="input", address=50, bits=(3, 3)),
    Point(name="mode", bus="b", unit="1", table="input", address=50, bits=(4, 6), labels={"0": "off", "2": "run"}),
)


@pytest.mark.parametrize(("last", "said"), [(0x3700, None), (0x3800, "is 'P18' and the rig file expects 'P17'")])
async def test_a_text_tells_which_device_it_is(last, said):
    async with FaultyServer() as server:
        server.registers = {40: 0x5031, 41: last, 50: 0b0010_1000}
        config = ModbusTcpBus(transport="modbus_tcp", port=server.port, timeout_s=0.2)
        driver = ModbusBus("plc", config, MIXED, time.monotonic)
        if said is None:
            await driver.connect()
            readings = await driver.read()
            assert driver.texts == {"serial": "P17"}
            assert readings.values == [1.0, 2.0]
            assert readings.quality == [Quality.GOOD] * 2
        else:
            with pytest.raises(ConfigurationError, match=said):
                await driver.connect()
        await driver.close()


BITS = tuple(
    Point(name=f"c{a}", bus="b", unit="1", table="coil", address=a, access="rw" if a < 22 else "r")
    for a in range(19, 38)
)


def coils(server, tid, unit, pdu):
    """The coils of the specification's example (V1.1b3, 6.1): 20 to 38, addressed from 19."""
    code, address, count = struct.unpack(">BHH", pdu[:5])
    if code == 1:
        bits = int.from_bytes(bytes.fromhex("cd6b05"), "little") >> (address - 19)
        data = (bits & (1 << count) - 1).to_bytes(-(-count // 8), "little")
        return bytes([1, len(data)]) + data
    server.written.append((code, pdu))
    return pdu[:5]


async def test_coils_are_read_and_written_as_the_specification_shows():
    async with FaultyServer(coils) as server:
        config = ModbusTcpBus(transport="modbus_tcp", port=server.port, timeout_s=0.2)
        driver = ModbusBus("plc", config, BITS, time.monotonic)
        await driver.connect()
        readings = await driver.read()
        await driver.write({"c19": 1.0})
        await driver.write({"c19": 1.0, "c20": 0.0, "c21": 1.0})
        held = await driver.read_back(("c19", "c20", "c21"))
        with pytest.raises(ConfigurationError, match="write 0 or 1"):
            await driver.write({"c19": 0.5})
        await driver.close()
    whole = [int(bit) for byte in bytes.fromhex("cd6b05") for bit in format(byte, "08b")[::-1]]
    assert readings.values == whole[3:19]
    assert held == {"c19": 1, "c20": 0, "c21": 1}
    assert server.written == [
        (5, bytes.fromhex("050013ff00")),
        (15, bytes.fromhex("0f001300030105")),
    ]


async def test_a_coil_reply_of_another_length_is_not_used():
    async with FaultyServer(coils) as server:
        config = ModbusTcpBus(transport="modbus_tcp", port=server.port, timeout_s=0.2)
        driver = ModbusBus("plc", config, BITS, time.monotonic)
        await driver.connect()
        server.behaviour = lambda *_: bytes.fromhex("0101ff")
        readings = await driver.read()
        await driver.close()
    assert set(readings.quality) == {Quality.LINK_FAULT}
    assert "answered 8 bits where 16 were asked" in readings.fault
