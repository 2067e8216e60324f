"""Course of one chaos case: start of the run, attack, its end, and perhaps a resume."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from hil.bench.chaos.acts import NotPossibleError
from hil.bench.chaos.kinds import ChaosKind, gravest
from hil.bench.chaos.plan import ChaosCase
from hil.bench.chaos.stage import ChaosStage, environment, set_chaos_stage, unstepped
from hil.bench.chaos.verdict import LIMIT_S, ChaosResult, Strike, is_of_the_machine, judged
from hil.bench.faults import STALL_S, judge, last_words, take_places_out, without_places
from hil.bench.measure import processes

START_S = 60.0
EARLY_S = (0.5, 8.0)
"""Earliest and latest early attack after the command, s."""
STRIKE_S = (0.3, 4.0)
"""Earliest and latest other attack after the heater went on, s."""
RIDE_S = (1.5, 7.0)
"""Time from the attack to the end of a run that goes on, s: it writes to its terminal every 5 s."""
END_S = 45.0
"""Time for a run to end, s: a run on a device that does not obey tries for 30 s."""
LEAVE_S = 60.0
STUCK_S = 10.0
"""Time after the end of the run, or after the heater is off, until a stuck terminal is released, s."""
CUT_S = 6.0
"""Time after its limit at which a heater that is still on counts as never cut, s."""
SETTLED_S = 1.0
"""Observation of the heater after everything is over, s: nothing may switch it on again."""
NOBODY_LEFT_S = 8.0
"""Time after the end by which every process of a run is gone, s."""
RESUME_S = 60.0
SAMPLES_AGE_S = 2.0
"""Largest age of the newest sample of a run that goes on, s: it commits twice a second."""


async def run_chaos_case(case: ChaosCase, seed: int, *, resume: bool = False, retries: int = 2) -> ChaosResult:
    """Run one case; repeat it if the machine stood still and a requirement was broken, or if no heater was on to
    attack.

    With `resume`, `hil resume` is tried on what is left.
    """
    for attempt in range(1, retries + 2):
        generator = random.Random(f"{seed} {case.name} {case.index}")
        result = ChaosResult(list(case.names), case.index, case.watchdog, case.early)
        with tempfile.TemporaryDirectory(prefix="hil-chaos-", ignore_cleanup_errors=True) as folder:
            try:
                async with set_chaos_stage(case.needs, case.watchdog, generator, Path(folder)) as stage:
                    await _attempt(case, stage, result, resume)
            except NotPossibleError as error:
                result.left_out = str(error)
            except Exception as error:  # A case that fails to run is no reason to skip the others.
                result.failures.append(f"not carried out: {type(error).__name__}: {error}")
        result.attempts = attempt
        take_places_out(result)
        stalled = result.stall_s >= STALL_S and is_of_the_machine(result) and result.resumed is not False
        if result.struck and not (result.failures and stalled):
            break
    return result


async def _attempt(case: ChaosCase, stage: ChaosStage, result: ChaosResult, resume: bool) -> None:
    strikes = await _strike(case, stage, result)
    if not strikes:
        return
    await _follow(case, stage, result, strikes)
    stage.undo_all()
    journal = await asyncio.to_thread(judged, result, case, stage, strikes)
    if resume and not result.failures and not stage.destroyed and result.ending != "lies":
        await _resume(stage, result, bool(journal.ticks))
    if result.failures:
        result.reason = (result.reason + " | " + last_words(stage.place))[:900]


async def _strike(case: ChaosCase, stage: ChaosStage, result: ChaosResult) -> list[Strike]:
    """Attack; return each kind with its wall time, nothing if there was no run to attack."""
    draw = stage.generator
    if case.early:
        await stage.until(lambda: not stage.harness.running, draw.uniform(*EARLY_S))
    elif not await stage.until(lambda: stage.heater_W > 100.0 or not stage.harness.running, START_S):
        result.failures.append("the run did not start within its time")
        return []
    if not case.early:
        await stage.until(lambda: False, draw.uniform(*STRIKE_S))
    if not stage.harness.running and not case.early:
        result.struck = False
        result.failures.append(f"the run ended before the attack: {last_words(stage.place)}")
        return []
    stage.waited_s = processes.waited_s(stage.pid)
    strikes: list[Strike] = []
    acting: list[asyncio.Task[None]] = []
    for number, kind in enumerate(case.kinds):
        if number:
            await stage.until(lambda: _is_over(stage), case.apart_s)
            if _is_over(stage):
                break
        strikes.append((kind, time.time()))
        acting.append(asyncio.create_task(_act(kind, stage)))
        await asyncio.sleep(0)
    await stage.until(lambda: all(task.done() for task in acting), START_S)
    for task in acting:
        if not task.done():
            task.cancel()
    await asyncio.gather(*acting)
    return strikes


async def _act(kind: ChaosKind, stage: ChaosStage) -> None:
    try:
        await kind.act(stage)
    except NotPossibleError:
        raise
    except Exception:
        await asyncio.sleep(0.2)
        if not _is_over(stage):  # Otherwise the other attack has ended the target of this one.
            raise


def _is_over(stage: ChaosStage) -> bool:
    return not stage.harness.running or stage.harness.ended_as() != ""


async def _follow(case: ChaosCase, stage: ChaosStage, result: ChaosResult, strikes: list[Strike]) -> None:
    """Wait until the heater is off and the run has ended; end a run that goes on."""
    ending = gravest(kind.ending for kind, _ in strikes)
    gone = [kind.ending for kind, _ in strikes if kind.ending in ("frozen", "killed", "unguarded")]
    if gone:
        result.ended = gravest(gone)
        await stage.until(lambda: stage.heater_W == 0.0, LIMIT_S + CUT_S)
        stage.release_all()
    elif ending != "stops":
        await stage.until(lambda: _is_over(stage), stage.generator.uniform(*RIDE_S))
        is_ending = ending == "either" and stage.heater_W == 0.0  # It cannot report it, or still waits for the meters.
        if not _is_over(stage) and not is_ending:
            result.ended = "rode through"
            _check_ride(case, stage, result, ending)
            stage.look()
            stage.asked_s = time.time()
            with contextlib.suppress(ProcessLookupError):
                os.kill(stage.pid, next((k.last for k in case.kinds if k.last != signal.SIGTERM), signal.SIGTERM))
        elif ending == "rides":
            result.failures.append("the run ended of an attack that it has to ride through")
    if result.ended in ("", "rode through"):
        await stage.until(lambda: stage.heater_W == 0.0, LIMIT_S)
        stage.release_all()
        if stage.terminal is not None and not await stage.until(lambda: _is_over(stage), STUCK_S):
            stage.terminal.let_go()  # A full disk leaves only the terminal to report the end of the run.
        if not await stage.until(lambda: _is_over(stage), END_S):
            result.failures.append(f"the run has not ended within {END_S:g} s")
        stage.waited_s = math.inf  # Slowness from now on is harmless.
        await _leave(stage, result)
        result.ended = result.ended or stage.harness.ended_as() or "ended"
    await stage.until(lambda: False, SETTLED_S)
    stage.code = stage.harness.process.returncode
    stage.look()
    await stage.harness.finish()
    # The guardian of a device that does not obey goes on trying, also where the rig has cut the heater.
    obeys = gravest(kind.ending for kind in case.kinds) != "lies"
    if obeys and stage.heater_W == 0.0 and not await stage.until(lambda: not _left(stage), NOBODY_LEFT_S):
        words = ", ".join(sorted({_said(pid) for pid in _left(stage)}))
        result.failures.append(f"left running {NOBODY_LEFT_S:g} s after the end: {words}")
    stage.look()


def _left(stage: ChaosStage) -> list[int]:
    """Return the processes that still run although the harness has ended.

    What the case itself has stopped does not count, nor does a guardian that states in its log that the rig is not safe
    and that it goes on: on a device that does not obey it has to.
    """
    trying = [pid for pid in stage.guardians() if judge.tries_on(pid)]
    return [pid for pid in stage.descendants() if not processes.is_stopped(pid) and pid not in trying]


def _said(pid: int) -> str:
    return without_places(processes.command(pid).replace(b"\0", b" ").decode(errors="replace"))[:80]


def _check_ride(case: ChaosCase, stage: ChaosStage, result: ChaosResult, ending: str) -> None:
    """Note missing heating or recording of a run that goes on."""
    if ending in ("rides", "either") and stage.heater_W <= 0.0:
        result.failures.append("the run goes on and nothing heats")
    if "journal locked" in case.names or stage.destroyed or ending != "rides":
        return
    newest = stage.seen.rows[max(stage.seen.rows)][0] if stage.seen.rows else 0.0
    age_s = time.time() - unstepped(newest, stage)
    if age_s > SAMPLES_AGE_S:
        result.failures.append(f"the run goes on, and its newest sample is {age_s:.1f} s old")


async def _leave(stage: ChaosStage, result: ChaosResult) -> None:
    """Let the run write its record and report; a stuck terminal is released after a while."""
    if stage.terminal is not None and stage.terminal.shape != "files":
        await stage.until(lambda: not stage.harness.running, STUCK_S)
        stage.terminal.let_go()
    if stage.harness.running and not await stage.until(lambda: not stage.harness.running, LEAVE_S):
        result.failures.append(f"the process has not ended {LEAVE_S:g} s after its run")


async def _resume(stage: ChaosStage, result: ChaosResult, begun: bool) -> None:
    """Try `hil resume` after the attack: it restores the thermal state, or refuses with a reason."""
    folder = stage.harness.folder()
    if folder is None:
        return
    stage.clear_up()
    await stage.plc.restore()
    if stage.disk is not None:
        stage.disk.clear()
    if stage.device is not None:
        stage.device.mode = "honest"
    command = [sys.executable, "-m", "hil", "resume", str(stage.seen_here(folder)), "--no-viewer", "--band", "3"]
    if stage.disk is not None:
        command = stage.disk.command(command)
    began = time.time()
    log = stage.place / "err.txt"
    said_before = log.stat().st_size
    with log.open("ab") as err:
        stage.harness.process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=err,
            stderr=err,
            cwd=stage.place,
            env=environment(stage.marker, stage.clock),
            start_new_session=True,
        )

    def led_back() -> bool:
        rows = judge.read_states(stage.look())
        return any(unstepped(at_s, stage) > began and target in ("restoring", "running") for at_s, target in rows)

    went_on = await stage.until(lambda: led_back() or not stage.harness.running, RESUME_S)
    went_on = went_on and stage.harness.running
    said = log.read_bytes()[said_before:].decode(errors="replace")
    if not begun:
        result.resumed = not stage.harness.running and "start a new run" in said
        if not result.resumed:
            result.failures.append(f"a resume without a first sample was not refused with a remedy: {said[-200:]}")
    else:
        result.resumed = went_on
        if not went_on:
            result.failures.append(f"not resumed: {said[-300:]}")
        elif not await _stopped_safe(stage):
            result.failures.append(f"the resumed run was not safe within {LIMIT_S:g} s of SIGTERM")
    if "Traceback" in said:
        result.failures.append("a resume ended with a traceback instead of a sentence")
    await stage.harness.finish()
    lost = judge.lost(stage.seen, await asyncio.to_thread(lambda: judge.read_journal(stage.look())))
    if lost:
        result.lost += lost
        result.failures.append(f"{lost} acknowledged samples lost by resuming")


async def _stopped_safe(stage: ChaosStage) -> bool:
    asked_s = time.time()
    os.kill(stage.pid, signal.SIGTERM)
    await stage.until(lambda: _is_over(stage), END_S)
    safe = judge.safe_since(stage.moments(), asked_s)
    return safe is not None and safe - asked_s <= LIMIT_S
