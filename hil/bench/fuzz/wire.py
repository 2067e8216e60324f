"""Benchmark `hil bench wire`: mutated replies and frames against the Modbus client and the CAN receiver, from a fixed
seed.

TCP's checksum guards the bytes of a value; what it cannot guard against is a device or a gateway that answers the wrong
thing: another transaction, unit, function or length, half a reply, two, or the one before. Those are what is made here.
"""

from __future__ import annotations

import asyncio
import math
import random
import struct
from collections import Counter
from collections.abc import Callable

from drivers.modbus import Lost, ModbusBus, ModbusLink, Received, Wire
from drivers.rig_file import ModbusBusSection, ModbusTcpBus, Point
from drivers.signals import Quality
from hil.bench.fuzz.can_frames import mutate_can
from hil.bench.fuzz.j1939_frames import mutate_j1939
from hil.bench.fuzz.rtu_replies import mutate_rtu
from hil.bench.measure import ReportTable

QUICK, FULL = 1_700, 100_000
REGISTERS = 12
POINTS = tuple(
    Point(name=f"p{a}_{k}", bus="b", unit="1", table="input", address=a * 40 + k)
    for a in range(2)
    for k in range(REGISTERS)
)
"""Two blocks of equal length, so that the reply to one could pass for the reply to the other."""


HARMLESS = ("none", "twice", "in segments")
"""Mutations that a client must accept: these replies are right, and must be used."""


Found = dict[str, tuple[int, int, int, int]]


def measure(
    count: int, seed: int, progress: Callable[[float], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...], bool]:
    """Return tables of `count` mutations each, everything left out, and True if no wrong value was accepted as good."""
    modbus = asyncio.run(mutate_modbus(count, seed, progress=lambda share: progress(0.8 * share)))
    rtu = mutate_rtu(count, seed)
    progress(0.9)
    frames = asyncio.run(mutate_can(count - count // 2, seed))
    groups = asyncio.run(mutate_j1939(count // 2, seed))
    frames |= {f"J1939: {kind}": numbers for kind, numbers in groups.items()}
    progress(1.0)
    tables = (
        _table(
            "modbus",
            "reads over Modbus/TCP with mutated replies",
            "reads",
            "values",
            modbus,
            "Wrong: good and not what the register held, or a number that is not good. A read asks for two blocks.",
        ),
        _table(
            "rtu",
            "mutated RTU replies",
            "replies",
            "replies",
            rtu,
            "Wrong: passed on, and other registers than the device sent. The checksum covers these, too.",
        ),
        _table(
            "can",
            "mutated CAN frames",
            "frames",
            "values",
            frames,
            "Wrong: good, and not what the bytes of a usable frame of its message say, or beyond its range. "
            "J1939: of a message that is read by its PGN; wrong, too, of another sender, or while two send it.",
        ),
    )
    return tables, (), not any(wrong for found in (modbus, rtu, frames) for *_, wrong in found.values())


def _table(key: str, what: str, unit: str, of: str, found: Found, note: str) -> ReportTable:
    rows = tuple((kind, *numbers) for kind, numbers in found.items())
    columns = ("mutation", unit, f"{of} used", f"{of} not used", "wrong")
    return ReportTable(key, f"{sum(row[1] for row in rows):,} {what}", columns, rows, (note,))


class _MemoryWire:
    """Wire in memory: `answer` replies to each request, in any number of segments."""

    def __init__(self, answer: Callable[[bytes], list[bytes]], received: Received) -> None:
        self._answer = answer
        self._received = received
        self._open = True

    def send(self, data: bytes) -> None:
        for segment in self._answer(data):
            asyncio.get_running_loop().call_soon(self._deliver, segment)

    def _deliver(self, segment: bytes) -> None:
        if self._open:
            self._received(segment)

    def take(self, seconds: float) -> bytes:
        return b""

    def close(self) -> None:
        self._open = False


def truth(address: int, epoch: int) -> int:
    """Return the content of register `address` in a given read: it differs from all nearby registers and reads."""
    return (address * 251 + epoch * 7919 + 13) & 0xFFFF


class Mutator:
    """Device that answers with one mutation in each read; `made` counts them by kind."""

    KINDS = (
        "none",
        "transaction",
        "transaction 0",
        "protocol",
        "length",
        "unit",
        "function",
        "byte count",
        "truncated",
        "trailing bytes",
        "twice",
        "the reply before",
        "the reply before as transaction 0",
        "exception",
        "in segments",
        "noise before",
        "silence",
    )

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.epoch = 0
        self.kind = "none"
        self.made: Counter[str] = Counter()
        self._before = b""

    def answer(self, request: bytes) -> list[bytes]:
        """Return the segments of the reply to a request frame."""
        tid, _, _, unit, code, address, count = struct.unpack(">HHHBBHH", request[:12])
        values = [truth(address + k, self.epoch) for k in range(count)]
        pdu = struct.pack(f">BB{count}H", code, 2 * count, *values)
        good = struct.pack(">HHHB", tid, 0, len(pdu) + 1, unit) + pdu
        before, self._before = self._before or good, good
        self.made[self.kind] += 1
        return self._mutated(good, before, request)

    def _mutated(self, good: bytes, before: bytes, request: bytes) -> list[bytes]:
        pick, frame, kind = self.random, bytearray(good), self.kind
        fields = {"transaction": (0, 2), "protocol": (2, 4), "length": (4, 6), "unit": (6, 7), "function": (7, 8)}
        fields["byte count"] = (8, 9)
        if kind in fields:
            low, high = fields[kind]
            old = bytes(frame[low:high])
            while bytes(frame[low:high]) == old:
                frame[low:high] = pick.randbytes(high - low)
            return [bytes(frame)]
        if kind == "transaction 0":
            return [b"\0\0" + good[2:]]
        if kind == "truncated":
            end = pick.randrange(len(good))
            cut = good[:end]
            if pick.random() < 0.5 and end > 8:  # The header agrees with the remaining bytes.
                cut = cut[:4] + struct.pack(">H", end - 6) + cut[6:]
            return [cut]
        if kind == "trailing bytes":
            more = pick.randbytes(pick.randint(1, 9))
            return [good[:4] + struct.pack(">H", len(good) - 6 + len(more)) + good[6:] + more]
        if kind == "twice":
            return [good + good]
        if kind == "the reply before":
            return [before]
        if kind == "the reply before as transaction 0":
            return [b"\0\0" + before[2:]]
        if kind == "exception":
            body = bytes([request[7] | 0x80 if pick.random() < 0.7 else pick.randrange(128, 256), pick.randrange(256)])
            return [good[:4] + b"\0\x03" + good[6:7] + body]
        if kind == "in segments":
            at = sorted(pick.sample(range(1, len(good)), 3))
            return [good[a:b] for a, b in zip([0, *at], [*at, len(good)], strict=True)]
        if kind == "noise before":
            return [pick.randbytes(pick.randint(1, 20)) + good]
        return [] if kind == "silence" else [good]


async def mutate_modbus(
    count: int, seed: int, *, timeout_s: float = 0.004, progress: Callable[[float], None] = lambda share: None
) -> Found:
    """Return by kind of mutation: reads, good values, values that were not good, and wrong ones (of either).

    A value is wrong that is good and not the register's, or not good and yet a number. Whatever the driver raises is
    let through: a lost link is a quality.
    """
    mutator = Mutator(seed)
    found: dict[str, list[int]] = {kind: [0, 0, 0, 0] for kind in Mutator.KINDS}
    patient, hasty = (_memory_bus(mutator, deadline_s) for deadline_s in (5.0, timeout_s))
    for number in range(count):
        mutator.kind = Mutator.KINDS[number % len(Mutator.KINDS)]
        mutator.epoch = number
        if number % 1000 == 0:
            progress(number / count)
        bus = patient if mutator.kind in HARMLESS else hasty
        await bus.link.open("memory")
        bus._plan.forget()
        readings = await bus.read()
        tally = found[mutator.kind]
        tally[0] += 1
        for point, value, quality in zip(bus.points, readings.values, readings.quality, strict=True):
            good = quality == Quality.GOOD
            tally[1 if good else 2] += 1
            if (good and value != truth(point.address or 0, number)) or (not good and not math.isnan(value)):
                tally[3] += 1
    await patient.close()
    await hasty.close()
    return {kind: (t[0], t[1], t[2], t[3]) for kind, t in found.items()}


def _memory_bus(mutator: Mutator, timeout_s: float) -> ModbusBus:
    """Return the driver with a socket in memory."""
    config = ModbusTcpBus(transport="modbus_tcp", port=1, timeout_s=timeout_s)

    async def opened(_: ModbusBusSection, tls: object, received: Received, lost: Lost) -> Wire:
        return _MemoryWire(mutator.answer, received)

    return ModbusBus("b", config, POINTS, lambda: 0.0, ModbusLink(config, opener=opened))
