"""The guardian: a rig is made safe when the engine is killed, stopped, hung or asks for it, and not otherwise."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.rig import RigConnection
from drivers.rig_file.reader import load_rig
from hil.guardian import process
from hil.guardian.client import GuardianClient, NoGuard
from hil.guardian.plan import plan_of
from hil.rig.notices import unguarded
from hil.run.outputs import write_safe
from tests.hil.engine_bench import EngineBench
from tests.hil.guarded_device import HEATER, METER, Device
from tests.hil.simulated_rig import rig_with

PROJECT = Path(__file__).resolve().parents[2]
WAIT_S = 60.0
"""Longest wait, s, for another process to do what has no limit of its own. A busy machine takes tens of seconds."""
ENGINE = """
import asyncio, sys, time
from pathlib import Path
from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from hil.guardian.client import GuardianClient

async def main(rig_path, log, how):
    rig = load_rig(Path(rig_path))
    connection = RigConnection(rig, time.monotonic)
    await connection.connect()
    guardian = GuardianClient(rig, Path(log))
    await guardian.start()
    alone = await guardian.probe()
    while alone and not await tried(connection):
        await asyncio.sleep(0.1)
    guardian.watch()
    await connection.write({"heater_set": 500.0})
    print("alone" if alone else "shared", guardian.pid, flush=True)
    if how == "hung":
        time.sleep(30)
    while guardian.failure() is None:
        guardian.expect(1.0 if how == "stuck" else 30.0)
        await asyncio.sleep(30.0 if how == "stuck" else 0.05)
    print(guardian.failure(), guardian.may_heat(), flush=True)
    await connection.write({"heater_set": 0.0})
    await guardian.done(safe=True)
    await connection.close()

async def tried(connection):
    snapshot = await connection.read()
    return not snapshot.faults

asyncio.run(main(*sys.argv[1:]))
"""


GUARDIANS: list[int] = []
"""Processes of guardians that tests have started; some would try for ever to reach a device that is gone."""


@contextlib.contextmanager
def engine(tmp_path: Path, device: Device, how: str = "beats", **more: Any) -> Iterator[subprocess.Popen[str]]:
    """A process that heats and beats."""
    (tmp_path / "rig.toml").write_text(device.rig_text(**more))
    command = [sys.executable, "-c", ENGINE, str(tmp_path / "rig.toml"), str(tmp_path / "guardian.log"), how]
    running = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True)
    try:
        yield running
    finally:
        running.kill()
        running.wait()
        assert running.stdout is not None
        running.stdout.close()
        while GUARDIANS:
            with contextlib.suppress(ProcessLookupError):
                os.kill(GUARDIANS.pop(), signal.SIGKILL)


def started(running: subprocess.Popen[str]) -> tuple[str, int]:
    """How the guardian found the device, and its process."""
    assert running.stdout is not None
    words = running.stdout.readline().split()
    GUARDIANS.append(int(words[1]))
    return words[0], GUARDIANS[-1]


def until(condition: Callable[[], bool], seconds: float = WAIT_S) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return condition()


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def log(tmp_path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (tmp_path / "guardian.log").read_text().splitlines()]


@pytest.mark.parametrize("how", ["killed", "stopped", "hung", "stuck"])
def test_a_rig_without_a_watchdog_is_safe_within_two_seconds_of_an_engine_that_is(how, tmp_path):
    device = Device()
    with engine(tmp_path, device, how) as running:
        found, pid = started(running)
        assert found == "shared"
        assert device.registers[HEATER] == 500
        event_s = time.monotonic()
        if how in ("killed", "stopped"):
            running.send_signal(signal.SIGKILL if how == "killed" else signal.SIGSTOP)
        assert until(lambda: device.off_s is not None)
        assert device.off_s is not None
        # An engine whose tick hangs was expected for another second.
        assert device.off_s - event_s < (3.0 if how == "stuck" else 2.0)
        said = [entry["what"] for entry in log(tmp_path)]
        assert "acting" in said
        assert until(lambda: "safe" in [entry["what"] for entry in log(tmp_path)])
        if how == "killed":
            assert until(lambda: gone(pid))
        elif running.poll() is None:  # an engine that may wake up again is watched on
            assert not gone(pid)
            device.registers[HEATER] = 300
            assert until(lambda: device.registers[HEATER] == 0)
    device.close()


def test_an_engine_that_wakes_up_learns_that_it_was_relieved_and_heats_no_more(tmp_path):
    device = Device()
    with engine(tmp_path, device) as running:
        _, pid = started(running)
        running.send_signal(signal.SIGSTOP)
        assert until(lambda: device.off_s is not None)
        time.sleep(0.3)
        running.send_signal(signal.SIGCONT)
        assert running.stdout is not None
        assert "the guardian has made the rig safe: no beat of the engine for 1 s False" in running.stdout.readline()
        assert running.wait(WAIT_S) == 0
        assert device.registers[HEATER] == 0
        assert until(lambda: gone(pid))
    device.close()


def test_a_stop_of_half_a_second_and_a_whole_pause_are_no_silence(tmp_path):
    device = Device()
    with engine(tmp_path, device) as running:
        _, pid = started(running)
        running.send_signal(signal.SIGSTOP)
        time.sleep(0.5)
        running.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        for one in (running.pid, pid):
            os.kill(one, signal.SIGSTOP)
        time.sleep(2.0)
        for one in (running.pid, pid):
            os.kill(one, signal.SIGCONT)
        time.sleep(1.0)
        assert device.registers[HEATER] == 500
        assert running.poll() is None
        running.kill()
        assert until(lambda: device.off_s is not None)
    device.close()


def test_a_device_that_admits_one_connection_is_taken_over_by_ending_the_engine_that_holds_it(tmp_path):
    device = Device(single=True)
    with engine(tmp_path, device) as running:
        found, _ = started(running)
        assert found == "alone"
        running.send_signal(signal.SIGSTOP)
        event_s = time.monotonic()
        assert until(lambda: device.off_s is not None)
        assert device.off_s is not None
        assert device.off_s - event_s < 2.0
        assert running.wait(WAIT_S) == -signal.SIGKILL
    device.close()


def test_a_device_that_is_deaf_after_connecting_is_made_safe_by_the_connection_of_the_probe(tmp_path):
    device = Device(deaf_s=3.0)
    with engine(tmp_path, device) as running:
        found, _ = started(running)
        assert found == "shared"
        running.send_signal(signal.SIGKILL)
        event_s = time.monotonic()
        assert until(lambda: device.off_s is not None)
        assert device.off_s is not None
        assert device.off_s - event_s < 2.0
        assert device.connections == 2  # one is the engine's
    device.close()


def test_the_standby_connection_is_opened_anew_where_the_device_has_closed_it(tmp_path, monkeypatch):
    monkeypatch.setattr(process, "STANDBY_S", 0.05)
    device = Device(deaf_s=1.0)
    (tmp_path / "rig.toml").write_text(device.rig_text())
    plan = plan_of(load_rig(tmp_path / "rig.toml"))
    assert plan is not None
    why, wire = process.probe(plan["wires"][0])
    assert (why, device.connections) == ("", 1)
    keeper = process.SafeStateKeeper(plan["wires"][0], lambda place: None, wire)
    keeper.start()
    device.hang_up()
    assert until(lambda: device.connections >= 2)
    time.sleep(1.3)
    device.registers[HEATER] = 400
    keeper.may_open.set()
    keeper.acting.set()
    assert until(lambda: keeper.safe, 0.9)  # a connection that is opened now is deaf for longer
    keeper.end()
    keeper.join(2.0)
    device.close()


async def test_a_deaf_device_with_one_connection_is_reported_with_the_time_that_the_guardian_needs(tmp_path):
    device = Device(single=True, deaf_s=2.0)
    (tmp_path / "rig.toml").write_text(device.rig_text())
    rig = load_rig(tmp_path / "rig.toml")
    with socket.create_connection(("127.0.0.1", device.port)):
        guardian = GuardianClient(rig, tmp_path / "guardian.log")
        await guardian.start()
        (why,) = await guardian.probe()
        await guardian.done(safe=True)
    assert "takes no request for 2.05 s after connecting, so that the guardian needs about 3.55 s" in why
    (note,) = [note for note in unguarded(rig, tmp_path / "rig.toml") if "connect_delay_s" in note]
    assert "bus plc" in note and "about 3.55 s" in note
    device.close()


def test_a_meter_has_the_time_of_the_rig_file_by_the_clock_of_the_rig(tmp_path):
    device = Device()
    text = device.rig_text().replace("period_s = 0.1", "period_s = 0.1\ntime_scale = 0.01", 1)
    (tmp_path / "rig.toml").write_text(text)
    plan = plan_of(load_rig(tmp_path / "rig.toml"))
    assert plan is not None
    assert plan["wires"][0]["meters"][0]["within_s"] == pytest.approx(100.0)  # 1 s of the rig's clock
    device.close()


def test_a_guardian_that_waits_for_the_engine_names_the_wire_and_the_cause(tmp_path):
    device = Device(serial=True)
    (tmp_path / "rig.toml").write_text(device.rig_text())
    guardian = GuardianClient(load_rig(tmp_path / "rig.toml"), tmp_path / "guardian.log")

    async def asked() -> None:
        await guardian.start()
        guardian.watch()
        guardian.act()
        end_s = time.monotonic() + WAIT_S
        while guardian.failure() is None and time.monotonic() < end_s:
            guardian.expect(5.0)
            await asyncio.sleep(0.01)
        await guardian.done(safe=True)

    asyncio.run(asked())
    assert guardian.acted is not None
    assert device.path in guardian.acted.problem
    assert guardian.acted.problem.endswith(": the engine holds the only connection, so that the guardian waits")


@pytest.mark.parametrize("parity", ["none", "even"])
def test_a_serial_line_is_taken_over(parity, tmp_path):
    """The driver of a pseudo terminal keeps no parity, and refuses to be told of it again."""
    device = Device(serial=True)
    with engine(tmp_path, device, parity=parity) as running:
        started(running)
        running.send_signal(signal.SIGKILL)
        event_s = time.monotonic()
        assert until(lambda: device.off_s is not None)
        assert device.off_s is not None
        assert device.off_s - event_s < 2.0


def test_the_engine_learns_that_its_guardian_was_killed(tmp_path):
    device = Device()
    with engine(tmp_path, device) as running:
        _, pid = started(running)
        os.kill(pid, signal.SIGKILL)
        assert running.stdout is not None
        assert "nobody would make the rig safe" in running.stdout.readline()
        assert running.wait(WAIT_S) == 0
        assert device.registers[HEATER] == 0
    device.close()


def test_a_pump_that_refuses_does_not_keep_the_heater_on(tmp_path):
    device = Device()
    with engine(tmp_path, device, pump=True) as running:
        started(running)
        device.refuses = {1}
        running.send_signal(signal.SIGKILL)
        assert until(lambda: device.off_s is not None)
    device.close()


VALVES = (1, 2, 3, 5, 6, 7)


def test_devices_that_are_mute_and_come_first_hold_up_no_heater(tmp_path):
    device = Device()
    with engine(tmp_path, device, valves=VALVES) as running:
        started(running)
        device.mute = set(VALVES)
        running.send_signal(signal.SIGKILL)
        event_s = time.monotonic()
        assert until(lambda: device.off_s is not None)
        assert device.off_s is not None
        assert device.off_s - event_s < 2.0
    device.close()


async def test_an_engine_turns_the_heater_off_after_one_device_that_is_mute(tmp_path):
    device = Device()
    (tmp_path / "rig.toml").write_text(device.rig_text(valves=VALVES))
    connection = RigConnection(load_rig(tmp_path / "rig.toml"), time.monotonic)
    await connection.connect()
    await connection.write({"heater_set": 500.0})
    device.mute = set(VALVES)
    began_s = time.monotonic()
    safe = {**{f"valve_{address}": 100.0 for address in VALVES}, "heater_set": 0.0}
    problem = await write_safe(connection, safe, within_s=2.0)
    assert "valve_1" in problem or "no answer" in problem
    assert device.off_s is not None and device.off_s - began_s < 1.5
    await connection.close()
    device.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1, signal.SIGALRM, signal.SIGXCPU, signal.SIGIO])
def test_a_signal_to_everybody_ends_no_guardian(number, tmp_path):
    device = Device()
    with engine(tmp_path, device) as running:
        _, pid = started(running)
        os.kill(pid, number)
        running.send_signal(signal.SIGKILL)
        assert until(lambda: device.off_s is not None)
    device.close()


def test_a_meter_that_stays_hot_is_no_safe_rig_whatever_is_read_back(tmp_path):
    device = Device()
    with engine(tmp_path, device) as running:
        started(running)
        device.stuck_W = 480  # before the guardian has a reason to act
        running.send_signal(signal.SIGSTOP)
        assert until(lambda: log(tmp_path)[-1].get("problem") == "heater still reads 480.0 W")
        assert device.registers[HEATER] == 0
    device.close()


def test_the_guardian_is_small(tmp_path):
    device = Device()
    with engine(tmp_path, device) as running:
        _, pid = started(running)
        status = Path(f"/proc/{pid}/status").read_text()
        kilobytes = int(status.partition("VmHWM:")[2].split()[0])
        assert kilobytes < 40_000
        assert os.getsid(pid) == pid
        assert os.readlink(f"/proc/{pid}/fd/0") == os.devnull
    device.close()


async def test_a_run_that_ends_in_order_leaves_no_guardian_and_no_write(tmp_path):
    device = Device()
    (tmp_path / "rig.toml").write_text(device.rig_text())
    guardian = GuardianClient(load_rig(tmp_path / "rig.toml"), tmp_path / "guardian.log")
    await guardian.start()
    assert await guardian.probe() == []
    guardian.watch()
    device.registers[HEATER] = 77
    await asyncio.sleep(0.2)
    pid = guardian.pid
    await guardian.done(safe=True)
    assert pid is not None
    assert until(lambda: gone(pid))
    assert device.registers[HEATER] == 77
    device.close()


async def test_the_guardian_acts_when_the_engine_asks(tmp_path):
    device = Device()
    (tmp_path / "rig.toml").write_text(device.rig_text())
    guardian = GuardianClient(load_rig(tmp_path / "rig.toml"), tmp_path / "guardian.log")
    await guardian.start()
    guardian.watch()
    device.registers[HEATER] = 500
    guardian.act()
    end_s = time.monotonic() + WAIT_S
    while (guardian.failure() is None or guardian.acted is None or not guardian.acted.safe) and (
        time.monotonic() < end_s
    ):
        guardian.expect(5.0)
        await asyncio.sleep(0.01)
    assert guardian.acted is not None
    assert (guardian.acted.safe, guardian.acted.reason) == (True, "the engine asked for it")
    assert device.registers[HEATER] == 0
    assert not guardian.may_heat()
    await guardian.done(safe=True)
    device.close()


@pytest.mark.parametrize("answers", [True, False])
async def test_the_last_report_is_of_the_rig_that_the_engine_leaves(answers, tmp_path):
    device = Device()
    (tmp_path / "rig.toml").write_text(device.rig_text())
    guardian = GuardianClient(load_rig(tmp_path / "rig.toml"), tmp_path / "guardian.log")
    await guardian.start()
    guardian.watch()
    device.registers[HEATER] = 500
    device.mute = {HEATER, METER}
    guardian.act()
    while "no answer" not in (tmp_path / "guardian.log").read_text():
        guardian.expect(5.0)
        await asyncio.sleep(0.01)
    device.registers[HEATER] = 0  # the engine gets through, and ends in order
    if answers:
        device.mute.clear()
    await guardian.done(safe=True)
    assert guardian.acted is not None and guardian.acted.safe == answers
    assert ("no answer" in guardian.acted.sentence(run_is_safe=True)) != answers
    last = "safe" if answers else "not safe"
    assert [entry["what"] for entry in log(tmp_path)][-3:] == [last, "done", "ended"]
    device.close()


async def test_an_echo_of_the_read_back_is_no_safe_value(tmp_path):
    device = Device()
    (tmp_path / "rig.toml").write_text(device.rig_text().replace('readback = "heater"\nreadback_within_s = 1.0\n', ""))
    guardian = GuardianClient(load_rig(tmp_path / "rig.toml"), tmp_path / "guardian.log")
    await guardian.start()
    guardian.watch()
    device.registers[HEATER] = 500
    device.echoes = True  # Address 0 and one register: the request has the bytes of a zero where values stand.
    guardian.act()
    end_s = time.monotonic() + WAIT_S
    while "an echo" not in (tmp_path / "guardian.log").read_text() and time.monotonic() < end_s:
        guardian.failure()
        guardian.expect(5.0)
        assert guardian.acted is None or not guardian.acted.safe
        await asyncio.sleep(0.01)
    assert time.monotonic() < end_s
    assert device.registers[HEATER] == 500
    device.echoes = False
    await guardian.done(safe=True)
    device.close()


def test_a_read_back_may_be_one_count_off_and_no_more():
    step = {"type": "int16", "order": "ABCD", "scale": 0.1, "offset": 0.0, "words": 1, "bits": None}
    assert process.number([0xFFFF], step) == -1.0
    assert process.number([0x0000, 0x4248], step | {"type": "float32", "order": "CDAB", "words": 2}) == 50.0
    assert process.number([0x4248, 0x0000], step | {"type": "float32", "words": 2}) == 50.0
    assert process.number([0b1010], step | {"type": "uint16", "bits": [1, 3]}) == 0b101


def test_the_shipped_rig_has_a_plan_that_turns_the_heater_off_first():
    plan = plan_of(load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml"))
    assert plan is not None
    (wire,) = plan["wires"]
    assert [step["name"] for step in wire["writes"]] == [
        "heater_power_set 0 W",
        "pump_speed_set 100 %",
        "fan_speed_set 100 %",
    ]
    assert wire["writes"][0]["pdu"] == "0600000000"
    assert [meter["name"] for meter in wire["meters"]] == ["heater_power"]


def test_a_run_whose_guardian_has_no_connection_of_its_own_says_so_at_its_start():
    class Alone(NoGuard):
        async def probe(self) -> list[str]:
            return ["the device closed a second connection"]

    with EngineBench(rig_with(interlocks=()), guard=Alone()) as bench:
        bench.ticks(5)
        said = [line for line in bench.told if "the guardian cannot have a connection of its own" in line]
        assert len(said) == 1 and "the device closed a second connection" in said[0]
        assert bench.told.index(said[0]) < next(k for k, line in enumerate(bench.told) if "running:" in line)
        assert any("the guardian cannot have" in text for _, text in bench.journal.events)
