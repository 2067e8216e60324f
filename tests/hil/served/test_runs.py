"""Runs on served rig files: with `hil run --virtual`, and on a rig that `hil rig` serves in another process."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hil.run_folder import RunFolder
from tests.hil.command_line import typed
from tests.hil.served.rig_files import PROJECT, bench_file, loop_file

LOAD = "time_s,heater_power_W,pump_speed_pct\n0,0,100\n60,800,100\n600,800,50\n1200,800,50\n"


@pytest.fixture(autouse=True)
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")


def hil(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Return the answer of the command line in this process, in another folder; rig and plant are processes still."""
    with contextlib.chdir(cwd):
        return typed(*arguments)


@contextlib.contextmanager
def served(folder: Path, *arguments: str) -> Iterator[list[str]]:
    """`hil rig ARGUMENTS` in a process of its own; yields its lines."""
    environment = {**os.environ, "PYTHONPATH": str(PROJECT), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", "rig", *arguments], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    lines = []
    try:
        for line in process.stdout:
            lines.append(line.rstrip())
            if "Ctrl-C ends it" in line:
                break
        yield lines
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
        assert process.returncode == 0


def columns(folder: Path) -> dict[str, np.ndarray]:
    (run,) = (folder / "runs").iterdir()
    table = pq.read_table(RunFolder(run).record)
    return {name: table[name].to_numpy() for name in table.column_names}


def test_virtual_serves_a_rig_file_with_its_twin_as_the_plant(tmp_path: Path) -> None:
    loop_file(tmp_path)
    (tmp_path / "load.csv").write_text(LOAD)
    options = ("--virtual", "--lockstep", "--no-viewer", "--no-report", "--calibrator", "least_squares")
    done = hil("run", "load.csv", "--rig", "loop.toml", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "inverse crime" in done.stderr
    record = columns(tmp_path)
    assert record["heater_power_W"][-100:] == pytest.approx(800.0)
    assert record["pump_speed_pct"][-1] == pytest.approx(50.0, abs=1.0)
    warmer_K = record["T_heater_C"][-20:].mean() - record["T_heater_C"][:20].mean()
    assert warmer_K > 3.0
    (run,) = (tmp_path / "runs").iterdir()
    errors = RunFolder(run).read_manifest()["errors_K"]
    assert errors["rows"]["T_tank_C"][errors["columns"].index("static")] < 0.2


def test_a_run_in_lockstep_is_the_same_every_time(tmp_path: Path) -> None:
    records = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        loop_file(folder)
        (folder / "load.csv").write_text(LOAD)
        options = ("--virtual", "--lockstep", "--no-twin", "--no-viewer", "--no-report", "--seed", "4")
        assert hil("run", "load.csv", "--rig", "loop.toml", *options, cwd=folder).returncode == 0
        records.append(columns(folder))
    assert np.array_equal(records[0]["T_tank_C"], records[1]["T_tank_C"])
    assert np.ptp(records[0]["T_tank_C"]) > 0.1


def test_hil_runs_on_a_rig_that_is_served_elsewhere_and_leaves_it_safe(tmp_path: Path) -> None:
    bench_file(tmp_path)
    (tmp_path / "load.csv").write_text("time_s,heater_power_W,valve_set_pct\n0,100,40\n4,500,60\n8,500,60\n")
    with served(tmp_path, "bench.toml", "--out", "served.toml") as lines:
        assert any("No twin" in line for line in lines)
        done = hil("run", "load.csv", "--rig", "served.toml", "--no-viewer", "--no-report", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        again = hil("run", "load.csv", "--rig", "served.toml", "--no-viewer", "--check-only", cwd=tmp_path)
        assert again.returncode == 0
        online = hil("check", "served.toml", "--online", cwd=tmp_path)
        assert "all 14 points are good" in online.stdout
    record = columns(tmp_path)
    assert record["heater_power_W"].max() == pytest.approx(500.0, abs=0.1)
    (run,) = (tmp_path / "runs").iterdir()
    manifest = RunFolder(run).read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("done", True)


def test_lockstep_is_granted_from_another_process(tmp_path: Path) -> None:
    loop_file(tmp_path)
    (tmp_path / "load.csv").write_text(LOAD)
    with served(tmp_path, "loop.toml", "--out", "served.toml", "--mode", "lockstep") as lines:
        control = next(line.split("--control ")[1] for line in lines if "--control" in line)
        options = ("--control", control, "--no-twin", "--no-viewer", "--no-report")
        done = hil("run", "load.csv", "--rig", "served.toml", *options, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert len(columns(tmp_path)["T_tank_C"]) >= 1200


def test_an_interlock_trips_a_served_run(tmp_path: Path) -> None:
    file = loop_file(tmp_path)
    file.write_text(file.read_text().replace("alarm = [0, 75]", "alarm = [0, 30]"))
    (tmp_path / "load.csv").write_text("time_s,heater_power_W,pump_speed_pct\n0,2000,100\n3000,2000,100\n")
    options = ("--virtual", "--lockstep", "--no-twin", "--no-viewer", "--no-report")
    done = hil("run", "load.csv", "--rig", "loop.toml", *options, cwd=tmp_path)
    assert done.returncode == 1
    (run,) = (tmp_path / "runs").iterdir()
    manifest = RunFolder(run).read_manifest()
    assert "T_heater" in manifest["reason"]
    assert manifest["safe"] is True


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("bench.toml",), "bus plc is at 192.168.1.20:502, which is not this machine; add --out served.toml"),
        (("bench.toml", "--out", "bench.toml"), "bench.toml is a file that this command reads"),
        (("bench.toml", "--out", "notes.toml"), "notes.toml: is there already and no served copy"),
        (("bench.toml", "--serial"), "--serial is of the built-in virtual rig"),
        (("--out", "served.toml"), "belong to a rig file"),
        (("bench.toml", "--twin", "bench.toml", "--out", "s.toml"), "bench.toml"),
        (("bench.toml", "--out", "none/s.toml"), "none is no folder that is there"),
    ],
)
def test_mistakes_give_a_sentence(tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    bench_file(tmp_path)
    (tmp_path / "notes.toml").write_text("kept", encoding="utf-8")
    done = hil("rig", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert (tmp_path / "notes.toml").read_text(encoding="utf-8") == "kept"
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


def test_a_port_in_use_gives_a_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        line = 'transport = "modbus_rtu"\nserial_port = "/dev/ttyUSB7"'
        changes = {"192.168.1.20": "127.0.0.1", "port = 502": f"port = {port}"}
        changes[line] = f'transport = "modbus_tcp"\nhost = "127.0.0.1"\nport = {port}'
        bench_file(tmp_path, **changes)
        done = hil("rig", "bench.toml", cwd=tmp_path)
        assert done.returncode == 1
        assert f"port 127.0.0.1:{port} is in use" in done.stderr
        assert "--out served.toml" in done.stderr


def test_the_file_s_own_ports_are_served_where_they_are_here(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    line = 'transport = "modbus_rtu"\nserial_port = "/dev/ttyUSB7"'
    changes = {"192.168.1.20": "127.0.0.1", "port = 502": f"port = {port}"}
    changes[line] = f'transport = "modbus_tcp"\nhost = "127.0.0.1"\nport = {port}'
    bench_file(tmp_path, **changes)
    with served(tmp_path, "bench.toml"):
        time.sleep(0.5)
        assert "all 14 points are good" in hil("check", "bench.toml", "--online", cwd=tmp_path).stdout
