"""Experiment between two rounds: its plan in words, its request as a run, and its finished run."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.rig_file import file_sha256, load_rig
from drivers.signals import split_column
from hil.explain.explanation import Experiment, HashedFile
from hil.run.session import RunRequest
from hil.run_folder import RunFolder, RunFolderError


@dataclass(frozen=True)
class RigChoice:
    """Rig that the experiments run on.

    Attributes
    ----------
    rig
        Rig file.
    virtual, mode, speed, seed, effects
        As in `RunRequest`.
    age_s
        Rig time of a virtual rig at the end of the diagnosed record, s: its effects have this age when the first
        experiment begins.
    rearm, guardian, no_lock, viewer, runs
        As in `RunRequest`.
    """

    rig: Path
    runs: Path
    virtual: bool = False
    mode: Any = "real"
    speed: float = 1.0
    seed: int = 0
    effects: Path | None = None
    age_s: float = 0.0
    rearm: bool = False
    guardian: bool = True
    no_lock: bool = False
    viewer: bool | None = None


def planned(plan: Mapping[str, Any] | None, profile: Path | None, rig: Path | None) -> Experiment | None:
    """Return the next experiment of a `diagnosis.json` within the limits of `rig`; None if nothing is open."""
    if not plan:
        return None
    limits = HashedFile.of(rig) if rig is not None else None
    steps = [dict(step) for step in plan.get("steps", ())]
    if not plan.get("possible") or profile is None:
        return Experiment(possible=False, why=str(plan.get("why", "")), rig=limits)
    return Experiment(
        possible=True,
        why=str(plan["why"]),
        sentence=in_words(steps),
        profile=str(profile.absolute()),
        hours=float(plan["hours"]),
        hottest_C=float(plan["hottest_C"]),
        steps=steps,
        rig=limits,
    )


def in_words(steps: Sequence[Mapping[str, float]]) -> str:
    """Return the inputs of an experiment, their levels and its duration as one sentence; the last step is the end."""
    columns = [column for column in steps[0] if column != "time_s"]
    parts = []
    for column in columns:
        name, unit = split_column(column) or (column, "")
        levels = [step[column] for step in steps[:-1]]
        low, high = f"{min(levels):g}", f"{max(levels):g}"
        size = f"stays at {low}" if low == high else f"changes between {low} and {high}"
        parts.append(f"{name.replace('_', ' ')} {size} {unit}".rstrip())
    count = len(steps) - 1
    return f"for {_hours(steps[-1]['time_s'])}, in {count} step{'s' * (count > 1)}: {', '.join(parts)}"


def run_request(choice: RigChoice, experiment: Experiment, twin: Path, later_s: float) -> RunRequest:
    """Return the request of an experiment's run, which begins `later_s` seconds of rig time after the first record.

    Calibrators run only where an interlock of the rig watches a twin: the next diagnosis needs the record alone.
    """
    rig = load_rig(choice.rig)
    watched = [spec.twin for spec in rig.interlock if spec.kind == "residual"]
    names = tuple(dict.fromkeys(name for name in watched if name != "static"))
    return RunRequest(
        profile=Path(experiment.profile),
        rig=choice.rig,
        twin=twin,
        runs=choice.runs,
        virtual=choice.virtual,
        mode=choice.mode,
        speed=choice.speed,
        seed=choice.seed,
        effects=choice.effects,
        calibrators=names or (("least_squares",) if watched else ()),
        viewer=choice.viewer,
        rearm=choice.rearm,
        guardian=choice.guardian,
        no_lock=choice.no_lock,
        start_s=choice.age_s + later_s if choice.virtual else 0.0,
    )


def runs_of(choice: RigChoice, experiment: Experiment, planned_at: datetime.datetime) -> list[tuple[RunFolder, str]]:
    """Return the runs of this experiment on this rig since it was planned, newest first, with their exit status.

    They show whether a `hil explain` that was killed, or `hil resume`, has completed the experiment.
    """
    profile = Path(experiment.profile)
    try:
        wanted = {"profile": file_sha256(profile), "rig": file_sha256(choice.rig)}
        folders = sorted(choice.runs.glob(f"*-{profile.stem}*"), reverse=True)
    except OSError:
        return []
    found = []
    for path in folders:
        try:
            manifest = RunFolder(path).read_manifest()
            started = datetime.datetime.fromisoformat(str(manifest["started"]))
            same = all(manifest["files"][name]["sha256"] == digest for name, digest in wanted.items())
            here = Path(manifest["files"]["profile"]["path"]) == profile
            # The manifest has whole seconds.
            since = started >= planned_at.replace(microsecond=0)
        except (RunFolderError, KeyError, ValueError, TypeError):
            continue
        if same and here and since:
            found.append((RunFolder(path), str(manifest["exit_status"])))
    return found


def is_record_of(record: Path, experiment: Experiment) -> bool:
    """Return True if a record is in the folder of a run that replayed this experiment's load profile."""
    try:
        manifest = RunFolder(record.parent).read_manifest()
        return bool(manifest["files"]["profile"]["sha256"] == file_sha256(Path(experiment.profile)))
    except (RunFolderError, OSError, KeyError, TypeError):
        return False


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    return (
        f"{minutes // 60} h" + (f" {minutes % 60} min" if minutes % 60 else "") if minutes >= 60 else f"{minutes} min"
    )
