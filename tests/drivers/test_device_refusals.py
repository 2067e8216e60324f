"""Devices that refuse requests: no other point is lost, and reads are split where that can help."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable

import pytest

from drivers.modbus.bus import ModbusBus
from drivers.rig_file.bus_sections import ModbusTcpBus
from drivers.rig_file.model import Point
from drivers.signals.points import DriverError, Quality
from tests.drivers.odd_device import Serve, answer, asked, driver, every, listening, mbap

MANY = tuple(Point(name=f"p{n}", bus="b", unit="1", table="input", address=n) for n in range(40))


def refusing(code: int, refused: Callable[[int, int], bool], asked_for: list[int]) -> Serve:
    """A device that refuses with exception `code` the reads for whose address and count `refused` is True."""

    def reply(tid: int, unit: int, pdu: bytes) -> bytes:
        _, address, count = struct.unpack(">BHH", pdu[:5])
        asked_for.append(count)
        return mbap(tid, unit, bytes((pdu[0] | 0x80, code)) if refused(address, count) else answer(pdu))

    return every(reply)


@pytest.mark.parametrize("code", [2, 3, 4, 8])
async def test_one_register_that_a_device_refuses_takes_no_other_whatever_the_exception(code):
    counts: list[int] = []
    async with listening(refusing(code, lambda at, count: at <= 5 < at + count, counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, time.monotonic)
        with pytest.raises(DriverError, match=rf"refused input 0 to 39: exception {code}.*cannot be read: p5$"):
            await bus.connect()
        readings = await bus.read()
        await bus.close()
    assert [n for n, quality in enumerate(readings.quality) if quality != Quality.GOOD] == [5]
    assert "input 5" in (readings.fault or "")


async def test_a_device_that_reads_few_registers_at_once_is_read_in_small_parts():
    counts: list[int] = []
    async with listening(refusing(3, lambda at, count: count > 6, counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, time.monotonic)
        await bus.connect()
        readings = await bus.read()
        await bus.close()
    assert set(readings.quality) == {Quality.GOOD} and readings.fault is None


@pytest.mark.parametrize("code", [1, 10, 11])
async def test_a_refusal_that_a_smaller_read_cannot_help_is_not_split(code):
    counts: list[int] = []
    async with listening(refusing(code, lambda at, count: True, counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, time.monotonic)
        with pytest.raises(DriverError, match=f"exception {code}"):
            await bus.connect()
        await bus.close()
    assert set(counts) == {40}


async def test_a_device_that_fails_as_a_whole_is_asked_for_few_parts_a_tick_and_for_the_whole_again_later():
    counts: list[int] = []
    now, fails = [0.0], [False]
    async with listening(refusing(4, lambda at, count: fails[0], counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, lambda: now[0])
        await bus.connect()
        fails[0] = True
        counts.clear()
        readings = await bus.read()
        assert Quality.GOOD not in readings.quality
        assert len(counts) < 20
        for _ in range(10):
            await bus.read()
        fails[0], now[0] = False, 31.0
        counts.clear()
        readings = await bus.read()
        await bus.close()
    assert set(readings.quality) == {Quality.GOOD} and counts == [40]


async def test_a_refused_write_is_named_with_its_function():
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            tid, unit, pdu = await asked(reader)
            writer.write(mbap(tid, unit, answer(pdu) if pdu[0] == 3 else bytes((pdu[0] | 0x80, 1))))

    async with listening(serve) as port:
        bus = driver(port)
        await bus.connect()
        said = "refused to write holding 70 with function 6: exception 1, function not supported"
        with pytest.raises(DriverError, match=said):
            await bus.write({"set": 1.0})
        await bus.close()
