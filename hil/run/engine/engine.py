"""Engine: fixed ticks; each reads all groups, judges, obeys, writes set-points, journals and publishes.

The table in `hil.journal.states` has the states and what may follow; the outputs follow from the state alone. The
heater ends at its safe value on every way out: normal end, stop request, interlock, lost link, exception. There is one
place that makes the rig safe, and no way around it: it comes before anything else that ends a run. What a person or a
disk sees goes through queues that never wait. A guardian in a process of its own (`hil.guardian`) does the same when
this process no longer can.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from drivers.rig.connection import RigConnection
from drivers.rig_file.bus_sections import CanBus
from drivers.rig_file.model import Point
from drivers.signals.points import DeviceExceptionError, DriverError, Quality, Snapshot
from hil.guardian.client import Guard, NoGuard
from hil.journal.states import ENDED, HEATED, UNTOUCHED, WAITING, Event, State, TransitionError
from hil.journal.writer import JournalError, JournalWriter
from hil.profile.load_profile import Profile
from hil.run.engine.attended import Cut, Finished, attended
from hil.run.engine.clock import LONGEST_WAIT_S, Clock
from hil.run.engine.operator import Verb
from hil.run.engine.recording import Position, Publisher, Recorder
from hil.run.engine.supervisor import End, Supervisor
from hil.run.interlocks.conditions import Residuals
from hil.run.outputs.deviations import Deviations
from hil.run.outputs.heaters import Descent, GoodReadings, safe_limits, still_hot
from hil.run.outputs.outputs import Outputs
from hil.run.outputs.readback import SetpointReadback
from hil.run.outputs.safing import Safed, attempt_s, make_safe, write_safe
from hil.run.outputs.setpoints import bind
from hil.run.restore.resumption import Resumption
from hil.run.restore.thermal_restore import Soak

FIRST_SAMPLE_TIMEOUT_S = 10.0
PAUSED_S = 1.0
"""Ticks that are further apart than this, and than two periods, are reported as a pause of process or machine, s."""
_INTERRUPTED_AT_MOST = 100
"""So often making safe is begun again after whatever interrupted it."""


@dataclass(frozen=True, slots=True)
class Status:
    """What an operator sees of a run: `time_s` since its first tick, `profile_s` on the profile's clock.

    `units` are those of set-points and of what is measured; the rig's own flags and counters have none there.
    """

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
    units: dict[str, str] = field(default_factory=dict)
    not_safe: str = ""
    """Of a run whose outputs are to be safe: what says that they are not, read back or measured."""


@dataclass(slots=True)
class Outcome:
    """How a run ended. `ticks` counts from the run's beginning, gaps included; `soaked_s` is how long the rig was led
    back after one, `restarts` how often its program was seen to begin anew. `safe` is whether the safe values were read
    back from the rig and no heater's meter contradicts them, `away` which measured value did not get there."""

    status: Literal["done", "aborted", "faulted"]
    reason: str
    ticks: int = 0
    overruns: int = 0
    safe: bool = False
    away: str = ""
    problems: list[str] = field(default_factory=list)
    trips: tuple[str, ...] = ()
    soaked_s: float = 0.0
    restarts: int = 0
    guardian: str = ""
    """What the guardian did, where it acted."""
    deviations: list[str] = field(default_factory=list)
    """Of a run that was done: what was asked and not measured."""

    @property
    def in_order(self) -> bool:
        """Whether the profile was run to its end as it asks, and the rig left safe."""
        return self.status == "done" and self.safe and not self.away and not self.deviations

    @property
    def verdict(self) -> str:
        """Its status as people read it."""
        return "done with deviations" if self.status == "done" and self.deviations else self.status


def age(snapshot: Snapshot, points: tuple[Point, ...], seconds: float) -> None:
    """Mark good values as stale that may be `seconds` old, where that is more than their points allow."""
    for index, point in enumerate(points):
        if seconds > point.stale_after_s and snapshot.quality[index] == Quality.GOOD:
            snapshot.quality[index] = int(Quality.STALE)


class Engine:
    """One run of `profile` on an open-able `connection`; `rearm` acknowledges a trip that the rig brings along.

    `observer` is shown a status a few times a second, `told` every transition as a sentence, `residuals` says how far
    twins are off. With `resumption` it goes on where an earlier one was cut, once the rig is back where it was.
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
        resumption: Resumption | None = None,
        rearm: bool = False,
        guard: Guard | None = None,
    ) -> None:
        self._connection = connection
        self._rig = connection.rig
        self._clock = clock
        self._profile = profile
        self._observer = observer
        self._residuals = residuals
        self._lockstep = lockstep
        self._resumption = resumption
        self._rearm = rearm
        self._soak: Soak | None = None
        self._soaked_s = 0.0
        self._found_safe = False
        self._first = 0
        self._at = Position(clock.period_s)
        if resumption is not None:
            self._first = resumption.first_tick(clock.period_s)
            self._at = Position(clock.period_s, self._first, resumption.standing.profile_s)
        self._told = Recorder(journal, self._at, publisher=publisher, told=told, lockstep=lockstep)
        self._supervisor = Supervisor(self._rig, connection.points, log=self._told.transition, note=self._told.event)
        self._machine = self._supervisor.machine
        self._interlocks = self._supervisor.interlocks
        self._targets: list[Point] = bind(self._rig, profile.columns)
        self._outputs = Outputs(connection)
        self._readback = SetpointReadback(connection, self._told.event, lockstep=lockstep)
        self._interlocks.add_alarm(self._readback)
        self._snapshot: Snapshot | None = None
        self._shown = 0.0
        self._guard: Guard = NoGuard() if guard is None else guard
        self._limits = safe_limits(self._rig)
        timeouts = [bus.timeout_s for bus in self._rig.bus.values() if not isinstance(bus, CanBus)]
        self._is_quick = sum(timeouts) <= LONGEST_WAIT_S
        # The meters of a slow rig are looked at more often than once a period while it is made safe.
        self._step_s = clock.period_s if lockstep else min(clock.period_s, LONGEST_WAIT_S)
        self._patience_s = clock.period_s + LONGEST_WAIT_S + self._rig.abort_after_s + 2.0 * sum(timeouts)
        self._descent = Descent(self._rig, self._limits, clock.period_s)
        self._deviations = Deviations(self._rig)
        self._meters_of_setpoints = GoodReadings(connection.points, self._deviations.meters)
        self._meters_of_heaters = GoodReadings(connection.points, (limit.meter for limit in self._limits))
        self._soonest_stale_s = min((point.stale_after_s for point in connection.points), default=math.inf)
        self._made_safe: Safed | None = None

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
        return self._at.tick

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
        soaks = machine.state is State.SOAKING and self._soak is not None
        return Status(
            machine.state,
            self._soak.said if soaks and self._soak is not None else machine.reason,
            self._at.tick,
            self._at.time_s,
            self._at.profile_s,
            self._profile.duration_s,
            values,
            dict(self._outputs.values),
            standing.trips,
            standing.warnings,
            {point.name: point.unit for point in self._rig.point if point.kind == "measured"},
            self._not_safe(),
        )

    def _hot(self) -> str:
        """Return which heater's meter reads more than is safe, as a sentence; empty where none does."""
        return still_hot(self._rig, self._limits, self._meters_of_heaters.of(self._snapshot))

    def _not_safe(self) -> str:
        """Return what contradicts a state with safe outputs; empty where nothing does, and in every other state."""
        state, done = self._machine.state, self._made_safe
        if state in HEATED or state in UNTOUCHED:
            return ""
        if done is not None:
            return done.problem if not done.safe else ""
        return self._hot() or ("" if self._outputs.safe_held else "the safe values are not read back yet")

    # A run from its beginning to its end -------------------------------------------------------

    async def run(self) -> Outcome:
        """Run to the end; whatever happens, the rig is made safe before this returns."""
        outcome = Outcome("faulted", "")
        event, reason = Event.FAIL, ""
        fatal: BaseException | None = None
        try:
            event, reason = await self._drive()
        except (DriverError, JournalError) as error:
            reason = str(error)
        except BaseException as error:
            reason, fatal = f"{type(error).__name__}: {error}", error
        if self._machine.state not in UNTOUCHED:
            # Nothing may come before this: no file, no terminal, no message.
            interrupted = await self._safely(event, reason, outcome)
            fatal = fatal or interrupted
        else:
            outcome.safe = self._found_safe  # nothing was heated since
            self._machine.take(event, reason)
        if self._machine.state in ENDED:
            outcome.status = self._machine.state.value  # type: ignore[assignment]
        outcome.reason = "" if event is Event.COMPLETE else reason
        outcome.ticks, outcome.overruns = self._at.tick, self._clock.overruns
        outcome.soaked_s, outcome.restarts = self._soaked_s, self._interlocks.restarts
        outcome.trips = self._interlocks.standing().trips
        if outcome.status == "done":
            outcome.deviations = self._deviations.found(self._clock.period_s)
        self._supervisor.close()
        outcome.problems += self._told.problems
        await self._connection.close()
        await self._guard.done(safe=outcome.safe)
        acted = self._guard.acted
        if acted is not None:
            outcome.guardian = f"{acted.reason}; {'safe values read back' if acted.safe else acted.problem}"
        await self._told.flush()
        await self._clock.close()
        if fatal is not None:
            raise fatal
        return outcome

    async def _safely(self, event: Event, reason: str, outcome: Outcome) -> BaseException | None:
        """Make the rig safe whatever interrupts that, and take the state along; returns what interrupted it.

        A cancelled task, a signal or a lack of memory may hit any line here: making safe is begun again until it has
        come to its end. What still fails then is left to the guardian and to the rig's own watchdog.
        """
        interrupted: BaseException | None = None
        for _ in range(_INTERRUPTED_AT_MOST):
            try:
                if not outcome.safe:
                    within_s = attempt_s(self._rig)
                    problem = await write_safe(self._connection, self._outputs.safe_values, within_s)
                    if problem:
                        self._guard.act()
                    await self._answer_stopped(problem)
                if self._machine.state not in ENDED | {State.FINISHING}:
                    self._machine.take(event, reason)
                outcome.safe = await self._make_safe(outcome)
                self._machine.take(event, reason)
            except TransitionError as error:
                event, reason, interrupted = Event.FAIL, str(error), interrupted or error
            except BaseException as error:
                interrupted = interrupted or error
            if self._machine.state in ENDED:
                return interrupted
        self._guard.act()
        return interrupted

    async def _answer_stopped(self, problem: str) -> None:
        """Answer operators who asked for the end, now that the rig was told and asked."""
        if not self._supervisor.owes_end:
            return
        if problem:
            self._supervisor.stopped(f"NOT confirmed safe yet, trying again: {problem}")
        else:
            self._supervisor.stopped(f"safe values read back{await self._meters()}; the run ends")

    async def _drive(self) -> End:
        machine, rig = self._machine, self._rig
        machine.take(Event.VALIDATE, f"{self._profile.name} on {rig.name}")
        machine.take(Event.CONNECT, ", ".join(rig.bus))
        await self._connection.connect()
        await self._guard.start()
        if self._resumption is not None:
            # Nobody knows what the rig was told last, and its watchdog may still wait.
            problem = await write_safe(self._connection, self._outputs.safe_values)
            self._found_safe = not problem
            self._told.event(
                "WARN" if problem else "INFO", problem or "safe values written on connecting, and read back"
            )
        self._snapshot = await self._first_snapshot()
        await self._ask_guard()
        refusals = self._interlocks.refusals(self._snapshot, rearm=self._rearm)
        if refusals:
            return Event.FAIL, f"not started: {'; '.join(refusals)}"
        if self._supervisor.stop is not None:
            return self._supervisor.stop
        self._guard.watch()
        machine.take(Event.SOAK, "safe set-points, heartbeat, arming")
        armed = self._outputs.arm(self._advance, self._interlocks.rig_trip)
        cut = await attended(armed, self._supervisor.stopping, self._trouble)
        if isinstance(cut, Cut):
            return (Event.FAIL, cut.trouble) if cut.trouble else self._supervisor.stop or (Event.ABORT, "stopped")
        if self._resumption is None:
            machine.take(Event.START, f"running {self._profile.name} on {rig.name}")
        await self._clock.start()
        ended = None if self._resumption is None else self._go_on(self._resumption)
        tick = self._one_tick if self._lockstep else self._interruptible_tick
        while ended is None:
            ended = await tick()
        return ended

    async def _interruptible_tick(self) -> End | None:
        """Do one tick; a request to stop or to pause ends one that waits for the next tick of a slow rig, or for a
        device that does not answer."""
        if self._clock.period_s <= LONGEST_WAIT_S and self._is_quick:
            return await self._one_tick()
        done = await attended(self._one_tick(), self._supervisor.urgent, self._trouble)
        if isinstance(done, Finished):
            return done.result
        if done.trouble is not None:
            return Event.FAIL, done.trouble
        if self._supervisor.stop is None:
            await self._obey_now()
        return self._supervisor.stop

    def _trouble(self) -> str | None:
        """Return why the run has to end before its next tick: the guardian acted or is gone, the journal is lost."""
        return self._guard.failure() or self._told.failure

    async def _obey_now(self) -> None:
        """Obey a request to make safe between two ticks, and answer it when the safe values are read back."""
        self._expect()
        self._supervisor.obey_urgent()
        await self._put_out(0.0)
        if self._supervisor.owes_answers:
            self._supervisor.answer(await self._obeyed())

    async def _ask_guard(self) -> None:
        """Have the guardian reach the rig beside this engine; a wire that takes one connection only is reported."""
        alone = await self._guard.probe()
        for why in alone:
            self._told.event(
                "WARN",
                f"the guardian cannot have a connection of its own beside the run's ({why}); where this process hangs "
                "it is ended first, and the guardian takes its place",
            )
        if alone:
            self._snapshot = await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)

    def _go_on(self, resumption: Resumption) -> End | None:
        """Begin a new segment of a run that was cut: lead the rig back, unless there is nothing left to run."""
        was = resumption.standing
        self._first = self._at.tick = resumption.first_tick(self._clock.period_s)
        gap_s = self._at.time_s - was.time_s
        self._told.segment(was.number, gap_s, was.aim_tick, resumption.reason)
        if self._at.profile_s >= self._profile.duration_s:
            self._machine.take(Event.START, "nothing is left of the profile")
            return Event.COMPLETE, "the profile was over"
        points = self._connection.points
        self._soak = Soak(self._rig, points, self._profile, self._at.profile_s, was.aim, resumption.rule)
        self._supervisor.soaks = True
        return None

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
        self._expect()
        if machine.state in WAITING:
            await clock.wait()
        last, was_running = self._at.tick, machine.state is State.RUNNING
        self._at.tick = self._first + await clock.next_tick()
        self._expect()
        if self._lockstep:
            await self._connection.wait_for_device_time(clock.now(), FIRST_SAMPLE_TIMEOUT_S)
        began = time.perf_counter()
        asked_s = clock.now()
        snapshot = self._snapshot = await self._connection.read()
        now, wall_s = clock.now(), time.time()
        # A process that was stopped while it read has read at any time since: the row is of now, old values are stale.
        self._at.tick = self._first + clock.current_tick()
        passed = self._at.tick - last
        if now - asked_s > self._soonest_stale_s:
            age(snapshot, self._connection.points, now - asked_s)
        self._notice_pause(passed * clock.period_s)
        # A machine without descriptors cannot open the link again: waiting for it would only heat on.
        why = self._guard.failure() or (self._connection.exhausted if snapshot.faults else None)
        if why is not None:
            return Event.FAIL, why
        await self._readback.look(snapshot, self._outputs.values, now)
        ended = self._supervisor.step(snapshot, now, self._outputs.values, self._residuals())
        if ended is None and self._soak is not None:
            ended = self._lead_back(self._soak, snapshot, now)
        if was_running and machine.state is State.RUNNING:
            self._at.profile_ticks += passed
            self._deviations.tick(self._outputs.values, self._meters_of_setpoints.of(snapshot))
        over = machine.state is State.RUNNING and self._at.profile_s >= self._profile.duration_s
        if ended is None:
            await self._put_out(clock.period_s)
            if self._supervisor.owes_answers:
                self._supervisor.answer(await self._obeyed())
            ended = (Event.COMPLETE, "the profile is over") if over else None
            if ended is None:
                clock.release()
        self._told.sample(snapshot, self._outputs.values, now, wall_s, began)
        if self._observer is not None and time.monotonic() - self._shown > 0.2:
            self._shown = time.monotonic()
            self._observer(self.status())
        await self._told.publish_if_due()
        return ended

    def _expect(self) -> None:
        """Tell the guardian how long this engine may be busy: until the next tick, and with devices that are mute."""
        self._guard.expect(self._patience_s)

    async def _advance(self) -> None:
        """Let one period pass, outside the grid."""
        self._expect()
        await self._clock.advance()

    async def _step(self) -> None:
        """Let `_step_s` pass, outside the grid."""
        if self._step_s == self._clock.period_s:
            await self._advance()
        else:
            self._expect()
            await self._clock.advance(self._step_s)

    def _notice_pause(self, passed_s: float) -> None:
        """Record a gap between two ticks; beyond `abort_after_s` an interlock trips as well."""
        if self._lockstep or passed_s <= max(PAUSED_S, 2.0 * self._clock.period_s):
            return
        self._told.event(
            "WARN",
            f"no tick for {passed_s:.1f} s: this process or its machine was paused, or a device kept it waiting; "
            "values from before the gap are stale",
        )

    def _lead_back(self, soak: Soak, snapshot: Snapshot, now_s: float) -> End | None:
        """One tick of soaking: go on with the profile once the rig is back, end the run where it takes too long."""
        soak.look(snapshot, now_s, stands=self._machine.state in WAITING)
        self._soaked_s = soak.elapsed_s
        if soak.reached and self._machine.state is State.SOAKING:
            self._soak, self._supervisor.soaks = None, False
            self._machine.take(Event.START, f"the rig is back where it was, after {self._soaked_s:.0f} s of soaking")
        return None if soak.failure is None else (Event.FAIL, soak.failure)

    async def _obeyed(self) -> str:
        """Return the answer to an operator: the state, and outside `HEATED` what the rig holds and its meters read."""
        said = f"{self.state} at {self._at.profile_s:g} s of the profile"
        if self.state in HEATED:
            return said
        if not self._outputs.safe_held:
            return said + "; NOT confirmed safe yet, trying again"
        return f"{said}; safe values read back{await self._meters()}"

    async def _meters(self) -> str:
        """Return what the heaters' meters read now, to go on with a sentence."""
        if not self._limits:
            return ""
        readings = self._meters_of_heaters.of(await self._connection.read())
        hot = still_hot(self._rig, self._limits, readings)
        if hot:
            return f", but {hot}"
        known = [limit.meter for limit in self._limits if limit.meter in readings]
        listed = ", ".join(f"{name} reads {readings[name]:.1f} {self._rig.get(name).unit}" for name in known)
        return f", {listed}" if known else ", but no meter can be read"

    async def _put_out(self, elapsed_s: float) -> None:
        """Write what the state asks for. A lost or garbled write is left to the interlocks of the next ticks and to the
        rig's watchdog; one that the device refuses ends the run, unless it is a safe value, which is tried again.

        An engine that may have been relieved by the guardian writes no heat before it knows."""
        state, before = self._machine.state, dict(self._outputs.values)
        try:
            if state not in HEATED:
                if not self._outputs.safe_held:
                    self._descent.clear()  # it counts from the read-back on
                readings = self._meters_of_heaters.of(self._snapshot)
                hot = self._descent.stays(readings, self._clock.now())
                await self._outputs.put_safe(arm=self._supervisor.arming, hot=hot)
            elif self._guard.may_heat():
                self._descent.clear()
                await self._outputs.move(self._wanted(), elapsed_s)
            else:
                self._told.event("WARN", "nothing was written on this tick: the guardian may have acted meanwhile")
        except DriverError as error:
            self._readback.not_confirmed()
            if state in HEATED and isinstance(error, DeviceExceptionError):
                raise
            self._told.event("WARN", str(error))
        reason = {State.RUNNING: "profile", State.SOAKING: "soak"}.get(state, f"safe: {state}")
        self._told.written(before, self._outputs.values, reason)

    def _wanted(self) -> dict[str, float]:
        """Where the set-points are to go; nothing where they stay."""
        if self._machine.state is State.RUNNING:
            names = (point.name for point in self._targets)
            return dict(zip(names, self._profile.at(self._at.profile_s), strict=True))
        return self._soak.targets() if self._machine.state is State.SOAKING and self._soak is not None else {}

    async def _make_safe(self, outcome: Outcome) -> bool:
        safe = self._outputs.safe_values
        result = await make_safe(
            self._connection,
            safe,
            heartbeat=self._outputs.heartbeat,
            advance=self._step,
            period_s=self._step_s,
            hurried=lambda: self._supervisor.hurried,
            progress=self._expect,
            failed=self._guard_has_made_safe,
        )
        self._made_safe = result
        listed = ", ".join(f"{name} {value:g} {self._rig.get(name).unit}" for name, value in safe.items())
        acted = self._guard.acted
        if not result.written:
            watchdog = self._rig.heartbeat is not None and self._rig.heartbeat.watchdog is not None
            rest = "its own watchdog has to cut the heater" if watchdog else "it has no watchdog that is known here"
            text = f"the rig could not be made safe from here ({result.problem}); {rest}: look at it now"
            self._told.event("ERROR", text)
            outcome.problems.append(text)
        elif result.hot:
            text = f"NOT SAFE: safe values are held by the rig ({listed}), but {result.hot}; look at it now"
            self._told.event("ERROR", text)
            outcome.problems.append(text)
            outcome.away = result.hot
        elif not result.followed:
            self._told.event("WARN", f"safe values are held by the rig ({listed}), but {result.problem}")
            outcome.problems.append(result.problem)
            outcome.away = result.problem
        else:
            by = "" if acted is None or not acted.safe else f"; the guardian had made it so ({acted.reason})"
            self._told.event("INFO", f"safe: {listed}; read back, and the measured values have followed{by}")
        return result.safe

    def _guard_has_made_safe(self) -> bool:
        """Ask the guardian to act, after an attempt of this engine that failed; whether it has made the rig safe."""
        self._guard.act()
        self._guard.failure()
        return self._guard.acted is not None and self._guard.acted.safe
