"""Course of one case of the fault campaign: start of the run, its fault, the consequences, and perhaps a resume."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from drivers.virtual.devices import last_moment
from hil.bench.faults import judge
from hil.bench.faults.kinds import MENDED_AFTER_S, FaultKind
from hil.bench.faults.places import take_places_out
from hil.bench.faults.plan import FaultCase, case_of
from hil.bench.faults.rig import STALE_LIMIT_S
from hil.bench.faults.stage import Stage, last_line, last_words, set_stage, spawn
from hil.bench.faults.verdict import REACT_S, FaultResult, Strike, judged
from hil.bench.measure import processes

START_S = 40.0
END_S = 30.0
RESUME_S = 150.0
"""Time for a resume, s: a run that goes on first stands still within its band for a minute."""
EARLY_S = (1.0, 8.0)
"""Earliest and latest strike of a fault at any instant after the command, s."""
EARLIEST_S, LATEST_S = 0.5, 2.5
"""Earliest and latest strike of another fault after the heater went on, s."""
AFTER_S = 1.5
"""Time for which a wire stays broken after the heater is off, unless the run ends before, s."""
STALL_S = 0.4
"""Wait of rig, harness or relays for a processor, s, from which a machine cannot keep a limit of a second. The rig's
own log shows its wait, the kernel that of the harness (/proc/PID/schedstat), our clock that of the relays.
"""


async def run_case(
    kind_name: str, number: int, seed: int, *, thorough: bool = False, resume: bool = True, retries: int = 2
) -> FaultResult:
    """Run one case; repeat it if the fault preceded the run, or if the machine stood still and a requirement broke.

    A case whose run was not resumed is not repeated. `thorough` waits for record and report. With `resume` such a case,
    a case that struck at any instant and a resumable one of two faults continue with `hil resume`.
    """
    for attempt in range(1, retries + 2):
        generator = random.Random(f"{seed} {kind_name} {number}")
        with tempfile.TemporaryDirectory(prefix="hil-fault-") as folder:
            try:
                result = await _attempt(kind_name, number, seed, generator, Path(folder), thorough, resume, attempt)
            except Exception as error:  # A case that fails to run is no reason to skip the others.
                result = FaultResult(kind_name, number, failures=[f"not carried out: {type(error).__name__}: {error}"])
        result.attempts = attempt
        take_places_out(result)
        if result.struck and (not result.failures or result.stall_s < STALL_S or result.resumed is False):
            break
    return result


async def _attempt(
    name: str, number: int, seed: int, generator: random.Random, place: Path, thorough: bool, resume: bool, attempt: int
) -> FaultResult:
    case, result = case_of(name, number, seed), FaultResult(name, number)
    onset_s = generator.uniform(9.0, 12.0) + 8.0 * (attempt - 1)
    async with set_stage(case, generator, place, onset_s) as stage:
        strikes = await _strike(stage, case, onset_s, result)
        if not strikes:
            return result
        await _follow(stage, case, result, thorough)
        journal = await asyncio.to_thread(judged, result, case, stage, strikes)
        # A resumed run stands still for a minute, so of kinds with equal consequences only the first one resumes.
        if resume and case.resumable and (thorough or case.early or len(case.kinds) > 1) and not result.failures:
            await _go_on(stage, result, bool(journal.ticks), onset_s + case.apart_s + MENDED_AFTER_S)
        if result.failures:
            result.reason = (result.reason + " | " + last_words(place))[:600]
    return result


async def _strike(stage: Stage, case: FaultCase, onset_s: float, result: FaultResult) -> list[Strike]:
    """Let the faults occur; return each with its wall time, or nothing if there was no run."""
    if case.early:
        await stage.until(lambda: not stage.harness.running, stage.generator.uniform(*EARLY_S))
    elif not await stage.until(lambda: stage.heater_W > 100.0 or not stage.harness.running, START_S):
        result.failures.append("the run did not start within its time")
        return []
    if not stage.harness.running and not case.early:
        result.struck = False
        result.failures.append(f"the run ended before the fault: {last_words(stage.truth.parent)}")
        return []
    stage.waited_s = processes.waited_s(stage.pid)
    if any(kind.act is None for kind in case.kinds):
        if not await stage.until(lambda: _after(stage, onset_s) is not None, START_S):
            result.failures.append("the rig stood still")
            return []
    elif not case.early:
        await stage.until(lambda: False, stage.generator.uniform(EARLIEST_S, LATEST_S))
        stage.look()
    return await _occur(stage, case, onset_s)


async def _occur(stage: Stage, case: FaultCase, onset_s: float) -> list[Strike]:
    """Let the first fault occur now and the second `apart_s` later, if the run still exists."""
    strikes: list[Strike] = []
    acting: list[asyncio.Task[None]] = []
    for number, kind in enumerate(case.kinds):
        at_s = onset_s + number * case.apart_s
        if kind.act is None:
            await stage.until(lambda at_s=at_s: _after(stage, at_s) is not None, START_S)  # type: ignore[misc]
            strikes.append((kind, _after(stage, at_s) or time.time()))
            continue
        if number:
            await stage.until(lambda: not stage.harness.running, case.apart_s)
            if not stage.harness.running:
                break
        strikes.append((kind, time.time()))
        acting.append(asyncio.create_task(_act(kind, stage)))
    await asyncio.gather(*acting)
    return strikes


async def _act(kind: FaultKind, stage: Stage) -> None:
    assert kind.act is not None
    with contextlib.suppress(ProcessLookupError):  # The other fault has ended it meanwhile.
        await kind.act(stage)


def _after(stage: Stage, rig_s: float) -> float | None:
    now = last_moment(stage.truth)
    if now is None or now.rig_s < rig_s - 1e-6:
        return None
    return next((moment.wall_s for moment in stage.moments() if moment.rig_s >= rig_s - 1e-6), None)


async def _follow(stage: Stage, case: FaultCase, result: FaultResult, thorough: bool) -> None:
    """Wait until the heater is off and the run has ended; end a run that goes on by SIGTERM."""
    harness, began, ending = stage.harness, time.monotonic(), case.ending

    def over() -> bool:
        if ending == "killed":
            return stage.heater_W == 0.0
        return not harness.running or harness.ended_as() != ""

    if ending in ("rides", "either"):
        # Long enough for any limit to be exceeded by a fault of this length.
        await stage.until(over, STALE_LIMIT_S + (4.0 if ending == "either" else 0.0))
        if harness.running and harness.ended_as() == "":
            result.ended = "rode through"
            if stage.heater_W <= 0.0:
                result.failures.append("the run goes on and nothing heats")
            stage.asked_s = time.time()
            os.kill(stage.pid, signal.SIGTERM)
            await _ended(stage, result)
            await _leave(stage, thorough, result)
            return
    # A repaired wire lets a run end that could not reach its rig; nothing may heat because of it.
    if await stage.until(lambda: over() or stage.heater_W == 0.0, STALE_LIMIT_S + END_S) and harness.running:
        await stage.until(over, AFTER_S)
        await stage.plc.restore()
        await stage.can.restore()
    if not await stage.until(over, END_S):
        result.failures.append(f"the run has not ended {time.monotonic() - began:.0f} s after the fault")
    if ending == "killed":
        await stage.until(lambda: False, 0.3)
        result.ended = "killed"
    await _leave(stage, thorough and ending != "killed", result)


async def _ended(stage: Stage, result: FaultResult) -> None:
    harness, asked_s = stage.harness, stage.asked_s
    if not await stage.until(lambda: not harness.running or harness.ended_as() != "", END_S):
        result.failures.append(f"the run did not end within {END_S:g} s of SIGTERM")
        return
    safe = judge.safe_since(stage.moments(), asked_s)
    if safe is None or safe - asked_s > REACT_S:
        after = "never" if safe is None else f"{safe - asked_s:.2f} s"
        result.failures.append(f"the heater was off {after} after SIGTERM")


async def _go_on(stage: Stage, result: FaultResult, begun: bool, mended_s: float) -> None:
    """Try `hil resume` after the fault: it continues, or refuses with a reason."""
    folder = stage.harness.folder()
    if folder is None:
        return
    await stage.mend(mended_s)
    command = [sys.executable, "-m", "hil", "resume", str(stage.seen_here(folder)), "--no-viewer", "--band", "3"]
    if stage.disk is not None:
        command = stage.disk.command(command)
    stage.harness.process = await spawn(command, stage.truth.parent)
    if begun:
        result.resumed = await _resumed(stage, result)
    else:
        # A run that was over before its first sample cannot be continued.
        ended = await stage.until(lambda: not stage.harness.running, START_S)
        said = last_line(stage.truth.parent)
        result.refused = ended and stage.harness.process.returncode != 0 and "start a new run" in said
        if not result.refused:
            result.failures.append(f"a resume that cannot be was not refused with a remedy: {said}")
    if "Traceback" in stage.harness.said():
        result.failures.append("a resume ended with a traceback instead of a sentence")
    await stage.harness.finish()


async def _resumed(stage: Stage, result: FaultResult) -> bool:
    """Return True if the run went on, with all acknowledged samples."""
    before, asked_s = dict(stage.seen.rows), time.time()

    def running() -> bool:
        return any(wall_s > asked_s and target == "running" for wall_s, target in judge.read_states(stage.look()))

    went_on = await stage.until(lambda: running() or not stage.harness.running, RESUME_S)
    went_on = went_on and stage.harness.running
    if not went_on:
        result.failures.append(f"not resumed within {RESUME_S:g} s")
    else:
        stage.asked_s = time.time()
        os.kill(stage.pid, signal.SIGTERM)
        await _ended(stage, result)
    await stage.harness.finish()
    journal = await asyncio.to_thread(lambda: judge.read_journal(stage.look()))
    gone = judge.lost(stage.seen, journal)
    if gone or not set(before) <= set(journal.ticks) or not journal.sound:
        result.failures.append(f"{gone} acknowledged samples lost by resuming")
    result.lost += gone
    wrong = await asyncio.to_thread(judge.wrong_values, journal, stage.moments())
    if wrong:
        result.failures.append(f"{len(wrong)} wrong values recorded as good by resuming: {wrong[0]}")
    result.wrong += wrong
    return went_on


async def _leave(stage: Stage, thorough: bool, result: FaultResult) -> None:
    """Let the run write its record and report if they are checked, otherwise end it at once."""
    harness = stage.harness
    if thorough and harness.running and not await stage.until(lambda: not harness.running, 60.0):
        result.failures.append("record and report were not written within 60 s")
    await harness.finish()
    stage.look()
