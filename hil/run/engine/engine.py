"""Engine of a run: each tick reads all signals, checks the interlocks, obeys requests, writes set-points and records.

The table in `hil.journal.states` has the states and what may follow; the outputs follow from the state alone. The
heater ends at its safe value on every way out: normal end, stop request, interlock, lost link, exception. There is one
place that makes the rig safe (`ending`), and no way around it: it comes before anything else that ends a run. What a
person or a disk sees goes through queues that never wait. A guardian in a process of its own (`hil.guardian`) does the
same when this process no longer can.
"""

from __future__ import annotations

import math
import time

from drivers.rig import RigConnection
from drivers.signals import DriverError, Snapshot
from hil.journal import ENDED, UNTOUCHED, JournalError, JournalWriter, RunEvent, State
from hil.profile import Profile
from hil.run.engine.attended import Cut, attended
from hil.run.engine.clock import Clock
from hil.run.engine.components import Components, Options
from hil.run.engine.ending import Ending
from hil.run.engine.operator import Verb
from hil.run.engine.status import Outcome, Status
from hil.run.engine.supervisor import End
from hil.run.engine.tick import FIRST_SAMPLE_TIMEOUT_S, TickWork
from hil.run.outputs import still_hot, write_safe
from hil.run.restore import Resumption, ThermalRestore

OBSERVE_EVERY_S = 0.2
"""Shortest interval between two statuses for the observer, s: faster than a person reads, and slow for the tick."""


class Engine:
    """One run of a load profile on a rig; `connection` is opened by the run, and `journal` records it."""

    def __init__(
        self,
        connection: RigConnection,
        clock: Clock,
        profile: Profile,
        journal: JournalWriter,
        options: Options | None = None,
    ) -> None:
        parts = self._parts = Components(connection, clock, profile, journal, options or Options())
        self._connection, self._clock, self._profile = connection, clock, profile
        self._options, self._guard = parts.options, parts.guard
        self._machine, self._supervisor, self._interlocks = parts.machine, parts.supervisor, parts.interlocks
        self._outputs, self._at, self._recorder = parts.outputs, parts.at, parts.recorder
        self._work = TickWork(parts, self._show)
        self._ending = Ending(parts, self._work)
        self._found_safe = False
        self._shown_s = 0.0

    def request_stop(self, reason: str) -> None:
        """See `Supervisor.request_stop`."""
        self._supervisor.request_stop(reason)

    async def ask(self, verb: Verb, reason: str) -> str:
        """See `Supervisor.ask`."""
        return await self._supervisor.ask(verb, reason)

    @property
    def tick(self) -> int:
        """Return the index of the tick under way."""
        return self._at.tick

    @property
    def state(self) -> State:
        """Return the state of the run."""
        return self._machine.state

    def status(self) -> Status:
        """Return everything that an operator may want to know now; values that are not good are NaN."""
        values, snapshot, restore = {}, self._work.snapshot, self._work.restore
        if snapshot is not None:
            rows = zip(self._connection.points, snapshot.values, snapshot.quality, strict=True)
            values = {point.name: value if quality == 0 else math.nan for point, value, quality in rows}
        standing, machine = self._interlocks.standing(), self._machine
        restores = machine.state is State.RESTORING and restore is not None
        return Status(
            machine.state,
            restore.progress if restores and restore is not None else machine.reason,
            self._at.tick,
            self._at.time_s,
            self._at.profile_s,
            self._profile.duration_s,
            values,
            dict(self._outputs.values),
            standing.trips,
            standing.warnings,
            {point.name: point.unit for point in self._parts.rig.point if point.kind == "measured"},
            self._ending.not_safe(),
        )

    async def run(self) -> Outcome:
        """Run to the end; whatever happens, the rig is made safe before this returns."""
        outcome = Outcome("faulted", "")
        event, reason = RunEvent.FAIL, ""
        fatal: BaseException | None = None
        try:
            event, reason = await self._drive()
        except DriverError as error:
            reason = str(error)
        except JournalError as error:
            event, reason = RunEvent.FAULT, str(error)
        except BaseException as error:
            event, reason, fatal = RunEvent.FAULT, f"{type(error).__name__}: {error}", error
        if self._machine.state not in UNTOUCHED:
            # Nothing may come before this: no file, no terminal, no message.
            interrupted = await self._ending.safely(event, reason, outcome)
            fatal = fatal or interrupted
        else:
            outcome.safe = self._found_safe  # nothing was heated since
            outcome.untouched = self._options.resumption is None  # else an earlier part of the run wrote
            hot = still_hot(self._parts.rig, self._parts.limits, self._parts.heater_meters.of(self._work.snapshot))
            if hot and not outcome.safe:
                wrote = "this run has written nothing to the rig: " if outcome.untouched else ""
                outcome.problems.append(f"{hot}; {wrote}look at it now")
            self._machine.take(event, reason)
        if self._machine.state in ENDED:
            outcome.status = self._machine.state.value  # type: ignore[assignment]
        outcome.reason = "" if event is RunEvent.COMPLETE else reason
        outcome.ticks, outcome.overruns = self._at.tick, self._clock.overruns
        outcome.restore_s, outcome.restarts = self._work.restore_s, self._interlocks.restarts
        outcome.trips = self._interlocks.standing().trips
        if outcome.status == "done":
            outcome.deviations = self._work.deviations.found(self._clock.period_s)
        outcome.deviations += [outcome.disobeyed] if outcome.disobeyed else []
        self._supervisor.close()
        outcome.problems += self._recorder.problems
        silent = [self._connection.points[index].name for index in sorted(self._recorder.silent)]
        if silent and outcome.ticks:
            since = "in the whole run" if self._options.resumption is None else "since the run was resumed"
            outcome.problems.append(
                f"{', '.join(silent)}: no good value {since}; `hil check RIG --online` with the rig file shows why"
            )
        await self._connection.close()
        await self._guard.done(safe=outcome.safe)
        acted = self._guard.acted
        if acted is not None:
            outcome.guardian = acted.sentence(run_is_safe=outcome.safe)
        await self._recorder.flush()
        await self._clock.close()
        if fatal is not None:
            raise fatal
        return outcome

    async def _drive(self) -> End:
        """Start, arm and tick; return how the run ends."""
        machine, rig, resumption = self._machine, self._parts.rig, self._options.resumption
        machine.take(RunEvent.VALIDATE, f"{self._profile.name} on {rig.name}")
        machine.take(RunEvent.CONNECT, ", ".join(rig.bus))
        await self._connection.connect()
        await self._guard.start()
        if resumption is not None:
            # Nobody knows what the rig was told last, and its watchdog may still wait.
            problem = await write_safe(self._connection, self._outputs.safe_values)
            self._found_safe = not problem
            self._recorder.event(
                "WARN" if problem else "INFO", problem or "safe values written on connecting, and read back"
            )
        snapshot = self._work.snapshot = await self._first_snapshot()
        snapshot = self._work.snapshot = await self._ask_guard() or snapshot
        refusals = self._interlocks.refusals(snapshot, rearm=self._options.rearm)
        if refusals:
            return RunEvent.FAIL, f"not started: {'; '.join(refusals)}"
        if self._supervisor.stop is not None:
            return self._supervisor.stop
        self._guard.watch()
        machine.take(RunEvent.RESTORE, "safe set-points, heartbeat, arming")
        armed = self._outputs.arm(self._parts.advance, self._interlocks.rig_trip)
        cut = await attended(armed, self._supervisor.stopping, self._parts.trouble)
        if isinstance(cut, Cut):
            return (
                (RunEvent.FAULT, cut.trouble) if cut.trouble else self._supervisor.stop or (RunEvent.ABORT, "stopped")
            )
        if resumption is None:
            machine.take(RunEvent.START, f"running {self._profile.name} on {rig.name}")
        await self._clock.start()
        ended = None if resumption is None else self._go_on(resumption)
        tick = self._work.one if self._options.lockstep or self._parts.is_quick else self._work.interruptible
        while ended is None:
            ended = await tick()
        return ended

    def _show(self) -> None:
        """Give the observer a status, where one is due."""
        observer = self._options.observer
        if observer is not None and time.monotonic() - self._shown_s > OBSERVE_EVERY_S:
            self._shown_s = time.monotonic()
            observer(self.status())

    async def _ask_guard(self) -> Snapshot | None:
        """Have the guardian reach the rig beside this engine; report a wire that takes one connection only, and return
        a snapshot that was read after it."""
        alone = await self._guard.probe()
        for why in alone:
            self._recorder.announce(
                "WARN",
                f"the guardian cannot have a connection of its own beside the run's ({why}); where this process hangs "
                "it is ended first, and the guardian takes its place",
            )
        return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S) if alone else None

    def _go_on(self, resumption: Resumption) -> End | None:
        """Begin a new segment of a run that was cut: lead the rig back, unless there is nothing left to run."""
        was, period_s = resumption.position, self._clock.period_s
        self._parts.first_tick = self._at.tick = resumption.first_tick(period_s)
        gap_s = self._at.time_s - was.time_s
        self._recorder.segment(was.number, gap_s, was.aim_tick, resumption.reason)
        if self._at.profile_s >= self._profile.duration_s:
            self._machine.take(RunEvent.START, "nothing is left of the profile")
            return RunEvent.COMPLETE, "the profile was over"
        points, rig = self._connection.points, self._parts.rig
        self._work.restore = ThermalRestore(rig, points, self._profile, self._at.profile_s, was.aim, resumption.rule)
        self._supervisor.restoring = True
        return None

    async def _first_snapshot(self) -> Snapshot:
        """Wait until every point has been heard of, letting a lockstep rig step so that its frames come."""
        if not self._options.lockstep:
            return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)
        await self._clock.start()
        for _ in range(3):
            await self._clock.next_tick()
            await self._connection.wait_for_device_time(self._clock.now(), FIRST_SAMPLE_TIMEOUT_S)
        return await self._connection.first_complete(FIRST_SAMPLE_TIMEOUT_S)
