"""The Modbus driver against a server that misbehaves: no wrong value is good, and a lost link comes back."""

from __future__ import annotations

import asyncio
import math
import struct
import time

import pytest

from drivers.modbus import ModbusBus
from drivers.points import DeviceExceptionError, LinkError, ProtocolError, Quality
from drivers.rigfile import ModbusTcpBus, Point
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
