"""One run from its files to its folder: validate, start what is needed, run the engine, derive record and report."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import shutil
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from drivers.rig import RigConnection
from drivers.rigfile import ModbusTcpBus, Rig
from hil import adoption
from hil.adoption import Adoption
from hil.clock import Clock, LockstepClock, MonotonicClock
from hil.control import serving
from hil.engine import Engine, Outcome, Publisher, Status
from hil.journal import Header, JournalReader, JournalWriter
from hil.live_diagnosis import LiveConfig, LiveDiagnosis, Reply
from hil.record import export_record, read_record
from hil.run_folder import RunFolder, create_run_folder, new_manifest
from hil.run_request import Prepared, RunRequest, prepare, tracking_config
from hil.signals import interrupted, stopping
from hil.tracking import STATIC, Comparison, Proposed, Twins
from hil.tracking_process import Tracking

HICCUP_S = 0.25
"""Wall time that a busy machine may lose now and then: in scaled time it must not look like a lost sensor."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """A finished run: its folder, how it ended, the twins side by side, how fast it went, what the diagnosis said, what
    became of parameters that the network's gates let through."""

    folder: RunFolder
    outcome: Outcome
    comparison: Comparison | None
    duration_s: float
    wall_s: float
    viewed: bool
    diagnosis: Reply | None = None
    adoption: Adoption | None = None


async def run_session(
    request: RunRequest,
    observer: Callable[[Status], None] | None = None,
    announce: Callable[[str], None] = lambda text: None,
) -> RunResult:
    """Run `request` to its end and derive everything in its folder; raises what `prepare` and `Twins` raise."""
    ready = prepare(request)
    for note in ready.notes:
        announce(note)
    async with contextlib.AsyncExitStack() as stack:
        # Before anything is made or moved: a calibrator that cannot be had is refused here.
        tracking = await _start_tracking(request, ready)
        if tracking is not None:
            stack.push_async_callback(tracking.close)
            for name, why in tracking.left_out.items():
                announce(f"{name} is left out: {why}")
        folder = create_run_folder(
            request.runs, request.profile.stem, int(ready.profile.duration_s / ready.rig.period_s) + 1
        )
        manifest = new_manifest(
            {
                "rig": request.rig,
                "profile": request.profile,
                "twin": ready.twin,
                "effects": request.effects,
                "healthy": request.healthy,
            },
            mode=request.mode,
            speed=request.speed,
            virtual=request.virtual,
            seed=request.seed,
            calibrators=[] if tracking is None else list(tracking.calibrators),
            left_out={} if tracking is None else tracking.left_out,
            network_mode=request.network_mode,
        )
        folder.write_manifest(manifest)
        if ready.twin is not None:
            shutil.copyfile(ready.twin, folder.twin)
        try:
            return await _run_in(folder, manifest, request, ready, tracking, observer, announce)
        except BaseException as error:
            # A disk that is full must not hide why the run ended.
            with contextlib.suppress(OSError):
                folder.write_manifest(
                    manifest | {"exit_status": "faulted", "reason": f"{type(error).__name__}: {error}"}
                )
            raise


def check_session(request: RunRequest) -> Prepared:
    """Everything that `run_session` checks, and nothing moved; raises the same. What is left out is among the notes."""
    ready = prepare(request)
    config = tracking_config(request, ready, ())
    if config is None:
        return ready
    left_out = Twins(config).left_out
    return replace(ready, notes=(*ready.notes, *(f"{name} is left out: {why}" for name, why in left_out.items())))


async def _run_in(
    folder: RunFolder,
    manifest: dict[str, Any],
    request: RunRequest,
    ready: Prepared,
    tracking: Tracking | None,
    observer: Callable[[Status], None] | None,
    announce: Callable[[str], None],
) -> RunResult:
    """The run itself, in its folder."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    async with contextlib.AsyncExitStack() as stack:
        rig, clock = await stack.enter_async_context(_rig_and_clock(request, ready.rig, announce))
        connection = RigConnection(rig, clock.now)
        header = _header(connection, ready, () if tracking is None else tracking.calibrators)
        journal = JournalWriter(folder.journal, header)
        stack.callback(journal.close)
        if ready.network is not None:
            parameters = ready.network.parameters
            journal.put_meta("commissioned", {name: p.value for name, p in parameters.items()})
            journal.put_meta("parameter_units", {name: p.unit for name, p in parameters.items()})
        if tracking is not None:
            tracking.attach(journal)
            for name, why in tracking.left_out.items():
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
            observer=observer,
            told=announce,
            residuals=dict if tracking is None else tracking.off_K,
            lockstep=request.mode == "lockstep",
        )
        async with serving(folder.control, engine, announce):
            with stopping(engine):
                outcome = await engine.run()
        comparison = await tracking.finish() if tracking is not None else None
        outcome.problems.extend(tracking.failures if tracking is not None else ())
        wall_s = loop.time() - began
        told = None
        if live is not None:
            announce("diagnosing the whole run (Ctrl-C skips it)")
            with interrupted(live.give_up):
                told = await live.finish(folder.diagnosis)
        manifest |= {
            "ended": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "exit_status": outcome.status,
            "reason": outcome.reason,
            "safe": outcome.safe,
            "trips": outcome.trips,
            "ticks": outcome.ticks,
            "overruns": outcome.overruns,
            "wall_s": round(wall_s, 2),
            "problems": outcome.problems,
            "errors_K": None if comparison is None else asdict(comparison.errors),
            "bands": None if comparison is None else comparison.bands,
            "parameters": None if comparison is None else comparison.parameters,
            "diagnosis": None if told is None or told.found is None else told.found.verdict,
        }
        journal.put_meta("exit_status", outcome.status)
        journal.put_meta("errors", manifest["errors_K"])
        journal.commit()
    folder.write_manifest(manifest)
    announce("writing record and report")
    export_record(folder.journal, folder.record, {"uid": manifest["uid"], "started": manifest["started"]})
    adopted = _adopted(request, folder)
    if adopted is not None:
        manifest["adoption"] = adoption.manifest(adopted)
        folder.write_manifest(manifest)
    if not follower:
        from hil.review import write_review

        announce("writing review.rrd")
        write_review(folder.journal, folder.review)
    from hil.report import write_report

    write_report(folder)
    duration_s = outcome.ticks * clock.period_s
    return RunResult(folder, outcome, comparison, duration_s, wall_s, follower, told, adopted)


def _adopted(request: RunRequest, folder: RunFolder) -> Adoption | None:
    """In controlled mode, what was accepted as the next revision of the run's twin."""
    if request.network_mode != "controlled" or not folder.twin.is_file():
        return None
    reader = JournalReader(folder.journal)
    try:
        proposals = [Proposed(row.calibrator, row.time_s, row.document) for row in reader.proposals()]
    finally:
        reader.close()
    made_by = f"hil run {request.profile.name} --network-mode controlled"
    return adoption.adopt(folder.twin, read_record(folder.record), proposals, made_by)


@contextlib.asynccontextmanager
async def _rig_and_clock(
    request: RunRequest, rig: Rig, announce: Callable[[str], None]
) -> AsyncIterator[tuple[Rig, Clock]]:
    if request.control is not None:
        lockstep = LockstepClock(*request.control)
        await lockstep.connect()
        yield rig, lockstep
        return
    if not request.virtual:
        yield rig, MonotonicClock(rig.period_s)
        return
    from drivers.virtual.rig import start_virtual_rig

    hidden = f" with effects that no twin knows of ({request.effects})" if request.effects is not None else ""
    announce(f"starting the virtual rig{hidden}")
    virtual = await start_virtual_rig(
        seed=request.seed,
        mode=request.mode,
        speed=request.speed,
        period_s=rig.period_s,
        effects=request.effects,
    )
    try:
        ports = {
            name: virtual.modbus_port if isinstance(bus, ModbusTcpBus) else virtual.can_port
            for name, bus in rig.bus.items()
        }
        if request.mode == "lockstep":
            lockstep = LockstepClock("127.0.0.1", virtual.control_port)
            await lockstep.connect()
            yield rig.with_ports(ports), lockstep
        else:
            patient = _patient(rig, request.speed) if request.mode == "scaled" else rig
            yield patient.with_ports(ports), MonotonicClock(rig.period_s, request.speed)
    finally:
        await virtual.stop()


def _patient(rig: Rig, speed: float) -> Rig:
    """`rig` with its staleness limits, which are in rig time, widened by a hiccup of the machine."""
    hiccup_s = HICCUP_S * speed
    points = tuple(p.model_copy(update={"stale_after_s": p.stale_after_s + hiccup_s}) for p in rig.point)
    return rig.model_copy(update={"point": points, "abort_after_s": rig.abort_after_s + hiccup_s})


def _header(connection: RigConnection, ready: Prepared, calibrators: tuple[str, ...]) -> Header:
    network = ready.network
    setpoints = tuple(point.as_signal() for point in ready.rig.setpoints)
    return Header(
        signals=connection.signals + setpoints,
        twin_sensors={} if network is None else dict(network.sensor_columns),
        twin_names=() if network is None else (STATIC, *calibrators),
        profile=ready.profile.name,
        duration_s=ready.profile.duration_s,
        period_s=ready.rig.period_s,
        noise_K={} if network is None else dict(zip(network.sensor_names, network.sigma.tolist(), strict=True)),
    )


async def _start_tracking(request: RunRequest, ready: Prepared) -> Tracking | None:
    signals = RigConnection(ready.rig, lambda: 0.0).signals + tuple(p.as_signal() for p in ready.rig.setpoints)
    config = tracking_config(request, ready, tuple(signal.column for signal in signals))
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
    config = LiveConfig(folder.twin, folder.journal, request.healthy, request.diagnose_s, request.adopt)
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
