"""The rig's own watchdog: given its time-out before anything is armed, it cuts the heater when the harness dies."""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

import pytest

from drivers.rig_file.reader import load_rig
from drivers.signals.points import DeviceExceptionError, LinkError
from drivers.virtual.devices.registers import HEARTBEAT, WATCHDOG
from drivers.virtual.devices.truth import Moment, read_truth
from drivers.virtual.rig import start_virtual_rig
from hil.bench.faults.rig import LOAD, rig_text
from hil.run.engine.operator import Verb
from hil.run.outputs.outputs import Outputs
from tests.drivers.test_rigfile import VIRTUAL, broken, complaint
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import SimulatedRig, rig_with

PROJECT = Path(__file__).resolve().parents[2]


def test_a_rig_is_armed_with_the_time_out_that_its_file_asks_for():
    with EngineBench(rig_with(1000.0)) as bench:
        bench.ticks(5)
        assert bench.state == "running"
        assert bench.rig.registers.holding[WATCHDOG] == 50
        bench.rig.reboot()
        bench.ticks(3)
        assert bench.rig.registers.holding[WATCHDOG] == 100  # a PLC's own idea
        bench.ask(Verb.ACK)
        bench.ticks(3)
        assert bench.rig.armed
        assert bench.rig.registers.holding[WATCHDOG] == 50
        assert not bench.violations


def test_a_rig_that_does_not_hold_the_time_out_is_not_armed():
    rig = rig_with()
    assert rig.heartbeat is not None
    rig = rig.model_copy(update={"heartbeat": rig.heartbeat.model_copy(update={"watchdog_s": 0.5})})
    with EngineBench(rig) as bench:  # this PLC takes no less than a second
        bench.ticks(5)
        assert bench.state == "faulted"
        assert "not armed: watchdog_timeout holds 10 s instead of the 0.5 s" in bench.outcome.reason
        assert not bench.rig.armed
        assert not bench.violations


class Tripped(SimulatedRig):
    """A rig whose watchdog has tripped: it is armed after another beat than the one it holds, and refuses before."""

    def __init__(self, beat: int, readable: bool) -> None:
        rig = rig_with()
        points = tuple(
            p.model_copy(update={"access": "rw" if readable else "w"}) if p.name == "heartbeat" else p
            for p in rig.point
        )
        super().__init__(rig.model_copy(update={"point": points}))
        self.registers.write(HEARTBEAT, [beat, 50, 1])
        self.registers.supervise(60.0, 20.0)
        assert not self.armed

    async def write(self, values: dict[str, float]) -> None:
        await super().write(values)
        if values.get("arm") and not self.armed:
            raise DeviceExceptionError("plc refused to write holding 5", 3)


@pytest.mark.parametrize("readable", [True, False])
@pytest.mark.parametrize("beat", [1, 2, 65535])
async def test_a_rig_is_armed_whatever_beat_a_killed_run_has_left(beat, readable):
    rig = Tripped(beat, readable)

    async def advance() -> None:
        rig.pass_time(1.0)

    await Outputs(rig).arm(advance, lambda snapshot: None)  # type: ignore[arg-type]
    assert rig.armed


async def test_a_rig_that_refuses_the_time_out_is_not_armed():
    from drivers.rig.connection import RigConnection

    async with await start_virtual_rig(period_s=0.1) as virtual:
        rig = load_rig(VIRTUAL).with_ports({"plc": virtual.modbus_port, "thermocouples": virtual.can_port})
        assert rig.heartbeat is not None
        rig = rig.model_copy(update={"heartbeat": rig.heartbeat.model_copy(update={"watchdog_s": 0.5})})
        connection = RigConnection(rig, time.monotonic)
        await connection.connect()

        async def advance() -> None:
            raise AssertionError("it went on to arm")

        try:
            with pytest.raises(LinkError, match=r"the rig refuses a watchdog time-out of 0\.5 s .*correct watchdog_s"):
                await Outputs(connection).arm(advance, lambda snapshot: None)
            assert await connection.read_back(("watchdog_timeout", "arm")) == {"watchdog_timeout": 10.0, "arm": 0.0}
        finally:
            await connection.close()


async def test_kill_9_and_the_heater_is_cut_within_the_time_out_that_the_harness_wrote(tmp_path):
    """In the rig's own time, by its own log: how busy this machine is does not matter."""
    truth, period_s = tmp_path / "truth.bin", 0.1
    async with await start_virtual_rig(mode="real", period_s=period_s, truth=truth) as virtual:
        text = rig_text({"plc": virtual.modbus_port, "thermocouples": virtual.can_port})
        text = text.replace("watchdog_s = 2.0\n", "").replace("abort_after_s = 1.5", "abort_after_s = 3.0")
        (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
        (tmp_path / "load.csv").write_text(LOAD.format(400), encoding="utf-8")
        assert load_rig(tmp_path / "rig.toml").watchdog_s == pytest.approx(3.0)  # of abort_after_s; by itself 10 s
        command = [sys.executable, "-m", "hil", "run", "load.csv", "--rig", "rig.toml", "--no-twin", "--no-viewer"]
        command += ["--no-report", "--no-guardian"]  # which would be faster
        with (tmp_path / "said.txt").open("wb") as said:
            process = await asyncio.create_subprocess_exec(*command, cwd=tmp_path, stdout=said, stderr=said)
        try:
            await until(truth, lambda now: now.heater_W > 100.0, process)
        finally:
            process.kill()
            await process.wait()
        killed = time.time()
        moments = await until(truth, lambda now: now.heater_W == 0.0)
    killed_s = next(moment.rig_s for moment in reversed(moments) if moment.wall_s <= killed)
    cut_s = next(moment.rig_s for moment in moments if moment.rig_s > killed_s and moment.heater_W == 0.0)
    assert 0.0 < cut_s - killed_s <= 3.0 + 2 * period_s


async def until(truth: Path, condition, process: asyncio.subprocess.Process | None = None) -> list[Moment]:
    deadline = time.monotonic() + 60.0
    while True:
        moments = read_truth(truth)
        if moments and condition(moments[-1]):
            return moments
        assert time.monotonic() < deadline
        assert process is None or process.returncode is None
        await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('watchdog = "watchdog_timeout"', 'watchdog = "nowhere"', ["heartbeat: no point 'nowhere'"]),
        ('watchdog = "watchdog_timeout"', 'watchdog = "plc_status"', ["plc_status must be in s, have access 'rw'"]),
        ('watchdog = "watchdog_timeout"', "watchdog_s = 3.0", ["watchdog_s is written to a point"]),
        ("abort_after_s = 5.0", "abort_after_s = 1.5", ["a watchdog of 1.5 s would cut", "at least two periods, 2 s"]),
        ("\n[heartbeat]", "\n[heartbeat]\nwatchdog_s = 7000.0", ["7000 s cannot be written to watchdog_timeout"]),
    ],
)
def test_a_watchdog_that_cannot_be_set_is_a_mistake_of_the_rig_file(tmp_path, old, new, words):
    said = complaint(broken(tmp_path, old, new))
    for word in [", line ", *words]:
        assert word in said


def test_a_time_out_is_rounded_down_to_what_the_rig_can_hold(tmp_path):
    text = VIRTUAL.read_text(encoding="utf-8").replace("abort_after_s = 5.0", "abort_after_s = 4.56")
    (tmp_path / "rig.toml").write_text(text.replace('dbc = "', f'dbc = "{VIRTUAL.parent}/'), encoding="utf-8")
    assert load_rig(tmp_path / "rig.toml").watchdog_s == pytest.approx(4.5)
