"""Who can reach what, what a file can make the harness do, and what a run folder gives away."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.rig_file.reader import RigFileError, file_sha256, load_rig
from drivers.virtual.rig import start_virtual_rig
from hil.bench.faults.judge import read_states
from hil.bench.faults.rig import LOAD, prepare, rig_text
from hil.bench.faults.tls import make_certificates
from hil.files.atomic import replacing
from hil.run.session.interrupted_run import request_of
from hil.run_folder.folder import RunFolder, create_run_folder
from hil.run_folder.room import RunSize

PROJECT = Path(__file__).resolve().parents[2]
HIL = [sys.executable, "-m", "hil"]
VIRTUAL = PROJECT / "profiles" / "rigs" / "virtual.toml"
LOOPBACK = {"0100007F", "00000000000000000000000001000000"}


def listening(pids: list[int]) -> list[str]:
    """Addresses, as the kernel writes them, on which these processes listen."""
    inodes = set()
    for pid in pids:
        for descriptor in Path(f"/proc/{pid}/fd").iterdir():
            try:
                target = os.readlink(descriptor)
            except OSError:
                continue
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        if not Path(table).exists():
            continue
        for line in Path(table).read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and words[9] in inodes:
                found.append(words[1].split(":")[0])
    return found


async def test_the_virtual_rig_listens_on_the_loopback_interface_only():
    async with await start_virtual_rig(mode="lockstep") as rig:
        addresses = listening(list(rig.pids.values()))
    assert len(addresses) == 3
    assert set(addresses) <= LOOPBACK


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("0.0.0.0", True)])
def test_a_rig_that_others_can_reach_says_so(host, warned):
    command = [*HIL, "rig", "--modbus-port", "0", "--can-port", "0", "--mode", "lockstep", "--host", host]
    process = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(3)]
    finally:
        process.send_signal(signal.SIGTERM)
        rest, _ = process.communicate(timeout=20)
    assert ("Reachable from other machines, without any password." in "".join(lines) + rest) == warned


def test_the_viewer_is_started_on_the_loopback_interface(monkeypatch):
    from hil.review import viewer

    asked: list[list[str]] = []

    class Ended:
        def __init__(self, command: list[str], **_: object) -> None:
            asked.append(command)

        def poll(self) -> int:
            return 1

        def wait(self, timeout: float | None = None) -> int:
            return 1

    monkeypatch.setattr(viewer.subprocess, "Popen", Ended)
    with pytest.raises(viewer.ViewerError):
        viewer.open_viewer(port=9)
    assert asked[0][asked[0].index("--bind") + 1] == "127.0.0.1"


EVIL = "__import__('os').system('touch {0}')"


@pytest.mark.parametrize(
    "key", ["name", "unit", "type", "scale", "message", "role", "doc", "readback", "safe_value", "table"]
)
def test_nothing_in_a_rig_file_is_executed(tmp_path, key):
    trace = tmp_path / "trace"
    text = VIRTUAL.read_text(encoding="utf-8").replace(
        '"thermocouples.dbc"', f'"{PROJECT}/profiles/rigs/thermocouples.dbc"'
    )
    head, first, *rest = text.split("[[point]]\n")
    lines = [line for line in first.splitlines() if not line.startswith(f"{key} =")]
    first = "\n".join([f'{key} = "{EVIL.format(trace)}"', *lines]) + "\n"
    path = tmp_path / "rig.toml"
    path.write_text("[[point]]\n".join([head, first, *rest]), encoding="utf-8")
    if key in ("role", "doc", "message"):  # words that nobody acts on
        load_rig(path)
    else:
        with pytest.raises(RigFileError):
            load_rig(path)
    assert not trace.exists()


def test_a_dbc_is_data_whatever_its_name_promises(tmp_path):
    trace, code = tmp_path / "trace", tmp_path / "evil.py"
    code.write_text(f"open({str(trace)!r}, 'w')\n", encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(
        VIRTUAL.read_text(encoding="utf-8").replace('"thermocouples.dbc"', '"evil.py"').replace("../twins", "twins"),
        encoding="utf-8",
    )
    done = subprocess.run([*HIL, "check", path], capture_output=True, text=True, cwd=PROJECT, timeout=60, check=False)
    assert done.returncode == 2
    assert "evil.py, line 1: is not a DBC file" in done.stderr + done.stdout
    assert not trace.exists()


def test_the_name_of_a_profile_cannot_lead_out_of_the_folder_of_runs(tmp_path):
    runs = tmp_path / "runs"
    for name in ("..", ".", "a b", "..%2f.."):
        folder = create_run_folder(runs, Path(f"{name}.csv").stem, RunSize(10))
        assert folder.path.resolve().parent == runs.resolve()


def test_what_is_derived_replaces_a_link_and_does_not_write_through_it(tmp_path):
    outside = tmp_path / "outside.txt"
    outside.write_text("mine", encoding="utf-8")
    link = tmp_path / "report.html"
    link.symlink_to(outside)
    with replacing(link) as unfinished:
        unfinished.write_text("report", encoding="utf-8")
    assert outside.read_text(encoding="utf-8") == "mine"
    assert link.read_text(encoding="utf-8") == "report"
    assert not link.is_symlink()


def test_a_run_folder_that_names_other_files_shows_nothing_of_them(tmp_path):
    """A run.json from elsewhere can name any file with its true hash: it is parsed as what it should be, or refused."""
    secret = tmp_path / "secret.txt"
    secret.write_text("password = hunter2 hunter2\n", encoding="utf-8")
    folder = RunFolder(tmp_path / "run")
    folder.path.mkdir()
    about = {"path": str(secret), "sha256": file_sha256(secret)}
    settings = {
        "virtual": True,
        "mode": "lockstep",
        "speed": 1.0,
        "seed": 0,
        "calibrators": [],
        "network_mode": "shadow",
    }
    manifest = {"exit_status": "running", "files": {"rig": about, "profile": about}, "settings": settings}
    request = request_of(folder, manifest, {})
    from hil.run.session.request import prepare

    with pytest.raises(RigFileError) as caught:
        prepare(request)
    assert "hunter2" not in str(caught.value)


def test_a_card_cannot_name_members_outside_its_folder(tmp_path):
    pytest.importorskip("torch")
    from twin.calibrators.hiera_unet.serve.members import HieraError, load_ensemble

    shipped = PROJECT / "profiles" / "trained" / "loop_small.json"
    document = json.loads(shipped.read_text(encoding="utf-8"))
    for name in ("../loop_small_0", str(shipped.parent / "loop_small_0"), "x/../../loop_small_0"):
        card = tmp_path / "card.json"
        card.write_text(json.dumps(document | {"members": {name: "0" * 64}}), encoding="utf-8")
        with pytest.raises(HieraError, match="does not lie beside it"):
            load_ensemble(card, None)  # type: ignore[arg-type]


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
async def test_a_run_over_tls_leaves_no_key_in_its_folder(tmp_path):
    made = make_certificates(tmp_path)
    async with await start_virtual_rig(period_s=0.1, tls=made.rig) as rig:
        await prepare(rig.modbus_port, made.context())
        (tmp_path / "rig.toml").write_text(
            rig_text({"plc": rig.modbus_port, "thermocouples": rig.can_port}, made.harness)
            .replace('kind = "heater_power"', 'kind = "sensor"\npoint = "T_tank"\n#')
            .split('[[interlock]]\nkind = "sensor"')[0],
            encoding="utf-8",
        )
        (tmp_path / "load.csv").write_text(LOAD.format(400), encoding="utf-8")
        process = await asyncio.create_subprocess_exec(
            *HIL,
            "run",
            str(tmp_path / "load.csv"),
            "--rig",
            str(tmp_path / "rig.toml"),
            "--no-twin",
            "--no-viewer",
            "--no-report",
            "--runs",
            str(tmp_path / "runs"),
            cwd=PROJECT,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline and not any(
            "running" in [target for _, target in read_states(path)]
            for path in (tmp_path / "runs").glob("*/journal.sqlite")
        ):
            await asyncio.sleep(0.1)
        await asyncio.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        _, err = await asyncio.wait_for(process.communicate(), 60.0)
    (folder,) = (tmp_path / "runs").iterdir()
    manifest = RunFolder(folder).read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("aborted", True), err.decode()
    secret = made.harness["key"].read_bytes().splitlines()[1]
    assert len(secret) > 40
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert len(files) >= 4
    for path in files:
        data = path.read_bytes()
        assert secret not in data, path
        assert b"PRIVATE KEY" not in data, path
