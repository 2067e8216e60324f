"""A device that answers as a test says, and the driver that reads it."""

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable

from drivers.modbus.bus import ModbusBus
from drivers.rig_file.bus_sections import ModbusBusSection, ModbusRtuTcpBus, ModbusTcpBus
from drivers.rig_file.model import Point
from drivers.signals.points import Quality

POINTS = (
    Point(name="a", bus="b", unit="1", table="holding", address=0),
    Point(name="far", bus="b", unit="1", table="holding", address=60),
    Point(name="set", bus="b", unit="1", table="holding", address=70, access="rw"),
)
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@contextlib.asynccontextmanager
async def listening(serve: Serve) -> AsyncIterator[int]:
    tasks: set[asyncio.Task[None]] = set()

    async def served(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            await serve(reader, writer)
        writer.close()

    server = await asyncio.start_server(served, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for task in list(tasks):
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def asked(reader: asyncio.StreamReader) -> tuple[int, int, bytes]:
    """Transaction, unit and PDU of the next request."""
    tid, _, length, unit = struct.unpack(">HHHB", await reader.readexactly(7))
    return tid, unit, await reader.readexactly(length - 1)


def answer(pdu: bytes) -> bytes:
    """A reply in which register n holds 100 + n."""
    code, address, count = struct.unpack(">BHH", pdu[:5])
    return struct.pack(f">BB{count}H", code, 2 * count, *(100 + address + k for k in range(count)))


def every(reply: Callable[[int, int, bytes], bytes]) -> Serve:
    """A device that answers each request with the bytes of `reply`."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            writer.write(reply(*await asked(reader)))

    return serve


def mbap(tid: int, unit: int, pdu: bytes, *, protocol: int = 0, more: int = 0) -> bytes:
    return struct.pack(">HHHB", tid, protocol, len(pdu) + 1 + more, unit) + pdu


def driver(port: int, kind: type[ModbusBusSection] = ModbusTcpBus, **changes: object) -> ModbusBus:
    transport = "modbus_rtu_tcp" if kind is ModbusRtuTcpBus else "modbus_tcp"
    config = kind(transport=transport, port=port, **{"timeout_s": 0.15, **changes})
    return ModbusBus("b", config, POINTS, time.monotonic)


async def good(port: int, **changes: object) -> tuple[ModbusBus, list[float]]:
    bus = driver(port, **changes)
    try:
        await bus.connect()
        for _ in range(4):
            readings = await bus.read()
            assert (readings.quality, readings.fault) == ([Quality.GOOD] * 2, None)
        return bus, readings.values
    finally:
        await bus.close()
