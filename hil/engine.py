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

from drivers.points import DeviceExceptionError, DriverError, LinkError, ProtocolError, Quality, Snapshot
from drivers.rig import RigConnection
from drivers.rigfile import Point
from hil.clock import Clock
from hil.conditions import Residuals
from hil.interlocks import Interlocks, Judgement
from hil.journal import JournalError, JournalWriter
from hil.operator import EVENT_OF, Desk, RefusedError, Request, Verb, refusal
from hil.profile import Profile
from hil.safing import make_safe, write_safe
from hil.setpoints import Setpoints, bind
from hil.states import HEATED, UNTOUCHED, WAITING, Event, Machine, State, Transition, following, level_of

FIRST_SAMPLE_TIMEOUT_S = 10.0
ARMING_TICKS = 3
SECOND_REQUEST_S = 0.5
PUBLISH_TICKS = 60
PUBLISH_WALL_S = 0.5

End = tuple[Event, str]
"""COMPLETE, ABORT or FAIL, and why."""


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
        self._machine = Machine(self._log)
        self._desk = Desk()
        self._targets: list[Point] = bind(self._rig, profile.columns)
        self._setpoints = Setpoints(self._rig)
        self._interlocks = Interlocks(self._rig, connection.points)
        self._beat = 0
        self._tick = 0
        self._profile_ticks = 0
        self._safe_held = False
        self._tripped_s = 0.0
        self._trips: tuple[str, ...] = ()
        self._acking: tuple[Request, int] | None = None
        self._stop_reason: str | None = None
        self._stop_asked = 0.0
        self._hurry = False
        self._snapshot: Snapshot | None = None
        self._pending: tuple[list[int], list[float], list[list[float]]] = ([], [], [])
        self._published = time.monotonic()
        self._shown = 0.0
        self._problems: list[str] = []

    # What others ask of it ---------------------------------------------------------------------

    def request_stop(self, reason: str) -> None:
        """End the run at the next tick. A second request shortens the waits of making safe, and skips nothing.

        One that comes within `SECOND_REQUEST_S` is taken for an echo of the first: a terminal and a supervisor may
        both pass on the same Ctrl-C.
        """
        if self._stop_reason is None:
            self._stop_reason, self._stop_asked = reason, time.monotonic()
        elif time.monotonic() - self._stop_asked > SECOND_REQUEST_S:
            self._hurry = True

    async def ask(self, verb: Verb, reason: str) -> str:
        """Have `verb` obeyed on the next tick, and what came of it as a sentence; raises RefusedError."""
        if verb is Verb.ABORT:
            self.request_stop(reason)
            return "aborting: the outputs go to their safe values; the run's own terminal says when they are there"
        if self._machine.state in UNTOUCHED or self._machine.state in (State.SOAKING, State.FINISHING):
            raise RefusedError(f"a run that is {self._machine.state} can only be aborted")
        return await self._desk.ask(verb, reason)

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
        standing, machine, period_s = self._interlocks.standing(), self._machine, self._clock.period_s
        return Status(
            machine.state,
            machine.reason,
            self._tick,
            self._tick * period_s,
            self._profile_ticks * period_s,
            self._profile.duration_s,
            values,
            dict(self._setpoints.values),
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
            self._desk.close(self._machine.state)
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
        if self._stop_reason is not None:
            return Event.ABORT, self._stop_reason
        machine.take(Event.SOAK, "safe set-points, heartbeat, arming")
        await self._arm()
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
            tripped = self._interlocks.rig_trip(await self._connection.read())
            if tripped is None:
                return
        raise LinkError(f"not started: {tripped}")

    def _heartbeat(self) -> dict[str, float]:
        if self._rig.heartbeat is None:
            return {}
        self._beat = (self._beat + 1) % 65536
        return {self._rig.heartbeat.point: float(self._beat)}

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
        judgement = self._interlocks.judge(snapshot, now, self._setpoints.values, self._residuals())
        self._obey(judgement)
        ended = self._protect(self._interlocks.standing(), now)
        if ended is None and self._stop_reason is not None:
            ended = Event.ABORT, self._stop_reason
        if was_running and machine.state is State.RUNNING:
            self._profile_ticks += passed
        over = machine.state is State.RUNNING and self._profile_s >= self._profile.duration_s
        if ended is None:
            await self._put_out((passed or 1) * clock.period_s)
            ended = (Event.COMPLETE, "the profile is over") if over else None
            if ended is None:
                clock.release()
        self._record(snapshot, now, began)
        await self._publish_if_due()
        return ended

    @property
    def _profile_s(self) -> float:
        return self._profile_ticks * self._clock.period_s

    def _obey(self, judgement: Judgement) -> None:
        """What operators asked since the last tick."""
        self._acknowledge_on()
        for request in self._desk.take():
            why_not = refusal(self._machine.state, request.verb, self._interlocks.standing().trips)
            if why_not is not None:
                request.refuse(why_not)
            elif request.verb is Verb.ACK:
                self._acking = request, ARMING_TICKS
                self._event("INFO", f"acknowledged {request.reason}: {'; '.join(judgement.trips)}")
            else:
                event = EVENT_OF[request.verb]
                if following(self._machine.state, event) is not None:
                    self._machine.take(event, request.reason)
                request.done(f"{self._machine.state} at {self._profile_s:g} s of the profile")

    def _acknowledge_on(self) -> None:
        """Let go of trips whose causes are gone. The rig's own goes when it is armed again, which takes a tick."""
        if self._acking is None:
            return
        request, left = self._acking
        stay = self._interlocks.acknowledge()
        if not stay:
            self._trips = ()
            request.done(f"acknowledged; the run is {self._machine.state}, `hil ctl resume` lets it go on")
        elif left == 0:
            request.refuse(f"still there: {'; '.join(stay)}")
        self._acking = (request, left - 1) if stay and left else None

    def _protect(self, judgement: Judgement, now_s: float) -> End | None:
        """What interlocks make of the state; they have the last word on a tick."""
        state, trips, waits_s = self._machine.state, judgement.trips, self._rig.acknowledge_within_s
        if trips:
            more = f" (and {len(trips) - 1} more)" if len(trips) > 1 else ""
            if waits_s <= 0:
                return Event.FAIL, trips[0] + more
            if not self._trips:
                self._tripped_s = now_s
            if set(trips) - set(self._trips):
                self._machine.take(Event.TRIP, f"tripped: {trips[0]}{more}")
            self._trips = trips
            if now_s - self._tripped_s > waits_s:
                return Event.FAIL, f"{trips[0]}{more}; not acknowledged within {waits_s:g} s"
        elif judgement.warnings and state in HEATED:
            self._machine.take(Event.WARN, "; ".join(judgement.warnings))
        elif not judgement.warnings and state is State.SUSPENDED:
            self._machine.take(Event.CLEAR, "all warnings are gone")
        return None

    async def _put_out(self, elapsed_s: float) -> None:
        """Write what the state asks for. A lost or garbled write is left to the interlocks of the next ticks and to the
        rig's watchdog; one that the device refuses ends the run."""
        if self._machine.state not in HEATED:
            await self._put_safe()
            return
        self._safe_held = False
        before, changed = dict(self._setpoints.values), dict[str, float]()
        if self._machine.state is State.RUNNING:
            targets = dict(zip((p.name for p in self._targets), self._profile.at(self._profile_s), strict=True))
            changed = self._setpoints.move(targets, elapsed_s)
        try:
            await self._connection.write(self._setpoints.values | self._heartbeat())
        except DeviceExceptionError:
            raise
        except (LinkError, ProtocolError) as error:
            # What was not confirmed has not moved: when the link is back the slew rate counts from here.
            self._setpoints.values.update(before)
            self._event("WARN", str(error))
            return
        self._journal_writes(changed, "profile")

    async def _put_safe(self) -> None:
        """Safe values in their order, read back. While they are not held there is no heartbeat: the watchdog may act."""
        self._journal_writes(self._setpoints.put_safe(), f"safe: {self._machine.state}")
        try:
            if not self._safe_held:
                problem = await write_safe(self._connection, self._setpoints.safe_values())
                if problem:
                    raise LinkError(f"not safe yet, trying again: {problem}")
                self._safe_held = True
            await self._connection.write(self._setpoints.values | self._heartbeat())
            if self._acking is not None and self._rig.heartbeat is not None and self._rig.heartbeat.arm is not None:
                await self._connection.write({self._rig.heartbeat.arm: 1.0})
        except DriverError as error:
            self._safe_held = False
            self._event("WARN", str(error))

    # What is told of it ------------------------------------------------------------------------

    def _journal_writes(self, changed: dict[str, float], reason: str) -> None:
        for name, value in changed.items():
            self._journal.write(self._tick, self._tick * self._clock.period_s, name, value, reason)

    def _record(self, snapshot: Snapshot, now_s: float, began: float) -> None:
        time_s = self._tick * self._clock.period_s
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
        time_s = self._tick * self._clock.period_s
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
