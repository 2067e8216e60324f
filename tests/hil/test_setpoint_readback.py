"""Set-points that the rig holds otherwise than this run wrote them: another master trips, a healthy device does not."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.modbus.protocol.pdu import NO_SUCH_FUNCTION
from drivers.rig_file.model import Point, Rig
from drivers.signals.points import DeviceExceptionError, LinkError, Quality, Snapshot
from drivers.virtual.devices.registers import HEATER_SET
from hil.run.engine.operator import Verb
from hil.run.interlocks.conditions import TickValues
from hil.run.outputs.readback import CLOSE_S, INTERVAL_S, LOCKSTEP_INTERVAL_S, SetpointReadback
from hil.run.outputs.safing import CONTEST_S
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import SHIPPED, rig_with

SENTENCE = "heater_power_set holds 100 W, this run wrote 700 W: another master writes to this rig"


def other_master(bench: EngineBench, power_W: float, every: int = 1, times: int = 10**6) -> None:
    """Have somebody else write the heater's register on every so many periods, so many times."""
    look, passed, left = bench.rig.watch, 0, times

    def also(seconds: float) -> None:
        nonlocal passed, left
        passed += 1
        if passed % every == 0 and left:
            left -= 1
            bench.rig.registers.holding[HEATER_SET] = round(10.0 * power_W)
        look(seconds)

    bench.rig.watch = also


@pytest.mark.parametrize("every", [1, 2, 3, 5])
def test_another_master_trips_however_seldom_it_writes(every):
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(30)
        other_master(bench, 100.0, every)
        bench.ticks(2 * round(CLOSE_S) * every + round(CONTEST_S))
        assert bench.state == "faulted"
        assert bench.outcome.reason.startswith(SENTENCE)
        # While the other goes on nobody can keep the heater off, and that is what is reported.
        assert not bench.outcome.safe
        assert "another master goes on writing to this rig" in bench.outcome.problems[0]


def test_a_master_that_gives_up_leaves_a_rig_that_is_safe():
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(30)
        other_master(bench, 100.0, times=12)
        bench.ticks(20 + round(CONTEST_S))
        assert bench.state == "faulted" and bench.outcome.reason.startswith(SENTENCE)
        assert bench.outcome.safe and bench.rig.heater_W == 0.0


def test_two_periods_of_another_master_are_enough():
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(30)
        other_master(bench, 100.0)
        bench.ticks(3)  # the next check is due after two ticks at most
        assert bench.state in ("finishing", "faulted")


def test_a_single_foreign_value_is_written_over_and_reported():
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(30)
        before = len(bench.journal.events)
        other_master(bench, 100.0, times=2)  # a check comes every two ticks at least
        bench.ticks(1)
        seen = len(bench.journal.events) > before
        bench.rig.watch = lambda passed_s: None
        bench.ticks(20)
        said = [text for level, text in bench.journal.events[before:] if level == "WARN"]
        assert bench.state == "running" and bench.rig.heater_W == pytest.approx(700.0)
        assert len(said) == seen
        assert not said or said[0].startswith("heater_power_set held 100 W where this run wrote 700 W")


def test_the_alarm_is_latched_and_cannot_be_acknowledged_while_the_other_writes():
    with EngineBench(rig_with(1000.0, interlocks=())) as bench:
        bench.ticks(30)
        look = bench.rig.watch
        other_master(bench, 100.0, every=3)
        bench.ticks(40)
        assert bench.state == "paused"
        assert bench.engine.status().trips[0].startswith("heater_power_set holds 100 W")
        bench.ask(Verb.ACK)
        bench.ticks(6)
        assert bench.engine.status().trips
        bench.rig.watch = look
        bench.ticks(round(CLOSE_S) + 2)
        bench.ask(Verb.ACK)
        bench.ticks(3)
        assert not bench.engine.status().trips
        bench.ask(Verb.RESUME)
        bench.ticks(30)
        assert bench.state == "running" and bench.rig.heater_W == pytest.approx(700.0)


class Device:
    """What a `RigConnection` is to the read-back: a device that makes `holds` of what it is told."""

    def __init__(self, rig: Rig, holds: Callable[[float], float] = lambda value: value) -> None:
        self.rig = rig
        self.points = tuple(point for point in rig.point if point.is_polled)
        self.holds = holds
        self.registers: dict[str, float] = {}
        self.asked: list[float] = []
        self.error: Exception | None = None
        self.lost = False
        self.now = 0.0
        self.events: list[str] = []

    def write(self, values: dict[str, float]) -> None:
        self.registers |= {name: self.holds(value) for name, value in values.items()}

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        self.asked.append(self.now)
        if self.error is not None:
            raise self.error
        return {name: self.registers[name] for name in names}

    async def write_and_read_back(self, values: dict[str, float], names: tuple[str, ...]) -> dict[str, float]:
        self.write(values)
        return {name: self.registers[name] for name in names}

    def snapshot(self) -> Snapshot:
        quality = Quality.LINK_FAULT if self.lost else Quality.GOOD
        return Snapshot([0.0] * len(self.points), [int(quality)] * len(self.points), [self.now] * len(self.points))


SAFE = {point.name: point.safe_value or 0.0 for point in SHIPPED.setpoints}


async def run(
    device: Device,
    ticks: int,
    wanted: Callable[[int], float],
    period_s: float = 0.1,
    meddle: Callable[[int], None] = lambda tick: None,
    lockstep: bool = False,
) -> str | None:
    """Tick as the engine does, the heater set to `wanted` W; the alarm, or None."""
    readback = SetpointReadback(device, lambda level, text: device.events.append(text), lockstep=lockstep)  # type: ignore[arg-type]
    values = SAFE
    device.write(values)
    for tick in range(ticks):
        device.now = tick * period_s
        meddle(tick)
        await readback.look(device.snapshot(), values, device.now)
        said = readback.judge(TickValues(device.now, {}, {}, {}), False)
        if said is not None:
            return said
        values = SAFE | {"heater_power_set": wanted(tick)}
        device.write(values)
    return None


def heater(**changed: object) -> Rig:
    """The shipped rig with another heater set-point."""

    def point(one: Point) -> Point:
        return one.model_copy(update=changed) if one.name == "heater_power_set" else one

    return SHIPPED.model_copy(update={"point": tuple(map(point, SHIPPED.point))})


async def test_ten_ticks_a_second_cost_one_request_a_second():
    device = Device(SHIPPED)
    assert await run(device, 1000, lambda tick: 500.0) is None
    gaps = [later - earlier for earlier, later in zip(device.asked, device.asked[1:], strict=False)]
    assert min(gaps) >= 0.5 * INTERVAL_S - 1e-6 and max(gaps) <= 1.5 * INTERVAL_S + 0.2
    assert len(device.asked) <= 101
    assert len({round(10.0 * at) % 10 for at in device.asked}) == 10  # every phase of a second
    slow = Device(SHIPPED)
    assert await run(slow, 1000, lambda tick: 500.0, 1.0, lockstep=True) is None
    assert len(slow.asked) <= 1.01 * 1000 / LOCKSTEP_INTERVAL_S


async def test_a_master_ten_times_slower_is_found_within_a_minute():
    device = Device(SHIPPED)

    def meddle(tick: int) -> None:
        if tick % 10 == 3:
            device.registers["heater_power_set"] = 100.0

    assert (await run(device, 600, lambda tick: 500.0, meddle=meddle) or "").startswith("heater_power_set holds 100 W")


async def test_a_setpoint_that_moves_on_every_tick_in_a_device_that_lags_is_no_alarm():
    device = Device(SHIPPED)
    past: list[dict[str, float]] = []

    def lags(tick: int) -> None:
        past.append(dict(device.registers))
        device.registers = dict(past[max(0, tick - 5)])

    assert await run(device, 300, lambda tick: 300.0 + tick * 1.37, meddle=lags) is None
    assert not device.events


async def test_a_device_that_rounds_is_known_by_it_and_another_master_is_found_all_the_same():
    device = Device(SHIPPED, holds=lambda value: 10.0 * round(value / 10.0))
    assert await run(device, 600, lambda tick: 300.0 + tick * 0.77) is None
    assert any("the device rounds" in text for text in device.events)
    assert len(device.events) < 10

    def meddle(tick: int) -> None:
        device.registers["heater_power_set"] = 250.0 if tick > 100 else device.registers["heater_power_set"]

    said = await run(device, 600, lambda tick: 300.0 + tick * 0.77, meddle=meddle)
    assert said is not None and said.startswith("heater_power_set holds 250 W")


async def test_a_device_that_does_not_take_what_is_written_is_an_alarm():
    device = Device(SHIPPED, holds=lambda value: value if value <= 400.0 else 400.0)
    said = await run(device, 100, lambda tick: 500.0 if tick > 20 else 300.0)
    assert said is not None and said.startswith(
        "heater_power_set holds 400 W at once after 500 W was written: the device"
    )


async def test_half_a_count_is_the_tolerance_and_a_switch_has_two_values():
    coarse = heater(scale=1.0, offset=0.0)
    device = Device(coarse, holds=round)
    assert await run(device, 300, lambda tick: 300.0 + tick * 0.31) is None and not device.events
    switch = heater(table="coil", type="bool", scale=1.0, offset=0.0, limits=(0.0, 1.0))
    device = Device(switch)

    def meddle(tick: int) -> None:
        device.registers["heater_power_set"] = 1.0

    assert (await run(device, 60, lambda tick: 0.0, meddle=meddle) or "").startswith("heater_power_set holds 1 W")
    fraction = heater(type="float32", scale=1.0, offset=0.0, limits=(0.0, 1.0))
    device = Device(fraction)

    def little(tick: int) -> None:
        device.registers["heater_power_set"] = 0.3

    assert await run(device, 60, lambda tick: 0.5, meddle=little) is not None


async def test_what_cannot_be_read_back_is_not_watched():
    device = Device(heater(access="w"))

    def meddle(tick: int) -> None:
        device.registers["heater_power_set"] = 100.0

    assert await run(device, 60, lambda tick: 500.0, meddle=meddle) is None
    device = Device(SHIPPED)
    device.error = DeviceExceptionError("plc: no such function", NO_SUCH_FUNCTION)
    assert await run(device, 60, lambda tick: 500.0, meddle=meddle) is None
    assert len(device.asked) == 1
    assert device.events == [text for text in device.events if "another master would not be noticed" in text]


async def test_a_read_back_that_fails_or_a_lost_link_is_no_alarm():
    device = Device(SHIPPED)

    def meddle(tick: int) -> None:
        device.error = LinkError("plc: no answer") if 20 <= tick < 60 else None
        device.lost = 100 <= tick < 140
        if device.error is not None or device.lost:
            device.registers["heater_power_set"] = 100.0

    assert await run(device, 200, lambda tick: 500.0, meddle=meddle) is None
    assert not any(10.0 <= at < 14.0 for at in device.asked)


async def test_a_write_that_was_not_confirmed_leaves_the_next_check_out():
    device = Device(SHIPPED)
    readback = SetpointReadback(device, lambda level, text: device.events.append(text))  # type: ignore[arg-type]
    device.write(SAFE | {"heater_power_set": 500.0})
    for tick in range(20):
        device.now = 2.0 * tick
        readback.not_confirmed()  # the device took it, its reply was lost
        await readback.look(device.snapshot(), SAFE, device.now)
        assert readback.judge(TickValues(device.now, {}, {}, {}), False) is None
    assert not device.asked and not device.events
