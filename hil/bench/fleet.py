"""Benchmark of fleets: diagnoses of many records with one worker, with two, and with one of two killed; and the cost of
handing a job out.
"""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.bench.measure import Cell, ReportTable, processes
from hil.executor import ExecutorOptions, Say, opened
from hil.fleet import FleetFolder, FleetRequest, Job, jobs_of, known_results, read_fleet, run_fleet

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
        stages = len(WORKERS) + 1

        def run(stage: int, workers: int, hear: Callable[[int], None] = lambda done: None) -> tuple[FleetFolder, float]:
            def report(done: int, note: str) -> None:
                hear(done)
                progress((stage + done / len(jobs)) / stages, note)

            folder_of = folder / f"out{stage}"
            began = time.monotonic()
            run_fleet(FleetRequest(fleet, jobs, folder_of, ExecutorOptions(workers=workers)), report, lambda note: None)
            return FleetFolder(folder_of), time.monotonic() - began

        for stage, workers in enumerate(WORKERS):
            out, took = run(stage, workers)
            first = first or took
            results = known_results(out, jobs).values()
            done = sum(result["status"] == "done" for result in results)
            cpu_s = sum(result.get("cpu_s", 0.0) for result in results)
            row: tuple[Cell, ...] = (workers, done, took, cpu_s, records / took, first / took)
            rows.append(row)
        killer = _Killer(records // 2)
        hurt = _after_a_kill(*run(len(WORKERS), WORKERS[-1], killer.hear), jobs, known_results(out, jobs))
        cost = _cost_of_a_task()
    columns = ("workers", "records done", "s", "processor s", "records/s", "times one worker")
    note = f"records of {HOURS:g} h at 1 Hz of the virtual rig; starting and ending the workers is part of the time"
    empty = ReportTable("task", "Cost of handing out a job", ("empty tasks", "ms each"), ((EMPTY, 1000.0 * cost),))
    table = ReportTable("workers", "Diagnoses on one worker and on two", columns, tuple(rows), (note,))
    return table, hurt, empty


class _Killer:
    """Kill of a worker of this process's cluster once so many jobs are done."""

    def __init__(self, at: int) -> None:
        self._at, self._killed = at, False

    def hear(self, done: int) -> None:
        """Take the number of finished jobs."""
        if done < self._at or self._killed:
            return
        workers = [pid for pid in processes.children(os.getpid()) if b"spawn_main" in processes.command(pid)]
        if workers:
            self._killed = True
            os.kill(workers[0], signal.SIGKILL)


def _after_a_kill(
    out: FleetFolder, took: float, jobs: tuple[Job, ...], whole: dict[str, dict[str, Any]]
) -> ReportTable:
    """Return the table of a fleet whose worker was killed, compared with one that nobody disturbed."""
    found = known_results(out, jobs)
    logs = [(out.path / "logs" / f"{job.id}.log").read_text(encoding="utf-8") for job in jobs]
    rows: tuple[tuple[Cell, ...], ...] = (
        ("records", len(jobs)),
        ("done", sum(result["status"] == "done" for result in found.values())),
        ("begun again, since their worker was lost", sum("was lost" in log for log in logs)),
        ("done more than once", sum(log.count(" done: ") > 1 for log in logs)),
        ("with another result than in the undisturbed fleet", sum(found[k]["row"] != whole[k]["row"] for k in found)),
        ("s in all", took),
    )
    note = "kill -9 of one of two workers when half of the records were done; another worker took its place"
    return ReportTable("killed", "A worker killed in the middle", ("what", "value"), rows, (note,))


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
