"""The loop: fixed ticks; each reads all groups, judges, obeys, writes set-points, journals and publishes.

Where a run is, and what may follow, is the table in `hil.states`; what the outputs do follows from the state alone. The
heater ends at its safe value on every way out: normal end, stop request, interlock, lost link, exception. There is one
place that makes the rig safe, and no way around it.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

from drivers.points import DeviceExceptionError, DriverError, Quality, Snapshot
from drivers.rig import RigConnection
from drivers.rigfile import Point
from hil.clock import Clock
from hil.conditions import Residuals
from hil.journal import JournalError, JournalWriter
from hil.operator import Verb
from hil.outputs import Outputs
from hil.profile import Profile
from hil.safing import make_safe
from hil.setpoints import bind
from hil.states import HEATED, UNTOUCHED, WAITING, Event, State, Transition, level_of
from hil.supervisor import End, Supervisor

FIRST_SAMPLE_TIMEOUT_S = 10.0
PUBLISH_TICKS = 60
PUBLISH_WALL_S = 0.5


@dataclass(frozen=True, slots=True)
class Status:
    """What an operator sees of a run: `time_s` since its first tick, `profile_s` on the profile's clock."""

    state: State
    reason: str
    tick: int
    time_s: float
    profile_s: float
    duration_s: float
    values: dict[str, float]
    setpoints: dict[str, float]
    trips: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(slots=True)
class Outcome:
    """How a run ended. `safe` is whether the safe values were read back from the rig."""

    status: Literal["done", "aborted", "faulted"]
    reason: str
    ticks: int = 0
    overruns: int = 0
    safe: bool = False
    problems: list[str] = field(default_factory=list)
    trips: tuple[str, ...] = ()


class Publisher(Protocol):
    """Where blocks of ticks go for calibration; must not delay a tick in real time."""

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Take a block: `rows (n, k)` in the order of the journal's signals, NaN where a value is not good."""


class Engine:
    """One run of `profile` on an open-able `connection`.

    `observer` is shown a status a few times a second, `told` every transition as a sentence, `residuals` says how far
    twins are off.
    """

    def __init__(
        self,
        connection: RigConnection,
        clock: Clock,
        profile: Profile,
        journal: JournalWriter,
        *,
        publisher: Publisher | None = None,
        observer: Callable[[Status], None] | None = None,
        told: Callable[[str], None] | None = None,
        residuals: Callable[[], Residuals] = dict,
        lockstep: bool = False,
    ) -> None:
        self._connection = connection
        self._rig = connection.rig
        self._clock = clock
        self._profile = profile
        self._journal = journal
        self._publisher = publisher
        self._observer = observer
        self._told = told
        self._residuals = residuals
        self._lockstep = lockstep
        self._supervisor = Supervisor(self._rig, connection.points, log=self._log, note=self._event)
        self._machine = self._supervisor.machine
        self._interlocks = self._supervisor.interlocks
        self._targets: list[Point] = bind(self._rig, profile.columns)
        self._outputs = Outputs(connection)
        self._tick = 0
        self._profile_ticks = 0
        self._snapshot: Snapshot | None = None
        self._pending: tuple[list[int], list[float], list[list[float]]] = ([], [], [])
        self._published = time.monotonic()
        self._shown = 0.0
        self._problems: list[str] = []

    # What others ask of it ---------------------------------------------------------------------

    def request_stop(self, reason: str) -> None:
        """See `Supervisor.request_stop`."""
        self._supervisor.request_stop(reason)

    async def ask(self, verb: Verb, reason: str) -> str:
        """See `Supervisor.ask`."""
        return await self._supervisor.ask(verb, reason)

    @property
    def tick(self) -> int:
        """Index of the tick under way."""
        return self._tick

    @property
    def state(self) -> State:
        """Where the run is."""
        return self._machine.state

    def status(self) -> Status:
        """Everything that an operator may want to know now; values that are not good are NaN."""
        values = {}
        if self._snapshot is not None:
            rows = zip(self._connection.points, self._snapshot.values, self._snapshot.quality, strict=True)
            values = {point.name: value if quality == 0 else math.nan for point, value, quality in rows}
        standing, machine = self._interlocks.standing(), self._machine
        return Status(
            machine.state,
            machine.reason,
            self._tick,
            self._time_s,
            self._profile_s,
            self._profile.duration_s,
            values,
            dict(self._outputs.values),
            standing.trips,
            standing.warnings,
        )

    # A run from its beginning to its end -------------------------------------------------------

    async def run(self) -> Outcome:
        """Run to the end; whatever happens, the rig is made safe before this returns."""
        outcome = Outcome("faulted", "")
        event, reason = Event.FAIL, ""
        try:
            event, reason = await self._drive()
        except (DriverError, JournalError) as error:
            reason = str(error)
        except BaseException as error:
            reason = f"{type(error).__name__}: {error}"
            raise
        finally:
            outcome.ticks, outcome.overruns = self._tick, self._clock.overruns
            outcome.reason = "" if event is Event.COMPLETE else reason
            untouched = self._machine.state in UNTOUCHED
            self._machine.take(event, reason)
            if not untouched:
                outcome.safe = await self._make_safe(outcome)
                self._machine.take(event, reason)
            outcome.status = self._machine.state.value  # type: ignore[assignment]
            outcome.trips = self._interlocks.standing().trips
            self._supervisor.close()
            outcome.problems += self._problems
            await self._flush()
            await self._connection.close()
            await self._clock.close()
        return outcome

    async def _drive(self) -> End:
        machine, rig = self._machine, self._rig
        machine.take(Event.VALIDATE, f"{self._profile.name} on {rig.name}")
        machine.take(Event.CONNECT, ", ".join(rig.bus))
        await self._connection.connect()
        self._snapshot = await self._first_snapshot()
        refusals = self._interlocks.refusals(self._snapshot)
        if refusals:
            return Event.FAIL, f"not started: {'; '.join(refusals)}"
        if self._supervisor.stop is not None:
            return self._supervisor.stop
        machine.take(Event.SOAK, "safe set-points, heartbeat, arming")
        await self._outputs.arm(self._clock.advance, self._interlocks.rig_trip)
        machine.take(Event.START, f"running {self._profile.name} on {rig.name}")
        await self._clock.start()
        ended = None
        while ended is None:
            ended = await self._one_tick()
        return ended

    async def _first_snapshot(self) -> Snapshot:
        """Wait until every point has been heard of, letting a lockstep rig step so that its frames come."""
        if not self._lockstep:
            return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)
        await self._clock.start()
        for _ in range(3):
            await self._clock.next_tick()
            await self._connection.wait_for_device_time(self._clock.now(), FIRST_SAMPLE_TIMEOUT_S)
        return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)

    # One tick ----------------------------------------------------------------------------------

    async def _one_tick(self) -> End | None:
        """Read, obey, protect, write, record; how the run ends, where it does."""
        clock, machine = self._clock, self._machine
        if machine.state in WAITING:
            await clock.wait()
        last, was_running = self._tick, machine.state is State.RUNNING
        self._tick = await clock.next_tick()
        passed = self._tick - last
        if self._lockstep:
            await self._connection.wait_for_device_time(clock.now(), FIRST_SAMPLE_TIMEOUT_S)
        began = time.perf_counter()
        snapshot = self._snapshot = await self._connection.read()
        now = clock.now()
        ended = self._supervisor.step(snapshot, now, self._outputs.values, self._residuals())
        if was_running and machine.state is State.RUNNING:
            self._profile_ticks += passed
        over = machine.state is State.RUNNING and self._profile_s >= self._profile.duration_s
        if ended is None:
            await self._put_out((passed or 1) * clock.period_s)
            self._supervisor.answer(self._obeyed())
            ended = (Event.COMPLETE, "the profile is over") if over else None
            if ended is None:
                clock.release()
        self._record(snapshot, now, began)
        await self._publish_if_due()
        return ended

    @property
    def _time_s(self) -> float:
        return self._tick * self._clock.period_s

    @property
    def _profile_s(self) -> float:
        return self._profile_ticks * self._clock.period_s

    def _obeyed(self) -> str:
        """What an operator is answered."""
        said = f"{self.state} at {self._profile_s:g} s of the profile"
        if self.state in HEATED:
            return said
        return said + (
            "; safe values read back" if self._outputs.safe_held else "; NOT confirmed safe yet, trying again"
        )

    async def _put_out(self, elapsed_s: float) -> None:
        """Write what the state asks for. A lost or garbled write is left to the interlocks of the next ticks and to the
        rig's watchdog; one that the device refuses ends the run, unless it is a safe value, which is tried again."""
        state, before = self._machine.state, dict(self._outputs.values)
        try:
            if state not in HEATED:
                await self._outputs.put_safe(arm=self._supervisor.arming)
            else:
                names = (point.name for point in self._targets)
                targets = zip(names, self._profile.at(self._profile_s), strict=True) if state is State.RUNNING else ()
                await self._outputs.move(dict(targets), elapsed_s)
        except DriverError as error:
            if state in HEATED and isinstance(error, DeviceExceptionError):
                raise
            self._event("WARN", str(error))
        reason = "profile" if state is State.RUNNING else f"safe: {state}"
        for name, value in self._outputs.values.items():
            if value != before[name]:
                self._journal.write(self._tick, self._time_s, name, value, reason)

    # What is told of it ------------------------------------------------------------------------

    def _record(self, snapshot: Snapshot, now_s: float, began: float) -> None:
        time_s = self._time_s
        commanded = [self._outputs.values[point.name] for point in self._rig.setpoints]
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
            self._observer(self.status())

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

    def _log(self, step: Transition) -> None:
        """Every transition: a row of the journal, an event, a line in the terminal."""
        time_s = self._time_s
        self._journal.state(
            self._tick, time_s, self._profile_s, step.source.value, step.event.value, step.target.value, step.reason
        )
        self._event(level_of(step), f"{step.source} → {step.target}: {step.reason}")
        if self._told is not None:
            # A terminal that went away must not come between a fault and safe outputs.
            with contextlib.suppress(Exception):
                self._told(f"{time_s:8.0f} s  {step.target}: {step.reason}")

    def _event(self, level: str, text: str) -> None:
        """Record an event; a journal that fails must not keep the rig from being made safe."""
        try:
            self._journal.event(self._tick, self._time_s, level, text)
        except JournalError as error:
            self._problems.append(str(error))

    async def _make_safe(self, outcome: Outcome) -> bool:
        safe = self._outputs.safe_values
        result = await make_safe(
            self._connection,
            safe,
            heartbeat=self._outputs.heartbeat,
            advance=self._clock.advance,
            period_s=self._clock.period_s,
            hurried=lambda: self._supervisor.hurried,
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
