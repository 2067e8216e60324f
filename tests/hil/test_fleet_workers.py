"""Fleets on worker processes: a killed worker, cancellation, a worker without this version."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pyarrow.parquet as pq
import pytest

from tests.docs.fences import PROJECT
from tests.hil.command_line import typed
from tests.hil.made_fleet import TRACKED, made_fleet

pytest.importorskip("distributed")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(PROJECT), "OPENBLAS_NUM_THREADS": "1"}
PATIENCE_S = 120.0
SEEDS = 12
"""Seeds of a fleet that is to be cancelled: it lasts for seconds."""


def until(found, what: str):
    """Wait for a condition; return what it gives."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if value := found():
            return value
        time.sleep(0.02)
    raise AssertionError(f"no {what} within {PATIENCE_S:g} s")


@contextmanager
def started(*words: object, log, environment=ENVIRONMENT):
    """Start a process, which is killed at the end of the block."""
    out = log.open("wb")
    process = subprocess.Popen(
        [sys.executable, "-m", *map(str, words)],
        env=environment,
        stdout=out,
        stderr=subprocess.STDOUT,
        cwd=log.parent,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        out.close()


@pytest.fixture
def scheduler(tmp_path):
    """Start a plain scheduler of Dask; return its address."""
    log = tmp_path / "scheduler.log"
    words = ("dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    with started(*words, log=log):
        yield until(lambda: re.search(r"Scheduler at:\s+(tcp://[\d.:]+)", log.read_text()), "scheduler")[1]


def worker(address, log, environment=ENVIRONMENT):
    words = ("dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", log.stem)
    return started(*words, environment=environment, log=log)


def logs(out):
    return {path.stem: path.read_text(encoding="utf-8") for path in (out / "logs").glob("*.log")}


def begun(out):
    """Return the worker of a job that has begun and not ended, with the job."""
    if not (out / "logs").is_dir():
        return None
    for job, text in logs(out).items():
        if "begins" in text and "done" not in text:
            return job, re.search(r"(tcp://\S+) attempt", text)[1]
    return None


def listener(address: str, *candidates: subprocess.Popen) -> subprocess.Popen:
    """Return the process that listens at the address."""
    port = f":{int(address.rpartition(':')[2]):04X}"
    with open("/proc/net/tcp", encoding="ascii") as table:
        inodes = {row.split()[9] for row in table if row.split()[1].endswith(port) and row.split()[3] == "0A"}
    for process in candidates:
        with os.scandir(f"/proc/{process.pid}/fd") as handles:
            if {f"socket:[{inode}]" for inode in inodes} & {os.readlink(handle.path) for handle in handles}:
                return process
    raise AssertionError(f"no worker listens at {address}")


def test_of_two_workers_one_is_killed_and_nothing_is_lost_or_done_twice(tmp_path, scheduler):
    file, out = made_fleet(tmp_path / "in", records=6), tmp_path / "out"
    with (
        worker(scheduler, tmp_path / "w1.log") as first,
        worker(scheduler, tmp_path / "w2.log") as second,
        started("hil", "fleet", file, "--on", scheduler, "--out", out, log=tmp_path / "fleet.log") as fleet,
    ):
        job, address = until(lambda: begun(out), "job")
        listener(address, first, second).send_signal(signal.SIGKILL)
        assert fleet.wait(PATIENCE_S) == 0, (tmp_path / "fleet.log").read_text()
    rows = {row["job"]: row for row in pq.read_table(out / "results.parquet").to_pylist()}
    assert len(rows) == 6 and {row["status"] for row in rows.values()} == {"done"}
    assert rows[job]["attempts"] == 2 and rows[job]["worker"] != address
    found = logs(out)
    assert "attempt 2 begins: the worker of the attempt before was lost" in found[job]
    assert all(text.count(" done: ") == 1 for text in found.values())
    other = tmp_path / "other"
    assert typed("fleet", file, "--on", "here", "--out", other).returncode == 0
    for row in pq.read_table(other / "results.parquet").to_pylist():
        assert row["rmse_least_squares_K"] == rows[row["job"]]["rmse_least_squares_K"]
    assert sorted(path.name for path in (out / "files").iterdir()) == sorted(rows)


# A signal of the terminal takes the way of SIGTERM.
@pytest.mark.parametrize("how", ["verb", signal.SIGTERM])
def test_a_cancelled_fleet_keeps_what_is_done_and_the_same_command_does_the_rest(tmp_path, how):
    seeds = f"seeds = {list(range(SEEDS))}\n"
    file, out = made_fleet(tmp_path / "in", records=4, jobs=TRACKED + seeds), tmp_path / "out"
    words = ("hil", "fleet", file, "--workers", 1, "--out", out)
    with started(*words, log=tmp_path / "fleet.log") as fleet:
        until(lambda: list(out.glob("jobs/*.json")), "result")
        done = typed("fleet", file, "--out", out)
        assert done.returncode == 2 and "another process works on this folder" in done.stderr
        if how == "verb":
            assert typed("fleet", file, "--out", out, "--cancel").returncode == 0
        else:
            fleet.send_signal(how)
        assert fleet.wait(PATIENCE_S) == 130, (tmp_path / "fleet.log").read_text()
    said = (tmp_path / "fleet.log").read_text()
    assert "cancelled; the same command does what is left" in said and "Traceback" not in said
    # A result that was cut off half written is a hidden part, which the next call removes.
    before = {path.name: path.stat().st_mtime_ns for path in (out / "jobs").glob("[!.]*")}
    assert 1 <= len(before) < 4 * SEEDS
    assert typed("fleet", file, "--on", "here", "--out", out).returncode == 0
    after = {path.name: path.stat().st_mtime_ns for path in (out / "jobs").glob("[!.]*")}
    assert len(after) == 4 * SEEDS and before.items() <= after.items()


def test_a_worker_without_this_version_is_named_before_any_job(tmp_path, scheduler):
    old = tmp_path / "old/hil"
    old.mkdir(parents=True)
    (old / "__init__.py").write_text('__version__ = "0.0.1"\n', encoding="utf-8")
    file, out = made_fleet(tmp_path / "in", records=1, hours=0.2), tmp_path / "out"
    log = tmp_path / "w1.log"
    with worker(scheduler, log, {**ENVIRONMENT, "PYTHONPATH": str(old.parent)}):
        until(lambda: "Registered to" in log.read_text(), "worker")
        done = typed("fleet", file, "--on", scheduler, "--out", out)
    assert done.returncode == 1 and done.stderr.count("hil: ") == 1
    # A part of this installation may be found behind the old package's name.
    assert "has no hil, or an older one" in done.stderr or "has hil 0.0.1, here it is" in done.stderr
    assert "install the same version there" in done.stderr
    assert not list((out / "jobs").iterdir())


def test_a_worker_that_comes_later_is_waited_for(tmp_path, scheduler):
    file, out = made_fleet(tmp_path / "in", records=1, hours=0.2), tmp_path / "out"
    log = tmp_path / "fleet.log"
    with started("hil", "fleet", file, "--on", scheduler, "--out", out, log=log) as fleet:
        until(lambda: "no worker is connected" in log.read_text(), "notice")
        with worker(scheduler, tmp_path / "w1.log"):
            assert fleet.wait(PATIENCE_S) == 0, log.read_text()
