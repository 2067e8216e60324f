"""Devices that close, listen late or answer late: connections that are waited for, made again, or told as they are."""

from __future__ import annotations

import asyncio
import time

import pytest

from drivers.rig.watch import RigWatch
from drivers.signals.points import Quality
from tests.drivers.faulty_server import FaultyServer, correct
from tests.drivers.odd_device import POINTS, answer, asked, driver, every, good, listening, mbap


@pytest.mark.parametrize("by", ["close", "abort"])
async def test_a_device_that_closes_after_each_reply_is_read_without_a_fault(by):
    written: list[int] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tid, unit, pdu = await asked(reader)
        if pdu[0] == 6:
            written.append(pdu[4])
        writer.write(mbap(tid, unit, pdu if pdu[0] == 6 else answer(pdu)))
        await writer.drain()
        if by == "abort":
            await asyncio.sleep(0.01)
            writer.transport.abort()

    async with listening(serve) as port:
        bus = driver(port)
        await bus.connect()
        for beat in range(5):
            readings = await bus.read()
            assert (readings.quality, readings.fault) == ([Quality.GOOD] * 2, None)
            await bus.write({"set": beat})
        await bus.close()
    assert written == [0, 1, 2, 3, 4]
    assert bus.reconnects == 0


async def test_a_device_that_is_deaf_after_connecting_is_waited_for():
    unanswered: list[bytes] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        listens = time.monotonic() + 0.7
        while True:
            tid, unit, pdu = await asked(reader)
            if time.monotonic() > listens:
                writer.write(mbap(tid, unit, answer(pdu)))
            else:
                unanswered.append(pdu)

    async with listening(serve) as port:
        assert (await good(port))[1] == [100, 160]
    assert unanswered


async def test_no_request_goes_out_before_the_connect_delay_is_over():
    first: list[float] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        began = time.monotonic()
        while True:
            tid, unit, pdu = await asked(reader)
            first.append(time.monotonic() - began)
            writer.write(mbap(tid, unit, answer(pdu)))

    async with listening(serve) as port:
        await good(port, connect_delay_s=0.5)
    assert first[0] > 0.45


@pytest.mark.parametrize("first", ["closed", "mute"])
async def test_a_device_that_serves_the_second_connection_only_is_read(first, monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.2, 1.0))
    connections: list[int] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(1)
        if len(connections) == 1:
            if first == "mute":
                await reader.read()
            return
        while True:
            tid, unit, pdu = await asked(reader)
            writer.write(mbap(tid, unit, answer(pdu)))

    async with listening(serve) as port:
        assert (await good(port))[1] == [100, 160]
    assert len(connections) == 2


async def test_a_missed_deadline_is_not_told_as_a_rig_that_is_off(monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.1, 0.1))
    from drivers.rig_file.model import Rig

    async with listening(every(lambda t, u, p: mbap(t, u, answer(p), more=1))) as port:
        config = {"transport": "modbus_tcp", "port": port, "timeout_s": 0.1}
        rig = Rig.model_validate({"name": "r", "bus": {"b": config}, "point": [p.model_dump() for p in POINTS[:1]]})
        async with RigWatch(rig) as watch:
            (said,) = watch.faults()["b"]
    assert "announces 6 bytes and has 5" in said


async def test_a_reply_that_lay_in_the_queue_while_the_process_was_stopped_is_asked_for_again(monkeypatch):
    asked_for: list[bytes] = []

    def watched(server, tid, unit, pdu):
        asked_for.append(pdu)
        return correct(server, tid, unit, pdu)

    async with FaultyServer(watched) as server:
        bus = driver(server.port)
        await bus.connect()
        asked_for.clear()
        stopped = Stopped(after=1)
        monkeypatch.setattr("drivers.modbus.link.steady_s", stopped)
        monkeypatch.setattr(bus.link, "_late", 3)
        server.behaviour = stopped.wrapping(watched)
        readings = await bus.read()
        assert (readings.quality, readings.fault) == ([Quality.GOOD] * 2, None)
        assert len(asked_for) == 3
        assert (bus.missed, bus.reconnects) == (0, 0)
        stopped.stops = 9
        readings = await bus.read()
        assert readings.quality == [Quality.LINK_FAULT] * 2
        assert "too late to be used" in (readings.fault or "")
        await bus.close()


class Stopped:
    """A steady clock that jumps by 5 s while a reply is under way, for the first `after` replies."""

    def __init__(self, after: int) -> None:
        self.stops = after
        self.ahead_s = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.ahead_s

    def wrapping(self, behaviour):
        def answer(*arguments):
            if self.stops:
                self.stops -= 1
                self.ahead_s += 5.0
            return behaviour(*arguments)

        return answer


async def test_a_read_that_reconnects_is_cancelled_though_the_connection_stands():
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tid, unit, pdu = await asked(reader)
        writer.write(mbap(tid, unit, answer(pdu)))
        await writer.drain()

    async with listening(serve) as port:
        bus = driver(port)
        await bus.connect()
        await asyncio.sleep(0.05)  # the device closes
        opened = bus.link.open

        async def opened_and_cancelled(where: str) -> None:
            await opened(where)
            reading.cancel()

        bus.link.open = opened_and_cancelled
        reading = asyncio.ensure_future(bus.read())
        await asyncio.wait((reading,), timeout=5.0)
        await bus.close()
    assert reading.cancelled()
