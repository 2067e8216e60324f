"""One tick of a run: read, judge, obey, write, record."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from drivers.rig_file import Point
from drivers.signals import DeviceExceptionError, DriverError, Quality, Snapshot
from hil.journal import HEATED, WAITING, RunEvent, State
from hil.run.engine.attended import Finished, attended
from hil.run.engine.components import Components
from hil.run.engine.recording import with_commands
from hil.run.engine.supervisor import End
from hil.run.outputs import Descent, GoodReadings, ReadbackDeviations, bind
from hil.run.restore import ThermalRestore

FIRST_SAMPLE_TIMEOUT_S = 10.0
"""Longest wait in lockstep for the frames of a step that was granted, s."""
PAUSED_S = 1.0
"""Ticks that are further apart than this, and than two periods, are reported as a pause of process or machine, s."""


def age(snapshot: Snapshot, points: tuple[Point, ...], seconds: float) -> None:
    """Mark good values as stale that may be `seconds` old, where that is more than their points allow."""
    for index, point in enumerate(points):
        if seconds > point.stale_after_s and snapshot.quality[index] == Quality.GOOD:
            snapshot.quality[index] = int(Quality.STALE)


class TickWork:
    """Work of one tick after the other. `snapshot` holds the latest readings, `restore` the thermal restore while one
    goes on, and `restore_s` how long it has taken, s. `show` is called at the end of each tick."""

    def __init__(self, parts: Components, show: Callable[[], None]) -> None:
        self.snapshot: Snapshot | None = None
        self.restore: ThermalRestore | None = None
        self.restore_s = 0.0
        self.deviations = ReadbackDeviations(parts.rig)
        self._parts = parts
        self._show = show
        self._connection, self._clock, self._profile = parts.connection, parts.clock, parts.profile
        self._machine, self._supervisor = parts.machine, parts.supervisor
        self._outputs, self._readback, self._guard = parts.outputs, parts.readback, parts.guard
        self._at, self._recorder = parts.at, parts.recorder
        self._lockstep = parts.options.lockstep
        self._residuals = parts.options.residuals
        self._targets = [point.name for point in bind(parts.rig, parts.profile.columns)]
        self._setpoint_meters = GoodReadings(parts.connection.points, self.deviations.meters)
        self.descent = Descent(parts.rig, parts.limits, parts.clock.period_s)
        self._not_safe_since_s: float | None = None
        self._soonest_stale_s = min((point.stale_after_s for point in parts.connection.points), default=math.inf)

    async def interruptible(self) -> End | None:
        """Do one tick; a request to stop or to pause ends one that waits for the next tick of a slow rig, or for a
        device that does not answer."""
        done = await attended(self.one(), self._supervisor.urgent, self._parts.trouble)
        if isinstance(done, Finished):
            return done.result
        if done.trouble is not None:
            return RunEvent.FAULT, done.trouble
        if self._supervisor.stop is None:
            await self._obey_now()
        return self._supervisor.stop

    async def _obey_now(self) -> None:
        """Obey a request to make safe between two ticks, and answer it when the safe values are read back."""
        self._parts.expect()
        self._supervisor.obey_urgent()
        await self._put_out(0.0)
        await self._answer()

    async def one(self) -> End | None:
        """Do one tick; return how the run ends, where it does. Raises DriverError or JournalError."""
        clock, machine, at, parts = self._clock, self._machine, self._at, self._parts
        parts.expect()
        if machine.state in WAITING:
            await clock.wait()
        last, was, was_restoring = at.tick, machine.state, self._supervisor.restoring
        at.tick = parts.first_tick + await clock.next_tick()
        parts.expect()
        if self._lockstep:
            await self._connection.wait_for_device_time(clock.now(), FIRST_SAMPLE_TIMEOUT_S)
        began = time.perf_counter()
        asked_s = clock.now()
        snapshot = self.snapshot = await self._connection.read()
        now, wall_s = clock.now(), time.time()
        # A process that was stopped while it read has read at any time since: the row is of now, old values are stale.
        at.tick = parts.first_tick + clock.current_tick()
        passed = at.tick - last
        if now - asked_s > self._soonest_stale_s:
            age(snapshot, self._connection.points, now - asked_s)
        self._notice_pause(passed * clock.period_s)
        # A machine without descriptors cannot open the link again: waiting for it would only heat on.
        why = self._guard.failure() or (self._connection.exhausted if snapshot.faults else None)
        if why is not None:
            return RunEvent.FAULT, why
        await self._readback.look(snapshot, self._outputs.values, now)
        ended = self._supervisor.step(snapshot, now, self._outputs.values, self._residuals())
        if ended is None and self.restore is not None:
            ended = self._lead_back(self.restore, snapshot, now)
        goes_on = was is State.RUNNING and machine.state is State.RUNNING
        if goes_on:
            at.profile_ticks += passed
            self.deviations.tick(self._outputs.values, self._setpoint_meters.of(snapshot))
        over = machine.state is State.RUNNING and at.profile_s >= self._profile.duration_s
        if ended is None:
            await self._put_out(clock.period_s)
            await self._answer()
            ended = (RunEvent.COMPLETE, "the profile is over") if over else self._never_safe(now)
            if ended is None:
                clock.release()
        if parts.watch is not None:
            row = with_commands(snapshot, self._outputs.values, self._outputs.unknown)
            if goes_on:
                parts.watch.tick(at.profile_s, *row)
            else:
                as_profile = was is State.RUNNING or (was is State.HELD and not was_restoring)
                parts.watch.standing(at.profile_s, *row, as_profile)
        self._recorder.sample(snapshot, self._outputs.values, now, wall_s, began, self._outputs.unknown)
        self._show()
        await self._recorder.publish_if_due()
        return ended

    def _notice_pause(self, passed_s: float) -> None:
        """Record a gap between two ticks; beyond `abort_after_s` an interlock trips as well."""
        if self._lockstep or passed_s <= max(PAUSED_S, 2.0 * self._clock.period_s):
            return
        self._recorder.event(
            "WARN",
            f"no tick for {passed_s:.1f} s: this process or its machine was paused, or a device kept it waiting; "
            "values from before the gap are stale",
        )

    def _lead_back(self, restore: ThermalRestore, snapshot: Snapshot, now_s: float) -> End | None:
        """Do one tick of thermal restore: go on with the profile once the rig is back, end a run that takes too long
        to get there."""
        restore.update(snapshot, now_s, stopped=self._machine.state in WAITING)
        self.restore_s = restore.elapsed_s
        if restore.reached and self._machine.state is State.RESTORING:
            self.restore, self._supervisor.restoring = None, False
            self._machine.take(
                RunEvent.START, f"the rig is back where it was, after {self.restore_s:.0f} s of thermal restore"
            )
        return None if restore.failure is None else (RunEvent.FAIL, restore.failure)

    async def _answer(self) -> None:
        """Answer the requests that were obeyed: the state, and outside `HEATED` what the rig holds and its meters
        read."""
        if not self._supervisor.owes_answers:
            return
        state = self._machine.state
        said = f"{state} at {self._at.profile_s:g} s of the profile"
        if state in HEATED:
            self._supervisor.answer(said)
        elif self._outputs.safe_held:
            self._supervisor.answer(f"{said}; safe values read back{await self.meters_now()}")
        else:
            why, patience_s = self._outputs.unconfirmed, self._parts.rig.abort_after_s
            self._supervisor.fall_short(
                f"{said}, but NOT confirmed safe ({why}); it is tried again for {patience_s:g} s, then the run ends "
                "and the guardian acts"
            )

    def _never_safe(self, now_s: float) -> End | None:
        """Return the end of a run whose rig answers and has not confirmed its safe values for too long.

        While nothing is heard of the rig, the interlocks on its link count.
        """
        lost = self.snapshot is None or self.snapshot.faults
        if self._machine.state in HEATED or self._outputs.safe_held or lost:
            self._not_safe_since_s = None
            return None
        since_s = self._not_safe_since_s = now_s if self._not_safe_since_s is None else self._not_safe_since_s
        if now_s - since_s <= self._parts.rig.abort_after_s:
            return None
        return RunEvent.FAIL, f"not confirmed safe for {now_s - since_s:.1f} s: {self._outputs.unconfirmed}"

    async def meters_now(self) -> str:
        """Return what the heaters' meters read now, to go on with a sentence.

        A meter follows its heater within the time that the rig file declares: until then a reading is no contradiction.
        """
        rig, limits = self._parts.rig, self._parts.limits
        if not limits:
            return ""
        readings = self._parts.heater_meters.of(await self._connection.read())
        disobeyed = self.descent.stays(readings, self._clock.now())
        if disobeyed:
            return f", but {disobeyed}"
        said = []
        for limit in limits:
            value, unit = readings.get(limit.meter, math.nan), rig.get(limit.meter).unit
            if math.isnan(value):
                continue
            falls = f" and has {limit.within_s:g} s to come down to {limit.at_most:g} {unit}"
            said.append(f"{limit.meter} reads {value:.1f} {unit}" + (falls if abs(value) > limit.at_most else ""))
        return f", {', '.join(said)}" if said else ", but no meter can be read"

    async def _put_out(self, elapsed_s: float) -> None:
        """Write what the state asks for. A lost or garbled write is left to the interlocks of the next ticks and to the
        rig's watchdog; one that the device refuses ends the run, unless it is a safe value, which is tried again.

        An engine that may have been relieved by the guardian writes no heat before it knows."""
        state, before = self._machine.state, dict(self._outputs.values)
        try:
            if state not in HEATED:
                if not self._outputs.safe_held:
                    self.descent.clear()  # it counts from the read-back on
                readings = self._parts.heater_meters.of(self.snapshot)
                hot = self.descent.stays(readings, self._clock.now())
                await self._outputs.put_safe(arm=self._supervisor.arming, hot=hot)
            elif self._guard.may_heat():
                self.descent.clear()
                await self._outputs.move(self._wanted(), elapsed_s)
            else:
                self._recorder.event("WARN", "nothing was written on this tick: the guardian may have acted meanwhile")
        except DriverError as error:
            self._readback.not_confirmed()
            if state in HEATED and isinstance(error, DeviceExceptionError):
                raise
            self._recorder.event("WARN", str(error))
        if self._outputs.values != before:
            reason = {State.RUNNING: "profile", State.RESTORING: "restore"}.get(state, f"safe: {state}")
            self._recorder.written(before, self._outputs.values, reason)

    def _wanted(self) -> dict[str, float]:
        """Return the targets of the set-points; nothing where they stay."""
        if self._machine.state is State.RUNNING:
            return dict(zip(self._targets, self._profile.at(self._at.profile_s), strict=True))
        return self.restore.targets() if self._machine.state is State.RESTORING and self.restore is not None else {}
