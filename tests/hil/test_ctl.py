"""`hil ctl` as a user types it, on a run in lockstep, and the socket behind it."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from hil.journal.states import State
from hil.journal.writer import JournalReader
from hil.review.rerun_io import read_words
from hil.run.engine.control_socket import ControlError, ask, live_runs, serving
from hil.run.engine.operator import RefusedError, Verb
from hil.run_folder.folder import RunFolder
from tests.hil.command_line import typed

PROJECT = Path(__file__).resolve().parents[2]
HIL = [sys.executable, "-m", "hil"]
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n900000,700,100,70\n"


def heater_set(folder: Path) -> float:
    return float(ask(folder / "control.sock", "status")["status"]["setpoints"].get("heater_power_set", 0.0))


def from_a_second_terminal(runs: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*HIL, "ctl", *arguments, "--runs", str(runs)]
    return subprocess.run(command, capture_output=True, text=True, cwd=PROJECT, timeout=180)


def test_a_run_in_lockstep_is_held_paused_resumed_and_aborted_from_a_second_terminal(tmp_path):
    (tmp_path / "load.csv").write_text(LOAD, encoding="utf-8")
    assert typed("ctl", "status", "--runs", tmp_path).returncode == 2  # nothing runs
    process = subprocess.Popen(
        [
            *HIL,
            "run",
            str(tmp_path / "load.csv"),
            "--virtual",
            "--lockstep",
            "--no-twin",
            "--no-viewer",
            "--runs",
            str(tmp_path),
        ],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 180
        # The set-point follows the profile no faster than its limit, so it gets there some ticks after the start.
        while not live_runs(tmp_path) or heater_set(live_runs(tmp_path)[0]) != 700.0:
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.1)
        folder = live_runs(tmp_path)[0]
        assert "held at" in typed("ctl", "hold", "--runs", tmp_path).stdout
        held_s = time.monotonic()
        held = json.loads(typed("ctl", "status", "--json", "--runs", tmp_path).stdout)["status"]
        assert (held["state"], held["setpoints"]["heater_power_set"]) == ("held", 700.0)
        shown = typed("ctl", "status", "--runs", tmp_path).stdout
        assert "heater_power_set 700.0 W" in shown
        assert "T_tank " in shown and " °C" in shown
        assert "plc_uptime" not in shown  # of no use to an operator; --json has it
        assert max(map(len, shown.splitlines())) <= max(100, len(str(folder)) + 80)
        paused = from_a_second_terminal(tmp_path, "pause", "--reason", "topping up")
        assert "safe values read back" in paused.stdout
        later = json.loads(typed("ctl", "status", folder, "--json", "--runs", tmp_path).stdout)["status"]
        assert (later["state"], later["reason"]) == ("paused", "topping up (hil ctl)")
        assert later["setpoints"]["heater_power_set"] == 0.0
        assert later["profile_s"] == held["profile_s"]
        # It waits at a person's pace, a tick of one second a second; a lockstep that runs on makes hundreds.
        assert later["time_s"] - held["time_s"] < 2.0 * (time.monotonic() - held_s) + 10.0
        refused = typed("ctl", "ack", "--runs", tmp_path)
        assert (refused.returncode, refused.stdout) == (1, "")
        assert "nothing has tripped" in refused.stderr
        assert "running at" in typed("ctl", "resume", "--runs", tmp_path).stdout
        assert "safe values read back" in from_a_second_terminal(tmp_path, "abort").stdout
        _, err = process.communicate(timeout=180)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 1, err
    manifest = RunFolder(folder).read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("aborted", True)
    assert "paused: topping up" in err
    assert not (folder / "control.sock").exists()
    reader = JournalReader(folder / "journal.sqlite")
    targets = [row.target for row in reader.states()]
    reader.close()
    assert targets == [
        "validating",
        "connecting",
        "restoring",
        "running",
        "held",
        "paused",
        "running",
        "finishing",
        "aborted",
    ]
    lane = [word for _, word in read_words(folder / "review.rrd", "/state")]
    assert lane == ["running", "held", "paused", "running", "aborted"]


def test_a_process_that_hangs_is_named_with_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.run.engine.control_socket.ANSWER_WITHIN_S", 0.3)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "control.sock"))
        listener.listen()
        with pytest.raises(ControlError, match=f"does not answer within 0.3 s; .*`kill -9 {os.getpid()}`"):
            ask(tmp_path / "control.sock", "status")


class Answering:
    """As much of an engine as the socket needs."""

    state = State.RUNNING

    def status(self) -> Any:
        from hil.run.engine.status import Status

        return Status(self.state, "", 3, 3.0, 3.0, 60.0, {"T": float("nan")}, {}, (), ())

    async def ask(self, verb: Verb, reason: str) -> str:
        if verb is Verb.HOLD:
            raise RefusedError("not now")
        return f"{verb}: {reason}"


async def test_the_socket_is_its_owners_alone_and_long_paths_are_no_matter(tmp_path):
    folder = tmp_path / ("a" * 120)
    folder.mkdir()
    path = folder / "control.sock"
    async with serving(path, Answering(), lambda text: None):  # type: ignore[arg-type]
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert await asyncio.to_thread(live_runs, tmp_path) == [folder]
        done = await asyncio.to_thread(ask, path, "pause", "lunch")
        assert (done["ok"], done["text"], done["status"]["values"]) == (True, "pause: lunch", {"T": None})
        long = await asyncio.to_thread(ask, path, "pause", "why " * 50_000)
        assert long["ok"] and long["text"].startswith("pause: why why") and len(long["text"]) < 300
        refused = await asyncio.to_thread(ask, path, "hold")
        assert (refused["ok"], refused["text"]) == (False, "not now")
        unknown = await asyncio.to_thread(ask, path, "explode")
        assert (unknown["ok"], "not understood" in unknown["text"]) == (False, True)
    assert not path.exists()
    with pytest.raises(ControlError, match="is no live run"):
        await asyncio.to_thread(ask, path, "status")


@pytest.mark.parametrize("sent", [b"\n", b"[]\n", b'"x"\n', b"\xff\xfe\n", b'{"verb": 3}\n', b"x" * 100_000])
async def test_nonsense_is_answered_or_dropped_and_the_next_one_is_served(tmp_path, sent):
    path = tmp_path / "control.sock"

    def send() -> None:
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(os.fspath(path))
            with_answer = client.makefile("rb")
            try:
                client.sendall(sent)
                with_answer.readline()
            except OSError:
                pass
            finally:
                with_answer.close()

    async with serving(path, Answering(), lambda text: None):  # type: ignore[arg-type]
        await asyncio.to_thread(send)
        assert (await asyncio.to_thread(ask, path, "status"))["text"] == "running"


async def test_a_folder_that_takes_no_socket_does_not_keep_a_run_from_going_on(tmp_path):
    (tmp_path / "control.sock").write_text("a file is in the way", encoding="utf-8")
    said: list[str] = []
    async with serving(tmp_path / "control.sock", Answering(), said.append):  # type: ignore[arg-type]
        assert "cannot reach this run" in said[0]
