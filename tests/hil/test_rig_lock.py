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

from drivers.rig_file.bus_sections import ModbusRtuTcpBus
from drivers.rig_file.model import Rig
from drivers.rig_file.reader import load_rig
from hil.cli.run_commands.resume import command as resume_command
from hil.cli.run_commands.run import command as run_command
from hil.errors import exit_code
from hil.run.engine.control_socket import ask, live_runs
from hil.run.engine.status import Outcome
from hil.run.locks.lock_folder import RigLockError
from hil.run.locks.rig_lock import RigBusyError, RigClaim, claimed, end_points
from hil.run.session.request import RunRequest
from hil.run.session.run import RunResult
from hil.run.session.session import run_session
from hil.run_folder.folder import RunFolder
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import rig_with

PROJECT = Path(__file__).resolve().parents[2]
AT_HOME = """
import os, pwd, sys
from types import SimpleNamespace
home = sys.argv.pop(1)
pwd.getpwuid = lambda uid: SimpleNamespace(pw_dir=home, pw_name=f"number {uid}")
"""
"""Takes the home folder of the user from the command line, so that no test writes into the real one."""
HIL = AT_HOME + "from hil.cli import main; main()"
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,100,100,100\n{end},100,100,100\n"
HOLDER = (
    AT_HOME
    + """
import time
from pathlib import Path
from drivers.rig_file.reader import load_rig
from hil.run.locks.rig_lock import claimed, end_points
rig = load_rig(Path(sys.argv[1]))
end_points(rig)  # imports what another user may not read
os.setuid(int(sys.argv[2]))
with claimed(rig, print) as claim:
    claim.record_holder(Path("/runs/first"))
    print("held", flush=True)
    time.sleep(600)
"""
)


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Home folder of the user, with no other folder in the environment."""
    path = tmp_path / "home"
    path.mkdir()
    for name in ("HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    user = SimpleNamespace(pw_dir=str(path), pw_name="the tester")
    monkeypatch.setattr("hil.run.locks.lock_folder.pwd.getpwuid", lambda uid: user)
    return path


def locks(home: Path) -> Path:
    return home / ".local/state/hil/locks"


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


PORT = free_ports(1)[0]
"""Locks are seen by all of the machine: no two sessions of tests may mean the same."""


def with_bus(**changed: object) -> Rig:
    """The shipped rig with its PLC elsewhere."""
    rig = load_rig(PROJECT / "profiles/rigs/virtual.toml")
    changed = {"port": PORT} | changed
    return rig.model_copy(update={"bus": rig.bus | {"plc": rig.bus["plc"].model_copy(update=changed)}})


@contextlib.contextmanager
def holding(rig: Path, home: Path, uid: int | None = None, **environ: str) -> Iterator[subprocess.Popen[str]]:
    """Another process that has the rig, with `home` as its user's home folder and `environ` in its environment."""
    command = [sys.executable, "-c", HOLDER, str(home), str(rig), str(os.getuid() if uid is None else uid)]
    holder = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True, env=os.environ | environ)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        yield holder
    finally:
        holder.kill()
        holder.communicate()


async def test_a_second_run_is_refused_before_the_rig_hears_of_it_and_goes_when_the_first_was_killed(tmp_path, home):
    (tmp_path / "load.csv").write_text(LOAD.format(end=700), encoding="utf-8")
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.setblocking(False)
        port = int(listener.getsockname()[1])
        first, second = (rig_file(tmp_path, port, port, host) for host in ("127.0.0.1", "localhost"))
        with holding(first, home) as holder:
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
            assert f"the run /runs/first (process {holder.pid}; " in said
            assert "`hil ctl abort /runs/first`" in said
            holder.kill()
            holder.wait()
        with claimed(load_rig(second), print):
            pass


@contextlib.contextmanager
def running(place: Path, home: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A run of its own process that has come to running, and its folder under `place`."""
    command = [sys.executable, "-c", HIL, str(home), "run", *arguments, "--runs", str(place)]
    run = subprocess.Popen(command, cwd=PROJECT, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 180
        while not (live := live_runs(place)) or ask(live[0] / "control.sock", "status")["text"] != "running":
            assert time.monotonic() < deadline and run.poll() is None
            time.sleep(0.1)
        yield run, live[0]
    finally:
        run.kill()
        run.wait()


def test_runs_on_one_rig_from_two_terminals(tmp_path, home):
    def beside(verb: str, *more: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", HIL, str(home), verb, *more]
        return subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=180)

    modbus, can = free_ports(2)
    options = [str(tmp_path / "load.csv"), "--rig", str(rig_file(tmp_path, modbus, can)), "--no-twin", "--no-viewer"]
    options += ["--no-report"]
    (tmp_path / "load.csv").write_text(LOAD.format(end=4000), encoding="utf-8")
    served = [sys.executable, "-m", "hil", "rig", "--modbus-port", str(modbus), "--can-port", str(can)]
    with subprocess.Popen(served, cwd=PROJECT, stdout=subprocess.PIPE) as server, contextlib.ExitStack() as stack:
        stack.callback(server.kill)
        assert b"Virtual rig" in server.stdout.readline()
        with running(tmp_path / "first", home, *options) as (first, folder):
            refused = beside("run", *options, "--runs", str(tmp_path / "second"))
            assert (refused.returncode, "Traceback" in refused.stderr) == (1, False)
            assert f"{folder} (process {first.pid};" in refused.stderr
            assert not (tmp_path / "second").exists()
            assert beside("run", *options, "--check-only").returncode == 0
        with running(tmp_path / "second", home, *options) as (second, _):  # the first was killed
            resumed = beside("resume", str(folder), "--no-viewer")
            assert (resumed.returncode, f"(process {second.pid};" in resumed.stderr) == (1, True)
            assert RunFolder(folder).was_cut  # as it was
            second.send_signal(signal.SIGINT)
            second.wait(timeout=180)


def test_an_end_point_has_one_key_however_it_is_written(tmp_path):
    hosts = ("127.0.0.1", "localhost", "LocalHost", "::1", "127.1", "::ffff:127.0.0.1", "0.0.0.0", "127.0.0.2", "[::1]")
    keys = [set(end_points(with_bus(host=host))) for host in hosts]
    assert all(key == keys[0] and len(key) == 1 for key in keys)
    assert keys[0] == set(end_points(with_bus(device_id=7)))
    (tmp_path / "line").symlink_to("/dev/null")
    rig = load_rig(PROJECT / "profiles/rigs/virtual.toml").model_dump(exclude_unset=True)
    found = []
    for path in (str(tmp_path / "line"), "/dev/null", "/dev/../dev/null"):
        rig["bus"]["plc"] = {"transport": "modbus_rtu", "serial_port": path}
        found.append(set(end_points(Rig.model_validate(rig))))
    assert found[0] == found[1] == found[2] and len(found[0]) == 1


def test_a_host_with_several_addresses_is_locked_at_each(monkeypatch):
    def known(host, *_args, **_kinds):
        found = {"gateway": ("192.0.2.1", "192.0.2.2")}.get(host, (host,))
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 0)) for address in found]

    monkeypatch.setattr("drivers.rig_file.host_address.socket.getaddrinfo", known)
    assert len(end_points(with_bus(host="gateway"))) == 2
    with claimed(with_bus(host="gateway"), pytest.fail):
        for host in ("192.0.2.1", "192.0.2.2"):
            with pytest.raises(RigBusyError), claimed(with_bus(host=host), pytest.fail):
                pass
        with claimed(with_bus(host="192.0.2.3"), pytest.fail):
            pass


def test_only_what_is_written_to_is_locked_and_serial_lines_always():
    rig = with_bus()
    points = tuple(p for p in rig.point if p.access == "r")
    assert not end_points(rig.model_copy(update={"point": points}))
    assert len({*end_points(rig), *end_points(with_bus(port=PORT + 1)), *end_points(with_bus(host="192.0.2.1"))}) == 3
    behind = ModbusRtuTcpBus(transport="modbus_rtu_tcp", port=PORT)
    rig = rig.model_copy(update={"bus": rig.bus | {"plc": behind}, "point": points})
    assert len(end_points(rig)) == 1


def test_a_claim_that_ends_leaves_nothing_locked_and_nothing_behind(home):
    rig = with_bus()
    with claimed(rig, pytest.fail) as claim:
        with (
            pytest.raises(RigBusyError, match=rf"process {os.getpid()} is starting .*whatever their ids"),
            claimed(with_bus(device_id=9), pytest.fail),
        ):
            pass
        assert len(list(locks(home).iterdir())) == 1
        claim.release()
        with claimed(rig, pytest.fail):
            pass
    with claimed(None, pytest.fail), claimed(rig, pytest.fail):
        pass
    assert not list(locks(home).iterdir())
    assert locks(home).stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("alone", ["files", "names"])
def test_processes_with_other_folders_in_their_environment_meet(tmp_path, home, monkeypatch, alone):
    if alone == "files":
        monkeypatch.setattr("hil.run.locks.rig_lock.take_name", lambda name: None)
    else:
        monkeypatch.setattr("hil.run.locks.rig_lock.open_folders", lambda: ([], []))
    environ = {name: str(tmp_path / name) for name in ("TMPDIR", "HOME", "XDG_RUNTIME_DIR")}
    for path in environ.values():
        Path(path).mkdir()
    path = rig_file(tmp_path, PORT, PORT)
    with holding(path, home, **environ) as holder:
        with pytest.raises(RigBusyError, match=f"process {holder.pid}"), claimed(load_rig(path), pytest.fail):
            pass
        for name in ("HOME", "XDG_RUNTIME_DIR"):
            monkeypatch.setenv(name, environ[name])
        with pytest.raises(RigBusyError, match=f"process {holder.pid}"), claimed(load_rig(path), pytest.fail):
            pass


@pytest.mark.skipif(os.getuid() != 0, reason="only root can run as another user")
def test_another_user_is_seen_and_named(tmp_path, home):
    path = rig_file(tmp_path, PORT, PORT)
    other = tmp_path / "other"
    other.mkdir()
    os.chown(other, 65534, 65534)
    shared = Path(tempfile.gettempdir())
    for folder in (tmp_path, *(parent for parent in tmp_path.parents if shared in parent.parents)):
        folder.chmod(folder.stat().st_mode | 0o011)
    with holding(path, other, uid=65534) as holder:
        with pytest.raises(RigBusyError) as refused, claimed(load_rig(path), pytest.fail):
            pass
        assert f"process {holder.pid} of user the tester" in str(refused.value)
        assert "ask that user" in str(refused.value)


def test_a_lock_folder_that_is_not_ours_refuses_and_no_lock_says_what_it_gives_up(home, monkeypatch):
    locks(home).parent.mkdir(parents=True)
    locks(home).symlink_to("/usr")
    with pytest.raises(RigLockError, match=r"locks, the folder of rig locks, cannot be used .*--no-lock") as refused:
        claimed(with_bus(), pytest.fail).__enter__()
    assert exit_code(refused.value) == 1
    said: list[str] = []
    with claimed(with_bus(), said.append, no_lock=True):
        with pytest.raises(RigLockError), claimed(with_bus(), pytest.fail):
            pass
        assert len(said) == 1
        assert "--no-lock: nothing keeps a second run from driving this rig" in said[0] and str(home) in said[0]
        locks(home).unlink()
        # What could be had was taken: others are refused, and another --no-lock names who has it.
        with pytest.raises(RigBusyError, match=f"process {os.getpid()}"), claimed(with_bus(), pytest.fail):
            pass
        with claimed(with_bus(), said.append, no_lock=True):
            assert f"driven by process {os.getpid()}" in said[1]


@pytest.mark.parametrize("named", ["HOME", "XDG_RUNTIME_DIR"])
def test_a_folder_of_the_environment_that_is_not_ours_refuses(tmp_path, home, monkeypatch, named):
    monkeypatch.setenv(named, str(tmp_path / "absent"))
    with claimed(with_bus(), pytest.fail):  # a session's folder goes when its user logs out
        pass
    everybodys = tmp_path / "everybodys"
    everybodys.mkdir()
    everybodys.chmod(0o777)
    monkeypatch.setenv(named, str(everybodys))
    with pytest.raises(RigLockError, match=f"{named} is {everybodys}, which every user may write to"):
        claimed(with_bus(), pytest.fail).__enter__()
    everybodys.chmod(0o700)
    owner = os.getuid() + 1
    monkeypatch.setattr("hil.run.locks.lock_folder.os.getuid", lambda: owner)
    with pytest.raises(RigLockError, match=f"{named} is {everybodys}, which belongs to user the tester"):
        claimed(with_bus(), pytest.fail).__enter__()


def test_a_user_without_a_folder_of_its_own_is_refused_unless_the_session_has_one(tmp_path, home, monkeypatch):
    home.rmdir()
    with pytest.raises(RigLockError, match=r"no folder of your own .*XDG_RUNTIME_DIR"):
        claimed(with_bus(), pytest.fail).__enter__()
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    with claimed(with_bus(), pytest.fail):
        assert list((runtime / "hil/locks").iterdir())


def test_a_lock_that_its_owner_removes_while_another_opens_it_is_not_taken_twice(home, monkeypatch):
    monkeypatch.setattr("hil.run.locks.rig_lock.take_name", lambda name: None)
    first, second = RigClaim(), RigClaim()
    first.take(with_bus(), pytest.fail)
    opened = os.open

    def late(path, flags, *rest, **more):
        handle = opened(path, flags, *rest, **more)
        if flags & os.O_CREAT:
            monkeypatch.setattr("hil.run.locks.lock_folder.os.open", opened)
            first.release()  # between opening and locking
        return handle

    monkeypatch.setattr("hil.run.locks.lock_folder.os.open", late)
    second.take(with_bus(), pytest.fail)
    with pytest.raises(RigBusyError), claimed(with_bus(), pytest.fail):
        pass
    second.release()


def test_no_lock_is_an_option_of_both_verbs():
    for verb in (run_command, resume_command):
        assert "--no-lock" in CliRunner().invoke(verb, ["--help"]).output


@pytest.mark.parametrize("reads_W", [0.0, 700.0])
def test_a_profile_that_is_over_is_no_good_end_where_the_heater_still_heats(reads_W):
    with EngineBench(rig_with(interlocks=()), duration_s=5.0) as bench:
        bench.ticks(3)
        bench.rig.readings["heater_power"] = reads_W
        bench.ticks(10)
        outcome = bench.outcome
        assert (outcome.status, outcome.safe, outcome.in_order) == ("done", reads_W == 0.0, reads_W == 0.0)
        assert outcome.away == ("" if reads_W == 0.0 else "heater_power still reads 700.0 W, safe is 10 W at most")


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
    folder.write_manifest({"exit_status": status})
    (tmp_path / "load.csv").write_text(LOAD.format(end=700), encoding="utf-8")

    async def over(*_: object) -> object:
        return RunResult(folder, Outcome(status, "", safe=safe, away=away), None, 0.0, 0.0, False)

    monkeypatch.setattr("hil.run.session.session.run_session", over)
    result = CliRunner().invoke(run_command, [str(tmp_path / "load.csv"), "--virtual", "--json"])
    assert result.exit_code == code, result.output
    assert json.loads(result.stdout)["folder"] == str(tmp_path)
