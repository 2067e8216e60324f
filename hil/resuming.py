"""What a run that was cut left behind, and whether it may go on: where it stood, and the files that it depends on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.points import Quality
from drivers.rigfile import file_sha256
from hil.journal import JournalReader
from hil.run_folder import RunFolder, RunFolderError
from hil.run_request import RunRequest
from hil.segments import Standing, profile_times
from hil.soaking import has_memory
from hil.states import State

AIM_TICKS = 10
"""The temperatures of a cut are means over so many of its last ticks."""
FILES = {"rig": "--rig", "profile": "--profile", "twin": "--twin", "effects": "--with", "healthy": "--healthy"}
"""Files that a run depends on, by their name in `run.json`, and the option that says where one has been moved to."""


def standing(folder: RunFolder) -> Standing:
    """Where the run in `folder` stood; raises JournalError, or RunFolderError where it never had a sample."""
    reader = JournalReader(folder.journal)
    try:
        states, segments = reader.states(), reader.segments()
        tick, wall_s = reader.last()
        if tick < 0 or not states:
            raise RunFolderError(f"{folder.path} was cut before its first sample; start a new run with `hil run`")
        profile_s = float(profile_times(states, np.array([tick]), reader.header.period_s)[0])
        aim_tick = tick
        if segments and not any(r.target == State.RUNNING and r.tick >= segments[-1].tick for r in states):
            # Cut while it was being led back: it still has to get to where it was before.
            aim_tick, profile_s = segments[-1].aim_tick, segments[-1].profile_s
        samples = reader.samples(aim_tick - AIM_TICKS, AIM_TICKS)
        header = reader.header
    finally:
        reader.close()
    good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
    aim = {}
    for index, signal in enumerate(header.signals):
        column = good[:, index][np.isfinite(good[:, index])]
        if has_memory(signal) and len(column):
            aim[signal.name] = float(column.mean())
    number = (segments[-1].number if segments else 1) + 1
    return Standing(tick, tick * header.period_s, wall_s, profile_s, states[-1].target, number, aim_tick, aim)


def request_of(
    folder: RunFolder,
    manifest: Mapping[str, Any],
    moved: Mapping[str, Path | None],
    *,
    control: tuple[str, int] | None = None,
    rearm: bool = False,
    viewer: bool | None = None,
) -> RunRequest:
    """What the run in `folder` was asked to be. `moved` says where files lie now; the other options are today's.

    Raises:
        RunFolderError: the run is over, or one of its files is not what it was.
    """
    if manifest.get("exit_status") == "done" and folder.report.is_file():
        raise RunFolderError(f"{folder.path} has run to its end; start it again with `hil run`")
    files = _checked_files(folder, manifest, moved)
    settings = manifest["settings"]
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
        effects=files.get("effects"),
        calibrators=tuple(settings["calibrators"]),
        network_mode=settings["network_mode"],
        viewer=viewer,
        control=control or (None if known is None else (known[0], known[1])),
        rearm=rearm,
        diagnose_s=settings.get("diagnose_s"),
        healthy=files.get("healthy"),
        adopt=settings.get("adopt", False),
    )


def _checked_files(folder: RunFolder, manifest: Mapping[str, Any], moved: Mapping[str, Path | None]) -> dict[str, Path]:
    """Where each file of the run is, its content unchanged; raises RunFolderError naming those that are not."""
    found, problems = {}, []
    for name, item in manifest["files"].items():
        path = moved.get(name) or Path(item["path"])
        found[name] = path
        copy = f" ({folder.twin} is the run's own copy)" if name == "twin" and folder.twin.is_file() else ""
        if not path.is_file():
            where = f"say where it is with {FILES[name]}" if name in FILES else "put it back"
            problems.append(f"{path}, the run's {name}, is not there; {where}{copy}")
        elif file_sha256(path) != item["sha256"]:
            problems.append(
                f"{path} is not what it was when the run began; put that {name} back{copy}, or start a new run"
            )
    if problems:
        raise RunFolderError("\n".join(problems))
    return found
