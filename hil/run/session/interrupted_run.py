"""Check of an interrupted run before it is resumed: its position, its settings, and the files that it depends on."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.rig_file import file_sha256, load_rig
from drivers.signals import Quality
from hil.diagnosis import END_ONLY
from hil.files import require_unshared
from hil.journal import JournalReader, SegmentRow, State, StateRow, profile_times, require_alone
from hil.run.restore import KEY, RunPosition, stores_heat, with_gap
from hil.run.session.regenerate import has_ended
from hil.run.session.request import RunRequest
from hil.run_folder import RunFolder, RunFolderError, require_settings

AIM_TICKS = 10
"""Last good values whose mean is the temperature at the interruption."""
AIM_WITHIN_S = 60.0
"""Greatest age of these values, s: the cause of the interruption may have lost a sensor's last values."""
FILES = {
    "rig": "--rig",
    "profile": "--profile",
    "twin": "--twin",
    "effects": "--with",
    "healthy": "--healthy",
    "network": "--network",
}
"""Files that a run depends on: name in `run.json` -> option that gives the new place of a moved file."""


def confirmed_position(folder: RunFolder, gap_s: float | None, announce: Callable[[str], None]) -> RunPosition:
    """Return the position of the run in `folder`, its gap checked against all clocks (`with_gap`).

    Parameters
    ----------
    folder
        Folder of an interrupted run.
    gap_s
        Gap that a person states, s; None to take it from the clocks.
    announce
        Gets a warning where the wall clock was set since.

    Raises
    ------
    JournalError
        The journal cannot be read.
    RunFolderError
        The run has no sample, or its gap is not plausible and `gap_s` is None.
    """
    was = position_of(folder)
    reader = _reader(folder)
    try:
        noted = reader.meta(KEY)
    finally:
        reader.close()
    return with_gap(was, noted, gap_s, announce)


def position_of(folder: RunFolder) -> RunPosition:
    """Return the position of the run in `folder`; raises JournalError, or RunFolderError for a run without samples."""
    reader = _reader(folder)
    try:
        states, segments = reader.states(), reader.segments()
        tick, wall_s = reader.last()
        if tick < 0 or not states:
            raise _never_began(folder)
        header = reader.header
        profile_s = float(profile_times(states, np.array([tick]), header.period_s)[0])
        aim_tick = _aim_tick(states, segments, tick)
        if segments and aim_tick < segments[-1].tick:
            # Interrupted during a thermal restore: the former target temperatures still hold.
            aim_tick, profile_s = segments[-1].aim_tick, segments[-1].profile_s
        back = math.ceil(AIM_WITHIN_S / header.period_s)
        samples = reader.samples(aim_tick - back, back)
    finally:
        reader.close()
    good = (samples.quality == Quality.GOOD) & np.isfinite(samples.values) & (samples.tick <= aim_tick)[:, None]
    aim = {}
    for index, signal in enumerate(header.signals):
        column = samples.values[good[:, index], index][-AIM_TICKS:]
        if stores_heat(signal) and len(column):
            aim[signal.name] = float(column.mean())
    number = (segments[-1].number if segments else 1) + 1
    return RunPosition(tick, tick * header.period_s, wall_s, profile_s, states[-1].target, number, aim_tick, aim)


def _reader(folder: RunFolder) -> JournalReader:
    if not folder.journal.is_file():
        raise _never_began(folder)
    return JournalReader(folder.journal)


def _never_began(folder: RunFolder) -> RunFolderError:
    return RunFolderError(f"{folder.path} ended before its first sample; start a new run with `hil run`")


def _aim_tick(states: Sequence[StateRow], segments: Sequence[SegmentRow], tick: int) -> int:
    """Return the last tick with the profile's load, running or held; -1 where the last segment had none.

    Later ticks, paused, suspended or with a trip to acknowledge, have only cooled the rig.
    """
    found = -1
    for row, following in zip(states, [*states[1:], None], strict=True):
        loaded = row.target == State.RUNNING or (row.target == State.HELD and row.source == State.RUNNING)
        if loaded and (not segments or row.tick >= segments[-1].tick):
            # On the tick of a transition the rig is still in its former state.
            found = tick if following is None else min(following.tick, tick)
    return found


def request_of(
    folder: RunFolder,
    manifest: Mapping[str, Any],
    moved: Mapping[str, Path | None],
    *,
    control: tuple[str, int] | None = None,
    rearm: bool = False,
    no_lock: bool = False,
    viewer: bool | None = None,
    guardian: bool = True,
) -> RunRequest:
    """Return the request of the run in `folder`, from its manifest.

    Parameters
    ----------
    folder
        Folder of an interrupted run.
    manifest
        Content of its `run.json`.
    moved
        Name of a file -> its new place, None where it was not moved.
    control, rearm, no_lock, viewer, guardian
        Options of this call, see `RunRequest`.

    Raises
    ------
    RunFolderError
        The run has ended, or one of its files has changed.
    """
    if has_ended(folder):
        rest = "start it again with `hil run`"
        if not folder.report.is_file() or not folder.record.is_file():
            rest = f"`hil report {shlex.quote(str(folder.path))}` makes its record and report"
        raise RunFolderError(f"{folder.path} has run to its end; {rest}")
    require_unshared(folder.path, RunFolderError)
    require_alone(folder.journal)
    settings = manifest["settings"]
    require_settings(settings, folder.manifest, RunFolderError)
    files = _checked_files(folder, manifest, moved)
    for name in ("rig", "profile"):
        if name not in files:
            raise RunFolderError(f"{folder.manifest} names no {name}, so the run cannot be resumed; start a new run")
    known = settings.get("control")
    return RunRequest(
        profile=files["profile"],
        rig=files["rig"],
        twin=files.get("twin"),
        use_twin="twin" in files,
        runs=folder.path.parent,
        virtual=settings["virtual"],
        mode=settings["mode"],
        speed=settings["speed"],
        seed=settings["seed"],
        start_s=settings.get("start_s", 0.0),
        effects=files.get("effects"),
        calibrators=tuple(settings["calibrators"]),
        card=files.get("network"),
        network_mode=settings["network_mode"],
        viewer=viewer,
        control=control or (None if known is None else (known[0], known[1])),
        rearm=rearm,
        no_lock=no_lock,
        diagnose_s=math.inf if settings.get("diagnose_s") == END_ONLY else settings.get("diagnose_s"),
        healthy=files.get("healthy"),
        adopt=settings.get("adopt", False),
        report=settings.get("report", True),
        guardian=guardian,
        test=files.get("test"),
    )


def _checked_files(folder: RunFolder, manifest: Mapping[str, Any], moved: Mapping[str, Path | None]) -> dict[str, Path]:
    """Return the path of each file of the run; raises RunFolderError that names missing and changed ones."""
    found, problems = {}, []
    inside = folder.path.resolve()
    for name, item in manifest["files"].items():
        path = moved.get(name) or Path(item["path"])
        found[name] = path
        if not moved.get(name) and (why := _why_untrusted(path, inside)):
            option = f"; where it is meant, name it with {FILES[name]}" if name in FILES else ""
            problems.append(f"{folder.manifest} names {path} as the run's {name}, which {why}{option}")
            continue
        copy = f" ({folder.twin} is the run's own copy)" if name == "twin" and folder.twin.is_file() else ""
        if not path.is_file():
            where = f"give its place with {FILES[name]}" if name in FILES else "put it back"
            problems.append(f"{path}, the run's {name}, is not there; {where}{copy}")
        elif file_sha256(path) != item["sha256"]:
            problems.append(
                f"{path} is not what it was when the run began; put that {name} back{copy}, or start a new run"
            )
    if problems:
        raise RunFolderError("\n".join(problems))
    return found


def _why_untrusted(path: Path, folder: Path) -> str:
    """Return why no run writes this path of one of its files into its manifest, or "".

    A run names its files by absolute paths outside its folder. A file inside came with the folder, so that the author
    of the folder would choose the rig and its set-points.
    """
    if not path.is_absolute() or "\0" in str(path):
        return "is no absolute path"
    try:
        return "came with the run's own folder" if path.resolve().is_relative_to(folder) else ""
    except (OSError, RuntimeError):
        return "is a loop of links"


def resume_notices(request: RunRequest) -> list[str]:
    """Return sentences about the rig and the profile of a resumed run, for the operator before anything moves."""
    rig = load_rig(request.rig)
    buses = ", ".join(f"{name} at {bus.place}" for name, bus in rig.bus.items())
    if request.virtual:
        where = "a virtual rig of its own in place of the one"
    elif request.control is not None:
        where = f"the rig whose time is set through {request.control[0]}:{request.control[1]},"
    else:
        where = f"the rig {rig.name!r} ({buses})"
    return [f"resuming drives {where} of {request.rig}, with the profile {request.profile}"]
