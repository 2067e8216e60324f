"""Ending of a run: the rig is made safe whatever interrupts that, and what is not safe is reported."""

from __future__ import annotations

from hil.journal import ENDED, HEATED, UNTOUCHED, RunEvent, State, TransitionError
from hil.run.engine.components import Components
from hil.run.engine.status import Outcome
from hil.run.engine.tick import TickWork
from hil.run.outputs import Meanwhile, Safed, attempt_s, make_safe, still_hot, write_safe

INTERRUPTED_AT_MOST = 100
"""So often making safe is begun again after whatever interrupted it."""


class Ending:
    """Way of one run from any state with outputs to its end, and the answer whether the rig is safe."""

    def __init__(self, parts: Components, work: TickWork) -> None:
        self._parts = parts
        self._work = work
        self._made_safe: Safed | None = None

    def not_safe(self) -> str:
        """Return what contradicts a state with safe outputs; empty where nothing does, and in every other state."""
        parts, state, done = self._parts, self._parts.machine.state, self._made_safe
        if state in HEATED or state in UNTOUCHED:
            return ""
        if done is not None:
            return done.problem if not done.safe else ""
        hot = still_hot(parts.rig, parts.limits, parts.heater_meters.of(self._work.snapshot))
        return hot or ("" if parts.outputs.safe_held else "the safe values are not read back yet")

    async def safely(self, event: RunEvent, reason: str, outcome: Outcome) -> BaseException | None:
        """Make the rig safe whatever interrupts that, and take the state along; return what interrupted it.

        A cancelled task, a signal or a lack of memory may hit any line here: making safe is begun again until it has
        come to its end. What still fails then is left to the guardian and to the rig's own watchdog.
        """
        machine, guard = self._parts.machine, self._parts.guard
        interrupted: BaseException | None = None
        for _ in range(INTERRUPTED_AT_MOST):
            try:
                if not outcome.safe:
                    within_s = attempt_s(self._parts.rig)
                    problem = await write_safe(self._parts.connection, self._parts.outputs.safe_values, within_s)
                    if problem:
                        guard.act()
                    await self._answer_stopped(problem)
                if machine.state not in ENDED | {State.FINISHING}:
                    machine.take(event, reason)
                outcome.safe = await self._make_safe(outcome)
                machine.take(event, reason)
            except TransitionError as error:
                event, reason, interrupted = RunEvent.FAIL, str(error), interrupted or error
            except BaseException as error:
                interrupted = interrupted or error
            if machine.state in ENDED:
                return interrupted
        guard.act()
        return interrupted

    async def _answer_stopped(self, problem: str) -> None:
        """Answer operators who asked for the end, now that the rig was told and asked."""
        supervisor = self._parts.supervisor
        if not supervisor.owes_end:
            return
        if problem:
            supervisor.stopped(f"NOT confirmed safe yet, trying again: {problem}")
        else:
            supervisor.stopped(f"safe values read back{await self._work.meters_now()}; the run ends")

    async def _make_safe(self, outcome: Outcome) -> bool:
        """Make the rig safe, record how that went, and return whether it worked."""
        parts = self._parts
        safe = parts.outputs.safe_values
        result = await make_safe(
            parts.connection,
            safe,
            heartbeat=parts.outputs.heartbeat,
            advance=parts.step,
            period_s=parts.step_s,
            hurried=lambda: parts.supervisor.hurried,
            meanwhile=Meanwhile(
                progress=parts.expect,
                failed=self._guard_has_made_safe,
                stays=lambda readings: self._work.descent.stays(readings, parts.clock.now()),
                contested=lambda: parts.readback.contested,
            ),
        )
        self._made_safe = result
        listed = ", ".join(f"{name} {value:g} {parts.rig.get(name).unit}" for name, value in safe.items())
        acted, note = parts.guard.acted, parts.recorder.event
        if not result.written:
            watchdog = parts.rig.heartbeat is not None and parts.rig.heartbeat.watchdog is not None
            rest = "its own watchdog has to cut the heater" if watchdog else "it has no watchdog that is known here"
            text = f"the rig could not be made safe from here ({result.problem}); {rest}: look at it now"
            note("ERROR", text)
            outcome.problems.append(text)
        elif result.hot:
            text = f"NOT SAFE: safe values are held by the rig ({listed}), but {result.hot}; look at it now"
            note("ERROR", text)
            outcome.problems.append(text)
            outcome.away = result.hot
        elif not result.followed:
            note("WARN", f"safe values are held by the rig ({listed}), but {result.problem}")
            outcome.problems.append(result.problem)
            outcome.away = result.problem
        else:
            by = "" if acted is None or not acted.safe else f"; the guardian had made it so ({acted.reason})"
            is_measured = any(parts.rig.get(name).readback is not None for name in safe)
            seen = "and the measured values have followed" if is_measured else "and no point measures what they move"
            stood = self._work.descent.not_obeyed() if parts.rig.heartbeat is not None else ""
            if stood:
                outcome.disobeyed = (
                    f"a heater did not obey when it was switched off ({stood}): it went off only after the heartbeat "
                    "was withheld, by the rig's own watchdog; repair it before the next run"
                )
                note("ERROR", f"safe values are held by the rig ({listed}), but {outcome.disobeyed}")
            else:
                note("INFO", f"safe: {listed}; read back, {seen}{by}")
        return result.safe

    def _guard_has_made_safe(self) -> bool:
        """Ask the guardian to act, after an attempt of this engine that failed; return whether it has made the rig
        safe."""
        guard = self._parts.guard
        guard.act()
        guard.failure()
        return guard.acted is not None and guard.acted.safe
