"""Attacks on a run: a few real ones on the virtual rig, the plan of the campaign, and the verdict's own eyes."""

from __future__ import annotations

import asyncio
import dataclasses
import math
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.rig_file.reader import load_rig
from drivers.virtual.devices.registers import ARM, HEARTBEAT, HEATER_SET
from drivers.virtual.devices.truth import read_truth
from drivers.virtual.rig import start_virtual_rig
from hil.bench.chaos import verdict
from hil.bench.chaos.campaign import campaign, chaos_tables
from hil.bench.chaos.clock import SteppedClock
from hil.bench.chaos.device import LyingDevice, write_register
from hil.bench.chaos.kinds import CHAOS_KINDS
from hil.bench.chaos.plan import chaos_case, chaos_cases, compatible
from hil.bench.chaos.stage import WATCHDOG_OFF_S, chaos_rig_text, unstepped
from hil.bench.chaos.terminal import Terminal
from hil.bench.chaos.verdict import LIMIT_S, ChaosResult
from hil.bench.faults import judge

SEED = 20_261
ATTACKS = (
    ("harness killed",),
    ("stopped and continued",),
    ("journal locked", "Ctrl-S"),
    ("folder deleted",),
    ("reader gone", "abort, odd reason"),
    ("guardian killed",),
    ("device lies",),
)
"""All without the rig's watchdog: only what the harness brings along can cut the heater."""


@pytest.fixture(scope="module")
def results() -> list[ChaosResult]:
    cases = [chaos_case(names, k, SEED, watchdog=False) for k, names in enumerate(ATTACKS)]
    cases = [dataclasses.replace(case, early=False) for case in cases]
    return asyncio.run(campaign(cases, SEED, jobs=4, resume=False))


@pytest.mark.timeout(300)
def test_attacked_runs_are_safe_within_two_seconds_without_the_rigs_watchdog(results):
    broken = [f"{r.name}: {'; '.join(r.failures)} [{r.reason}]" for r in results if r.failures]
    assert not broken, "\n".join(broken)
    for result in results:
        assert result.heated
        assert not result.by_rig
        assert result.ending == "lies" or (result.safe is not None and result.safe <= LIMIT_S)
    assert sum(result.acknowledged for result in results) > 100
    assert not any(result.lost or result.wrong or result.misplaced for result in results)


# The plan ------------------------------------------------------------------------------------------


def test_half_of_the_cases_are_pairs_and_half_are_without_the_rigs_watchdog():
    plan = chaos_cases(500, 0)
    assert plan == chaos_cases(500, 0) != chaos_cases(500, 1)
    assert Counter(len(case.names) for case in plan) == {1: 250, 2: 250}
    assert 215 <= sum(case.watchdog for case in plan) <= 285
    assert len({case.names for case in plan if len(case.names) == 2}) == 250
    assert {name for case in plan for name in case.names} == set(CHAOS_KINDS)
    off = Counter(name for case in plan if not case.watchdog for name in case.names)
    assert all(off[name] for name, kind in CHAOS_KINDS.items() if not kind.watched)


def test_a_pair_leaves_harness_or_guardian_able_to_act_and_has_one_terminal():
    assert not compatible("guardian killed", "harness killed")
    assert not compatible("guardian stopped", "memory gone")
    assert not compatible("Ctrl-S", "reader gone")
    assert not compatible("both killed", "SIGTERM")
    assert not compatible("folder read-only", "guardian's file deleted")
    assert compatible("device lies", "harness killed")
    assert all(case.names[0] != "harness killed" for case in chaos_cases(500, 3) if len(case.names) > 1)
    assert all(case.apart_s <= 0.4 for case in chaos_cases(300, 3) if case.names[0] == "SIGTERM")


def test_harness_and_guardian_gone_at_once_is_tried_only_with_the_rigs_watchdog():
    assert chaos_case(["both killed"], 0, 0, watchdog=False).watchdog


# The attackers' tools ------------------------------------------------------------------------------


def test_the_rig_without_a_watchdog_takes_heartbeats_and_waits_longer_than_any_case(tmp_path):
    for on, seconds in ((True, 2.0), (False, WATCHDOG_OFF_S)):
        (tmp_path / "rig.toml").write_text(chaos_rig_text({"plc": 5999}, watchdog=on), encoding="utf-8")
        rig = load_rig(tmp_path / "rig.toml")
        assert rig.heartbeat is not None
        assert rig.watchdog_s == seconds


async def _told(device: LyingDevice, truth: Any, watts: int, then: float) -> float:
    """Set the heater, and return its power when it is `then` W, at the latest after ten seconds."""
    await write_register(device.port, HEATER_SET, watts * 10)
    for _ in range(100):
        await asyncio.sleep(0.1)
        if (power := read_truth(truth)[-1].heater_W) == then:
            break
    return power


@pytest.mark.timeout(120)
def test_a_lying_device_acknowledges_a_heater_set_point_that_it_does_not_apply(tmp_path):
    async def tell() -> None:
        truth = tmp_path / "truth.bin"
        rig = await start_virtual_rig(seed=1, mode="real", period_s=0.1, truth=truth)
        async with rig, LyingDevice(rig.modbus_port) as device:
            await write_register(device.port, HEARTBEAT, 1)
            await write_register(device.port, ARM, 1)
            assert await _told(device, truth, 300, then=300.0) == 300.0
            await write_register(device.port, HEARTBEAT, 2)  # the rig's own watchdog stays quiet for two more seconds
            device.mode = "echo"
            await write_register(device.port, HEATER_SET, 0)
            await asyncio.sleep(0.3)
            assert read_truth(truth)[-1].heater_W == 300.0
            device.mode = "honest"
            assert await _told(device, truth, 0, then=0.0) == 0.0
            assert len(device.beats) == 2
            device.mode = "deaf"
            await write_register(device.port, HEARTBEAT, 3)
            assert len(device.beats) == 3

    asyncio.run(tell())


@pytest.mark.skipif(shutil.which("gcc") is None and shutil.which("cc") is None, reason="no C compiler")
def test_a_stepped_clock_moves_the_wall_clock_of_one_process_alone(tmp_path):
    clock = SteppedClock(tmp_path)
    code = "import time; input(); print(time.time(), time.monotonic())"
    with subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, **clock.environment},
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        clock.step(-86_400)
        said, _ = process.communicate("\n", timeout=20)
    wall_s, monotonic_s = map(float, said.split())
    assert wall_s == pytest.approx(time.time() - 86_400, abs=20.0)
    assert monotonic_s == pytest.approx(time.monotonic(), abs=20.0)
    stage: Any = SimpleNamespace(clock=clock)
    assert unstepped(wall_s, stage) == pytest.approx(time.time(), abs=20.0)


async def _reads(file: Path, content: bytes) -> bool:
    """Wait ten seconds at most until the file has this content."""
    for _ in range(1000):
        if await asyncio.to_thread(file.read_bytes) == content:
            return True
        await asyncio.sleep(0.01)
    return False


@pytest.mark.parametrize("shape", ["pipe", "pty"])
def test_a_terminal_keeps_what_is_written_until_its_reader_stops(tmp_path, shape):
    async def write() -> None:
        terminal = Terminal(tmp_path, shape)
        handle = os.dup(terminal.err)
        terminal.started()
        os.write(handle, b"one\n")
        assert await _reads(tmp_path / "err.txt", b"one\n")
        terminal.stop_reading()
        os.write(handle, b"two\n")
        await asyncio.sleep(0.1)
        assert (tmp_path / "err.txt").read_bytes() == b"one\n"
        terminal.let_go()
        assert await _reads(tmp_path / "err.txt", b"one\ntwo\n")
        terminal.hang_up()
        with pytest.raises(OSError, match=r"Broken pipe|Input/output error"):
            os.write(handle, b"three\n")
        os.close(handle)
        terminal.close()

    asyncio.run(write())


# The verdict ---------------------------------------------------------------------------------------


def _event(
    *names_and_times: tuple[str, float],
    asked_s: float = math.inf,
    left_s: float | None = None,
    foreign_s: float = -math.inf,
) -> Any:
    strikes = [(CHAOS_KINDS[name], at_s) for name, at_s in names_and_times]
    states = () if left_s is None else ((left_s, "running", "finishing", ""),)
    journal = judge.JournalContent(wall_s=(9.0, 12.5), states=states)
    stage = SimpleNamespace(asked_s=asked_s, foreign_s=foreign_s)
    return verdict.event_of(strikes, stage, journal)  # type: ignore[arg-type]


def test_the_event_is_the_attack_that_ends_the_run_or_the_signal_at_its_end():
    assert _event(("journal locked", 10.0), asked_s=15.0) == ("rides", 15.0)
    assert _event(("journal locked", 10.0), ("SIGTERM", 11.0)) == ("stops", 11.0)
    assert _event(("memory gone", 10.0)) == ("either", 12.5)
    assert _event(("SIGTERM", 10.0), ("harness killed", 10.2), left_s=10.3) == ("killed", 10.0)
    assert _event(("SIGTERM", 10.0), ("harness killed", 10.4), left_s=10.1) == ("stops", 10.0)
    assert _event(("memory gone", 10.0), foreign_s=13.0) == ("either", 13.0)
    assert _event(("SIGTERM", 10.0), foreign_s=9.0) == ("stops", 10.0)
    assert _event(("device lies", 10.0), asked_s=14.0) == ("lies", 14.0)
    assert _event(("device lies", 10.0), asked_s=14.0, left_s=11.0) == ("lies", 11.0)


def test_time_in_which_nothing_could_act_does_not_count_and_time_before_it_does():
    paused = [(11.0, 15.0), (10.5, 12.0)]
    assert verdict.active_s(paused, 10.0, 10.4) == pytest.approx(0.4)
    assert verdict.active_s(paused, 10.0, 14.0) == pytest.approx(0.5)
    assert verdict.active_s(paused, 10.0, 16.0) == pytest.approx(1.5)
    assert verdict.active_s(paused, 12.0, 16.0) == pytest.approx(1.0)
    assert verdict.active_s([], 10.0, 9.0) == 0.0


def test_a_heartbeat_after_a_pause_is_late_by_the_time_in_which_the_run_could_act():
    beats = [10.1, 11.4, 11.6, 15.2, 16.4, 16.7]
    assert verdict.late_beats(beats, [], 10.0, math.inf) == [11.6, 15.2, 16.4, 16.7]
    assert verdict.late_beats(beats, [(10.2, 15.1)], 10.0, math.inf) == [16.7]
    assert verdict.late_beats(beats, [(12.0, 15.1)], 10.0, math.inf) == [11.6, 15.2, 16.4, 16.7]
    assert verdict.late_beats(beats, [], 10.0, off_s=11.0) == []


def test_the_tables_count_by_kind_and_list_what_was_broken():
    good = ChaosResult(["Ctrl-S"], 0, False, ending="rides", safe=0.1, heated=True, acknowledged=40)
    late = ChaosResult(
        ["harness killed", "link drop, brief"],
        1,
        False,
        ending="killed",
        safe=20.0,
        heated=True,
        acknowledged=30,
        lost=1,
        failures=["safe 20.00 s after the event, the limit is 2 s"],
    )
    left_out = ChaosResult(["folder read-only"], 2, True, left_out="no immutable folders")
    musts, kinds, about, broken = chaos_tables([good, late, left_out])
    found = dict(musts.rows)
    assert found["safe within 2 s, rig's watchdog off"] == "1 of 2, worst 20.00 s"
    assert found["acknowledged samples lost"] == "1 of 70"
    assert found["cases that kept every must"] == "1 of 2"
    rows = {row[0]: row for row in kinds.rows}
    assert set(rows) == {"Ctrl-S", "harness killed", "link drop, brief", "all"}
    assert rows["link drop, brief"][1:3] == (1, 1)
    assert rows["all"][5] == "1 of 2"
    assert len(about.rows) == 3
    assert broken.rows[0][0] == "1 harness killed + link drop, brief, watchdog off"


def test_the_attacks_of_a_case_are_drawn_the_same_every_time():

    case = chaos_case(["SIGINT", "Ctrl-S"], 4, 9, watchdog=True)
    assert case == chaos_case(["SIGINT", "Ctrl-S"], 4, 9, watchdog=True)
    assert case.needs == {"pty"}
