"""Entries of `run.json` about a run: the files and settings that it depends on, its end, its segments."""

from __future__ import annotations

import datetime
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.rig_file import CanBus
from hil.diagnosis import END_ONLY
from hil.journal import JournalError, JournalReader
from hil.run.engine import Outcome
from hil.run.restore import Resumption, RunPosition
from hil.run.session.request import RunInputs, RunRequest
from hil.run_folder import FolderLostError, RunFolder
from hil.tracking import Comparison, Tracking

RUN_UID = "run"
"""Name in a journal's metadata of the `uid` in the `run.json` of its run."""


def files_of(request: RunRequest, ready: RunInputs) -> dict[str, Path | None]:
    """Return every file that the run depends on, by its name in `run.json`."""
    dbc = {f"dbc of {name}": bus.dbc for name, bus in ready.rig.bus.items() if isinstance(bus, CanBus)}
    return {
        "rig": request.rig,
        "profile": request.profile,
        "twin": ready.twin,
        "effects": request.effects,
        "healthy": request.healthy,
        "network": request.card,
        "test": request.test,
        **dbc,
    }


def settings_of(request: RunRequest, tracking: Tracking | None) -> dict[str, Any]:
    """Return the settings of the run for `run.json`."""
    return {
        "mode": request.mode,
        "speed": request.speed,
        "virtual": request.virtual,
        "control": request.control,
        "seed": request.seed,
        "start_s": request.start_s,
        "calibrators": [] if tracking is None else list(tracking.calibrators),
        "left_out": {} if tracking is None else tracking.left_out,
        "network_mode": request.network_mode,
        # JSON has no infinity.
        "diagnose_s": END_ONLY if request.diagnose_s == math.inf else request.diagnose_s,
        "adopt": request.adopt,
        "report": request.report,
    }


def interruption_reason(manifest: dict[str, Any], was: RunPosition) -> str:
    """Return the beginning of a sentence about the end of the segment before."""
    if manifest["exit_status"] == "running":
        return f"the run was cut while {was.state}"
    return f"the run {manifest['exit_status']} ({manifest['reason']})"


END_OF_RUN = "end_of_run"
"""Key of the journal's metadata for the entries on the end of a run: `run.json` gets them after the last diagnosis."""
END_KEYS = (
    "ended",
    "exit_status",
    "deviations",
    "reason",
    "safe",
    "untouched",
    "away",
    "guardian",
    "trips",
    "ticks",
    "rig_restarts",
    "overruns",
    "wall_s",
    "segments",
    "problems",
)
"""Entries of a manifest on the end of its run, see `end_entries`."""
TWIN_KEYS = ("errors_K", "bands", "parameters", "parameter_units")
"""Entries of a manifest on the twins of its run, see `twin_entries`."""


def end_entries(
    folder: RunFolder, manifest: dict[str, Any], outcome: Outcome, resumption: Resumption | None, wall_s: float
) -> dict[str, Any]:
    """Return the new entries of the manifest at the end of a segment, after `wall_s` seconds of wall time."""
    return {
        "ended": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "exit_status": outcome.verdict,
        "deviations": outcome.deviations,
        "reason": outcome.reason,
        "safe": None if outcome.untouched and not outcome.safe else outcome.safe,
        "untouched": outcome.untouched,
        "away": outcome.away,
        "guardian": outcome.guardian,
        "trips": outcome.trips,
        "ticks": outcome.ticks,
        "rig_restarts": outcome.restarts + manifest.get("rig_restarts", 0),
        "overruns": outcome.overruns + manifest.get("overruns", 0),
        "wall_s": round(wall_s + manifest.get("wall_s", 0.0), 2),
        "segments": _segments(folder, manifest, outcome, resumption),
        "problems": outcome.problems,
    }


def twin_entries(comparison: Comparison | None) -> dict[str, Any]:
    """Return the entries of the manifest on the twins: errors, bands and parameters, None without a twin."""
    if comparison is None:
        return dict.fromkeys(TWIN_KEYS)
    values = (asdict(comparison.errors), comparison.bands, comparison.parameters, comparison.units)
    return dict(zip(TWIN_KEYS, values, strict=True))


def _segments(
    folder: RunFolder, manifest: dict[str, Any], outcome: Outcome, resumption: Resumption | None
) -> list[dict[str, Any]]:
    """Return every resumption so far as plain data, with the result of this one."""
    if resumption is None:
        return []
    try:
        reader = JournalReader(folder.located().journal)
    except (JournalError, FolderLostError):
        return list(manifest.get("segments", []))
    try:
        rows = reader.segments()
    finally:
        reader.close()
    known = {item["number"]: item for item in manifest.get("segments", [])}
    mine = {"restore_s": outcome.restore_s, "exit_status": outcome.status, "reason": outcome.reason}
    return [
        {"number": row.number, "from_s": row.time_s, "gap_s": row.gap_s, "profile_s": row.profile_s, "why": row.reason}
        | (mine if row.number == resumption.position.number else known.get(row.number, {"exit_status": "cut"}))
        for row in rows
    ]


def foreign_journal(folder: RunFolder, manifest: dict[str, Any]) -> str | None:
    """Return why the journal in `folder` cannot be used (it belongs to another run), or None."""
    try:
        reader = JournalReader(folder.journal)
        try:
            uid = reader.meta(RUN_UID)
        finally:
            reader.close()
    except (JournalError, OSError):
        return None  # each step reports its own error
    if uid is None or uid == manifest.get("uid"):
        return None
    return f"{folder.journal} is the journal of another run: put the one of this run in its place"
