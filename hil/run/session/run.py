"""Run in its folder: journal, rig, engine, and the files that are derived at its end."""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from drivers.rig import RigConnection, rig_signals
from drivers.virtual import taking_turns
from hil.alarms import META_KEY, as_document, definitions_of
from hil.diagnosis import LiveDiagnosis, Reply
from hil.journal import ENDED, Header, JournalError, JournalWriter, State
from hil.run.engine import (
    Clock,
    Engine,
    LockstepClock,
    Options,
    Outcome,
    RunSignals,
    Status,
    interrupted,
    serving,
    stopping,
)
from hil.run.locks import RigClaim
from hil.run.restore import Resumption, clocks_recorded, restore_calibrators
from hil.run.session.derived_files import REPORT, REVIEW, DerivedFiles, derive_files
from hil.run.session.manifest import END_OF_RUN, RUN_UID, end_entries, twin_entries
from hil.run.session.request import RunInputs, RunRequest
from hil.run.session.rig_time import rig_and_clock
from hil.run.session.services import (
    Publishers,
    RunReview,
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
        return self._code(self.outcome.in_order)

    def exit_code_of_test(self, document: dict[str, Any]) -> int:
        """Return the exit code of a test with the checked `verdict.json`: 0 where every limit passed.

        The run must be in order, or have ended safe by a trip that a limit asks for.
        """
        from hil.testing import is_wanted_trip

        outcome = self.outcome
        tripped = outcome.status == "faulted" and outcome.safe and not outcome.away and is_wanted_trip(document)
        return self._code(outcome.in_order or tripped) or int(document["verdict"] != "pass")

    def _code(self, in_order: bool) -> int:
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


@dataclass(slots=True)
class _LiveRun:
    """Parts of a run while its rig is connected: engine with its clock, services, and loop time at the start, s."""

    journal: JournalWriter
    engine: Engine
    clock: Clock
    tracking: Tracking | None
    diagnosis: LiveDiagnosis | None
    review: RunReview
    began_s: float


@dataclass(frozen=True, slots=True)
class _LastResults:
    """Results that are complete only after the last tick; `wall_s` without the last diagnosis."""

    comparison: Comparison | None
    reply: Reply | None
    wall_s: float


async def _run_in(run: PreparedRun) -> RunResult:
    """Return the result of the run, carried out in its folder."""
    folder, manifest = run.folder, run.manifest
    async with contextlib.AsyncExitStack() as stack:
        journal = await _begun_journal(stack, run)
        live = await _started(stack, run, journal)
        outcome = await _replayed(run, live)
        run.claim.release()  # what follows needs no rig
        # A kill from here on must not lose how the run ended.
        spent_s = asyncio.get_running_loop().time() - live.began_s
        journal.put_meta(END_OF_RUN, end_entries(folder, manifest, outcome, run.resumption, spent_s))
        last = await _last_results(stack, run, live, outcome)
        manifest |= end_entries(folder, manifest, outcome, run.resumption, last.wall_s) | _result_entries(last)
        journal.put_meta("exit_status", outcome.status)
        journal.put_meta("errors", manifest["errors_K"])
        try:
            journal.commit()
        except JournalError as error:  # a lost journal must not prevent the other files
            manifest["problems"] = [*manifest["problems"], str(error)]
    manifest.pop("adoption", None)  # from an earlier segment
    derived = derive_files(
        folder, manifest, run.announce, omitted=_omitted_pages(run, live.review), signals=run.signals
    )
    return RunResult(
        derived.folder,
        outcome,
        last.comparison,
        outcome.ticks * live.clock.period_s,
        last.wall_s,
        live.review.shown,
        last.reply,
        derived.adopted,
        derived.gates,
        derived,
    )


async def _begun_journal(stack: contextlib.AsyncExitStack, run: PreparedRun) -> JournalWriter:
    """Return the open journal of a run, with its identity and alarms and, of a resumed one, the cut."""
    resumption = run.resumption
    header = _header(run.ready, () if run.tracking is None else run.tracking.calibrators)
    journal = _opened(run.folder, header, again=resumption is not None)
    stack.callback(_closed, journal)
    journal.put_meta(RUN_UID, run.manifest["uid"])
    journal.put_meta(META_KEY, as_document(definitions_of(run.ready.rig)))
    journal.put_meta(END_OF_RUN, None)
    await stack.enter_async_context(clocks_recorded(journal))
    if resumption is not None and State(resumption.position.state) not in ENDED:
        was = resumption.position
        journal.state(was.tick, was.time_s, was.profile_s, was.state, "cut", State.IDLE.value, resumption.reason)
    return journal


async def _started(stack: contextlib.AsyncExitStack, run: PreparedRun, journal: JournalWriter) -> _LiveRun:
    """Return the engine of a run, with calibrators, rig, live diagnosis and review started; `stack` closes them."""
    folder, request, ready, resumption = run.folder, run.request, run.ready, run.resumption
    tracking, announce = run.tracking, run.announce
    if tracking is not None and resumption is not None:
        tracking = await _restored(stack, run, tracking, journal)
    began_s = asyncio.get_running_loop().time()
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
    diagnosis = start_diagnosis(request, folder, journal, announce)
    if diagnosis is not None:
        stack.push_async_callback(diagnosis.close)
    review = await stack.enter_async_context(run_review(request, folder, announce))
    options = Options(
        publisher=Publishers(tuple(p for p in (tracking, diagnosis) if p is not None)),
        observer=run.observer,
        announce=announce,
        residuals=dict if tracking is None else tracking.off_K,
        lockstep=request.mode == "lockstep",
        resumption=resumption,
        rearm=request.rearm,
        guard=guard_of(request, folder, run.claim, rig),
        watch=live_watch(ready.test, ready.rig, announce),
    )
    engine = Engine(connection, clock, ready.profile, journal, options)
    return _LiveRun(journal, engine, clock, tracking, diagnosis, review, began_s)


async def _replayed(run: PreparedRun, live: _LiveRun) -> Outcome:
    """Return the end of the engine's run, which operators steer and signals stop."""
    async with serving(run.folder.control, live.engine, run.announce):
        rig_pids = live.clock.pids if isinstance(live.clock, LockstepClock) else ()
        turns = taking_turns(rig_pids) if rig_pids else contextlib.nullcontext()
        with stopping(live.engine, run.signals), turns:
            return await live.engine.run()


async def _last_results(
    stack: contextlib.AsyncExitStack, run: PreparedRun, live: _LiveRun, outcome: Outcome
) -> _LastResults:
    """Return the results of calibrators and diagnosis over the whole run; failed calibrators become problems of it."""
    # The diagnosis reads the samples alone: it need not wait until the calibrators have caught up.
    last = None if live.diagnosis is None else asyncio.ensure_future(live.diagnosis.finish(run.folder.diagnosis))
    if last is not None:
        stack.callback(last.cancel)
        if run.request.report:
            await prepare_pages(live.review)
    tracking = live.tracking
    comparison = None if tracking is None else await _unless_interrupted(tracking.finish(), run)
    outcome.problems.extend(tracking.failures if tracking is not None else ())
    wall_s = asyncio.get_running_loop().time() - live.began_s
    # Nor must a kill in the last diagnosis, which takes minutes, lose the errors of the twins.
    end = end_entries(run.folder, run.manifest, outcome, run.resumption, wall_s)
    live.journal.put_meta(END_OF_RUN, end | twin_entries(comparison))
    reply = None
    if live.diagnosis is not None and last is not None:
        run.announce("diagnosing the whole run (Ctrl-C skips it)")
        with interrupted(live.diagnosis.give_up, run.signals):
            reply = await last
    return _LastResults(comparison, reply, wall_s)


def _result_entries(last: _LastResults) -> dict[str, Any]:
    """Return the entries of `run.json` about the twins and the diagnosis."""
    reply = last.reply
    return twin_entries(last.comparison) | {
        "diagnosis": None if reply is None or reply.found is None else reply.found.verdict
    }


def _omitted_pages(run: PreparedRun, review: RunReview) -> set[str]:
    """Return the pages not to make: the review that was written live and, without a report, those that do not exist.

    Pages that an earlier segment left would lack this one, so they are made anew.
    """
    pages = () if run.request.report else ((REVIEW, run.folder.review), (REPORT, run.folder.report))
    omitted = {name for name, path in pages if not path.is_file()}
    return omitted | {REVIEW} if review.complete else omitted


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
