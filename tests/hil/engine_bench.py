"""The real engine on the simulated rig, tick by tick, watched by something that knows nothing of interlocks."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import numpy as np

import hil.run.outputs.safing
from drivers.rig_file.model import Rig
from hil.guardian.client import Guard, NoGuard
from hil.journal.states import HEATED, UNTOUCHED, State
from hil.profile.load_profile import Profile
from hil.run.engine.components import Options
from hil.run.engine.engine import Engine
from hil.run.engine.operator import RefusedError, Verb
from hil.run.engine.status import Outcome
from hil.run.interlocks import Watch
from hil.run.restore.resumption import Resumption, RunPosition
from hil.run.restore.thermal_restore import RestoreRule
from tests.hil.simulated_rig import MemoryJournal, RigTime, SimulatedClock, SimulatedRig

WITHIN_S = 1.0
WATCHDOG_S = 10.0


def profile(duration_s: float = 600.0, power_W: float = 700.0) -> Profile:
    """Constant heat."""
    columns = ("heater_power_W", "pump_speed_pct", "fan_speed_pct")
    values = np.array([[power_W, 90.0, 70.0], [power_W, 90.0, 70.0]])
    return Profile("bench", np.array([0.0, duration_s]), columns, values)


def cut_at(profile_s: float, aim: dict[str, float], *, timeout_s: float = 600.0, gap_s: float = 100.0) -> Resumption:
    """How a run goes on that was cut at `profile_s`, with the rig at `aim`, `gap_s` ago."""
    tick = int(profile_s)
    standing = RunPosition(tick, profile_s, time.time() - gap_s, profile_s, "running", 2, tick, aim)
    return Resumption(standing, RestoreRule(1.0, timeout_s), "the run was cut while running")


class EngineBench:
    """One run, as a context manager; `violations` of the safety property, a sentence each."""

    def __init__(
        self,
        rig: Rig,
        duration_s: float = 600.0,
        resumption: Resumption | None = None,
        rearm: bool = False,
        watch: Watch | None = None,
        guard: Guard | None = None,
    ) -> None:
        self.told: list[str] = []
        self._restores = resumption is not None
        self.loop = asyncio.new_event_loop()
        self.rig = SimulatedRig(rig)
        self.clock = SimulatedClock(self.rig)
        self.journal = MemoryJournal()
        self.residuals: dict[tuple[str, str], float] = {}
        self.bug: Exception | None = None
        self.violations: list[str] = []
        self.visited: set[str] = set()
        self._answers: list[asyncio.Task[str]] = []
        self._unsafe_s = 0.0
        self._unreachable_s = 0.0
        self._time, hil.run.outputs.safing.time = hil.run.outputs.safing.time, RigTime(self.rig)  # type: ignore[attr-defined]
        safing = hil.run.outputs.safing
        self._waits = safing.RETRY_EVERY_S, safing.REOPENED_S
        safing.RETRY_EVERY_S = safing.REOPENED_S = 0.0
        connection: Any = self.rig
        journal: Any = self.journal
        self.engine = Engine(
            connection,
            self.clock,
            profile(duration_s),
            journal,
            Options(
                residuals=self._off,
                resumption=resumption,
                rearm=rearm,
                watch=watch,
                guard=guard or NoGuard(),
                announce=self.told.append,
            ),
        )
        self.rig.watch = self._look
        self.task = self.loop.create_task(self.engine.run())
        self._settle()

    def _off(self) -> dict[tuple[str, str], float]:
        if self.bug is not None:
            raise self.bug
        return self.residuals

    @property
    def state(self) -> str:
        return self.engine.state.value

    @property
    def outcome(self) -> Outcome:
        return self.task.result()

    def ticks(self, count: int = 1) -> None:
        """Grant ticks."""
        for _ in range(count):
            if self.task.done():
                return
            self.clock.granted.release()
            self._settle()
            trips = self.engine.status().trips
            self.visited.add(self.state)
            if trips and self.engine.state in HEATED:
                self.violations.append(f"{self.state} although {trips[0]}")

    def ask(self, verb: Verb) -> str:
        """Have a verb obeyed on the next tick; what the operator is told."""
        task = self.loop.create_task(self.engine.ask(verb, "by the test"))
        self._answers.append(task)
        self._settle(2)
        self.ticks()
        self._settle(2)
        if not task.done():
            return ""
        error = task.exception()
        assert error is None or isinstance(error, RefusedError), error
        return f"refused: {error}" if error is not None else task.result()

    def _settle(self, most: int = 5000) -> None:
        """Let the engine go on until it wants the next tick or has ended."""
        asked = self.clock.asked  # a tick that was granted runs before the first step of `until`

        async def until() -> None:
            for _ in range(most):
                await asyncio.sleep(0)
                if self.task.done() or self.clock.asked > asked:
                    break

        self.loop.run_until_complete(until())

    def _look(self, passed_s: float) -> None:
        """The safety property, judged whenever rig time goes on, on what reaches the heater."""
        state = self.engine.state
        restored = state is State.RESTORING and self._restores
        if state in {State.RUNNING, State.HELD} | UNTOUCHED or restored or self.rig.heater_W == 0.0:
            self._unsafe_s = self._unreachable_s = 0.0
            return
        if not self.rig.link or self.rig.loses_writes:
            self._unreachable_s += passed_s
            if self._unreachable_s > WATCHDOG_S + WITHIN_S:
                self.violations.append(f"{state}: {self.rig.heater_W:.0f} W long after the link was lost")
            return
        self._unsafe_s += passed_s
        if self._unsafe_s > WITHIN_S:
            self.violations.append(f"{state}: {self.rig.heater_W:.0f} W for {self._unsafe_s:g} s")

    def __enter__(self) -> EngineBench:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """End the run whatever it is at, and put back what was patched."""
        try:
            for _ in range(200):
                if self.task.done():
                    break
                self.engine.request_stop("the test is over")
                self.ticks()
            done = self.task.done()
            if not done:
                self.task.cancel()
            self.loop.run_until_complete(asyncio.gather(self.task, *self._answers, return_exceptions=True))
            assert done, "the engine did not end"
        finally:
            safing = hil.run.outputs.safing
            safing.time = self._time  # type: ignore[attr-defined]
            safing.RETRY_EVERY_S, safing.REOPENED_S = self._waits
            self.loop.close()
