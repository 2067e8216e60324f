"""Judgement of a case of the fault campaign: the rig's own log as the truth, and the journal of the run.

The harness is asked only for what it believed and when; whether the heater was off, and what the temperatures were,
is told by the rig.
"""

from __future__ import annotations

import bisect
import json
import os
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.signals import Quality
from drivers.virtual.devices import WATCHDOG_TRIPPED, Moment
from drivers.virtual.plant import CHANNELS
from hil.bench.faults.rig import PERIOD_S, STALE_AFTER_S
from hil.files import connect_read_only
from hil.journal import JournalReader

_SLACK_S = 0.3
_SIGMAS = 6.0
_TOLERANCE: dict[str, float] = {
    "heater_power_W": _SIGMAS * 0.8 + 0.1,
    "flow_L_per_min": _SIGMAS * 0.006 + 0.002,
    "pump_speed_pct": _SIGMAS * 0.05 + 0.1,
    "fan_speed_pct": _SIGMAS * 0.08 + 0.1,
    "T_ambient_C": _SIGMAS * 0.03 + 0.5,  # The room's sensor lags by 20 s.
    **dict.fromkeys(CHANNELS, _SIGMAS * 0.05 + 0.03 + 0.01),
}
"""Largest error of a good reading: offset, noise and resolution of the instrument."""
_ENDINGS = ("finishing", "paused", "suspended", "faulted", "aborted", "done")


@dataclass(slots=True)
class AcknowledgedSamples:
    """Samples in the live journal that a reader has read, and which are so acknowledged: tick -> (wall_s, quality)."""

    rows: dict[int, tuple[float, bytes]] = field(default_factory=dict)

    def look(self, journal: Path) -> None:
        """Read new samples."""
        try:
            database = connect_read_only(journal, timeout_s=1.0)
        except sqlite3.Error:
            return
        try:
            query = "SELECT tick, wall_s, quality FROM samples WHERE tick > ? ORDER BY tick"
            for tick, wall_s, quality in database.execute(query, (max(self.rows, default=-1),)):
                self.rows[tick] = (wall_s, quality)
        except sqlite3.Error:
            pass  # The file does not exist yet, or its disk is gone.
        finally:
            database.close()


@dataclass(frozen=True, slots=True)
class JournalContent:
    """Content of a run's journal: samples as columns, states and events with their wall times."""

    ticks: tuple[int, ...] = ()
    wall_s: tuple[float, ...] = ()
    values: dict[str, list[float]] = field(default_factory=dict)
    quality: dict[str, list[int]] = field(default_factory=dict)
    raw_quality: tuple[bytes, ...] = ()
    states: tuple[tuple[float, str, str, str], ...] = ()
    events: tuple[tuple[float, str, str], ...] = ()
    sound: bool = True


def read_journal(path: Path) -> JournalContent:
    """Read a journal, complete or as a kill has left it; return an empty one if there is none."""
    if not path.is_file():
        return JournalContent()
    database = connect_read_only(path)
    try:
        sound = database.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'samples'").fetchone() is None:
            return JournalContent(sound=sound)  # Interrupted at its creation, before anything moved.
        rows = database.execute("SELECT tick, wall_s, quality FROM samples ORDER BY tick").fetchall()
    except sqlite3.Error:
        return JournalContent(sound=False)
    finally:
        database.close()
    reader = JournalReader(path)
    try:
        samples = reader.samples()
        columns = [signal.column for signal in reader.header.signals]
        states = tuple((row.wall_s, row.source, row.target, row.reason) for row in reader.states())
        events = tuple((row.wall_s, row.level, row.text) for row in reader.events())
    finally:
        reader.close()
    return JournalContent(
        tuple(row[0] for row in rows),
        tuple(row[1] for row in rows),
        {name: samples.values[:, k].tolist() for k, name in enumerate(columns)},
        {name: samples.quality[:, k].tolist() for k, name in enumerate(columns)},
        tuple(row[2] for row in rows),
        states,
        events,
        sound,
    )


def read_states(path: Path) -> list[tuple[float, str]]:
    """Return wall time and target of every transition so far, of a live journal too."""
    try:
        database = connect_read_only(path, timeout_s=1.0)
    except sqlite3.Error:
        return []
    try:
        return [(row[0], row[1]) for row in database.execute("SELECT wall_s, target FROM states ORDER BY id")]
    except sqlite3.Error:
        return []
    finally:
        database.close()


def lost(seen: AcknowledgedSamples, journal: JournalContent) -> int:
    """Return the acknowledged samples that are missing in the journal, or different."""
    kept = dict(zip(journal.ticks, zip(journal.wall_s, journal.raw_quality, strict=True), strict=True))
    return sum(kept.get(tick) != row for tick, row in seen.rows.items())


def safe_since(truth: list[Moment], occurred_s: float) -> float | None:
    """Return the wall time from which nothing heats, not before `occurred_s`; None if something heats to the end."""
    if not truth or truth[-1].heater_W > 0.0:
        return None
    last = next((k for k in range(len(truth) - 1, -1, -1) if truth[k].heater_W > 0.0), None)
    if last is None:
        return occurred_s
    return max(truth[last + 1].wall_s, occurred_s)


def watchdog_at(truth: list[Moment], occurred_s: float) -> float | None:
    """Return the time at which the rig's own watchdog cut the heater, after `occurred_s`."""
    return next((m.wall_s for m in truth if m.wall_s >= occurred_s and m.status & WATCHDOG_TRIPPED), None)


def guardian_at(folder: Path | None, occurred_s: float) -> float | None:
    """Return the time at which the run's guardian began to make the rig safe, after `occurred_s`."""
    try:
        lines = (folder or Path()).joinpath("guardian.log").read_text(encoding="utf-8").splitlines()
        rows = [json.loads(line) for line in lines]
    except (OSError, ValueError):
        return None
    return next((row["wall_s"] for row in rows if row["what"] == "acting" and row["wall_s"] >= occurred_s), None)


def tries_on(pid: int) -> bool:
    """Return True if the guardian `pid` states that the rig is not safe and that it goes on.

    Its log is read by its own descriptor: the attack may have deleted the run's folder.
    """
    try:
        for name in os.listdir(f"/proc/{pid}/fd"):
            path = f"/proc/{pid}/fd/{name}"
            if "guardian.log" in os.readlink(path):
                last = Path(path).read_text(encoding="utf-8", errors="replace").splitlines()[-1]
                return bool(json.loads(last)["what"] == "not safe")
    except (OSError, ValueError, IndexError, KeyError):
        pass
    return False


def ended_at(journal: JournalContent, occurred_s: float) -> float | None:
    """Return the time at which the harness left its running state, after `occurred_s`."""
    return next((row[0] for row in journal.states if row[0] >= occurred_s and row[2] in _ENDINGS), None)


def noticed_at(journal: JournalContent, occurred_s: float, until_s: float) -> float | None:
    """Return the time of the first value that is not good, or of the first warning, between the two times."""
    samples = zip(journal.wall_s, journal.raw_quality, strict=True)
    bad = (wall_s for wall_s, quality in samples if occurred_s <= wall_s < until_s and any(quality))
    told = (row[0] for row in journal.events if occurred_s <= row[0] < until_s and row[1] in ("WARN", "ERROR"))
    return min([*_first(bad), *_first(told)], default=None)


def _first(times: Any) -> list[float]:
    return [time for time in [next(iter(times), None)] if time is not None]


def wrong_values(journal: JournalContent, truth: list[Moment]) -> list[str]:
    """Return the values recorded as good that were not true at any time within the staleness limit, a sentence each."""
    times = [moment.wall_s for moment in truth]
    found = []
    for row, wall_s in enumerate(journal.wall_s):
        low = bisect.bisect_left(times, wall_s - STALE_AFTER_S - 2 * PERIOD_S - _SLACK_S)
        window = truth[max(low - 1, 0) : bisect.bisect_right(times, wall_s + PERIOD_S) + 1]
        if not window:
            continue
        for name, tolerance in _TOLERANCE.items():
            if journal.quality[name][row] != Quality.GOOD:
                continue
            value, true = journal.values[name][row], [_true(moment, name) for moment in window]
            if not min(true) - tolerance <= value <= max(true) + tolerance:
                found.append(
                    f"tick {journal.ticks[row]}: {name} {value:g} recorded as good, "
                    f"true were {min(true):.2f} to {max(true):.2f}"
                )
    return found


def _true(moment: Moment, name: str) -> float:
    if name in CHANNELS:
        return moment.junctions_C[CHANNELS.index(name)]
    return {
        "heater_power_W": moment.power_W,
        "flow_L_per_min": moment.flow_L_per_min,
        "pump_speed_pct": moment.pump_pct,
        "fan_speed_pct": moment.fan_pct,
        "T_ambient_C": moment.ambient_C,
    }[name]


def longest_stall_s(truth: list[Moment], since_s: float) -> float:
    """Return the longest wait of the rig for a processor, beyond its period, after `since_s`."""
    times = [moment.wall_s for moment in truth if moment.wall_s >= since_s]
    return max((b - a for a, b in zip(times, times[1:], strict=False)), default=0.0) - PERIOD_S
