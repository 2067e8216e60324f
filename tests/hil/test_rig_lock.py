"""One run drives a rig at a time, and no run ends well on a rig that was not seen safe."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from drivers.rig_model import Rig
from drivers.rigfile import load_rig
from hil.commands.run import command as run_command
from hil.control import ask, live_runs
from hil.engine import Outcome
from hil.rig_lock import RigBusyError, claimed, end_points
from hil.run_folder import RunFolder
from hil.run_request import RunRequest
from hil.session import run_session
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import rig_with

PROJECT = Path(__file__).resolve().parents[2]
HIL = [sys.executable, "-m", "hil"]
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,100,100,100\n{end},100,100,100\n"
HOLDER = """
import sys, time
from pathlib import Path
from drivers.rigfile import load_rig
from hil.rig_lock import claimed
with claimed(load_rig(Path(sys.argv[1])), print) as claim:
    claim.tell(Path("/runs/first"))
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture(autouse=True)
def _locks_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


def rig_file(place: Path, modbus: int, can: int, host: str = "127.0.0.1") -> Path:
    """The shipped rig at other addresses."""
    text = (PROJECT / "profiles/rigs/virtual.toml").read_text(encoding="utf-8")
    text = text.replace("port = 5020", f"port = {modbus}").replace("port = 29536", f"port = {can}")
    text = text.replace('"127.0.0.1"', f'"{host}"')
    for folder, name in (("rigs/", "thermocouples.dbc"), ("twins/", "virtual.toml")):
        text = text.replace(f'"../{folder}{name}"', f'"{name}"').replace(
            f'"{name}"', f'"{PROJECT}/profiles/{folder}{name}"'
        )
    path = place / f"rig-{host}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in probes]


def with_bus(**changed: object) -> Rig:
    """The shipped rig with its PLC elsewhere."""
    rig = load_rig(PROJECT / "profiles/rigs/virtual.toml")
    return rig.model_copy(update={"bus": rig.bus | {"plc": rig.bus["plc"].model_copy(update=changed)}})


@contextlib.contextmanager
def holding(rig: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has the rig."""
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(rig)], cwd=PROJECT, stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        yield holder
    finally:
        holder.kill()
        holder.communicate()


async def test_a_second_run_is_refused_before_the_rig_hears_of_it_and_goes_when_the_first_was_killed(tmp_path):
    (tmp_path / "load.csv").write_text(LOAD.format(end=700), encoding="utf-8")
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.setblocking(False)
        port = int(listener.getsockname()[1])
        first, second = (rig_file(tmp_path, port, port, host) for host in ("127.0.0.1", "localhost"))
        with holding(first) as holder:
            request = RunRequest(
                tmp_path / "load.csv", rig=second, twin=None, use_twin=False, runs=tmp_path / "runs", viewer=False
            )
            with pytest.raises(RigBusyError) as refused:
                await run_session(request)
            with pytest.raises(BlockingIOError):
                listener.accept()  # nobody has called
            assert not (tmp_path / "runs").exists()
            said = str(refused.value)
            assert said.splitlines() == [said]
            assert f"localhost:{port}" in said
            assert f"the run /runs/first (process {holder.pid})" in said
            assert "`hil ctl abort /runs/first`" in said
            holder.kill()
            holder.wait()
        with claimed(load_rig(second), print):
            pass


@contextlib.contextmanager
def running(place: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A run of its own process that has come to running, and its folder under `place`."""
    run = subprocess.Popen([*HIL, "run", *arguments, "--runs", str(place)], cwd=PROJECT, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60
        while not (live := live_runs(place)) or ask(live[0] / "control.sock", "status")["text"] != "running":
            assert time.monotonic() < deadline and run.poll() is None
            time.sleep(0.1)
        yield run, live[0]
    finally:
        run.kill()
        run.wait()


def test_runs_on_one_rig_from_two_terminals(tmp_path):
    def beside(verb: str, *more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*HIL, verb, *more], cwd=PROJECT, capture_output=True, text=True, timeout=60)

    modbus, can = free_ports(2)
    options = [str(tmp_path / "load.csv"), "--rig", str(rig_file(tmp_path, modbus, can)), "--no-twin", "--no-viewer"]
    (tmp_path / "load.csv").write_text(LOAD.format(end=4000), encoding="utf-8")
    served = [*HIL, "rig", "--modbus-port", str(modbus), "--can-port", str(can)]
    with subprocess.Popen(served, cwd=PROJECT, stdout=subprocess.PIPE) as server, contextlib.ExitStack() as stack:
        stack.callback(server.kill)
        assert b"Virtual rig" in server.stdout.readline()
        with running(tmp_path / "first", *options) as (first, folder):
            refused = beside("run", *options, "--runs", str(tmp_path / "second"))
            assert (refused.returncode, "Traceback" in refused.stderr) == (1, False)
            assert f"{folder} (process {first.pid})" in refused.stderr
            assert not (tmp_path / "second").exists()
            assert beside("run", *options, "--check-only").returncode == 0
        with running(tmp_path / "second", *options) as (second, _):  # the first was killed
            resumed = beside("resume", str(folder), "--no-viewer")
            assert (resumed.returncode, f"(process {second.pid})" in resumed.stderr) == (1, True)
            assert RunFolder(folder).was_cut  # as it was
            second.send_signal(signal.SIGINT)
            second.wait(timeout=60)


def test_an_end_point_has_one_name_however_it_is_written(tmp_path):
    names = [set(end_points(with_bus(host=host))) for host in ("127.0.0.1", "localhost", "LocalHost", "::1")]
    assert all(name == names[0] for name in names)
    (tmp_path / "line").symlink_to("/dev/null")
    rtu = {"transport": "modbus_rtu", "serial_port": str(tmp_path / "line")}
    rig = load_rig(PROJECT / "profiles/rigs/virtual.toml").model_dump(exclude_unset=True)
    rig["bus"]["plc"] = rtu
    assert "serial /dev/null" in end_points(Rig.model_validate(rig))


def test_devices_behind_one_gateway_and_other_ports_are_apart():
    with claimed(with_bus(host="192.0.2.1"), pytest.fail):
        names = [
            set(end_points(with_bus(**other)))
            for other in ({}, {"device_id": 7}, {"port": 5021}, {"host": "192.0.2.1"})
        ]
        assert len(set.union(*names)) == 4
    reading = with_bus()
    points = tuple(p for p in reading.point if p.access == "r")
    assert not end_points(reading.model_copy(update={"point": points}))


def test_a_claim_that_ends_leaves_nothing_locked():
    rig, said = with_bus(), []
    with claimed(rig, said.append) as claim:
        with pytest.raises(RigBusyError, match=f"process {os.getpid()} is starting"), claimed(rig, said.append):
            pass
        claim.release()
        with claimed(rig, said.append):
            pass
    with claimed(None, said.append), claimed(rig, said.append):
        pass
    assert said == []


def test_without_a_folder_for_locks_a_run_goes_on_and_says_so(tmp_path, monkeypatch):
    (tmp_path / f"hil-rigs-{os.getuid()}").symlink_to("/usr")
    said: list[str] = []
    with claimed(with_bus(), said.append), claimed(with_bus(), said.append):
        pass
    assert len(said) == 2
    assert "nothing keeps a second run" in said[0]
    (tmp_path / f"hil-rigs-{os.getuid()}").unlink()
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(
            "hil.rig_lock._open_folder", lambda: (_ for _ in ()).throw(PermissionError("somebody else's"))
        )
        with claimed(with_bus(), said.append):
            assert "somebody else's" in said[-1]
    with claimed(with_bus(), pytest.fail):
        assert (tmp_path / f"hil-rigs-{os.getuid()}").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("reads_W", [0.0, 700.0])
def test_a_profile_that_is_over_is_no_good_end_where_the_heater_still_heats(reads_W):
    with EngineBench(rig_with(interlocks=()), duration_s=5.0) as bench:
        bench.ticks(3)
        bench.rig.readings["heater_power"] = reads_W
        bench.ticks(10)
        outcome = bench.outcome
        assert (outcome.status, outcome.safe, outcome.in_order) == ("done", True, reads_W == 0.0)
        assert outcome.away == ("" if reads_W == 0.0 else "heater_power reads 700.0 W where 0 W is safe")


@pytest.mark.parametrize(
    ("status", "safe", "away", "code"),
    [
        ("done", True, "", 0),
        ("done", True, "heater_power reads 700 W", 1),
        ("done", False, "", 1),
        ("faulted", True, "", 1),
    ],
)
def test_the_exit_code_is_1_unless_the_rig_was_seen_safe(tmp_path, monkeypatch, status, safe, away, code):
    folder = RunFolder(tmp_path)
    folder.write_manifest({})
    (tmp_path / "load.csv").write_text(LOAD.format(end=700), encoding="utf-8")

    async def over(*_: object) -> object:
        return SimpleNamespace(folder=folder, outcome=Outcome(status, "", safe=safe, away=away))

    monkeypatch.setattr("hil.session.run_session", over)
    result = CliRunner().invoke(run_command, [str(tmp_path / "load.csv"), "--virtual", "--json"])
    assert result.exit_code == code, result.output
    assert json.loads(result.stdout)["folder"] == str(tmp_path)
