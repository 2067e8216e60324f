"""Run in its folder: journal, rig, engine, and the files that are derived at its end."""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
from collections.abc import Callable, Coroutine
from dataclasses import asdict, dataclass
from typing import Any

from drivers.rig import RigConnection, rig_signals
from drivers.virtual import taking_turns
from hil.alarms import META_KEY, as_document, definitions_of
from hil.diagnosis import Reply
from hil.journal import ENDED, Header, JournalError, JournalWriter, State
from hil.run.engine import Engine, LockstepClock, Options, Outcome, RunSignals, Status, interrupted, serving, stopping
from hil.run.locks import RigClaim
from hil.run.restore import Resumption, clocks_recorded, restore_calibrators
from hil.run.session.derived_files import REPORT, REVIEW, DerivedFiles, derive_files
from hil.run.session.manifest import RUN_UID, end_entries
from hil.run.session.request import RunInputs, RunRequest
from hil.run.session.rig_time import rig_and_clock
from hil.run.session.services import (
    Publishers,
    guard_of,
    prepare_pages,
    run_review,
    start_diagnosis,
    start_tracking,
)
from hil.run_folder import RunFolder
from hil.testing import live_watch
from hil.tracking import STATIC, Adoption, Comparison, Tracking


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a finished run.

    Attributes
    ----------
    folder
        Folder with all its files.
    outcome
        End of the engine.
    comparison
        Errors of the twins, None without a twin.
    duration_s
        Rig time, s.
    wall_s
        Wall time, s.
    viewed
        True where a viewer followed the run.
    diagnosis
        Diagnosis of the whole run, None without one.
    adoption
        Revision of the twin from the network's proposals, None without one.
    gates
        Sentence about the proposals that the network's gates held.
    derived
        Files of the run.
    """

    folder: RunFolder
    outcome: Outcome
    comparison: Comparison | None
    duration_s: float
    wall_s: float
    viewed: bool
    diagnosis: Reply | None = None
    adoption: Adoption | None = None
    gates: str | None = None
    derived: DerivedFiles | None = None

    @property
    def exit_code(self) -> int:
        """Exit code of the command: 0 where the run was in order and has all its files (see `DerivedFiles`)."""
        in_order = self.outcome.in_order
        return int(not in_order) if self.derived is None else self.derived.exit_code(in_order)


@dataclass(frozen=True, slots=True)
class PreparedRun:
    """Run that is ready to begin or, with `resumption`, to continue."""

    folder: RunFolder
    manifest: dict[str, Any]
    request: RunRequest
    ready: RunInputs
    claim: RigClaim
    tracking: Tracking | None
    observer: Callable[[Status], None] | None
    announce: Callable[[str], None]
    signals: RunSignals
    resumption: Resumption | None = None


async def carry_out(run: PreparedRun) -> RunResult:
    """Return the result of the run; an error that ends it is written to its manifest and raised again."""
    try:
        return await _run_in(run)
    except BaseException as error:
        failed = {"exit_status": "faulted", "reason": f"{type(error).__name__}: {error}"}
        # A full disk must not hide the cause.
        with contextlib.suppress(OSError):
            run.folder.write_manifest(run.manifest | failed)
        raise


def _opened(folder: RunFolder, header: Header, *, again: bool) -> JournalWriter:
    """Return the journal of a run; raises JournalError where its file cannot be written."""
    try:
        return JournalWriter(folder.journal, header, again=again)
    except sqlite3.Error as error:
        raise JournalError(
            f"{folder.journal} cannot be written ({error}); make room, or allow larger files (ulimit -f)"
        ) from error


async def _run_in(run: PreparedRun) -> RunResult:
    """Return the result of the run, carried out in its folder."""
    folder, manifest, request, ready = run.folder, run.manifest, run.request, run.ready
    tracking, announce, resumption = run.tracking, run.announce, run.resumption
    loop = asyncio.get_running_loop()
    async with contextlib.AsyncExitStack() as stack:
        header = _header(ready, () if tracking is None else tracking.calibrators)
        journal = _opened(folder, header, again=resumption is not None)
        stack.callback(_closed, journal)
        journal.put_meta(RUN_UID, manifest["uid"])
        journal.put_meta(META_KEY, as_document(definitions_of(ready.rig)))
        await stack.enter_async_context(clocks_recorded(journal))
        if resumption is not None and State(resumption.position.state) not in ENDED:
            was = resumption.position
            journal.state(was.tick, was.time_s, was.profile_s, was.state, "cut", State.IDLE.value, resumption.reason)
        if tracking is not None and resumption is not None:
            tracking = await _restored(stack, run, tracking, journal)
        began = loop.time()
        starts_s = 0.0 if resumption is None else resumption.first_tick(ready.rig.period_s) * ready.rig.period_s
        rig, clock = await stack.enter_async_context(rig_and_clock(request, ready.rig, starts_s, announce))
        connection = RigConnection(rig, clock.now)
        if ready.network is not None and resumption is None:
            parameters = ready.network.parameters
            journal.put_meta("commissioned", {name: p.value for name, p in parameters.items()})
            journal.put_meta("parameter_units", {name: p.unit for name, p in parameters.items()})
        if tracking is not None:
            tracking.attach(journal)
            for name, why in tracking.left_out.items() if resumption is None else ():
                journal.event(0, 0.0, "INFO", f"{name} is left out: {why}")
        live = start_diagnosis(request, folder, journal, announce)
        if live is not None:
            stack.push_async_callback(live.close)
        review = await stack.enter_async_context(run_review(request, folder, announce))
        engine = Engine(
            connection,
            clock,
            ready.profile,
            journal,
            Options(
                publisher=Publishers(tuple(p for p in (tracking, live) if p is not None)),
                observer=run.observer,
                told=announce,
                residuals=dict if tracking is None else tracking.off_K,
                lockstep=request.mode == "lockstep",
                resumption=resumption,
                rearm=request.rearm,
                guard=guard_of(request, folder, run.claim, rig),
                watch=live_watch(ready.test, ready.rig, announce),
            ),
        )
        async with serving(folder.control, engine, announce):
            rig_pids = clock.pids if isinstance(clock, LockstepClock) else ()
            turns = taking_turns(rig_pids) if rig_pids else contextlib.nullcontext()
            with stopping(engine, run.signals), turns:
                outcome = await engine.run()
        run.claim.release()  # what follows needs no rig
        # The diagnosis reads the samples alone: it need not wait until the calibrators have caught up.
        last = None if live is None else asyncio.ensure_future(live.finish(folder.diagnosis))
        if last is not None:
            stack.callback(last.cancel)
            if request.report:
                await prepare_pages(review)
        comparison = None if tracking is None else await _unless_interrupted(tracking.finish(), run)
        outcome.problems.extend(tracking.failures if tracking is not None else ())
        wall_s = loop.time() - began
        reply = None
        if live is not None and last is not None:
            announce("diagnosing the whole run (Ctrl-C skips it)")
            with interrupted(live.give_up, run.signals):
                reply = await last
        manifest |= end_entries(folder, manifest, outcome, resumption, wall_s) | {
            "errors_K": None if comparison is None else asdict(comparison.errors),
            "bands": None if comparison is None else comparison.bands,
            "parameters": None if comparison is None else comparison.parameters,
            "parameter_units": None if comparison is None else comparison.units,
            "diagnosis": None if reply is None or reply.found is None else reply.found.verdict,
        }
        journal.put_meta("exit_status", outcome.status)
        journal.put_meta("errors", manifest["errors_K"])
        try:
            journal.commit()
        except JournalError as error:  # a lost journal must not prevent the other files
            manifest["problems"] = [*manifest["problems"], str(error)]
    manifest.pop("adoption", None)  # from an earlier segment
    # Pages that an earlier segment left would lack this one, so they are made anew.
    pages = () if request.report else ((REVIEW, folder.review), (REPORT, folder.report))
    not_made = {name for name, path in pages if not path.is_file()}
    if review.complete:
        not_made.add(REVIEW)
    derived = derive_files(folder, manifest, announce, there=not_made, signals=run.signals)
    duration_s = outcome.ticks * clock.period_s
    return RunResult(
        derived.folder,
        outcome,
        comparison,
        duration_s,
        wall_s,
        review.shown,
        reply,
        derived.adopted,
        derived.gates,
        derived,
    )


async def _unless_interrupted(work: Coroutine[Any, Any, Comparison | None], run: PreparedRun) -> Comparison | None:
    """Return the last results of the calibrators; None where an operator asks for the end, which keeps the record."""
    asked = asyncio.Event()
    with interrupted(asked.set, run.signals):
        last, stop = asyncio.ensure_future(work), asyncio.ensure_future(asked.wait())
        await asyncio.wait({last, stop}, return_when=asyncio.FIRST_COMPLETED)
        stop.cancel()
        if last.done():
            return last.result()
        last.cancel()
        await asyncio.gather(last, stop, return_exceptions=True)
    run.announce("the calibrators were not waited for: their last windows are missing")
    return None


def _closed(journal: JournalWriter) -> None:
    """Close the journal; errors of writing have been reported by then."""
    with contextlib.suppress(JournalError):
        journal.close()


async def _restored(
    stack: contextlib.AsyncExitStack, run: PreparedRun, tracking: Tracking, journal: JournalWriter
) -> Tracking:
    """Return the calibrators with their former state; where that fails they start anew, which is reported."""
    assert run.resumption is not None
    was = run.resumption.position
    run.announce("restoring the calibrators from the journal")
    await restore_calibrators(tracking, journal, run.folder.journal, run.announce)
    if not tracking.failures:
        return tracking
    warning = f"the calibrators could not be restored and start anew: {'; '.join(tracking.failures)}"
    run.announce(warning)
    journal.event(was.tick, was.time_s, "WARN", warning)
    anew = await start_tracking(run.request, run.ready)
    assert anew is not None
    stack.push_async_callback(anew.close)
    return anew


def _header(ready: RunInputs, calibrators: tuple[str, ...]) -> Header:
    network = ready.network
    return Header(
        signals=rig_signals(ready.rig),
        twin_sensors={} if network is None else dict(network.sensor_columns),
        twin_names=() if network is None else (STATIC, *calibrators),
        profile=ready.profile.name,
        duration_s=ready.profile.duration_s,
        period_s=ready.rig.period_s,
        noise_K={} if network is None else dict(zip(network.sensor_names, network.sigma.tolist(), strict=True)),
    )
