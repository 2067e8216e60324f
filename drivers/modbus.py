"""Modbus/TCP client, plain or over TLS: the one module that imports pymodbus.

pymodbus accepts replies that are too short or of the wrong function, declares a dead link only after many time-outs
and backs off its reconnection to minutes. So the deadline, the checks of each reply and the reconnection are ours;
pymodbus frames and matches transactions.
"""

from __future__ import annotations

import asyncio
import logging
import math
import ssl
from collections.abc import Mapping
from typing import Any

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.transport import CommParams, CommType

from drivers.bus import Clock, Readings, judge
from drivers.codec import decode, encode
from drivers.plan import Block, plan_reads, plan_writes
from drivers.points import (
    ConfigurationError,
    DeadlineError,
    DeviceExceptionError,
    DriverError,
    LinkError,
    ProtocolError,
    Quality,
)
from drivers.rigfile import ModbusTcpBus, ModbusTlsBus, Point
from drivers.sensor_watch import watches
from drivers.tls import client_context, why_refused

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what it reports, this module raises

RECONNECT_EVERY_S = 1.0
_READ_CODE = {"holding": 3, "input": 4}
_EXCEPTIONS = {
    1: "function not supported",
    2: "address does not exist (is the address zero-based?)",
    3: "value not accepted",
    4: "device failure",
    5: "still working on it",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer (is device_id right?)",
}


class _SecureClient(AsyncModbusTcpClient):
    """pymodbus's own TLS client takes each TLS record for one frame; this one finds frames by their length."""

    def __init__(self, host: str, *, port: int, timeout: float, context: ssl.SSLContext) -> None:
        self.comm_params = CommParams(
            comm_type=CommType.TLS, host=host, port=port, timeout_connect=timeout, reconnect_delay=0, sslctx=context
        )
        super().__init__(host, port=port, timeout=timeout, retries=0, reconnect_delay=0)


class ModbusBus:
    """One Modbus/TCP device: its polled points are read in as few blocks as the limits admit."""

    def __init__(self, name: str, config: ModbusTcpBus, points: tuple[Point, ...], clock: Clock) -> None:
        self.name = name
        self.points = tuple(point for point in points if point.access == "r")
        self.reconnects = 0
        self._all = {point.name: point for point in points}
        self._config = config
        self._clock = clock
        self._tls = client_context(config) if isinstance(config, ModbusTlsBus) else None
        kind = "Modbus/TCP" if self._tls is None else "Modbus/TCP Security"
        self._where = f"{name} ({kind} {config.host}:{config.port}, device {config.device_id})"
        self._plan = plan_reads(self.points, max_read=config.max_read, max_gap=config.max_gap)
        order = {point.name: index for index, point in enumerate(self.points)}
        self._slots = [
            [(order[p.name], p, (p.address or 0) - block.address) for p in block.points] for block in self._plan
        ]
        self._watches = watches(self.points)
        self._uptime = order.get(config.uptime) if config.uptime is not None else None
        self._write_plans: dict[tuple[str, ...], list[Block]] = {}
        self._client: AsyncModbusTcpClient | None = None
        self._supervisor: asyncio.Task[None] | None = None

    async def connect(self) -> None:
        """Connect and read each block once; raises LinkError, or ConfigurationError where the map is wrong."""
        await self._open()
        try:
            for block in self._plan:
                await self._request(block)
        except LinkError:
            # In TLS 1.3 a client learns only now that its certificate was refused.
            await self._explain()
            raise

    async def _open(self) -> None:
        self._drop()
        client = self._new_client()
        try:
            async with asyncio.timeout(self._config.timeout_s + 1.0):
                connected = await client.connect()
        except (TimeoutError, OSError, ModbusException) as error:
            client.close()
            raise LinkError(f"{self._where} cannot be reached: {error or 'no answer'}; is the rig on?") from error
        if not connected:
            client.close()
            await self._explain()
            raise LinkError(f"{self._where} cannot be reached; is the rig on, and host and port right?")
        self._client = client

    def _new_client(self) -> AsyncModbusTcpClient:
        config = self._config
        client: AsyncModbusTcpClient
        if self._tls is not None:
            client = _SecureClient(config.host, port=config.port, timeout=config.timeout_s, context=self._tls)
        else:
            client = AsyncModbusTcpClient(
                config.host, port=config.port, timeout=config.timeout_s, retries=0, reconnect_delay=0
            )
        receive = client.ctx.data_received

        def guarded(data: bytes) -> None:
            # A reply that pymodbus cannot decode raises in asyncio's callback, which prints a traceback.
            try:
                receive(data)
            except Exception:
                client.close()

        client.ctx.data_received = guarded  # type: ignore[method-assign]
        return client

    async def _explain(self) -> None:
        """Raise the reason why TLS was refused, where that is why; pymodbus tells only that there is no connection."""
        if self._tls is None or not isinstance(self._config, ModbusTlsBus):
            return
        why = await why_refused(self._config, self._tls)
        if why is not None:
            raise LinkError(f"{self._where}: {why}")

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    async def read(self) -> Readings:
        """All polled points; LINK_FAULT for those of a block that failed, and a reconnection is set going."""
        count = len(self.points)
        values, quality, source = [math.nan] * count, [int(Quality.LINK_FAULT)] * count, [math.nan] * count
        fault: str | None = None
        for block, slots in zip(self._plan, self._slots, strict=True):
            try:
                registers = await self._request(block)
            except DriverError as error:
                fault = str(error)
                if isinstance(error, LinkError):
                    break
                continue
            now = self._clock()
            for index, point, at in slots:
                values[index], quality[index] = judge(
                    point, decode(registers[at : at + point.width], point.type, point.order)
                )
                watch = self._watches[index]
                if watch is not None:
                    quality[index] = watch.judge(values[index], quality[index], now)
                source[index] = now
        if self._uptime is not None and math.isfinite(values[self._uptime]):
            device_time = values[self._uptime]
            source = [device_time if math.isfinite(time) else time for time in source]
        return Readings(values, quality, source, fault)

    async def write(self, values: Mapping[str, float]) -> None:
        """Write by point name, touching registers in one request (function 16); raises DriverError."""
        names = tuple(values)
        plan = self._write_plans.get(names)
        if plan is None:
            plan = plan_writes((self._all[name] for name in names), max_write=self._config.max_write)
            self._write_plans[names] = plan
        for block in plan:
            registers: list[int] = []
            for point in block.points:
                try:
                    registers += encode((values[point.name] - point.offset) / point.scale, point.type, point.order)
                except ValueError as error:
                    raise ConfigurationError(f"{point.name}: {error}; correct its type or scale") from error
            client = self._connected()
            if len(registers) == 1:
                call = client.write_register(block.address, registers[0], device_id=self._config.device_id)
                reply = await self._bounded(call)
                self._check(reply, 6, block)
                if reply.registers[:1] != registers:
                    raise ProtocolError(f"{self._where} echoed {reply.registers} to a write of {registers}")
            else:
                call = client.write_registers(block.address, registers, device_id=self._config.device_id)
                reply = await self._bounded(call)
                self._check(reply, 16, block)
                if (reply.address, reply.count) != (block.address, block.count):
                    raise ProtocolError(
                        f"{self._where} confirmed {reply.count} registers at {reply.address}, "
                        f"asked were {block.count} at {block.address}"
                    )

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Writable points as the device holds them."""
        found: dict[str, float] = {}
        for block in plan_reads((self._all[name] for name in names), max_gap=0):
            registers = await self._request(block)
            for point in block.points:
                at = (point.address or 0) - block.address
                found[point.name], _ = judge(point, decode(registers[at : at + point.width], point.type, point.order))
        return found

    async def close(self) -> None:
        """Stop reconnecting and close the connection."""
        if self._supervisor is not None:
            self._supervisor.cancel()
            await asyncio.gather(self._supervisor, return_exceptions=True)
            self._supervisor = None
        self._drop()
        await asyncio.sleep(0)

    async def _request(self, block: Block) -> list[int]:
        client = self._connected()
        read = client.read_input_registers if block.table == "input" else client.read_holding_registers
        reply = await self._bounded(read(block.address, count=block.count, device_id=self._config.device_id))
        self._check(reply, _READ_CODE[block.table], block)
        if len(reply.registers) != block.count:
            raise ProtocolError(
                f"{self._where} answered {len(reply.registers)} registers where {block.count} were asked "
                f"({block.table} {block.address}); the reply is not used"
            )
        return list(reply.registers)

    def _connected(self) -> AsyncModbusTcpClient:
        client = self._client
        if client is None or not client.connected:
            self._lost()
            raise LinkError(f"{self._where}: the connection is lost; reconnecting every {RECONNECT_EVERY_S:g} s")
        return client

    async def _bounded(self, call: Any) -> Any:
        """Await a pymodbus call within our own deadline; a link that missed it is closed, for its late reply."""
        try:
            async with asyncio.timeout(self._config.timeout_s * 1.5):
                return await call
        except (TimeoutError, ConnectionException, ModbusException, OSError) as error:
            self._drop()
            self._lost()
            kind = LinkError if isinstance(error, ConnectionException | OSError) else DeadlineError
            raise kind(f"{self._where}: no answer within {self._config.timeout_s:g} s; reconnecting") from error

    def _check(self, reply: Any, function_code: int, block: Block) -> None:
        if reply.isError():
            code = int(getattr(reply, "exception_code", 0))
            what = _EXCEPTIONS.get(code, "an unknown exception")
            raise DeviceExceptionError(
                f"{self._where} refused {block.table} {block.address} to {block.address + block.count - 1}: "
                f"exception {code}, {what}",
                code,
            )
        if reply.function_code != function_code:
            raise ProtocolError(f"{self._where} answered function {reply.function_code} to function {function_code}")

    def _lost(self) -> None:
        if self._supervisor is None or self._supervisor.done():
            self._supervisor = asyncio.create_task(self._reconnect(), name=f"reconnect {self.name}")

    async def _reconnect(self) -> None:
        while True:
            try:
                await self._open()
            except LinkError:
                await asyncio.sleep(RECONNECT_EVERY_S)
            else:
                self.reconnects += 1
                return
