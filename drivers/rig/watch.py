"""Read-only observation of a rig: the values of every bus, raw and judged, and its faults.

Unlike `drivers.rig.connection` it goes on where a bus is down: it tries again, and reports the others meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivers.bus import Readings
from drivers.can import CanReceiver
from drivers.modbus import BIT_TABLES, Block, ModbusBus
from drivers.rig_file import CanBus, Point, Rig
from drivers.signals import DriverError, LinkError, Quality

CONNECT_WITHIN_S = 10.0
FIRST_WITHIN_S = 5.0
TRY_AGAIN_S = 1.0
FASTEST_S, SLOWEST_S = 0.1, 2.0


@dataclass(frozen=True, slots=True)
class PointState:
    """Present state of one point. `raw` are its registers or its frame in hexadecimal, empty where nothing came.

    `value` is NaN where none is known, `text` that of a string or label; `age_s` is the time since it came, infinite
    where it never did.
    """

    point: Point
    raw: str
    value: float
    text: str
    quality: Quality
    age_s: float

    @property
    def fault(self) -> str | None:
        """Sentence about the point's fault, or None."""
        name, unit = self.point.name, self.point.unit
        if not math.isfinite(self.age_s):
            return f"{name}: nothing heard of it"
        if self.quality != Quality.GOOD:
            what = self.quality.name.lower().replace("_", " ")
            came = f" (raw {self.raw})" if self.raw else ""
            return f"{name}: {what}{came}"
        alarm = self.point.alarm
        if alarm is not None and not alarm[0] <= self.value <= alarm[1]:
            return f"{name}: {self.value:g} {unit} is beyond its alarm limits {alarm[0]:g} to {alarm[1]:g}"
        return None


class _WatchedModbusBus(ModbusBus):
    """Modbus bus that keeps the words of its replies: (table, address) -> register or bit, and its time."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.raw: dict[tuple[str, int], tuple[int, float]] = {}

    async def _request(self, block: Block) -> Sequence[int]:
        registers = await super()._request(block)
        now = time.monotonic()
        for at, register in enumerate(registers, block.address):
            self.raw[block.table, at] = register, now
        return registers

    def came(self, point: Point) -> tuple[str, float]:
        """Return a point's registers in hexadecimal, or its bit, and the time of the oldest."""
        first = point.address or 0
        found = [self.raw.get((str(point.table), at)) for at in range(first, first + point.width)]
        known = [item for item in found if item is not None]
        if len(known) < len(found):
            return "", -math.inf
        form = "{}" if point.table in BIT_TABLES else "{:04X}"
        return " ".join(form.format(register) for register, _ in known), min(at for _, at in known)


class _Frames(CanReceiver):
    """CAN bus that keeps the last frame of each message: name -> bytes, and its time."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.raw: dict[str, tuple[bytes, float]] = {}

    def _take(self, frame: Any, arrival: float | None = None) -> None:
        came = time.monotonic() if arrival is None else arrival  # the clock of a watch is this one
        super()._take(frame, came)
        found = self._message_of(frame)
        if found is not None and not frame.is_error_frame and not frame.is_remote_frame:
            self.raw[found.name] = bytes(frame.data), came

    def came(self, point: Point) -> tuple[str, float]:
        """Return the frame of a point in hexadecimal, and its time."""
        data, at = self.raw.get(point.message or "", (b"", -math.inf))
        return data.hex(" ").upper(), at


class BusWatch:
    """Observed bus: opened within a deadline, tried again where it is down, polled every period. Nothing is written."""

    def __init__(self, name: str, rig: Rig) -> None:
        config = rig.bus[name]
        self.name = name
        self.points = tuple(point for point in rig.point if point.bus == name)
        self.opened_s: float | None = None
        """Time that opening took, s; None while the bus is down."""
        self._refusal: str | None = None
        self._fault: str | None = None
        delay_s = 0.0 if isinstance(config, CanBus) else config.connect_delay_s
        self._connect_within_s = CONNECT_WITHIN_S + 2.0 * delay_s
        self._period_s = min(max(rig.period_s, FASTEST_S), SLOWEST_S)
        kind = _Frames if isinstance(config, CanBus) else _WatchedModbusBus
        self._bus: _Frames | _WatchedModbusBus = kind(name, config, self.points, time.monotonic)
        self._held = tuple(p.name for p in self.points if p.access == "rw" and isinstance(self._bus, _WatchedModbusBus))
        self._of_frames = {p.name: p for p in self.points} if isinstance(self._bus, _Frames) else {}
        self._came: dict[str, tuple[str, float]] = {}
        self._known: dict[str, tuple[float, int]] = {}
        self.looked = asyncio.Event()
        """Set once every point was read, and every point that arrives unasked has arrived."""
        self._task: asyncio.Task[None] | None = None

    @property
    def failures(self) -> list[str]:
        """Sentences: the cause of a bus that is down, and contradictions between device and rig file."""
        return [text for text in dict.fromkeys((self._refusal, self._fault)) if text is not None]

    async def open(self) -> None:
        """Open the bus; a failure is added to `failures`, and the bus is tried again until `close`."""
        await self._open()
        self._task = asyncio.create_task(self._poll(), name=f"watch {self.name}")

    async def _open(self) -> None:
        began = time.monotonic()
        try:
            async with asyncio.timeout(self._connect_within_s):
                await self._bus.connect()
        except LinkError as error:  # a missed deadline of the bus is one, and a TimeoutError, too
            self._fault = str(error)
            return
        except TimeoutError:
            self._fault = f"{self.name}: not connected within {self._connect_within_s:g} s"
            return
        except DriverError as error:
            # It answers, though not as the rig file has it: the rest can be looked at.
            self._refusal = str(error)
        self._fault, self.opened_s = None, time.monotonic() - began

    async def _poll(self) -> None:
        while True:
            began = time.monotonic()
            if self.opened_s is None:
                await asyncio.sleep(TRY_AGAIN_S)
                await self._bus.close()
                await self._open()
                continue
            readings = await self._read()
            rows = zip(self._bus.points, readings.values, readings.quality, strict=True)
            self._known |= {point.name: (value, quality) for point, value, quality in rows}
            self._fault = await self._hold() or readings.fault
            self._came |= {p.name: self._bus.came(p) for p in self.points if p.name not in self._of_frames}
            if isinstance(self._bus, _WatchedModbusBus) or Quality.LINK_FAULT not in readings.quality:
                self.looked.set()
            period_s = self._period_s if self.looked.is_set() else FASTEST_S
            await asyncio.sleep(max(0.0, began + period_s - time.monotonic()))

    async def _read(self) -> Readings:
        """Return the readings and keep the frames that belong to them: a thread receives frames meanwhile."""
        while True:
            before = {name: self._bus.came(point) for name, point in self._of_frames.items()}
            readings = await self._bus.read()
            if before == {name: self._bus.came(point) for name, point in self._of_frames.items()}:
                self._came |= before
                return readings

    async def _hold(self) -> str | None:
        """Read the writable points back; return the failure as a sentence, or None."""
        if not self._held:
            return None
        try:
            held = await self._bus.read_back(self._held)
        except DriverError as error:
            self._known |= dict.fromkeys(self._held, (math.nan, int(Quality.LINK_FAULT)))
            return str(error)
        self._known |= {name: (value, int(Quality.GOOD)) for name, value in held.items()}
        return None

    def seen(self) -> list[PointState]:
        """Return the state of every point of the bus that can be read, in the order of the rig file."""
        return [self._seen(point) for point in self.points if point.access != "w"]

    def _seen(self, point: Point) -> PointState:
        raw, came = self._came.get(point.name, ("", -math.inf))
        age_s = time.monotonic() - came
        texts = self._bus.texts if isinstance(self._bus, _WatchedModbusBus) else {}
        if point.type == "string":
            text = texts.get(point.name, "")
            return PointState(point, raw, math.nan, text, Quality.GOOD if text else Quality.LINK_FAULT, age_s)
        value, quality = self._known.get(point.name, (math.nan, int(Quality.LINK_FAULT)))
        labels = point.label_of or {}
        text = labels.get(round(value), "") if math.isfinite(value) else ""
        return PointState(point, raw, value, text, Quality(quality), age_s)

    async def close(self) -> None:
        """Stop polling and close the bus."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        await self._bus.close()


class RigWatch:
    """All buses of `rig`, opened and polled concurrently, as an asynchronous context. Nothing is written."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.buses = tuple(BusWatch(name, rig) for name in rig.bus)

    async def __aenter__(self) -> RigWatch:
        await asyncio.gather(*(bus.open() for bus in self.buses))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(FIRST_WITHIN_S):
                for bus in self.buses:
                    if bus.opened_s is not None:
                        await bus.looked.wait()
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.gather(*(bus.close() for bus in self.buses))

    def seen(self) -> list[PointState]:
        """Return the state of every point that can be read, bus by bus."""
        return [seen for bus in self.buses for seen in bus.seen()]

    def faults(self) -> dict[str, list[str]]:
        """Return the present faults by bus: the failures of the bus and the faults of its points; none of a good bus.

        Points of a bus that was never open are not listed one by one.
        """
        found: dict[str, list[str]] = {}
        for bus in self.buses:
            said = bus.failures
            if bus.opened_s is not None:
                said += [seen.fault for seen in bus.seen() if seen.fault is not None]
            if said:
                found[bus.name] = said
        return found
