"""One run from its files to its folder: validate, start what is needed, run the engine, derive record and report."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import asdict, dataclass, replace
from typing import Any

from drivers.rig.connection import RigConnection
from drivers.rig_file.model import Rig
from drivers.signals.points import Signal
from hil.diagnosis.healthy_record import commissioned_on, copy_record
from hil.diagnosis.live import LiveConfig, LiveDiagnosis, Reply
from hil.guardian.client import Guard, Guardian, NoGuard
from hil.journal.states import ENDED, State
from hil.journal.writer import Header, JournalError, JournalWriter
from hil.run.engine.control_socket import serving
from hil.run.engine.engine import Engine, Outcome, Status
from hil.run.engine.recording import Publisher
from hil.run.engine.signals import RunSignals, interrupted, stopping
from hil.run.locks.rig_lock import RigClaim, claimed
from hil.run.outputs.setpoints import bind
from hil.run.restore.calibrators import restore
from hil.run.restore.gap_evidence import clocks_noted
from hil.run.restore.resumption import Resumption
from hil.run.restore.thermal_restore import SoakRule, unled
from hil.run.session.derived_files import REVIEW, RUN_UID, Derived, derive_files
from hil.run.session.interrupted_run import questioned
from hil.run.session.manifest import ended, files_of, how_it_stopped, settings_of
from hil.run.session.output_queue import queued_output
from hil.run.session.request import Prepared, RunRequest, prepare, tracking_config
from hil.run.session.rig_time import rig_and_clock, speed_of
from hil.run.session.terminal import hours
from hil.run_folder.folder import RunFolder, create_run_folder, new_manifest, require_room
from hil.tracking import adoption
from hil.tracking.adoption import Adoption
from hil.tracking.process import Tracking
from hil.tracking.twins import STATIC, Comparison, Twins
from twin.revisions import chain


@dataclass(frozen=True, slots=True)
class RunResult:
    """A finished run: its folder, how it ended, the twins side by side, how fast it went, what the diagnosis said, what
    became of parameters that the network's gates let through, and what these gates held, as a sentence."""

    folder: RunFolder
    outcome: Outcome
    comparison: Comparison | None
    duration_s: float
    wall_s: float
    viewed: bool
    diagnosis: Reply | None = None
    adoption: Adoption | None = None
    gates: str | None = None
    derived: Derived | None = None

    @property
    def exit_code(self) -> int:
        """Exit code of the command: 0 where the run was in order and every file of it is there (see `Derived`)."""
        in_order = self.outcome.in_order
        return int(not in_order) if self.derived is None else self.derived.exit_code(in_order)


async def run_session(
    request: RunRequest,
    observer: Callable[[Status], None] | None = None,
    announce: Callable[[str], None] = lambda text: None,
    signals: RunSignals | None = None,
) -> RunResult:
    """Run `request` to its end and derive everything in its folder.

    `signals` takes the process's signals over when the run begins; who gives it says for how long.

    Raises what `prepare` and `Twins` raise, RigBusyError where another run drives the rig, and RigLockError where that
    cannot be known.
    """
    ready = prepare(request)
    async with contextlib.AsyncExitStack() as stack:
        signals = signals or stack.enter_context(RunSignals())
        observer, announce = stack.enter_context(queued_output(observer, announce))
        for note in ready.notes:
            announce(note)
        # Before anything is made or moved: a rig or a calibrator that cannot be had is refused here.
        claim = stack.enter_context(claimed(_shared_rig(request, ready), announce, no_lock=request.no_lock))
        tracking = await _start_tracking(request, ready)
        if tracking is not None:
            stack.push_async_callback(tracking.close)
            for name, why in tracking.left_out.items():
                announce(f"{name} is left out: {why}")
        folder = create_run_folder(request.runs, request.profile.stem, _ticks(ready))
        stack.enter_context(folder.owned())
        claim.tell(folder.path)
        manifest = new_manifest(files_of(request, ready), **settings_of(request, tracking))
        folder.write_manifest(manifest)
        if ready.twin is not None:
            folder.keep_twin([entry.path for entry in chain(ready.twin)])
            copy_record(ready.twin, folder.path)
        return await _guarded(_Run(folder, manifest, request, ready, claim, tracking, observer, announce, signals))


async def resume_session(
    folder: RunFolder,
    request_of: Callable[[dict[str, Any]], RunRequest],
    rule: SoakRule,
    observer: Callable[[Status], None] | None = None,
    announce: Callable[[str], None] = lambda text: None,
    gap_s: float | None = None,
    before_moving: Callable[[RunRequest], None] = lambda request: None,
    signals: RunSignals | None = None,
) -> RunResult:
    """Go on with the run in `folder` that was cut, as `request_of` its manifest, and derive everything anew.

    `gap_s` states how long the run has been down where clocks do not agree on it, s. `before_moving` is told what will
    be driven, once nothing refuses to go on.

    Raises what `run_session` raises, and RunFolderError where the run still goes on or cannot go on.
    """
    async with contextlib.AsyncExitStack() as stack:
        signals = signals or stack.enter_context(RunSignals())
        observer, announce = stack.enter_context(queued_output(observer, announce))
        stack.enter_context(folder.owned())
        manifest = folder.read_manifest()
        request = request_of(manifest)
        ready = prepare(request)
        claim = stack.enter_context(claimed(_shared_rig(request, ready), announce, no_lock=request.no_lock))
        claim.tell(folder.path)
        was = questioned(folder, gap_s, announce)
        require_room(folder, _ticks(ready))
        before_moving(request)
        folder.control.unlink(missing_ok=True)
        tracking = await _start_tracking(request, ready)
        if tracking is not None:
            stack.push_async_callback(tracking.close)
        reason = how_it_stopped(manifest, was)
        announce(f"{reason} at {hours(was.profile_s)} of {hours(ready.profile.duration_s)} of the profile")
        if was.aim and (why := unled(ready.rig, bind(ready.rig, ready.profile.columns))) is not None:
            announce(why)
        resumption = Resumption(was, rule, reason, speed_of(request, ready.rig))
        manifest |= {"exit_status": "running", "reason": "", "ended": None}
        folder.write_manifest(manifest)
        return await _guarded(
            _Run(folder, manifest, request, ready, claim, tracking, observer, announce, signals, resumption)
        )


def _shared_rig(request: RunRequest, ready: Prepared) -> Rig | None:
    """The rig that others could drive, too; None for one that the run starts itself."""
    return None if request.virtual else ready.rig


def _ticks(ready: Prepared) -> int:
    return int(ready.profile.duration_s / ready.rig.period_s) + 1


def check_session(request: RunRequest) -> Prepared:
    """Everything that `run_session` checks, and nothing moved; raises the same. What is left out is among the notes."""
    ready = prepare(request)
    config = tracking_config(request, ready, ())
    if config is None:
        return ready
    left_out = Twins(config).left_out
    return replace(ready, notes=(*ready.notes, *(f"{name} is left out: {why}" for name, why in left_out.items())))


@dataclass(frozen=True, slots=True)
class _Run:
    """Everything about a run that is ready to begin, or with `resumption` to go on."""

    folder: RunFolder
    manifest: dict[str, Any]
    request: RunRequest
    ready: Prepared
    claim: RigClaim
    tracking: Tracking | None
    observer: Callable[[Status], None] | None
    announce: Callable[[str], None]
    signals: RunSignals
    resumption: Resumption | None = None


async def _guarded(run: _Run) -> RunResult:
    """The run, and a manifest that says so where it cannot even end in order."""
    try:
        return await _run_in(run)
    except BaseException as error:
        failed = {"exit_status": "faulted", "reason": f"{type(error).__name__}: {error}"}
        # A disk that is full must not hide why the run ended.
        with contextlib.suppress(OSError):
            run.folder.write_manifest(run.manifest | failed)
        raise


async def _run_in(run: _Run) -> RunResult:
    """The run itself, in its folder."""
    folder, manifest, request, ready = run.folder, run.manifest, run.request, run.ready
    tracking, announce, resumption = run.tracking, run.announce, run.resumption
    loop = asyncio.get_running_loop()
    async with contextlib.AsyncExitStack() as stack:
        header = _header(ready, () if tracking is None else tracking.calibrators)
        journal = JournalWriter(folder.journal, header, again=resumption is not None)
        stack.callback(_closed, journal)
        journal.put_meta(RUN_UID, manifest["uid"])
        await stack.enter_async_context(clocks_noted(journal))
        if resumption is not None and State(resumption.standing.state) not in ENDED:
            was = resumption.standing
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
        live = _start_diagnosis(request, folder, journal, announce)
        if live is not None:
            stack.push_async_callback(live.close)
        follower = await stack.enter_async_context(_live_review(request, folder, announce))
        engine = Engine(
            connection,
            clock,
            ready.profile,
            journal,
            publisher=_Publishers(tuple(p for p in (tracking, live) if p is not None)),
            observer=run.observer,
            told=announce,
            residuals=dict if tracking is None else tracking.off_K,
            lockstep=request.mode == "lockstep",
            resumption=resumption,
            rearm=request.rearm,
            guard=_guard(request, run, rig),
        )
        async with serving(folder.control, engine, announce):
            with stopping(engine, run.signals):
                outcome = await engine.run()
        run.claim.release()  # what follows needs no rig
        comparison = None if tracking is None else await _unless_interrupted(tracking.finish(), run)
        outcome.problems.extend(tracking.failures if tracking is not None else ())
        wall_s = loop.time() - began
        told = None
        if live is not None:
            announce("diagnosing the whole run (Ctrl-C skips it)")
            with interrupted(live.give_up, run.signals):
                told = await live.finish(folder.diagnosis)
        manifest |= ended(folder, manifest, outcome, resumption, wall_s) | {
            "errors_K": None if comparison is None else asdict(comparison.errors),
            "bands": None if comparison is None else comparison.bands,
            "parameters": None if comparison is None else comparison.parameters,
            "diagnosis": None if told is None or told.found is None else told.found.verdict,
        }
        journal.put_meta("exit_status", outcome.status)
        journal.put_meta("errors", manifest["errors_K"])
        try:
            journal.commit()
        except JournalError as error:  # a journal that is lost must not keep the rest from being made
            manifest["problems"] = [*manifest["problems"], str(error)]
    manifest.pop("adoption", None)  # of a segment before this one
    there = (REVIEW,) if follower and folder.review.is_file() else ()
    derived = derive_files(folder, manifest, announce, there=there, signals=run.signals)
    duration_s = outcome.ticks * clock.period_s
    return RunResult(
        derived.folder, outcome, comparison, duration_s, wall_s, follower, told, derived.adopted, derived.gates, derived
    )


async def _unless_interrupted(work: Coroutine[Any, Any, Comparison | None], run: _Run) -> Comparison | None:
    """Return what the calibrators have left to say; None where an impatient operator asks for the end, which must not
    cost the record."""
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
    """Close the journal; what keeps it from being written has been reported by then."""
    with contextlib.suppress(JournalError):
        journal.close()


def _guard(request: RunRequest, run: _Run, rig: Rig) -> Guard:
    """Return the guardian of a rig that goes on without this process; a virtual one of the run's own ends with it."""
    if request.virtual or request.control is not None or not request.guardian:
        return NoGuard()
    return Guardian(rig, run.folder.path / "guardian.log", run.claim.descriptors)


async def _restored(
    stack: contextlib.AsyncExitStack, run: _Run, tracking: Tracking, journal: JournalWriter
) -> Tracking:
    """The calibrators with all that they knew; where that fails they start anew, and that is said."""
    assert run.resumption is not None
    was = run.resumption.standing
    run.announce("restoring the calibrators from the journal")
    await restore(tracking, journal, run.folder.journal, run.announce)
    if not tracking.failures:
        return tracking
    said = f"the calibrators could not be restored and start anew: {'; '.join(tracking.failures)}"
    run.announce(said)
    journal.event(was.tick, was.time_s, "WARN", said)
    anew = await _start_tracking(run.request, run.ready)
    assert anew is not None
    stack.push_async_callback(anew.close)
    return anew


def _header(ready: Prepared, calibrators: tuple[str, ...]) -> Header:
    network = ready.network
    return Header(
        signals=_signals(ready.rig),
        twin_sensors={} if network is None else dict(network.sensor_columns),
        twin_names=() if network is None else (STATIC, *calibrators),
        profile=ready.profile.name,
        duration_s=ready.profile.duration_s,
        period_s=ready.rig.period_s,
        noise_K={} if network is None else dict(zip(network.sensor_names, network.sigma.tolist(), strict=True)),
    )


def _signals(rig: Rig) -> tuple[Signal, ...]:
    """What is polled, then what is commanded."""
    return RigConnection(rig, lambda: 0.0).signals + tuple(point.as_signal() for point in rig.setpoints)


async def _start_tracking(request: RunRequest, ready: Prepared) -> Tracking | None:
    config = tracking_config(request, ready, tuple(signal.column for signal in _signals(ready.rig)))
    if config is None or ready.network is None:
        return None
    advise = None if request.network_mode == "shadow" else adoption.Advice(ready.network).news
    lockstep, watched = request.mode == "lockstep", any(spec.kind == "residual" for spec in ready.rig.interlock)
    tracking = Tracking(config, wait=lockstep, in_step=lockstep and watched, advise=advise)
    await tracking.start()
    return tracking


@dataclass(frozen=True, slots=True)
class _Publishers:
    """Hands every block to several publishers."""

    each: tuple[Publisher, ...]

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        for publisher in self.each:
            await publisher.publish(ticks, time_s, rows)


def _start_diagnosis(
    request: RunRequest, folder: RunFolder, journal: JournalWriter, announce: Callable[[str], None]
) -> LiveDiagnosis | None:
    if request.diagnose_s is None:
        return None
    healthy = request.healthy or commissioned_on(folder.twin).path
    config = LiveConfig(folder.twin, folder.journal, healthy, request.diagnose_s, request.adopt)
    live = LiveDiagnosis(config, journal, announce)
    live.start()
    return live


@contextlib.asynccontextmanager
async def _live_review(request: RunRequest, folder: RunFolder, announce: Callable[[str], None]) -> AsyncIterator[bool]:
    """A viewer that follows the journal, where there is a display or one was asked for; yields whether it runs."""
    from hil.review import has_display

    wanted = has_display() if request.viewer is None else request.viewer
    if not wanted:
        yield False
        return
    from hil.review import start_follower

    announce("opening Rerun")
    follower = await asyncio.to_thread(start_follower, folder.journal, folder.review)
    try:
        yield True
    finally:
        await asyncio.to_thread(follower.finish)
