"""CAN receiver: frames decoded to values behind the contract of a bus.

A thread of this module receives: python-can's notifier thread dies silently on a bus error, and its socketcand bus
returns "nothing yet" at once and for ever when the server has gone. The thread decodes each frame by the DBC, keeps
the latest value of every wanted signal with its arrival, and reopens the bus when it is lost.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.bus import RECEIVE_TIMEOUT_S, Arrivals, Clock, Readings, Stamps, judge_of, watches
from drivers.can.dbc import Bound, bind
from drivers.can.wire import CanWire, Frame
from drivers.rig_file import CanBus, Point, Senders
from drivers.signals import ConfigurationError, LinkError, Quality

REOPEN_EVERY_S = 1.0
_EMPTY_READS_OF_A_DEAD_LINK = 20
_SETTLE_S = 5e-3
"""Pause, s, between two checks of a queue that was empty after a gap, so that waiting takes no processor time."""
_STAMPS: dict[str, Stamps] = {"socketcan": "kernel", "socketcand": "sender"}
"""Source of the time stamps of a transport's frames; slcan and virtual have none of their own."""
_GOOD = int(Quality.GOOD)
_BUS_OFF = 0x40
"""CAN_ERR_BUSOFF of linux/can/error.h, in the identifier of an error frame: no interface reports it otherwise."""


@dataclass(slots=True)
class _Latest:
    value: float = math.nan
    quality: int = int(Quality.LINK_FAULT)
    arrival_s: float = -math.inf


class CanReceiver:
    """Receiver of points that arrive unasked in CAN frames, as those of thermocouple modules do."""

    def __init__(self, name: str, config: CanBus, points: tuple[Point, ...], clock: Clock) -> None:
        self.name = name
        self.points = points
        self.frames = 0
        self.unknown_frames = 0
        self.bad_frames = 0
        self.error_frames = 0
        self.reconnects = 0
        self._config = config
        self._clock = clock
        self._where = f"{name} ({config.place})"
        self._latest = [_Latest() for _ in points]
        self._stale_after_s = [point.stale_after_s for point in points]
        self._arrivals = Arrivals(clock, _STAMPS.get(config.transport, "none"))
        self._watches = watches(points)
        self._judges = [judge_of(point) for point in points]
        self._uptime = next((i for i, p in enumerate(points) if p.name == config.uptime), None)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._fault: str | None = "nothing received yet"
        self._bus: CanWire | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiter: tuple[float, asyncio.Future[None]] | None = None
        self.messages = bind(name, config, points)
        self._exact = {(m.match.value, m.match.extended): m for m in self.messages if m.match.is_exact}
        self._masked = [m for m in self.messages if not m.match.is_exact]
        self._senders = {m.name: Senders(m.match) for m in self._masked}

    @property
    def cycle_s(self) -> dict[str, float]:
        """Cycle time of each wanted message by the DBC, in s; messages without a cycle time are left out."""
        return {bound.name: bound.cycle_s for bound in self.messages if bound.cycle_s is not None}

    async def connect(self) -> None:
        """Open the bus and start receiving; raise LinkError where the interface cannot be opened."""
        self._loop = asyncio.get_running_loop()
        self._bus = await asyncio.to_thread(self._open)
        self._stop.clear()
        self._thread = threading.Thread(target=self._receive, name=f"can {self.name}", daemon=True)
        self._thread.start()

    def _open(self) -> CanWire:
        wire = CanWire(self._config, self._where, [message.match for message in self.messages])
        self._arrivals.restart()
        return wire

    async def read(self) -> Readings:
        """Return the latest values; STALE once older than the point's stale_after, LINK_FAULT while the bus is down."""
        now = self._clock()
        with self._lock:
            conflict = self._sender_conflict(now)
            fault = self._fault or conflict
            base = self._latest[self._uptime] if self._uptime is not None else None
            device_ahead = base.value - base.arrival_s if base is not None and math.isfinite(base.value) else 0.0
            too_old = int(Quality.LINK_FAULT if fault else Quality.STALE)
            known = self._latest
            values = [latest.value for latest in known]
            quality = [
                latest.quality if now - latest.arrival_s <= stale_after_s else too_old
                for stale_after_s, latest in zip(self._stale_after_s, known, strict=True)
            ]
            source = [latest.arrival_s + device_ahead for latest in known]
        if -math.inf in source:  # of points that nothing has been heard of
            source = [time_s if time_s > -math.inf else math.nan for time_s in source]
        if self._thread is not None and not self._thread.is_alive() and fault is None:
            fault = f"{self._where}: the receiving thread has ended"
        return Readings(values, quality, source, fault)

    async def wait_for_device_time(self, device_time_s: float, timeout_s: float) -> None:
        """Return once frames of `device_time_s` (the module's uptime, s) are here; raise LinkError at the time-out."""
        assert self._loop is not None
        self._arrivals.in_step = True  # whoever waits so lets the rig go on step by step
        with self._lock:
            if self._uptime is None or self._latest[self._uptime].value >= device_time_s - 1e-6:
                return
            future: asyncio.Future[None] = self._loop.create_future()
            self._waiter = (device_time_s - 1e-6, future)
        try:
            async with asyncio.timeout(timeout_s):
                await future
        except TimeoutError:
            raise LinkError(f"{self._where}: no frames of {device_time_s:g} s within {timeout_s:g} s") from None
        finally:
            self._waiter = None

    async def write(self, values: Mapping[str, float]) -> None:
        """Refuse: CAN points are read only. Raise ConfigurationError where `values` holds any."""
        if values:
            raise ConfigurationError(f"{self._where}: {', '.join(values)} cannot be written, CAN points are read only")

    async def write_and_read_back(self, values: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
        """Refuse as `write` does; return no value."""
        await self.write(values)
        return {}

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return no value: nothing on this bus is writable."""
        return {}

    async def close(self) -> None:
        """End the receiving thread and close the bus."""
        self._stop.set()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 5.0)
            self._thread = None
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _receive(self) -> None:
        empty_reads = 0
        arrivals = self._arrivals
        while not self._stop.is_set():
            if self._bus is None and not self._reopened():
                continue
            assert self._bus is not None
            began = time.monotonic()
            try:
                frame = self._bus.receive(arrivals.wait_s)
            except LinkError as error:
                self._lost(str(error))
                continue
            if frame is None:
                was_in_doubt = arrivals.in_doubt
                arrivals.empty()
                if was_in_doubt:
                    self._stop.wait(_SETTLE_S)
                    continue
                at_once = time.monotonic() - began < RECEIVE_TIMEOUT_S / 4
                empty_reads = empty_reads + 1 if at_once else 0
                if empty_reads > _EMPTY_READS_OF_A_DEAD_LINK:
                    empty_reads = 0
                    self._lost(f"{self._where}: the server closed the connection; reopening")
                continue
            empty_reads = 0
            self._take(frame, arrivals.frame(frame.timestamp))

    def _reopened(self) -> bool:
        if self._stop.wait(REOPEN_EVERY_S):
            return False
        try:
            self._bus = self._open()
        except LinkError as error:
            with self._lock:
                self._fault = str(error)
            return False
        self.reconnects += 1
        return True

    def _lost(self, fault: str) -> None:
        with self._lock:
            self._fault = fault
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _message_of(self, frame: Frame) -> Bound | None:
        """Return the message of a frame by its identifier, or None."""
        identifier, extended = frame.arbitration_id, frame.is_extended_id
        found = self._exact.get((identifier, extended))
        if found is None:
            found = next((m for m in self._masked if m.match.matches(identifier, extended)), None)
        return found

    def _sender_conflict(self, now: float) -> str | None:
        """Return a sentence about the first message that comes from two senders, or None."""
        for name, senders in self._senders.items():
            both = senders.conflict(now)
            if both is not None:
                return (
                    f"{self._where}: {name} comes from {both}, and is not used; name the sender that is meant in a "
                    f"[[bus.{self.name}.message]]"
                )
        return None

    def _take(self, frame: Frame, arrival: float | None = None) -> None:
        """Decode a frame that arrived at `arrival` (rig time, s; now where none is given) and keep its values."""
        arrival = self._clock() if arrival is None else arrival
        self.frames += 1
        if frame.is_error_frame or frame.is_remote_frame:
            self.error_frames += 1
            if frame.is_error_frame and frame.arbitration_id & _BUS_OFF:
                with self._lock:
                    self._fault = f"{self._where}: the CAN controller is bus-off; look for a short or a wrong bit rate"
            return
        found = self._message_of(frame)
        if found is None:
            self.unknown_frames += 1
            return
        decoded = found.decode(bytes(frame.data)) if len(frame.data) == frame.dlc == found.length else None
        if decoded is None:
            self.bad_frames += 1
            with self._lock:
                self._fault = (
                    f"{self._where}: {found.name} came with {frame.dlc} bytes and is not used; {self._config.dbc.name} "
                    f"has it with {found.length}"
                )
            return
        if found.name in self._senders:
            with self._lock:
                used = self._senders[found.name].admits(frame.arbitration_id, arrival)
                if not used:
                    for index, _ in found.wanted:
                        self._latest[index] = _Latest(arrival_s=arrival)
            if not used:
                return
        wake: asyncio.Future[None] | None = None
        with self._lock:
            self._fault = None
            known, judges, watched = self._latest, self._judges, self._watches
            for index, signal in found.wanted:
                raw = decoded.get(signal.name)
                if raw is None:  # multiplexed, and not in this frame
                    continue
                value, quality = judges[index](raw)
                if quality == _GOOD and not signal.minimum <= raw <= signal.maximum:
                    quality = int(Quality.OUT_OF_RANGE)
                if signal.missing_from <= raw <= signal.missing_to:
                    value, quality = math.nan, int(Quality.SENSOR_FAULT)
                watch = watched[index]
                if watch is not None:
                    quality = watch.judge(value, quality, arrival)
                latest = known[index]
                latest.value, latest.quality, latest.arrival_s = value, quality, arrival
            if (
                self._uptime is not None
                and self._waiter is not None
                and self._latest[self._uptime].value >= self._waiter[0]
            ):
                wake = self._waiter[1]
                self._waiter = None
        if wake is not None and self._loop is not None:
            self._loop.call_soon_threadsafe(_resolve, wake)


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
