"""One device behind every Modbus transport, with a wire between that fails on request.

The device is the virtual rig's protocol side; what it holds is changed before every read, so that any value of another
register or of an earlier read is seen to be wrong.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
import struct
import time
import tty
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.bus.contract import Readings
from drivers.modbus.bus import ModbusBus
from drivers.rig_file.bus_sections import ModbusBusSection, ModbusRtuBus, ModbusRtuTcpBus, ModbusTcpBus, ModbusTlsBus
from drivers.rig_file.model import Point
from drivers.signals.points import DeadlineError, LinkError, Quality
from drivers.virtual.devices.modbus_protocol import ModbusConnection
from drivers.virtual.devices.modbus_server import tls_context
from drivers.virtual.devices.pymodbus_server import PymodbusServer
from drivers.virtual.devices.registers import INPUT_COUNT, Registers
from drivers.virtual.devices.rtu_protocol import RtuConnection
from drivers.virtual.faults.faulty_link import Change, FaultyLink, modbus_frames, rtu_frames
from drivers.virtual.faults.faulty_replies import in_rtu
from hil.bench.faults.tls import Certificates

TRANSPORTS = (
    *("tcp", "tls", "tcp, transaction 0", "rtu over tcp", "rtu serial"),
    *("tcp to pymodbus", "rtu over tcp to pymodbus"),
)
"""Those to pymodbus end at its server, the others at the virtual rig's own."""
POINTS = (
    *(Point(name=f"p{a}", bus="b", unit="1", table="input", address=a) for a in range(INPUT_COUNT)),
    Point(name="set", bus="b", unit="1", table="holding", address=1, access="rw"),
    Point(name="beat", bus="b", unit="1", table="holding", address=3, access="rw"),
    Point(name="timeout", bus="b", unit="1", table="holding", address=4, access="rw"),
)
TIMEOUT_S = 0.15


@dataclass
class Wired:
    """The driver, the device's memory, and the wire between them."""

    bus: ModbusBus
    registers: Registers
    link: FaultyLink
    is_rtu: bool
    epoch: int = 0

    def break_by(self, change: Change | None, *, any_frame: bool = False) -> None:
        """Change replies; `any_frame` changes do not know what a frame is and are the same in RTU."""
        self.link.change = in_rtu(change) if self.is_rtu and change is not None and not any_frame else change

    async def read(self) -> Readings:
        """A read of registers that hold something new; fails where a good value is wrong, or another is a number."""
        self.epoch += 1
        truth = [(a * 251 + self.epoch * 7919 + 13) & 0xFFFF for a in range(INPUT_COUNT)]
        self.registers.inputs = struct.pack(f">{INPUT_COUNT}H", *truth)
        readings = await self.bus.read()
        for number, (value, quality) in enumerate(zip(readings.values, readings.quality, strict=True)):
            if quality == Quality.GOOD:
                assert value == truth[number], f"read {self.epoch}: p{number} is {value} and was {truth[number]}"
            else:
                assert value != value, f"read {self.epoch}: p{number} is not good and yet {value}"
        return readings

    async def good_again(self, within_s: float) -> None:
        """Read until everything is good."""
        end = time.monotonic() + within_s
        while set((await self.read()).quality) != {Quality.GOOD}:
            assert time.monotonic() < end, f"not good again within {within_s} s"
            await asyncio.sleep(0.02)


class PseudoPair:
    """A serial line of this machine whose other end is a TCP connection; it stays when that is reset."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)
        self._writer: asyncio.StreamWriter | None = None
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> PseudoPair:
        asyncio.get_running_loop().add_reader(self._ours, self._from_line)
        self._tasks.append(asyncio.create_task(self._to_line(), name="pseudo line"))
        while self._writer is None:
            await asyncio.sleep(0.005)
        return self

    async def __aexit__(self, *_: object) -> None:
        asyncio.get_running_loop().remove_reader(self._ours)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        os.close(self._ours)
        os.close(self._theirs)

    def _from_line(self) -> None:
        with contextlib.suppress(OSError):
            data = os.read(self._ours, 4096)
            if self._writer is not None and not self._writer.is_closing():
                self._writer.write(data)

    async def _to_line(self) -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
                self._writer = writer
                try:
                    while data := await reader.read(4096):
                        os.write(self._ours, data)
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def _tls_front(port: int, certificates: Certificates) -> AsyncIterator[int]:
    """Ends TLS in front of a plain port."""
    context: ssl.SSLContext = tls_context(*certificates.rig)
    tasks: set[asyncio.Task[None]] = set()

    async def pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(4096):
                writer.write(data)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            writer.transport.abort()
            return
        halves = [asyncio.create_task(pump(reader, far_writer)), asyncio.create_task(pump(far_reader, writer))]
        try:
            await asyncio.wait(halves, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            pass
        finally:
            for half in halves:
                half.cancel()
            await asyncio.gather(*halves, return_exceptions=True)
            far_writer.transport.abort()
            writer.transport.abort()

    server = await asyncio.start_server(serve, "127.0.0.1", 0, ssl=context)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for task in list(tasks):
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def _served(registers: Registers, is_rtu: bool, *, by_pymodbus: bool) -> AsyncIterator[int]:
    """Serve the registers on a port."""
    if by_pymodbus:
        served = PymodbusServer(registers, "127.0.0.1", 0, None, rtu_port=0)
        await served.open()
        try:
            yield (served.rtu_port or 0) if is_rtu else served.port
        finally:
            served.close()
            await asyncio.sleep(0)
        return
    clients: set[ModbusConnection | RtuConnection] = set()
    kind: Callable[..., asyncio.Protocol] = RtuConnection if is_rtu else ModbusConnection
    server = await asyncio.get_running_loop().create_server(lambda: kind({1: registers}, clients), "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        for client in list(clients):
            client.close()
        server.close()


@contextlib.asynccontextmanager
async def wired(transport: str, certificates: Certificates | None, **changes: object) -> AsyncIterator[Wired]:
    """A connected driver on one transport."""
    registers = Registers()
    is_rtu = transport.startswith("rtu")
    async with contextlib.AsyncExitStack() as stack:
        port = await stack.enter_async_context(_served(registers, is_rtu, by_pymodbus="pymodbus" in transport))
        transport = transport.removesuffix(" to pymodbus")
        if transport == "tcp, transaction 0":
            device = await stack.enter_async_context(FaultyLink(port, modbus_frames))
            device.change = lambda frame: [(0.0, b"\0\0" + frame[2:])]
            port = device.port
        link = await stack.enter_async_context(FaultyLink(port, rtu_frames if is_rtu else modbus_frames))
        common = {"timeout_s": TIMEOUT_S, "max_read": 6} | changes
        config: ModbusBusSection
        if transport == "tcp":
            config = ModbusTcpBus(transport="modbus_tcp", port=link.port, **common)
        elif transport == "tcp, transaction 0":
            config = ModbusTcpBus(transport="modbus_tcp", port=link.port, transaction="zero", **common)
        elif transport == "tls":
            assert certificates is not None
            front = await stack.enter_async_context(_tls_front(link.port, certificates))
            config = ModbusTlsBus(transport="modbus_tls", port=front, **certificates.harness, **common)
        elif transport == "rtu over tcp":
            config = ModbusRtuTcpBus(transport="modbus_rtu_tcp", port=link.port, **common)
        else:
            line = await stack.enter_async_context(PseudoPair(link.port))
            config = ModbusRtuBus(transport="modbus_rtu", serial_port=line.path, serial_baud=115200, **common)
        bus = ModbusBus("b", config, POINTS, time.monotonic)
        stack.push_async_callback(bus.close)
        await _connected(bus)
        yield Wired(bus, registers, link, is_rtu)


async def _connected(bus: ModbusBus) -> None:
    """Connect; where driver and device share a busy processor, the deadline of the first reads may pass."""
    for left in range(4, -1, -1):
        try:
            await bus.connect()
            return
        except (LinkError, DeadlineError):
            if not left:
                raise
        await asyncio.sleep(1.0)


def certificates_in(folder: Path) -> Certificates:
    """Certificates for `tls`."""
    from hil.bench.faults.tls import make_certificates

    return make_certificates(folder)
