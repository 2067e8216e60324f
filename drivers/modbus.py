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
from collections.abc import Iterable, Mapping
from typing import Any

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.transport import CommParams, CommType

from drivers.bus import Clock, Readings, judge
from drivers.bus_sections import ModbusTcpBus, ModbusTlsBus
from drivers.codec import CodecError, decode, decode_text, encode
from drivers.plan import BIT_TABLES, Block, ReadPlan, plan_reads, plan_writes
from drivers.points import (
    ConfigurationError,
    DeadlineError,
    DeviceExceptionError,
    DriverError,
    LinkError,
    ProtocolError,
    Quality,
)
from drivers.replies import FrameGuard
from drivers.rig_model import Point
from drivers.sensor_watch import watches
from drivers.tls import client_context, why_refused

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what it reports, this module raises

RECONNECT_EVERY_S = 1.0
_NO_SUCH_ADDRESS = 2
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
        self.points = tuple(point for point in points if point.is_polled)
        self.texts: dict[str, str] = {}
        self.reconnects = 0
        self._all = {point.name: point for point in points}
        self._config = config
        self._clock = clock
        self._tls = client_context(config) if isinstance(config, ModbusTlsBus) else None
        kind = "Modbus/TCP" if self._tls is None else "Modbus/TCP Security"
        self._where = f"{name} ({kind} {config.host}:{config.port}, device {config.device_id})"
        self._plan = ReadPlan(self._planned(self.points))
        self._order = order = {point.name: index for index, point in enumerate(self.points)}
        self._slots: dict[Block, list[tuple[int, Point, int]]] = {}
        self._watches = watches(self.points)
        self._uptime = order.get(config.uptime) if config.uptime is not None else None
        self._write_plans: dict[tuple[str, ...], list[Block]] = {}
        self._client: AsyncModbusTcpClient | None = None
        self._supervisor: asyncio.Task[None] | None = None
        self._refused: str | None = None

    async def connect(self) -> None:
        """Connect and read each block once; raises LinkError, or ConfigurationError where the map is wrong."""
        await self._open()
        try:
            await self._read_once()
        except LinkError:
            # In TLS 1.3 a client learns only now that its certificate was refused.
            await self._explain()
            raise

    async def _read_once(self) -> None:
        """Each block once: a block that is refused is split, and a single value that is refused is a mistake."""
        pending = list(self._plan.blocks)
        first: DeviceExceptionError | None = None
        while pending:
            block = pending.pop(0)
            try:
                await self._request(block)
            except DeviceExceptionError as error:
                if error.code != _NO_SUCH_ADDRESS:
                    raise
                first = first or error
                pending += self._plan.refuse(block, self._clock())
        if first is not None and self._plan.refused:
            names = ", ".join(point.name for block in self._plan.refused for point in block.points)
            raise DeviceExceptionError(f"{first}; points that cannot be read: {names}", _NO_SUCH_ADDRESS)
        for block in self._planned(p for p in self._all.values() if p.type == "string"):
            registers = await self._request(block)
            for point in block.points:
                self.texts[point.name] = self._text(point, registers, block)

    def _text(self, point: Point, registers: list[int], block: Block) -> str:
        at = (point.address or 0) - block.address
        try:
            text = decode_text(registers[at : at + point.width], point.order)
        except CodecError as error:
            raise ConfigurationError(f"{self._where}: {point.name}: {error}") from error
        if point.expect is not None and text != point.expect:
            raise ConfigurationError(
                f"{self._where}: {point.name} is {text!r} and the rig file expects {point.expect!r}; is this the right "
                "device? Correct host, device_id or expect"
            )
        return text

    def _planned(self, points: Iterable[Point], *, max_gap: int | None = None) -> list[Block]:
        config = self._config
        return plan_reads(
            points,
            max_read=config.max_read,
            max_gap=config.max_gap if max_gap is None else max_gap,
            max_read_bits=config.max_read_bits,
            holes=config.hole,
        )

    def _slots_of(self, block: Block) -> list[tuple[int, Point, int]]:
        """Where the readings of a block go: index among the polled points, point, offset in the reply."""
        slots = self._slots.get(block)
        if slots is None:
            slots = [(self._order[p.name], p, (p.address or 0) - block.address) for p in block.points]
            self._slots[block] = slots
        return slots

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
        receive, guard = client.ctx.data_received, FrameGuard()
        self._refused = None

        def guarded(data: bytes) -> None:
            # A reply that pymodbus cannot decode raises in asyncio's callback, which prints a traceback.
            try:
                for frame in guard.feed(data, client.ctx.request_transaction_id, config.device_id):
                    receive(frame)
            except ProtocolError as error:
                self._refused = str(error)
                client.close()
            except Exception:
                client.close()
            if guard.dropped:
                self._refused = f"{guard.dropped} replies to another request or of another unit were not used"

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
        pending = self._plan.due(self._clock())
        while pending:
            block = pending.pop(0)
            try:
                registers = await self._request(block)
            except DriverError as error:
                fault = str(error)
                if isinstance(error, LinkError):
                    break
                if isinstance(error, DeviceExceptionError) and error.code == _NO_SUCH_ADDRESS:
                    pending = self._plan.refuse(block, self._clock()) + pending
                continue
            now = self._clock()
            for index, point, at in self._slots_of(block):
                raw = decode(registers[at : at + point.width], point.type, point.order, point.bits)
                values[index], quality[index] = judge(point, raw)
                watch = self._watches[index]
                if watch is not None:
                    quality[index] = watch.judge(values[index], quality[index], now)
                source[index] = now
        if self._plan.refused and fault is None:
            fault = f"{self._where}: the device has no {', '.join(str(block) for block in self._plan.refused)}"
        if self._uptime is not None and math.isfinite(values[self._uptime]):
            device_time = values[self._uptime]
            source = [device_time if math.isfinite(time) else time for time in source]
        return Readings(values, quality, source, fault)

    async def write(self, values: Mapping[str, float]) -> None:
        """Write by point name, touching registers in one request (function 16); raises DriverError."""
        names = tuple(values)
        plan = self._write_plans.get(names)
        if plan is None:
            plan = plan_writes(
                (self._all[name] for name in names),
                max_write=self._config.max_write,
                max_write_bits=self._config.max_write_bits,
            )
            self._write_plans[names] = plan
        for block in plan:
            registers: list[int] = []
            for point in block.points:
                try:
                    registers += encode((values[point.name] - point.offset) / point.scale, point.type, point.order)
                except ValueError as error:
                    raise ConfigurationError(f"{point.name}: {error}; correct its type or scale") from error
            await self._write_block(block, registers)

    async def _write_block(self, block: Block, registers: list[int]) -> None:
        """Write registers, or bits as 0 and 1, and check what the device confirms; raises DriverError."""
        client, code, device = self._connected(), block.write_code, self._config.device_id
        call: Any
        if code == 5:
            call = client.write_coil(block.address, bool(registers[0]), device_id=device)
        elif code == 6:
            call = client.write_register(block.address, registers[0], device_id=device)
        elif code == 15:
            call = client.write_coils(block.address, [bool(bit) for bit in registers], device_id=device)
        else:
            call = client.write_registers(block.address, registers, device_id=device)
        reply = await self._bounded(call)
        self._check(reply, code, block)
        if code in (15, 16):
            if (reply.address, reply.count) != (block.address, block.count):
                what = "coils" if code == 15 else "registers"
                raise ProtocolError(
                    f"{self._where} confirmed {reply.count} {what} at {reply.address}, "
                    f"asked were {block.count} at {block.address}"
                )
            return
        echoed = [int(bit) for bit in reply.bits[:1]] if code == 5 else list(reply.registers[:1])
        if (reply.address, echoed) != (block.address, registers):
            raise ProtocolError(
                f"{self._where} echoed {echoed} at {reply.address} to a write of {registers} at {block.address}"
            )

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Writable points as the device holds them."""
        found: dict[str, float] = {}
        for block in self._planned((self._all[name] for name in names), max_gap=0):
            registers = await self._request(block)
            for point in block.points:
                at = (point.address or 0) - block.address
                raw = decode(registers[at : at + point.width], point.type, point.order, point.bits)
                found[point.name], _ = judge(point, raw)
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
        """The registers of a block, or its bits as 0 and 1; raises DriverError."""
        client = self._connected()
        read: Any = {
            1: client.read_coils,
            2: client.read_discrete_inputs,
            3: client.read_holding_registers,
            4: client.read_input_registers,
        }[block.read_code]
        reply = await self._bounded(read(block.address, count=block.count, device_id=self._config.device_id))
        self._check(reply, block.read_code, block)
        is_bits = block.table in BIT_TABLES
        got, due = (len(reply.bits), -(-block.count // 8) * 8) if is_bits else (len(reply.registers), block.count)
        if got != due:
            raise ProtocolError(
                f"{self._where} answered {got} {'bits' if is_bits else 'registers'} where {block.count} were asked "
                f"({block.table} {block.address}); the reply is not used"
            )
        return [int(bit) for bit in reply.bits[: block.count]] if is_bits else list(reply.registers)

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
            why = f" ({self._refused})" if self._refused is not None else ""
            raise kind(f"{self._where}: no answer within {self._config.timeout_s:g} s{why}; reconnecting") from error

    def _check(self, reply: Any, function_code: int, block: Block) -> None:
        if reply.isError() and reply.function_code & 0x7F == function_code:
            code = int(getattr(reply, "exception_code", 0))
            what = _EXCEPTIONS.get(code, "an unknown exception")
            raise DeviceExceptionError(
                f"{self._where} refused {block}: exception {code}, {what}",
                code,
            )
        if reply.function_code != function_code:
            raise ProtocolError(
                f"{self._where} answered function {reply.function_code & 0x7F} to function {function_code}"
            )

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
                self._plan.forget()
                self._slots.clear()
                return
