"""Modbus device behind the contract of a bus, on any wire: reads, writes, retries and quality of readings."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from drivers.bus import Clock, Judge, Readings, judge_of, steady_s, watches
from drivers.modbus.link import RECONNECT_EVERY_S, ModbusLink
from drivers.modbus.protocol import (
    BUSY,
    GATEWAY_SILENCE,
    NO_SUCH_ADDRESS,
    NO_SUCH_FUNCTION,
    OF_CONTENT,
    OpenRequests,
    Read,
    ReadBack,
    check_written,
    write_request,
)
from drivers.modbus.read_plan import AGAIN_AFTER_S, MAX_READ_WRITE, Block, ReadPlan, plan_reads
from drivers.modbus.writes import Writes, values_of
from drivers.rig_file import ModbusBusSection, ModbusRtuBus, Point
from drivers.signals import (
    CodecError,
    ConfigurationError,
    DeadlineError,
    DeviceExceptionError,
    DriverError,
    LateReplyError,
    LinkError,
    ProtocolError,
    decode_text,
    decoder,
)
from drivers.signals import Quality as Q

_Slot = tuple[int, int, Callable[[Sequence[int], int], float], Judge]
_BUSY_RETRIES = 2
_BUSY_WAIT_S = 0.05
CONNECT_PATIENCE_S = (1.0, 3.5)
"""Time, s, that a first and a second connection may be silent before the device is mute: gateways start up, or serve
the connection before the last; more than their sum needs `connect_delay_s`."""
PASSING = frozenset({4, 8})
"""Exceptions that may pass: a device failure, a memory error."""
_SPLITS = 8
"""Refused reads that one tick splits for another reason than a missing address: a device that fails as a whole refuses
each part, and would have a slow line for itself. The next ticks go on."""
_LONGER = 1.5
"""A device that was deaf on one connection may be deaf for so many times as long on the next."""
_MUTE_AFTER = 2
"""Deadlines missed in a row, after which a device is asked every `RECONNECT_EVERY_S` only: others wait behind it."""


class ModbusBus:
    """Modbus device whose polled points are read in as few blocks as the limits admit.

    Without `link` it has a wire of its own. `exceptions` counts exception replies by code, `missed` deadlines.
    """

    def __init__(
        self,
        name: str,
        config: ModbusBusSection,
        points: tuple[Point, ...],
        clock: Clock,
        link: ModbusLink | None = None,
    ) -> None:
        self.name = name
        self.points = tuple(point for point in points if point.is_polled)
        self.texts: dict[str, str] = {}
        self.exceptions: Counter[int] = Counter()
        self.missed = 0
        self.link = ModbusLink(config) if link is None else link
        self.link.devices += 1
        self.link.on_reopened.append(self._forget)
        self._all = {point.name: point for point in points}
        self._config = config
        self._clock = clock
        self._where = f"{name} ({config.where})"
        self._plan = ReadPlan(self._planned(self.points))
        self._order = order = {point.name: index for index, point in enumerate(self.points)}
        self._slots: dict[Block, list[_Slot]] = {}
        self._reads: dict[Block, Read] = {}
        self._watches = watches(self.points)
        self._soonest_stale_s = min((point.stale_after_s for point in self.points), default=math.inf)
        self._uptime = order.get(config.uptime) if config.uptime is not None else None
        self._writes = Writes(self._all, config)
        self._has_read_write = config.read_write
        self._open_requests = OpenRequests(numbered=self.link.is_numbered and config.serial_baud is None)
        self._silences = 0
        self._again_at = 0.0

    @property
    def reconnects(self) -> int:
        """Number of times that the wire was lost and opened again."""
        return self.link.reconnects

    @property
    def is_mute(self) -> bool:
        """True where the device left its last requests without an answer."""
        return self._silences > 0

    async def connect(self) -> None:
        """Connect and read each block once; raise LinkError, or another DriverError where the register map is wrong.

        A device that is deaf after connecting is waited for, on the same connection and on a second one.
        """
        link, failure = self.link, None
        for patience_s in CONNECT_PATIENCE_S:
            link.patience_s = max(link.patience_s, patience_s)
            try:
                await link.open(self._where)
            except LinkError as error:
                raise failure or error from None
            failure = await self._heard_within(patience_s)
            if failure is None:
                link.patience_s = _LONGER * link.deaf_s
                return
            if link.has_answered:
                break
        # In TLS 1.3 a client learns only now that its certificate was refused.
        await link.explain(self._where)
        raise failure if failure is not None else AssertionError("no connection was tried")

    async def _heard_within(self, patience_s: float) -> LinkError | None:
        """Return None once all is read; else the failure, as soon as waiting longer is of no use."""
        end = steady_s() + patience_s
        while True:
            try:
                await self._read_once()
            except LinkError as error:
                failure = error
            else:
                return None
            self._silences, self._again_at = 0, 0.0
            if not self.link.connected or self.link.has_answered or steady_s() > end:
                return self._with_remedy(failure)

    def _with_remedy(self, failure: LinkError) -> LinkError:
        """Return the failure, with a remedy where it is a silence after connecting."""
        if not isinstance(failure, DeadlineError) or self.link.has_answered or not self.link.heard_nothing:
            return failure
        serial = isinstance(self._config, ModbusRtuBus)
        keys = "device_id, serial_baud and parity" if serial else "device_id and transport"
        said = str(failure).removesuffix("; reconnecting")
        return DeadlineError(
            f"{said}; the {'line is open' if serial else 'port takes connections'} and nothing comes back: "
            f"correct {keys}, or give connect_delay_s where the device is deaf for long after connecting"
        )

    async def _read_once(self) -> None:
        """Read each block once. Split refused blocks; raise DeviceExceptionError for refused single values."""
        pending = list(self._plan.blocks)
        first: DeviceExceptionError | None = None
        unread: list[Block] = []
        while pending:
            block = pending.pop(0)
            try:
                await self._request(block)
            except DeviceExceptionError as error:
                if error.code not in OF_CONTENT:
                    raise
                first = first or error
                parts = self._refused(block, error)
                pending += parts
                unread += [] if parts else [block]
        if first is not None and unread:
            names = ", ".join(point.name for block in unread for point in block.points)
            raise DeviceExceptionError(f"{first}; points that cannot be read: {names}", first.code)
        for block in self._planned(p for p in self._all.values() if p.type == "string"):
            registers = await self._request(block)
            for point in block.points:
                self.texts[point.name] = self._text(point, registers, block)

    def _refused(self, block: Block, error: DeviceExceptionError) -> list[Block]:
        """Return the parts in which a refused block is read from now on, none where it has only one."""
        return self._plan.refuse(block, self._clock(), passing=error.code in PASSING)

    def _text(self, point: Point, registers: Sequence[int], block: Block) -> str:
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

    def _slots_of(self, block: Block) -> list[_Slot]:
        """Return index among the polled points, offset in the reply, decoder and judge of each reading of a block."""
        slots = self._slots.get(block)
        if slots is None:
            slots = [
                (self._order[p.name], (p.address or 0) - block.address, decoder(p.type, p.order, p.bits), judge_of(p))
                for p in block.points
            ]
            self._slots[block] = slots
        return slots

    def _forget(self) -> None:
        """Forget refusals and plans: after the link was lost another device may answer."""
        self._plan.forget()
        self._slots.clear()
        self._reads.clear()
        self._has_read_write = self._config.read_write

    async def read(self) -> Readings:
        """Return all polled points; LINK_FAULT for those of a block that failed. A lost link begins to reconnect."""
        count = len(self.points)
        values, quality, source = [math.nan] * count, [int(Q.LINK_FAULT)] * count, [math.nan] * count
        fault: str | None = None
        pending = self._plan.due(self._clock())
        splits_left = _SPLITS
        is_read = False
        while pending:
            block = pending.pop(0)
            asked = self._clock()
            try:
                registers = await self._request(block)
            except DriverError as error:
                fault = str(error)
                if isinstance(error, LinkError):
                    break
                if isinstance(error, DeviceExceptionError) and error.code in OF_CONTENT:
                    if error.code != NO_SUCH_ADDRESS:
                        splits_left -= 1
                    if splits_left >= 0:
                        pending = self._refused(block, error) + pending
                continue
            now = self._clock()
            is_read = True
            is_late = now - asked > self._soonest_stale_s
            for index, at, decoded, judged in self._slots_of(block):
                values[index], quality[index] = judged(decoded(registers, at))
                watch = self._watches[index]
                if watch is not None:
                    quality[index] = watch.judge(values[index], quality[index], now)
                if is_late and now - asked > self.points[index].stale_after_s and quality[index] == Q.GOOD:
                    quality[index] = int(Q.STALE)  # it may be as old as its request
                source[index] = now
        if not is_read and self._plan.refused:
            self._plan.forget()  # a device that reads nothing refuses as a whole, and no single register
        if self._plan.refused and fault is None:
            listed = ", ".join(str(block) for block in self._plan.refused)
            fault = f"{self._where}: the device does not read {listed}; asked again every {AGAIN_AFTER_S:g} s"
        if self._uptime is not None and math.isfinite(values[self._uptime]):
            device_time = values[self._uptime]
            source = [device_time if math.isfinite(time) else time for time in source]
        return Readings(values, quality, source, fault)

    async def write(self, values: Mapping[str, float]) -> None:
        """Write engineering values by point name, adjacent registers in one request (16); raise DriverError."""
        for block, raw in self._writes.of(values):
            await self._write(block, raw)

    async def write_and_read_back(self, values: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
        """Write `values`, then return writable points `names` as held; the last write reads back where it can (23)."""
        found: dict[str, float] = {}
        asked = self._planned((self._all[name] for name in names), max_gap=0)
        written = self._writes.of(values)
        for number, (block, raw) in enumerate(written, 1):
            same = next((other for other in asked if set(block.points) & set(other.points)), None)
            if number < len(written) or same is None or not await self._write_and_read(block, raw, same, found):
                await self._write(block, raw)
            else:
                asked.remove(same)
        return found | await self._held(asked)

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return writable points as the device holds them; raise DriverError."""
        return await self._held(self._planned((self._all[name] for name in names), max_gap=0))

    async def _write(self, block: Block, raw: Sequence[int]) -> None:
        request = write_request(block, raw)
        for tries_left in reversed(range(_BUSY_RETRIES + 1)):
            try:
                check_written(block, raw, request, await self._ask(request), self._where)
                break
            except DeviceExceptionError as error:
                await self._busy(error, tries_left)

    async def _write_and_read(self, block: Block, raw: Sequence[int], read: Block, found: dict[str, float]) -> bool:
        """Write `block` and add the values of `read` to `found`, in one request; return False where that takes two."""
        if not self._has_read_write or block.table != "holding" or len(raw) > MAX_READ_WRITE:
            return False
        exchange = ReadBack(block, raw, read)
        try:
            registers = await self._answered(exchange)
        except DeviceExceptionError as error:
            if error.code != NO_SUCH_FUNCTION:
                raise
            self._has_read_write = False
            return False
        found |= values_of(read, registers)
        return True

    async def _held(self, blocks: Iterable[Block]) -> dict[str, float]:
        found: dict[str, float] = {}
        for block in blocks:
            found |= values_of(block, await self._request(block))
        return found

    async def close(self) -> None:
        """Stop reconnecting and close the wire, for all that share it."""
        await self.link.close()

    async def _request(self, block: Block) -> Sequence[int]:
        """Return the registers of a block, or its bits as 0 and 1; raise DriverError."""
        read = self._reads.get(block)
        if read is None:
            read = self._reads[block] = Read(block)
        return await self._answered(read)

    async def _answered(self, read: Read | ReadBack) -> Sequence[int]:
        """Return the registers of the answer to a request, which is repeated while the device is busy."""
        for tries_left in reversed(range(_BUSY_RETRIES + 1)):
            try:
                return read.raw_of(await self._ask(read.request), self._where)
            except LateReplyError:
                if tries_left == 0 or not isinstance(read, Read):
                    raise
            except DeviceExceptionError as error:
                if error.code == GATEWAY_SILENCE:
                    self._open_requests.doubt(read.request)
                await self._busy(error, tries_left)
            except ProtocolError:
                self._open_requests.doubt(read.request)
                raise
        raise AssertionError("the last try returns or raises")

    async def _busy(self, error: DeviceExceptionError, tries_left: int) -> None:
        """Wait before another try where the device is only busy; else raise its exception."""
        self.exceptions[error.code] += 1
        if error.code != BUSY or tries_left == 0:
            raise error
        await asyncio.sleep(_BUSY_WAIT_S)

    async def _ask(self, request: bytes) -> bytes:
        """Return the reply to a request, after a probe where the device may be a reply behind; raise DriverError."""
        open_requests = self._open_requests
        if self._silences and asyncio.get_running_loop().time() < self._again_at:
            raise LinkError(f"{self._where}: gives no answer; asked again every {RECONNECT_EVERY_S:g} s")
        if open_requests.open:
            probe = open_requests.probe(self._plan.planned)
            if probe is not None:
                read = Read(probe)
                read.raw_of(await self._exchange(read.request), self._where)
                open_requests.found()
        return await self._exchange(request)

    async def _exchange(self, request: bytes) -> bytes:
        config = self._config
        self._open_requests.asked(request)
        try:
            reply = await self.link.ask(config.device_id, request, config.timeout_s, self._where)
        except LateReplyError:
            raise  # of this process, not of the device
        except DeadlineError:
            self.missed += 1
            self._silences += 1
            if self._silences >= _MUTE_AFTER and (self.link.is_rtu or self.link.devices > 1):
                self._again_at = asyncio.get_running_loop().time() + RECONNECT_EVERY_S
            raise
        self._open_requests.answered()
        self._silences = 0
        return reply
