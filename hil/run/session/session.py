"""Sessions: new and resumed runs, from their files to their folder."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.rig import rig_signals
from drivers.rig_file import Rig
from hil.diagnosis import copy_record
from hil.run.engine import RunSignals, Status, cancelling
from hil.run.locks import claimed
from hil.run.outputs import bind
from hil.run.restore import RestoreRule, Resumption, restore_obstacle
from hil.run.session.interrupted_run import confirmed_position
from hil.run.session.manifest import files_of, foreign_journal, interruption_reason, settings_of
from hil.run.session.output_queue import queued_output
from hil.run.session.request import RunInputs, RunRequest, prepare, tracking_config
from hil.run.session.rig_time import speed_of
from hil.run.session.run import PreparedRun, RunResult, carry_out
from hil.run.session.services import start_tracking
from hil.run.session.terminal import hours
from hil.run_folder import (
    RunFolder,
    RunFolderError,
    RunSize,
    create_run_folder,
    new_manifest,
    require_room,
    without_end,
)
from hil.tracking import Twins
from twin import chain


async def run_session(
    request: RunRequest,
    observer: Callable[[Status], None] | None = None,
    announce: Callable[[str], None] = lambda text: None,
    signals: RunSignals | None = None,
) -> RunResult:
    """Run `request` to its end and derive all files in its folder.

    Parameters
    ----------
    request
        Files and options of the run.
    observer
        Gets the status a few times a second.
    announce
        Gets messages for the operator, a line each.
    signals
        Signals of the process; the caller determines how long they are held. None holds them for this call.

    Raises
    ------
    ConfigurationError
        The request is inconsistent. Errors of its files are raised as their readers raise them.
    RigBusyError
        Another run drives the rig.
    RigLockError
        The locks of the rig cannot be taken.
    """
    async with contextlib.AsyncExitStack() as stack:
        signals = signals or stack.enter_context(RunSignals())
        stack.enter_context(cancelling(signals))
        ready = prepare(request)
        observer, announce = stack.enter_context(queued_output(observer, announce))
        for note in ready.notes:
            announce(note)
        # Before anything is made or moved: a locked rig or a calibrator that cannot start is refused here.
        claim = stack.enter_context(claimed(_shared_rig(request, ready), announce, no_lock=request.no_lock))
        tracking = await start_tracking(request, ready)
        if tracking is not None:
            stack.push_async_callback(tracking.close)
            for name, why in tracking.left_out.items():
                announce(f"{name} is left out: {why}")
        folder = create_run_folder(
            request.runs, request.profile.stem, _size(ready, 0 if tracking is None else len(tracking.calibrators))
        )
        stack.enter_context(folder.owned())
        claim.record_holder(folder.path)
        manifest = new_manifest(files_of(request, ready), **settings_of(request, tracking))
        manifest["labels"] = request.labels.given()
        folder.write_manifest(manifest)
        if ready.twin is not None:
            folder.copy_twin([entry.path for entry in chain(ready.twin)])
            copy_record(ready.twin, folder.path)
        return await carry_out(
            PreparedRun(folder, manifest, request, ready, claim, tracking, observer, announce, signals)
        )


async def resume_session(
    folder: RunFolder,
    request_of: Callable[[dict[str, Any]], RunRequest],
    rule: RestoreRule,
    observer: Callable[[Status], None] | None = None,
    announce: Callable[[str], None] = lambda text: None,
    gap_s: float | None = None,
    before_moving: Callable[[RunRequest], None] = lambda request: None,
    signals: RunSignals | None = None,
) -> RunResult:
    """Resume the interrupted run in `folder` and derive all its files anew.

    Parameters
    ----------
    folder
        Folder of the run.
    request_of
        Returns the request for the run's manifest.
    rule
        Rule of the thermal restore.
    observer, announce, signals
        As in `run_session`.
    gap_s
        Length of the gap where the clocks do not agree on it, s.
    before_moving
        Gets the request after all checks, before anything moves.

    Raises
    ------
    RunFolderError
        The run is live, has ended, or cannot be resumed. Further errors are those of `run_session`.
    """
    async with contextlib.AsyncExitStack() as stack:
        signals = signals or stack.enter_context(RunSignals())
        stack.enter_context(cancelling(signals))
        observer, announce = stack.enter_context(queued_output(observer, announce))
        stack.enter_context(folder.owned())
        manifest = folder.read_manifest()
        foreign = foreign_journal(folder, manifest)
        if foreign is not None:
            raise RunFolderError(foreign)
        request = request_of(manifest)
        ready = prepare(request)
        claim = stack.enter_context(claimed(_shared_rig(request, ready), announce, no_lock=request.no_lock))
        claim.record_holder(folder.path)
        was = confirmed_position(folder, gap_s, announce)
        require_room(folder, _size(ready, len(request.calibrators or ())))
        before_moving(request)
        folder.control.unlink(missing_ok=True)
        tracking = await start_tracking(request, ready)
        if tracking is not None:
            stack.push_async_callback(tracking.close)
        reason = interruption_reason(manifest, was)
        announce(f"{reason} at {hours(was.profile_s)} of {hours(ready.profile.duration_s)} of the profile")
        if was.aim and (why := restore_obstacle(ready.rig, bind(ready.rig, ready.profile.columns))) is not None:
            announce(why)
        resumption = Resumption(was, rule, reason, speed_of(request, ready.rig))
        manifest = without_end(manifest) | {"exit_status": "running", "reason": "", "ended": None}
        folder.write_manifest(manifest)
        return await carry_out(
            PreparedRun(folder, manifest, request, ready, claim, tracking, observer, announce, signals, resumption)
        )


def _shared_rig(request: RunRequest, ready: RunInputs) -> Rig | None:
    """Return the rig that other runs could drive, too; None for one that the run starts itself."""
    return None if request.virtual else ready.rig


def _size(ready: RunInputs, calibrators: int) -> RunSize:
    """Return the size of a run with this number of calibrators; without a twin it has no predictions."""
    ticks, signals = int(ready.profile.duration_s / ready.rig.period_s) + 1, len(rig_signals(ready.rig))
    if ready.network is None:
        return RunSize(ticks, signals)
    return RunSize(ticks, signals, 1 + calibrators, len(ready.network.sensor_columns))


def check_session(request: RunRequest) -> RunInputs:
    """Return the files of a run after all checks of `run_session`, without moving anything; raises the same errors.

    The notes name calibrators that are left out.
    """
    ready = prepare(request)
    config = tracking_config(request, ready, ())
    if config is None:
        return ready
    left_out = Twins(config).left_out
    return replace(ready, notes=(*ready.notes, *(f"{name} is left out: {why}" for name, why in left_out.items())))
