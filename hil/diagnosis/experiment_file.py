"""Next experiment of a diagnosis as a load profile, within the limits of a rig file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from drivers.rig_file import file_sha256, load_rig
from hil.diagnosis.store import EXPERIMENT
from hil.files import parse_json
from hil.profile import Profile, SetpointLimit, validate, write_profile
from hil.run.outputs import setpoint_columns
from twin.discovery import Diagnosis, Limits


def limits_of(rig: Path) -> Limits:
    """Return the limits of a rig file: set-point limits, and the lowest upper alarm limit of its temperatures.

    Raises
    ------
    ConfigurationError
        The rig file cannot be used.
    """
    loaded = load_rig(rig)
    driven = {column: p.limits for column, p in setpoint_columns(loaded).items() if p.limits is not None}
    alarms = [p.alarm[1] for p in loaded.point if p.alarm is not None and p.unit == "degC"]
    return Limits(driven, min(alarms, default=float("nan")), loaded.name)


def rig_of(run: Path) -> Path | None:
    """Return the rig file that a run folder names, or None if it has changed since the run."""
    try:
        about = parse_json((run / "run.json").read_text(encoding="utf-8"))["files"]["rig"]
        path = Path(str(about["path"]))
        return path if file_sha256(path) == about["sha256"] else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_experiment(diagnosis: Diagnosis, out: Path, rig: Path | None = None) -> Path | None:
    """Write the next experiment as a load profile, `experiment.csv`; return None if there is none.

    Raises
    ------
    ProfileError
        The rig does not allow it.
    """
    plan = diagnosis.next_experiment
    if not plan or not plan.get("possible"):
        return None
    profile = profile_of(plan)
    if rig is not None:
        loaded = load_rig(rig)
        limits = {
            column: SetpointLimit(*p.limits, p.max_rate, p.unit)
            for column, p in setpoint_columns(loaded).items()
            if p.limits is not None
        }
        validate(profile, limits, period_s=loaded.period_s)
    path = out / EXPERIMENT
    write_profile(profile, path, (f"{plan['name']}: {plan['why']}",))
    return path


def profile_of(plan: dict[str, Any] | Any) -> Profile:
    """Return the steps of a planned experiment as a profile; the last step is its end."""
    steps = plan["steps"]
    columns = tuple(sorted({c for step in steps for c in step if c != "time_s"}))
    values = np.array([[float(step[c]) for c in columns] for step in steps])
    return Profile("experiment", np.array([float(s["time_s"]) for s in steps]), columns, values)
