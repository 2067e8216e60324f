"""`hil bench loop`: jitter and processor time of the loop's ticks, its memory over hours, and the loss of a killed
run."""

from __future__ import annotations

import asyncio
import datetime
import json
import random
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.rig_file import load_rig
from drivers.virtual import start_virtual_rig
from hil.bench.loop import processor_time
from hil.bench.loop.processor_time import CountedClock, CountedConnection, CountedGuardian, CountedJournal, Counts
from hil.bench.measure import Cell, ReportTable, processes
from hil.journal import Header, JournalReader, profile_times
from hil.profile import Profile
from hil.run.engine import ControlError, Engine, Options, Outcome, ask

PROFILES = Path(__file__).resolve().parents[3] / "profiles"
RIG = PROFILES / "rigs" / "virtual.toml"
PERIOD_S = 0.1
GOAL_MS = 5.0
BEGUN = 0.05
"""Part of the profile from which memory counts: before, libraries are still being loaded."""
SETTLED_S = 7200.0
"""Time after the interruption at which an error of a kelvin after the thermal restore has decayed, s."""


@dataclass(frozen=True, slots=True)
class TimingSize:
    """Size of the benchmark: seconds of real time, and the profile that is run in lockstep."""

    real_s: float = 60.0
    profile: Path = PROFILES / "loads" / "battle_40h.csv"
    hours: float = 40.0


FULL = TimingSize()
QUICK = TimingSize(real_s=10.0, profile=PROFILES / "loads" / "battle_10h.csv", hours=10.0)


def measure(
    size: TimingSize, seed: int, work: Path, progress: Callable[[float, str], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return all tables; the runs' folders are kept in a new folder of `work`. Raise RuntimeError if a run fails."""
    work = work / datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    work.mkdir(parents=True)
    progress(0.0, "10 Hz in real time")
    outcome, samples, counts = asyncio.run(_real_time(size, seed, work / "journal.sqlite"))
    progress(0.2, f"{size.hours:g} h in lockstep")
    whole, memory, wall_s = _watched(size, seed, work / "whole", None)
    cut_s = random.Random(seed).uniform(0.2, 0.8) * size.hours * 3600.0
    progress(0.5, "the same, killed")
    killed, _, _ = _watched(size, seed, work / "cut", cut_s)
    before = _RunRows.read(killed)
    progress(0.65, "resumed")
    manifest = _hil("resume", killed, "--no-viewer", "--json")
    tables = (
        _timing_table(outcome, samples),
        processor_time.table(counts),
        _memory_table(memory, size, wall_s),
        *_resume_tables(_RunRows.read(whole), before, _RunRows.read(killed), manifest),
    )
    return tables, ()


async def _real_time(size: TimingSize, seed: int, path: Path) -> tuple[Outcome, NDArray[np.float64], Counts]:
    """Run the engine at 10 Hz, guarded; return its outcome, per tick (n, 3) its number, when its work began, s, and how
    long that took, s, and its processor time. Raises RuntimeError where the run does not end as done."""
    counts = Counts()
    rig = load_rig(RIG).model_copy(update={"period_s": PERIOD_S})
    async with await start_virtual_rig(seed=seed, period_s=PERIOD_S) as virtual:
        rig = rig.with_ports({"plc": virtual.modbus_port, "thermocouples": virtual.can_port})
        clock = CountedClock(PERIOD_S, counts)
        connection = CountedConnection(rig, clock.now, counts)
        guard = CountedGuardian(rig, path.with_name("guardian.log"), counts)
        load = np.array([[500.0, 90.0, 70.0], [500.0, 90.0, 70.0]])
        columns = ("heater_power_W", "pump_speed_pct", "fan_speed_pct")
        profile = Profile("constant load", np.array([0.0, size.real_s]), columns, load)
        signals = connection.signals + tuple(point.as_signal() for point in rig.setpoints)
        header = Header(signals, {}, (), profile.name, size.real_s, PERIOD_S, {})
        journal = CountedJournal(path, header, counts)
        options = Options(guard=guard, residuals=guard.residuals)
        try:
            outcome = await Engine(connection, clock, profile, journal, options).run()
        finally:
            journal.close()
    if outcome.status != "done":
        raise RuntimeError(f"the run at 10 Hz ended {outcome.status}: {outcome.reason}")
    reader = JournalReader(path)
    try:
        return outcome, reader.timing(), counts
    finally:
        reader.close()


def _timing_table(outcome: Outcome, timing: NDArray[np.float64]) -> ReportTable:
    tick, began, took = timing.T
    late = began - tick * PERIOD_S
    off_ms = 1e3 * np.abs(late - np.median(late))
    factor = (tick[-1] - tick[0]) * PERIOD_S / (began[-1] - began[0])

    def row(name: str, values: NDArray[np.float64]) -> tuple[Cell, ...]:
        return (name, *(float(v) for v in np.percentile(values, [50, 99])), float(values.max()))

    rows = (
        row("from the grid to the beginning of a tick, ms", off_ms),
        row("work in a tick: read, judge, write, journal, ms", 1e3 * took),
    )
    notes = (
        f"{len(tick)} ticks of {len(load_rig(RIG).point)} points, two processes on Modbus/TCP and CAN; "
        f"{outcome.overruns} ticks began late by more than a period; times real time: {factor:.4f}.",
        f"Goal: 99 % within {GOAL_MS:g} ms of the grid on a quiet machine of two cores: "
        f"{'met' if np.percentile(off_ms, 99) < GOAL_MS else 'not met'} here. The manifest has the machine's load.",
    )
    return ReportTable("timing", "10 Hz in real time", ("what", "median", "99 %", "longest"), rows, notes)


@dataclass(frozen=True, slots=True)
class _Memory:
    """Resident memory, MB, of the loop and of all its calibrators, at a profile time."""

    profile_s: float
    loop_MB: float
    calibrators_MB: float


def _watched(size: TimingSize, seed: int, runs: Path, kill_s: float | None) -> tuple[Path, list[_Memory], float]:
    """Return folder, memory over time and wall time of a run as a user starts it; `kill_s`: SIGKILL at that profile
    time.
    """
    began = time.monotonic()
    command = ["run", str(size.profile), "--virtual", "--lockstep", "--no-viewer", "--seed", str(seed)]
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *command, "--runs", str(runs)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=PROFILES.parent,
        text=True,
    )
    memory: list[_Memory] = []
    try:
        while process.poll() is None:
            folder = next(iter(runs.glob("*/control.sock")), None)
            status = None if folder is None else _status(folder)
            if status is not None and status["state"] == "running":
                profile_s = float(status["profile_s"])
                memory.append(_Memory(profile_s, processes.resident_MB(process.pid), _calibrators_MB(process.pid)))
                if kill_s is not None and profile_s >= kill_s:
                    process.kill()
            time.sleep(0.2)
    finally:
        process.kill()
        assert process.stderr is not None
        said = process.communicate()[1]
    if kill_s is None and process.returncode != 0:
        raise RuntimeError(f"hil {' '.join(command)} failed: {said.strip().splitlines()[-1]}")
    return next(iter(runs.glob("*/run.json"))).parent, memory, time.monotonic() - began


def _status(socket: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = ask(socket, "status")["status"]
    except ControlError:
        return None
    return found


def _calibrators_MB(pid: int) -> float:
    named = [child for child in processes.children(pid) if b"multiprocessing" in processes.command(child)]
    return sum(processes.resident_MB(child) for child in named)


def _memory_table(memory: list[_Memory], size: TimingSize, wall_s: float) -> ReportTable:
    first = next(m for m in memory if m.profile_s >= BEGUN * size.hours * 3600.0)
    last = memory[-1]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (name, before, after, after - before)
        for name, before, after in (
            ("loop", first.loop_MB, last.loop_MB),
            ("calibrators", first.calibrators_MB, last.calibrators_MB),
        )
    )
    columns = ("process", f"at {first.profile_s / 3600:.1f} h", f"at {last.profile_s / 3600:.1f} h", "grown")
    note = f"{size.hours:g} h in {wall_s:.0f} s with record, review and report: {3600 * size.hours / wall_s:.0f} times."
    return ReportTable("memory", f"Resident memory over {size.hours:g} h in lockstep, MB", columns, rows, (note,))


def _hil(*arguments: object) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "hil", *map(str, arguments)], capture_output=True, text=True, cwd=PROFILES.parent
    )
    if done.returncode != 0:
        raise RuntimeError(f"hil {arguments[0]} failed: {(done.stderr.strip() or done.stdout).splitlines()[-1]}")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@dataclass(frozen=True, slots=True)
class _RunRows:
    """Rows (n, k) of a run by tick, profile time, and the static twin's predictions (n, m)."""

    header: Header
    tick: NDArray[np.int64]
    profile_s: NDArray[np.float64]
    values: NDArray[np.float64]
    static: NDArray[np.float64]

    @classmethod
    def read(cls, folder: Path) -> _RunRows:
        reader = JournalReader(folder / "journal.sqlite")
        try:
            samples = reader.samples()
            static = reader.twin_outputs("static").values
            profile_s = profile_times(reader.states(), samples.tick, reader.header.period_s)
            return cls(reader.header, samples.tick, profile_s, samples.values, static)
        finally:
            reader.close()

    def moving(self) -> NDArray[np.int64]:
        """Return the rows with a running clock of the profile."""
        return np.flatnonzero(np.diff(self.profile_s, prepend=-1.0) > 0)

    def column(self, name: str) -> int:
        return [signal.column for signal in self.header.signals].index(name)


def _resume_tables(
    whole: _RunRows, before: _RunRows, after: _RunRows, manifest: dict[str, Any]
) -> tuple[ReportTable, ...]:
    segment, count = manifest["segments"][0], len(before.tick)
    kept = np.array_equal(after.tick[:count], before.tick) and np.array_equal(
        after.values[:count], before.values, equal_nan=True
    )
    mine, theirs = after.moving(), whole.moving()
    same_grid = np.array_equal(after.profile_s[mine], whole.profile_s[theirs])
    setpoints = [i for i, signal in enumerate(whole.header.signals) if signal.kind == "setpoint"]
    away = np.abs(after.values[mine][:, setpoints] - whole.values[theirs][:, setpoints]).max(axis=1) > 1e-9
    facts: tuple[tuple[Cell, ...], ...] = (
        ("killed at, h of the profile", segment["profile_s"] / 3600.0),
        ("gap, s", segment["gap_s"]),
        ("thermal restore, min", segment["restore_s"] / 60.0),
        ("rows that were acknowledged", count),
        ("of these lost or changed", 0 if kept else "some"),
        ("every second of the profile once", "yes" if same_grid else "no"),
        ("seconds with another set-point", int(away.sum())),
        ("windows calibrated after it", sum(1 for _ in _later_windows(manifest))),
    )
    story = ReportTable("resumed", "Killed at a random instant and resumed", ("what", "found"), facts)
    if not same_grid:
        return (story,)
    at = whole.profile_s[theirs]
    parts = {
        "before": at < segment["profile_s"],
        "2 h after": (at >= segment["profile_s"]) & (at < segment["profile_s"] + SETTLED_S),
        "later": at >= segment["profile_s"] + SETTLED_S,
    }
    rows: list[tuple[Cell, ...]] = []
    for k, (sensor, columns) in enumerate(whole.header.twin_sensors.items()):
        own, other = (
            j.values[r][:, [j.column(c) for c in columns]].mean(axis=1) for j, r in ((after, mine), (whole, theirs))
        )
        off = own - other
        rest = off - (after.static[mine, k] - whole.static[theirs, k])
        noise = float(np.sqrt(2.0) * whole.header.noise_K[sensor])
        later = _rms(rest[parts["later"]])
        rows.append(
            (
                sensor,
                _rms(off[parts["before"]]),
                _rms(off[parts["2 h after"]]),
                _rms(off[parts["later"]]),
                later,
                noise,
                "yes" if later <= 1.25 * noise else "no",
            )
        )
    notes = (
        "room out: less what the static twin expects of the two runs' room temperatures, which are of other hours. "
        "noise: of the difference of two readings. within: room out is at most 1.25 times that.",
    )
    columns_ = ("sensor", *parts, "later, room out", "noise", "within")
    return story, ReportTable(
        "difference", "RMS difference to a run that nothing disturbed, K", columns_, tuple(rows), notes
    )


def _later_windows(manifest: dict[str, Any]) -> list[float]:
    reader = JournalReader(Path(manifest["folder"]) / "journal.sqlite")
    try:
        return [row.end_s for row in reader.calibrations() if row.start_s >= manifest["segments"][0]["from_s"]]
    finally:
        reader.close()


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if len(values) else float("nan")
