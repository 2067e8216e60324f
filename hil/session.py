"""One run from its files to its folder: validate, start what is needed, run the engine, derive record and report."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import shutil
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from drivers.points import ConfigurationError
from drivers.rig import RigConnection
from drivers.rigfile import Rig, load_rig
from hil.clock import Clock, LockstepClock, MonotonicClock
from hil.engine import Engine, Outcome, Publisher, Status
from hil.journal import Header, JournalWriter
from hil.live_diagnosis import LiveConfig, LiveDiagnosis, Reply
from hil.profile import Profile, SetpointLimit, read_profile, validate
from hil.record import export_record
from hil.run_folder import RunFolder, create_run_folder, new_manifest
from hil.setpoints import setpoint_columns
from hil.tracking import ErrorTable, TrackingConfig, TrackingProcess

if TYPE_CHECKING:
    from twin.network import Network

Mode = Literal["real", "scaled", "lockstep"]
MOST_SPEED = 100.0
"""Faster than this the rig's watchdog of seconds is shorter than a scheduler's hiccup; lockstep has no such limit."""
HICCUP_S = 0.25
"""Wall time that a busy machine may lose now and then: in scaled time it must not look like a lost sensor."""


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What to run. `virtual` starts the virtual rig in place of the one at the rig file's addresses.

    `twin` None takes the twin that the rig file names, if any; `use_twin` False runs without one. `control` is the
    control port of a virtual rig in lockstep that runs already, at the rig file's addresses. `diagnose_s`: seconds of
    profile time between diagnoses of the record so far, against the record `healthy`; `adopt` saves what they find.
    """

    profile: Path
    rig: Path
    twin: Path | None
    runs: Path
    virtual: bool = False
    mode: Mode = "real"
    speed: float = 1.0
    seed: int = 0
    effects: Path | None = None
    calibrators: tuple[str, ...] = ("pso",)
    viewer: bool | None = None
    use_twin: bool = True
    control: tuple[str, int] | None = None
    diagnose_s: float | None = None
    healthy: Path | None = None
    adopt: bool = False


@dataclass(frozen=True, slots=True)
class RunResult:
    """A finished run: its folder, how it ended, the twins' errors, how fast it went, what the diagnosis said."""

    folder: RunFolder
    outcome: Outcome
    errors: ErrorTable | None
    duration_s: float
    wall_s: float
    viewed: bool
    diagnosis: Reply | None = None


@dataclass(frozen=True, slots=True)
class Prepared:
    """Everything that could be checked before anything moves."""

    rig: Rig
    profile: Profile
    twin: Path | None
    network: Network | None
    notes: tuple[str, ...]


def prepare(request: RunRequest) -> Prepared:
    """Read and validate all files of a run; raises RigFileError, ProfileError, TwinFileError or ConfigurationError."""
    rig = load_rig(request.rig)
    profile = read_profile(request.profile)
    notes = validate(profile, setpoint_limits(rig), period_s=rig.period_s)
    network = None
    twin = (request.twin or rig.twin) if request.use_twin else None
    if twin is not None:
        from twin.twinfile import load

        network = load(twin)
        _check_twin_columns(twin, network, rig)
        from twin.calibrators import NAMES

        unknown = [name for name in request.calibrators if name not in NAMES]
        if unknown:
            raise ConfigurationError(f"no calibrator {', '.join(unknown)}; there are {', '.join(NAMES)}")
    if request.mode == "scaled" and not 0 < request.speed <= MOST_SPEED:
        raise ConfigurationError(
            f"--speed {request.speed:g} is not between 0 and {MOST_SPEED:g}; use --lockstep to go faster"
        )
    if request.mode != "real" and not request.virtual and request.control is None:
        raise ConfigurationError(f"{request.mode} time needs a rig whose time can be set; add --virtual")
    if request.effects is not None and not request.virtual:
        raise ConfigurationError(
            "--with switches on effects in the virtual rig; give --virtual too, or take --with out"
        )
    if request.diagnose_s is not None:
        notes = [*notes, *_check_diagnosis(request, network)]
    return Prepared(rig, profile, twin, network, tuple(notes))


def _check_diagnosis(request: RunRequest, network: Network | None) -> list[str]:
    """Remarks on a diagnosis that is asked for; raises ConfigurationError or RecordError."""
    if network is None:
        raise ConfigurationError("--diagnose asks why a twin is wrong, and this run has none; take --no-twin out")
    if request.healthy is None:
        return ["--diagnose without --healthy takes the noise floor from the run itself: small effects are not seen"]
    from hil.diagnosing import read_columns

    read_columns(network, request.healthy, None)
    return []


def setpoint_limits(rig: Rig) -> dict[str, SetpointLimit]:
    """What profiles may ask of the rig, by profile column."""
    limits = {}
    for column, point in setpoint_columns(rig).items():
        assert point.limits is not None
        low, high = point.limits
        limits[column] = SetpointLimit(low=low, high=high, max_rate_per_s=point.max_rate, unit=point.unit)
    return limits


def _check_twin_columns(path: Path, network: Network, rig: Rig) -> None:
    have = {point.as_signal().column for point in rig.point if not point.is_setpoint}
    wanted = set(network.input_columns).union(*network.sensor_columns.values())
    missing = sorted(wanted - have)
    if missing:
        raise ConfigurationError(
            f"{path}: the twin needs {', '.join(missing)}, which the rig {rig.name} does not measure; "
            "name a twin of this rig with --twin"
        )


async def run_session(
    request: RunRequest,
    observer: Callable[[Status], None] | None = None,
    announce: Callable[[str], None] = lambda text: None,
) -> RunResult:
    """Run `request` to its end and derive everything in its folder; raises what `prepare` raises."""
    ready = prepare(request)
    for note in ready.notes:
        announce(note)
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
        calibrators=list(request.calibrators),
    )
    folder.write_manifest(manifest)
    if ready.twin is not None:
        shutil.copyfile(ready.twin, folder.twin)
    try:
        result = await _run_in(folder, manifest, request, ready, observer, announce)
    except BaseException as error:
        folder.write_manifest(manifest | {"exit_status": "faulted", "reason": f"{type(error).__name__}: {error}"})
        raise
    return result


async def _run_in(
    folder: RunFolder,
    manifest: dict[str, Any],
    request: RunRequest,
    ready: Prepared,
    observer: Callable[[Status], None] | None,
    announce: Callable[[str], None],
) -> RunResult:
    """The run itself, in its folder."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    async with contextlib.AsyncExitStack() as stack:
        rig, clock = await stack.enter_async_context(_rig_and_clock(request, ready.rig, announce))
        connection = RigConnection(rig, clock.now)
        header = _header(connection, ready, request.calibrators)
        journal = JournalWriter(folder.journal, header)
        stack.callback(journal.close)
        if ready.network is not None:
            parameters = ready.network.parameters
            journal.put_meta("commissioned", {name: p.value for name, p in parameters.items()})
            journal.put_meta("parameter_units", {name: p.unit for name, p in parameters.items()})
        tracking = await _start_tracking(request, folder, ready, header, journal)
        if tracking is not None:
            stack.push_async_callback(tracking.close)
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
            lockstep=request.mode == "lockstep",
        )
        with _signals(engine):
            outcome = await engine.run()
        errors = await tracking.finish() if tracking is not None else None
        if tracking is not None and tracking.failure is not None:
            outcome.problems.append(f"the calibrators stopped: {tracking.failure}")
        wall_s = loop.time() - began
        told = None
        if live is not None:
            announce("diagnosing the whole run (Ctrl-C skips it)")
            with _interrupted(live.give_up):
                told = await live.finish(folder.diagnosis)
        manifest |= {
            "ended": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "exit_status": outcome.status,
            "reason": outcome.reason,
            "safe": outcome.safe,
            "ticks": outcome.ticks,
            "overruns": outcome.overruns,
            "wall_s": round(wall_s, 2),
            "problems": outcome.problems,
            "errors_K": None if errors is None else asdict(errors),
            "diagnosis": None if told is None or told.found is None else told.found.verdict,
        }
        journal.put_meta("exit_status", outcome.status)
        journal.put_meta("errors", manifest["errors_K"])
        journal.commit()
    folder.write_manifest(manifest)
    announce("writing record and report")
    export_record(folder.journal, folder.record, {"uid": manifest["uid"], "started": manifest["started"]})
    if not follower:
        from hil.review import write_review

        announce("writing review.rrd")
        write_review(folder.journal, folder.review)
    from hil.report import write_report

    write_report(folder)
    return RunResult(folder, outcome, errors, outcome.ticks * clock.period_s, wall_s, viewed=follower, diagnosis=told)


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
            name: virtual.modbus_port if bus.transport == "modbus_tcp" else virtual.can_port
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
        twin_names=() if network is None else ("static", *calibrators),
        profile=ready.profile.name,
        duration_s=ready.profile.duration_s,
        period_s=ready.rig.period_s,
        noise_K={} if network is None else dict(zip(network.sensor_names, network.sigma.tolist(), strict=True)),
    )


async def _start_tracking(
    request: RunRequest, folder: RunFolder, ready: Prepared, header: Header, journal: JournalWriter
) -> TrackingProcess | None:
    if ready.network is None or not request.calibrators:
        return None
    config = TrackingConfig(
        twin=folder.twin,
        columns=tuple(signal.column for signal in header.signals),
        calibrators=request.calibrators,
        seed=request.seed,
    )
    tracking = TrackingProcess(config, journal, wait=request.mode == "lockstep")
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


@contextlib.contextmanager
def _interrupted(callback: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM call `callback`: what is derived after a run must not be lost to an impatient operator."""
    loop = asyncio.get_running_loop()
    numbers = signal.SIGINT, signal.SIGTERM
    for number in numbers:
        loop.add_signal_handler(number, callback)
    try:
        yield
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)


@contextlib.contextmanager
def _signals(engine: Engine) -> Any:
    """Ctrl-C, SIGTERM and a lost terminal ask the engine to stop; a second one shortens its waits."""
    loop = asyncio.get_running_loop()
    names = {
        signal.SIGINT: "stopped by the operator (Ctrl-C)",
        signal.SIGTERM: "stopped by SIGTERM",
        signal.SIGHUP: "stopped because the terminal went away (SIGHUP)",
    }
    for number, reason in names.items():
        loop.add_signal_handler(number, engine.request_stop, reason)
    try:
        yield
    finally:
        for number in names:
            loop.remove_signal_handler(number)
