"""Supervisor of a run: operators, interlocks and stop requests move the state table, once a tick.

Operators come first, interlocks have the last word. A trip ends the run, unless the rig file lets it wait for an
acknowledgement (`acknowledge_within_s`): then the run is paused, and nothing moves until the trip is acknowledged with
its cause gone, the rig armed again, and the run resumed. A trip during a thermal restore waits for nobody: the run can
be resumed again. Hold, pause and resume are obeyed there, too.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping

from drivers.rig_file import Point, Rig
from drivers.signals import Snapshot
from hil.journal import ACKNOWLEDGED, HEATED, RunEvent, State, StateMachine, Transition, next_state
from hil.run.engine.operator import URGENT, Desk, RefusedError, Request, Verb, event_of, refusal, unheard
from hil.run.interlocks import Interlocks, InterlockStatus, Residuals
from hil.run.outputs import ARMING_TICKS

SECOND_REQUEST_S = 1.0
"""A stop request that follows another within this time is its echo, s. A key that is held down repeats after at most
0.7 s, and a terminal and a supervisor may both pass on the same Ctrl-C."""

End = tuple[RunEvent, str]
"""COMPLETE, ABORT or FAIL, and why."""


class Supervisor:
    """State, interlocks and operators of one run; `log` is told every transition, `note` what else happens."""

    def __init__(
        self,
        rig: Rig,
        points: tuple[Point, ...],
        *,
        log: Callable[[Transition], None],
        note: Callable[[str, str], None],
    ) -> None:
        self.machine = StateMachine(log)
        self.interlocks = Interlocks(rig, points)
        self.hurried = False
        self.stopping = asyncio.Event()
        self.urgent = asyncio.Event()  # a request that must not wait for the next tick
        self.restoring = False  # whether a rig is led back to where a run was cut
        self._waits_s = rig.acknowledge_within_s
        self._suspends_s = rig.suspend_at_most_s
        self._suspended_s: float | None = None
        self._note = note
        self._desk = Desk()
        self._obeyed: list[Request] = []
        self._aborting: list[Request] = []
        self._acking: tuple[Request, int, tuple[str, ...]] | None = None
        self._trips: tuple[str, ...] = ()
        self._tripped_s = 0.0
        self._stop_reason: str | None = None
        self._stop_asked = 0.0

    @property
    def state(self) -> State:
        """Return the state of the run."""
        return self.machine.state

    @property
    def arming(self) -> bool:
        """Return whether a trip is being acknowledged, for which the rig is armed again."""
        return self._acking is not None

    @property
    def stop(self) -> End | None:
        """Return the end that was asked for, where one was."""
        return None if self._stop_reason is None else (RunEvent.ABORT, self._stop_reason)

    def request_stop(self, reason: str) -> None:
        """End the run at the next tick. A second request shortens the waits of making safe, and skips nothing.

        One that comes within `SECOND_REQUEST_S` of another is taken for its echo, see there.
        """
        self.stopping.set()
        self.urgent.set()
        now = time.monotonic()
        if self._stop_reason is None:
            self._stop_reason = reason
        elif now - self._stop_asked > SECOND_REQUEST_S:
            self.hurried = True
        self._stop_asked = now

    async def ask(self, verb: Verb, reason: str) -> str:
        """Have `verb` obeyed on the next tick; return the answer as a sentence. Raises RefusedError."""
        if verb is Verb.ABORT:
            self.request_stop(reason)
            request = Request(verb, reason, asyncio.get_running_loop().create_future())
            self._aborting.append(request)
            return await request.answer
        why_not = unheard(self.state)
        if why_not is not None:
            raise RefusedError(why_not)
        if verb in URGENT:
            self.urgent.set()
        return await self._desk.ask(verb, reason)

    def step(
        self, snapshot: Snapshot, now_s: float, commanded: Mapping[str, float], residuals: Residuals
    ) -> End | None:
        """Judge, obey and protect on one tick; return how the run ends, where it does."""
        judgement = self.interlocks.judge(snapshot, now_s, commanded, residuals)
        self._acknowledge()
        self._obey(self._desk.take(), judgement.trips)
        if self._stop_reason is None:
            self.urgent.clear()
        return self._protect(self.interlocks.standing(), now_s) or self._overdue(now_s) or self.stop

    @property
    def owes_answers(self) -> bool:
        """Return whether operators wait for the answers to their requests."""
        return bool(self._obeyed)

    @property
    def owes_end(self) -> bool:
        """Return whether operators wait to read that the run has ended safe."""
        return bool(self._aborting)

    def answer(self, said: str) -> None:
        """Answer the requests that were obeyed, now that the rig is written to."""
        for request in self._obeyed:
            request.done(said)
        self._obeyed.clear()

    def fall_short(self, said: str) -> None:
        """Answer the requests that were obeyed and have not had their effect yet."""
        for request in self._obeyed:
            request.refuse(said)
        self._obeyed.clear()

    def stopped(self, said: str) -> None:
        """Answer operators who asked for an end: what the rig holds and its meters read."""
        for request in self._aborting:
            request.done(said)
        self._aborting.clear()

    def close(self) -> None:
        """Refuse every request that still waits: the run has ended."""
        self.stopped(f"the run is {self.state}")
        acking = [] if self._acking is None else [self._acking[0]]
        for request in [*self._desk.take(), *self._obeyed, *acking]:
            request.refuse(f"the run is {self.state}")

    def obey_urgent(self) -> None:
        """Obey between two ticks what makes safe, and what was asked before that."""
        if self._stop_reason is None:
            self.urgent.clear()
        self._obey(self._desk.take_urgent(), self.interlocks.standing().trips)

    def _obey(self, requests: list[Request], trips: tuple[str, ...]) -> None:
        for request in requests:
            why_not = refusal(self.state, request.verb, self.interlocks.standing().trips, restoring=self.restoring)
            if why_not is not None:
                request.refuse(why_not)
            elif request.verb is Verb.ACK and self._acking is not None:
                request.refuse("an acknowledgement is under way; see `hil ctl status`")
            elif request.verb is Verb.ACK:
                self._acking = request, ARMING_TICKS, trips
            else:
                event = event_of(request.verb, restoring=self.restoring)
                if next_state(self.state, event) is not None:
                    self.machine.take(event, request.reason)
                self._obeyed.append(request)

    def _acknowledge(self) -> None:
        """Let go of trips whose causes are gone. The rig's own goes when it is armed again, which takes a tick."""
        if self._acking is None:
            return
        request, left, trips = self._acking
        stay = self.interlocks.acknowledge()
        self._acking = None if not stay or left == 0 else (request, left - 1, trips)
        if not stay:
            self._trips = ()
            self.machine.reason = f"{ACKNOWLEDGED} ({request.reason})"
            self._note("INFO", f"{self.machine.reason}: {'; '.join(trips)}")
            request.done(f"acknowledged; the run is {self.state}, `hil ctl resume` lets it go on")
        elif left == 0:
            self._note("WARN", f"acknowledgement refused ({request.reason}), still there: {'; '.join(stay)}")
            request.refuse(f"still there: {'; '.join(stay)}")

    def _overdue(self, now_s: float) -> End | None:
        """Return the end of a run that a warning has suspended for too long."""
        if self.state is not State.SUSPENDED:
            self._suspended_s = None
            return None
        self._suspended_s = now_s if self._suspended_s is None else self._suspended_s
        if self._suspends_s <= 0 or now_s - self._suspended_s <= self._suspends_s:
            return None
        why = "; ".join(self.interlocks.standing().warnings) or self.machine.reason
        return RunEvent.FAIL, f"{why}; suspended for longer than {self._suspends_s:g} s"

    def _protect(self, judgement: InterlockStatus, now_s: float) -> End | None:
        trips = judgement.trips
        if trips:
            said = trips[0] + (f" (and {len(trips) - 1} more)" if len(trips) > 1 else "")
            if self._waits_s <= 0 or self.restoring:
                return RunEvent.FAIL, said
            if not self._trips:
                self._tripped_s = now_s
            if set(trips) - set(self._trips):
                self.machine.take(RunEvent.TRIP, f"tripped: {said}")
            self._trips = trips
            if now_s - self._tripped_s > self._waits_s:
                return RunEvent.FAIL, f"{said}; not acknowledged within {self._waits_s:g} s"
        elif judgement.warnings and self.state in HEATED:
            self.machine.take(RunEvent.WARN, "; ".join(judgement.warnings))
        elif not judgement.warnings and self.state is State.SUSPENDED:
            self.machine.take(RunEvent.RESTORE if self.restoring else RunEvent.CLEAR, "all warnings are gone")
        return None
