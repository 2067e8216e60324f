"""Benchmark of fleets: diagnoses of many records with one worker and with two, and the cost of handing a job out."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.bench.measure import Cell, ReportTable
from hil.executor import ExecutorOptions, Say, opened
from hil.fleet import FleetRequest, jobs_of, read_fleet, run_fleet

FULL, QUICK = 200, 8
"""Records of a measurement, and of a trial run."""
HOURS = 3.0
WORKERS = (1, 2)
EMPTY = 200
"""Empty tasks for the cost of handing one out."""
TWINS = Path(__file__).resolve().parents[2] / "profiles" / "twins"
RIG = TWINS.parent / "rigs" / "virtual.toml"
FLEET = """id = "bench"

[[rig]]
name = "virtual"
twin = "virtual.toml"
records = ["*.record.parquet"]

[[job]]
kind = "diagnose"
page = false
"""


def measure(records: int, seed: int, progress: Callable[[float, str], None]) -> tuple[ReportTable, ...]:
    """Measure; `progress` is called with the share done. Raises ExecutorError if there are no workers."""
    with tempfile.TemporaryDirectory(prefix="hil-bench-fleet-") as name:
        folder = Path(name)
        file = _made(folder, records, seed)
        fleet = read_fleet(file)
        jobs, rows, first = jobs_of(fleet), [], 0.0
        for number, workers in enumerate(WORKERS):
            options = ExecutorOptions(workers=workers)
            share = number / len(WORKERS)
            began = time.monotonic()
            found = run_fleet(
                FleetRequest(fleet, jobs, folder / f"out{workers}", options),
                lambda done, note, share=share: progress(share + done / len(jobs) / len(WORKERS), note),  # type: ignore[misc]
                lambda sentence: None,
            )
            took = time.monotonic() - began
            first = first or took
            cpu_s = sum(result.get("cpu_s", 0.0) for result in found.results.values())
            row: tuple[Cell, ...] = (workers, records - len(found.failed), took, cpu_s, records / took, first / took)
            rows.append(row)
        cost = _cost_of_a_task()
    columns = ("workers", "records done", "s", "processor s", "records/s", "times one worker")
    note = f"records of {HOURS:g} h at 1 Hz of the virtual rig; starting and ending the workers is part of the time"
    empty = ReportTable("task", "Cost of handing out a job", ("empty tasks", "ms each"), ((EMPTY, 1000.0 * cost),))
    return ReportTable("workers", "Diagnoses on one worker and on two", columns, tuple(rows), (note,)), empty


def nothing(given: Any, say: Say) -> None:
    """Do nothing, on a worker."""


def _cost_of_a_task() -> float:
    """Return the time of an empty task, all handed out at once to one worker, s."""
    with opened(ExecutorOptions(), lambda message: None) as executor:
        executor.submit(nothing, None, "first").result()
        began = time.monotonic()
        for future in [executor.submit(nothing, None, f"task{n}") for n in range(EMPTY)]:
            future.result()
        return (time.monotonic() - began) / EMPTY


def _made(folder: Path, records: int, seed: int) -> Path:
    """Write records, the shipped twin with its healthy record, and the fleet file; return the file."""
    from drivers.rig_file import load_rig
    from hil.record import write_record
    from hil.synthetic import direct_record, profile, setting

    for name in ("virtual.toml", "virtual.healthy.parquet"):
        shutil.copyfile(TWINS / name, folder / name)
    rig = load_rig(RIG)
    for number in range(records):
        case = setting(number, seed, HOURS, "healthy")
        write_record(direct_record(profile(case), rig, seed=case.seed, unit=0), folder / f"{number}.record.parquet")
    file = folder / "fleet.toml"
    file.write_text(FLEET, encoding="utf-8")
    return file
