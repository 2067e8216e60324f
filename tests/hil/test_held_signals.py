"""Signals to a run that come many at a time: they are one request, and cost no record."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from hil.run.engine import signals as held
from hil.run.engine.signals import RunSignals
from hil.run.session.derived_files import derive_files
from tests.hil.ended_run import ended_run, wait_until

PROJECT = Path(__file__).resolve().parents[2]
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,100,100,70\n9000,100,100,70\n"
"""Its meter is below 10 W, and the rig safe, in 4 s after a stop."""


def many(number: signal.Signals, count: int, every_s: float) -> None:
    for _ in range(count):
        os.kill(os.getpid(), number)
        time.sleep(every_s)


def test_a_key_that_is_held_down_is_one_request_and_a_later_one_is_another(monkeypatch):
    monkeypatch.setattr(held, "SECOND_REQUEST_S", 0.3)
    seen: list[bool] = []
    before = signal.getsignal(signal.SIGINT)
    with RunSignals() as signals:
        with signals.phase(lambda number, is_deliberate: seen.append(is_deliberate)):
            many(signal.SIGINT, 10, 0.03)
            time.sleep(0.4)
            many(signal.SIGINT, 3, 0.03)
        many(signal.SIGINT, 3, 0.03)  # between phases nothing happens
        with signals.phase(lambda number, is_deliberate: seen.append(is_deliberate)):
            many(signal.SIGINT, 1, 0.0)  # the key is still held
    assert seen == [True, *[False] * 9, True, False, False, False]
    assert signal.getsignal(signal.SIGINT) is before


def test_the_echoes_of_the_stop_cut_no_file_off_and_a_deliberate_signal_ends_the_making_alone(tmp_path, monkeypatch):
    # Longer than a busy machine may keep the thread of the echoes waiting between two of them.
    monkeypatch.setattr(held, "SECOND_REQUEST_S", 1.0)
    folder, manifest = ended_run(tmp_path / "run")
    with RunSignals() as signals:
        with signals.phase(lambda number, is_deliberate: None):
            many(signal.SIGINT, 2, 0.02)
        burst = threading.Thread(target=many, args=(signal.SIGINT, 20, 0.05))
        burst.start()
        assert derive_files(folder, manifest, lambda text: None, signals=signals).missing == {}
        burst.join()

        def slow(*paths: object) -> None:
            time.sleep(1.2)
            many(signal.SIGINT, 30, 0.01)
            time.sleep(30.0)

        monkeypatch.setattr("hil.review.write_review", slow)
        said: list[str] = []
        derived = derive_files(folder, manifest, said.append, signals=signals)
    assert derived.missing == {"review.rrd": "stopped by SIGINT", "report.html": "stopped by SIGINT"}
    assert folder.read_manifest()["missing"] == derived.missing
    assert "report " in said[-1] and "makes them from the journal" in said[-1]


def test_a_signal_in_a_finalizer_where_python_discards_exceptions_ends_the_making(tmp_path, monkeypatch):
    folder, manifest = ended_run(tmp_path / "run")

    class Finalized:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)
            time.sleep(0.01)

    def slow(*paths: object) -> None:
        Finalized()
        time.sleep(30.0)

    monkeypatch.setattr("hil.review.write_review", slow)
    began = time.monotonic()
    derived = derive_files(folder, manifest, lambda text: None)
    assert derived.missing == {"review.rrd": "stopped by SIGTERM", "report.html": "stopped by SIGTERM"}
    assert time.monotonic() - began < 20.0
    assert not any(isinstance(thread, threading.Timer) for thread in threading.enumerate())


def test_signals_that_gather_while_python_runs_no_handler_are_an_echo(monkeypatch):
    monkeypatch.setattr(held, "SECOND_REQUEST_S", 0.3)
    seen: list[bool] = []
    with RunSignals() as signals, signals.phase(lambda number, is_deliberate: seen.append(is_deliberate)):
        many(signal.SIGINT, 2, 0.0)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(number)
        time.sleep(0.5)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
        time.sleep(0.5)
        many(signal.SIGTERM, 1, 0.0)
    assert seen == [True, False, False, False, True]


@pytest.mark.parametrize("every_s", [0.004, 0.03])
def test_a_run_that_is_stopped_by_a_held_key_has_its_record_and_says_so(tmp_path, every_s):
    (tmp_path / "load.csv").write_text(LOAD)
    command = [sys.executable, "-m", "hil", "run", "load.csv", "--virtual", "--no-twin", "--no-viewer"]
    rig = str(PROJECT / "profiles" / "rigs" / "virtual.toml")
    out = (tmp_path / "out.txt").open("wb")
    running = subprocess.Popen(
        [*command, "--rig", rig], cwd=tmp_path, stdout=out, stderr=out, env=os.environ | {"PYTHONPATH": str(PROJECT)}
    )
    try:
        wait_until(lambda: b"running" in (tmp_path / "out.txt").read_bytes() or running.poll() is not None)
        time.sleep(1.0)
        end = time.monotonic() + 120.0
        while running.poll() is None and time.monotonic() < end:
            running.send_signal(signal.SIGINT)
            time.sleep(every_s)
    finally:
        running.kill()
        running.wait()
        out.close()
    said = (tmp_path / "out.txt").read_text()
    (folder,) = (tmp_path / "runs").iterdir()
    assert "Traceback" not in said and "Aborted" not in said, said
    assert (folder / "record.parquet").is_file() and (folder / "report.html").is_file()
    assert running.returncode == 1
    assert "stopped by the operator (Ctrl-C)" in said and f"resume runs/{folder.name}" in said


class Asked:
    """As much of an engine as signals need."""

    def __init__(self) -> None:
        self.reasons: list[str] = []

    def request_stop(self, reason: str) -> None:
        self.reasons.append(reason)


async def test_a_request_whose_cancellation_is_swallowed_stops_the_engine_before_it_heats():
    engine = Asked()
    with RunSignals() as signals, held.cancelling(signals):
        signal.raise_signal(signal.SIGINT)
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(5.0)
        with held.stopping(engine, signals):  # type: ignore[arg-type]
            assert engine.reasons == ["stopped by the operator (Ctrl-C)"]
            signal.raise_signal(signal.SIGTERM)
            await asyncio.sleep(0.0)
            await asyncio.sleep(0.0)
        assert engine.reasons[1:] == ["stopped by SIGTERM"]
        signal.raise_signal(signal.SIGINT)  # what follows the engine is not cancelled
        await asyncio.sleep(0.05)


def test_ctrl_c_at_any_instant_of_the_beginning_ends_the_command(tmp_path):
    (tmp_path / "load.csv").write_text(LOAD)
    command = [sys.executable, "-m", "hil", "run", "load.csv", "--virtual", "--no-twin", "--no-viewer"]
    rig = str(PROJECT / "profiles" / "rigs" / "virtual.toml")
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    with (tmp_path / "out.txt").open("wb") as out:
        started = [
            subprocess.Popen([*command, "--rig", rig], cwd=tmp_path, env=environment, stdout=out, stderr=out)
            for _ in range(6)
        ]
    try:
        for running in started:
            time.sleep(0.4)
            running.send_signal(signal.SIGINT)
        assert all(running.wait(60.0) != 0 for running in started)
    finally:
        for running in started:
            running.kill()
            running.wait()


def test_a_signal_after_the_run_does_not_replace_the_exit_code() -> None:
    """A supervisor that sends SIGTERM in the last moment reads how the run ended, not that it was killed."""
    code = (
        "import os, signal\n"
        "from hil.run.engine.signals import RunSignals\n"
        "with RunSignals(until_exit=True) as signals:\n"
        "    signals.hold()\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
        "raise SystemExit(3)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60.0, check=False).returncode == 3


@pytest.mark.parametrize(
    ("by_nohup", "heard"), [("signal.signal(signal.SIGHUP, signal.SIG_IGN)", None), ("", "SIGHUP")]
)
def test_a_run_that_was_started_by_nohup_outlives_its_terminal(by_nohup: str, heard: str | None) -> None:
    code = (
        "import os, signal\n"
        "from hil.run.engine.signals import RunSignals\n"
        f"{by_nohup}\n"
        "with RunSignals() as signals:\n"
        "    signals.hold()\n"
        "    os.kill(os.getpid(), signal.SIGHUP)\n"
        f"    assert (signals.first and signals.first.name) == {heard!r}\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        f"    assert signals.first.name == {heard or 'SIGTERM'!r}\n"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60.0, check=False).returncode == 0
