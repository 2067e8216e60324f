"""The loop: fixed ticks; each reads all groups, checks, writes set-points, journals and publishes.

The heater ends at its safe value on every way out: normal end, stop request, interlock, lost link, exception. There
is one place that makes the rig safe, and no way around it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

from drivers.points import DeviceExceptionError, DriverError, LinkError, ProtocolError, Quality, Snapshot
from drivers.rig import RigConnection
from drivers.rigfile import Point
from hil.clock import Clock
from hil.interlocks import Interlocks
from hil.journal import JournalError, JournalWriter
from hil.profile import Profile
from hil.safing import make_safe
from hil.setpoints import Setpoints, bind

FIRST_SAMPLE_TIMEOUT_S = 10.0
ARMING_TICKS = 3
SECOND_REQUEST_S = 0.5
PUBLISH_TICKS = 60
PUBLISH_WALL_S = 0.5


@dataclass(frozen=True, slots=True)
class Status:
    """What an operator sees while a run goes on."""

    tick: int
    time_s: float
    duration_s: float
    values: dict[str, float]


@dataclass(slots=True)
class Outcome:
    """How a run ended. `safe` is whether the safe values were read back from the rig."""

    status: Literal["done", "aborted", "faulted"]
    reason: str
    ticks: int = 0
    overruns: int = 0
    safe: bool = False
    problems: list[str] = field(default_factory=list)


class Publisher(Protocol):
    """Where blocks of ticks go for calibration; must not delay a tick in real time."""

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Take a block: `rows (n, k)` in the order of the journal's signals, NaN where a value is not good."""


class Engine:
    """One run of `profile` on an open-able `connection`."""

    def __init__(
        self,
        connection: RigConnection,
        clock: Clock,
        profile: Profile,
        journal: JournalWriter,
        *,
        publisher: Publisher | None = None,
        observer: Callable[[Status], None] | None = None,
        lockstep: bool = False,
    ) -> None:
        self._connection = connection
        self._rig = connection.rig
        self._clock = clock
        self._profile = profile
        self._journal = journal
        self._publisher = publisher
        self._observer = observer
        self._lockstep = lockstep
        self._targets: list[Point] = bind(self._rig, profile.columns)
        self._setpoints = Setpoints(self._rig)
        self._interlocks = Interlocks(self._rig, connection.points)
        self._beat = 0
        self._tick = 0
        self._stop_reason: str | None = None
        self._stop_asked = 0.0
        self._hurry = False
        self._pending: tuple[list[int], list[float], list[list[float]]] = ([], [], [])
        self._published = time.monotonic()
        self._shown = 0.0
        self._problems: list[str] = []

    def request_stop(self, reason: str) -> None:
        """End the run at the next tick. A second request shortens the waits of making safe, and skips nothing.

        One that comes within `SECOND_REQUEST_S` is taken for an echo of the first: a terminal and a supervisor may
        both pass on the same Ctrl-C.
        """
        if self._stop_reason is None:
            self._stop_reason, self._stop_asked = reason, time.monotonic()
        elif time.monotonic() - self._stop_asked > SECOND_REQUEST_S:
            self._hurry = True

    @property
    def tick(self) -> int:
        """Index of the tick under way."""
        return self._tick

    async def run(self) -> Outcome:
        """Run to the end; whatever happens, the rig is made safe before this returns."""
        outcome = Outcome("faulted", "")
        touched = False
        try:
            await self._connection.connect()
            snapshot = await self._first_snapshot()
            refusals = self._interlocks.alarms(snapshot)
            if refusals:
                outcome.reason = f"not started: {'; '.join(refusals)}"
                return outcome
            touched = True
            await self._arm()
            self._event("INFO", f"running {self._profile.name} on {self._rig.name}")
            reason = await self._ticks()
            outcome.status, outcome.reason = ("done", "") if reason is None else self._classified(reason)
        except (DriverError, JournalError) as error:
            outcome.reason = str(error)
        except Exception as error:
            outcome.reason = f"{type(error).__name__}: {error}"
            raise
        finally:
            outcome.ticks, outcome.overruns = self._tick, self._clock.overruns
            if outcome.reason:
                self._event("ERROR" if outcome.status == "faulted" else "WARN", outcome.reason)
            if touched:
                outcome.safe = await self._make_safe(outcome)
            outcome.problems += self._problems
            await self._flush()
            await self._connection.close()
            await self._clock.close()
        return outcome

    def _classified(self, reason: str) -> tuple[Literal["aborted", "faulted"], str]:
        return ("aborted" if reason == self._stop_reason else "faulted"), reason

    async def _first_snapshot(self) -> Snapshot:
        """Wait until every point has been heard of, letting a lockstep rig step so that its frames come."""
        if not self._lockstep:
            return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)
        await self._clock.start()
        for _ in range(3):
            await self._clock.next_tick()
            await self._connection.wait_for_device_time(self._clock.now(), FIRST_SAMPLE_TIMEOUT_S)
        return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)

    async def _arm(self) -> None:
        """Write safe set-points, start the heartbeat, arm the outputs; raises LinkError where the rig stays tripped."""
        await self._connection.write(self._setpoints.values)
        heartbeat = self._rig.heartbeat
        if heartbeat is None:
            return
        tripped: str | None = None
        for _ in range(ARMING_TICKS):
            await self._connection.write(self._heartbeat())
            if heartbeat.arm is not None:
                await self._connection.write({heartbeat.arm: 1.0})
            await self._clock.advance()
            tripped = self._interlocks.tripped(await self._connection.read())
            if tripped is None:
                return
        raise LinkError(f"not started: {tripped}")

    def _heartbeat(self) -> dict[str, float]:
        if self._rig.heartbeat is None:
            return {}
        self._beat = (self._beat + 1) % 65536
        return {self._rig.heartbeat.point: float(self._beat)}

    async def _ticks(self) -> str | None:
        """Tick until the profile ends; the reason of an early end, or None."""
        clock, profile = self._clock, self._profile
        await clock.start()
        last_time = 0.0
        while True:
            self._tick = await clock.next_tick()
            time_s = self._tick * clock.period_s
            if self._lockstep:
                await self._connection.wait_for_device_time(clock.now(), FIRST_SAMPLE_TIMEOUT_S)
            began = time.perf_counter()
            snapshot = await self._connection.read()
            now = clock.now()
            trip = self._interlocks.check(snapshot, now)
            if trip is None and self._stop_reason is not None:
                trip = self._stop_reason
            if trip is None:
                targets = dict(zip((p.name for p in self._targets), profile.at(time_s), strict=True))
                changed = self._setpoints.move(targets, time_s - last_time if self._tick else clock.period_s)
                last_time = time_s
                await self._write_tick()
                for name, value in changed.items():
                    self._journal.write(self._tick, time_s, name, value, "profile")
                if time_s < profile.duration_s:
                    clock.release()
            self._record(snapshot, time_s, now, began)
            await self._publish_if_due()
            if trip is not None:
                return trip
            if time_s >= profile.duration_s:
                return None

    async def _write_tick(self) -> None:
        """Set-points and heartbeat in one go. A lost or garbled write is left to the interlocks of the next ticks and
        to the rig's watchdog; one that the device refuses ends the run."""
        try:
            await self._connection.write(self._setpoints.values | self._heartbeat())
        except DeviceExceptionError:
            raise
        except (LinkError, ProtocolError) as error:
            self._journal.event(self._tick, self._tick * self._clock.period_s, "WARN", str(error))

    def _record(self, snapshot: Snapshot, time_s: float, now_s: float, began: float) -> None:
        commanded = [self._setpoints.values[point.name] for point in self._rig.setpoints]
        values = snapshot.values + commanded
        quality = snapshot.quality + [int(Quality.GOOD)] * len(commanded)
        source = snapshot.source_time_s + [now_s] * len(commanded)
        latency = time.perf_counter() - began
        self._journal.sample(self._tick, time_s, time.time(), latency, values, quality, source)
        self._journal.commit_if_due()
        ticks, times, rows = self._pending
        ticks.append(self._tick)
        times.append(time_s)
        rows.append([v if q == 0 else math.nan for v, q in zip(values, quality, strict=True)])
        if self._observer is not None and time.monotonic() - self._shown > 0.2:
            self._shown = time.monotonic()
            names = (point.name for point in self._connection.points)
            shown = dict(zip(names, snapshot.values, strict=True))
            self._observer(Status(self._tick, time_s, self._profile.duration_s, shown))

    async def _publish_if_due(self) -> None:
        full = len(self._pending[0]) >= PUBLISH_TICKS
        late = not self._lockstep and time.monotonic() - self._published > PUBLISH_WALL_S
        if full or late:
            await self._flush()

    async def _flush(self) -> None:
        block, self._pending = self._pending, ([], [], [])
        self._published = time.monotonic()
        if self._publisher is not None and block[0]:
            await self._publisher.publish(*block)

    def _event(self, level: str, text: str) -> None:
        """Record an event; a journal that fails must not keep the rig from being made safe."""
        try:
            self._journal.event(self._tick, self._tick * self._clock.period_s, level, text)
        except JournalError as error:
            self._problems.append(str(error))

    async def _make_safe(self, outcome: Outcome) -> bool:
        safe = self._setpoints.safe_values()
        result = await make_safe(
            self._connection,
            safe,
            heartbeat=self._heartbeat,
            advance=self._clock.advance,
            period_s=self._clock.period_s,
            hurried=lambda: self._hurry,
        )
        listed = ", ".join(f"{name} {value:g} {self._rig.get(name).unit}" for name, value in safe.items())
        if not result.written:
            text = (
                f"the rig could not be made safe from here ({result.problem}); "
                "its own watchdog cuts the heater, look at it before you go on"
            )
            self._event("ERROR", text)
            outcome.problems.append(text)
        elif not result.followed:
            self._event("WARN", f"safe values are held by the rig ({listed}), but {result.problem}")
            outcome.problems.append(result.problem)
        else:
            self._event("INFO", f"safe: {listed}; read back, and the measured values have followed")
        return result.written
