"""Making safe where parts of the rig refuse, and what counts as off."""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Iterable

import pytest

from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from drivers.signals.points import DeviceExceptionError, DriverError, Quality
from hil.run.engine.operator import Verb
from hil.run.outputs import safing
from hil.run.outputs.heaters import Descent, not_cold, safe_limit, safe_limits
from hil.run.outputs.safing import attempt_s, write_safe
from hil.run.outputs.setpoints import Setpoints
from tests.hil.engine_bench import EngineBench
from tests.hil.guarded_device import HEATER, Device
from tests.hil.simulated_rig import SHIPPED, rig_with
from tests.hil.test_trips import warm


class Refusing:
    """A rig of which some outputs refuse to be written."""

    def __init__(self, refused: set[str], held: dict[str, float]) -> None:
        self.rig = SHIPPED
        self.refused = refused
        self.held = held

    async def write(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            if name in self.refused:
                raise DeviceExceptionError(f"{name} refused", 4)
            self.held[name] = value

    def by_wire(self, names: Iterable[str]) -> list[tuple[str, ...]]:
        return [tuple(names)]

    async def write_and_read_back(self, values: dict[str, float], names: tuple[str, ...]) -> dict[str, float]:
        await self.write(values)
        return await self.read_back(names)

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        if "mute" in self.refused:
            raise DriverError("no answer")
        return {name: self.held[name] for name in names}


HOT = {"heater_power_set": 700.0, "pump_speed_set": 60.0, "fan_speed_set": 60.0}


@pytest.mark.parametrize("refused", ["heater_power_set", "pump_speed_set", "fan_speed_set"])
def test_an_output_that_refuses_keeps_no_other_from_being_made_safe(refused):
    rig = Refusing({refused}, dict(HOT))
    safe = Setpoints(SHIPPED).safe_values()
    problem = asyncio.run(write_safe(rig, safe))  # type: ignore[arg-type]
    assert problem == f"{refused} refused"
    assert {name for name in safe if rig.held[name] == safe[name]} == set(safe) - {refused}


def test_an_output_that_refuses_what_it_does_already_is_safe():
    rig = Refusing({"pump_speed_set"}, HOT | {"pump_speed_set": 100.0})
    assert asyncio.run(write_safe(rig, Setpoints(SHIPPED).safe_values())) == ""  # type: ignore[arg-type]


def test_the_heater_comes_first_where_the_rig_file_gives_no_order(tmp_path):
    device = Device()
    (tmp_path / "rig.toml").write_text(device.rig_text(pump=True))
    assert list(Setpoints(load_rig(tmp_path / "rig.toml")).safe_values()) == ["heater_set", "pump_set"]
    device.close()


def test_no_tolerance_makes_a_heater_off_that_takes_a_tenth_of_its_range():
    heater = SHIPPED.get("heater_power_set")
    for tolerance, at_most in ((10.0, 10.0), (1000.0, 50.0)):
        changed = heater.model_copy(update={"readback_tolerance": tolerance})
        limit = safe_limit(SHIPPED, changed)
        assert limit is not None
        assert limit.at_most == at_most


@pytest.mark.parametrize(("reads_W", "said"), [(3.0, ""), (-400.0, "still reads"), (math.nan, "is not known")])
def test_a_meter_that_is_dead_or_the_wrong_way_round_shows_no_heater_off(reads_W, said):
    found = not_cold(SHIPPED, safe_limits(SHIPPED), {"heater_power": reads_W})
    assert said in found and bool(found) == bool(said)


def test_a_run_whose_power_meter_died_does_not_claim_to_be_safe():
    with EngineBench(rig_with(interlocks=()), duration_s=60.0) as bench:
        warm(bench)
        bench.rig.quality["heater_power"] = Quality.SENSOR_FAULT
        bench.ticks(200)
        assert not bench.outcome.safe
        assert "is not known" in bench.outcome.away


def test_what_another_master_writes_while_the_run_ends_is_made_safe_again():
    with EngineBench(rig_with(interlocks=()), duration_s=600.0) as bench:
        warm(bench)
        written = False

        def another_master(passed_s: float) -> None:
            nonlocal written
            if bench.state == "finishing" and not written:
                written = True
                bench.rig.registers.holding[0] = 3000  # 300 W

        bench.rig.watch = another_master
        bench.engine.request_stop("the test")
        bench.ticks(200)
        assert written
        assert bench.rig.registers.holding[0] == 0
        assert bench.outcome.safe


def test_a_heater_that_does_not_obey_gets_no_second_dead_time_when_the_run_ends():
    """It was told long before: the pause has withheld the heartbeat already, and so does the end."""
    with EngineBench(rig_with(interlocks=())) as bench:
        warm(bench)
        bench.rig.readings["heater_power"] = 350.0
        bench.ask(Verb.PAUSE)
        bench.ticks(5)
        assert bench.state == "paused"
        withheld = bench.rig.beat
        bench.ticks(3)
        assert bench.rig.beat == withheld
        bench.engine.request_stop("the test")
        bench.ticks(200)
        assert bench.rig.beat == withheld
        assert "still reads 350.0 W" in bench.outcome.away


@pytest.mark.parametrize("paused_first", [False, True])
@pytest.mark.parametrize("kept_W", [350.0, 90.0])
def test_a_heater_that_only_the_rigs_watchdog_cuts_is_a_deviation(kept_W, paused_first):
    """It acknowledges OFF and heats on, at all of its power or a part; without a heartbeat it goes off."""
    with EngineBench(rig_with(interlocks=()), duration_s=60.0) as bench:
        warm(bench)
        silent_s, last_beat = 0.0, bench.rig.beat

        def disobeys(passed_s: float) -> None:
            nonlocal silent_s, last_beat
            silent_s = silent_s + passed_s if bench.rig.beat == last_beat else 0.0
            last_beat = bench.rig.beat
            if bench.state in ("paused", "finishing") and bench.rig.readings.get("heater_power") != 0.0:
                bench.rig.readings["heater_power"] = 0.0 if silent_s > 5.0 else kept_W

        bench.rig.watch = disobeys
        if paused_first:
            bench.ask(Verb.PAUSE)
            bench.ticks(20)
            bench.engine.request_stop("the test")
        bench.ticks(200)
        assert bench.outcome.safe and not bench.outcome.in_order
        assert any("went off only after the heartbeat was withheld" in said for said in bench.outcome.deviations)
        assert paused_first or bench.outcome.verdict == "done with deviations"
        assert any("did not obey" in text for _, text in bench.journal.events if isinstance(text, str))


@pytest.mark.parametrize("fall_s", [0.5, 3.0, 10.0, 25.0])
@pytest.mark.parametrize("shape", ["line", "lag"])
def test_a_heater_that_comes_down_in_its_time_has_obeyed(fall_s, shape):
    heater = SHIPPED.get("heater_power_set")
    descent = Descent(SHIPPED, safe_limits(SHIPPED), 0.5)
    assert heater.readback_within_s >= 25.0
    for k in range(80):
        t = 0.5 * k
        left = max(1.0 - t / fall_s, 0.0) if shape == "line" else math.exp(-5.0 * t / fall_s)
        descent.stays({"heater_power": 700.0 * left}, t)
    assert descent.not_obeyed() == ""


async def test_a_mute_device_keeps_no_other_waiting_and_an_attempt_has_an_end(tmp_path, monkeypatch):
    """The pump's device comes first and takes connections, and answers nothing."""
    monkeypatch.setattr(safing, "ATTEMPT_S", 0.2)
    device = Device()
    with socket.create_server(("127.0.0.1", 0)) as mute:
        text = device.rig_text(pump=True).replace('bus = "plc"', 'bus = "pumps"', 1)
        pumps = f'[bus.pumps]\ntransport = "modbus_tcp"\nport = {mute.getsockname()[1]}\ntimeout_s = 1.0\n'
        (tmp_path / "rig.toml").write_text(text.replace("[bus.plc]", pumps + "[bus.plc]", 1))
        rig = load_rig(tmp_path / "rig.toml")
        connection = RigConnection(rig, time.monotonic)
        await connection.connect()
        device.registers[HEATER] = 500
        began = time.monotonic()
        writing = asyncio.ensure_future(write_safe(connection, {"pump_set": 100.0, "heater_set": 0.0}, attempt_s(rig)))
        while device.registers[HEATER]:
            assert time.monotonic() - began < 0.9  # no time-out of the pump's device has passed
            await asyncio.sleep(0.01)
        problem = await writing
        assert time.monotonic() - began < 2.0 * 1.0 + 0.2 + 1.0
        assert problem and "heater_set" not in problem
        await connection.close()
    device.close()


def test_a_mute_device_without_set_points_holds_up_no_end():
    with EngineBench(rig_with(interlocks=()), duration_s=600.0) as bench:
        warm(bench)
        other = next(p.name for p in bench.rig.points if p.name == "T_tank")
        bench.rig.quality[other] = Quality.LINK_FAULT
        bench.rig.faults = ["tc: no answer"]
        bench.engine.request_stop("the test")
        bench.ticks(200)
        assert bench.outcome.safe and not bench.outcome.away
