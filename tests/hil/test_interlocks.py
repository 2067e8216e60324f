"""Interlocks: what ends a run, judged on one tick's values."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.rig_file.reader import load_rig
from drivers.signals.points import Quality, Snapshot
from hil.run.interlocks.interlocks import Interlocks

PROJECT = Path(__file__).resolve().parents[2]
RIG = load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml")
POINTS = tuple(point for point in RIG.point if point.access == "r")
HEALTHY = {"heater_power": 700.0, "flow": 3.8, "pump_speed": 100.0, "fan_speed": 70.0, "plc_status": 1.0}


def snapshot(counter: float = 0.0, quality: dict[str, Quality] | None = None, **values: float) -> Snapshot:
    known = HEALTHY | {"cycle_counter": counter} | values
    return Snapshot(
        [known.get(p.name, 30.0) for p in POINTS],
        [int((quality or {}).get(p.name, Quality.GOOD)) for p in POINTS],
        [0.0] * len(POINTS),
    )


def trip(interlocks: Interlocks, now: Snapshot, now_s: float = 0.0) -> str | None:
    """The first trip that stands after a tick, or None."""
    return next(iter(interlocks.judge(now, now_s).trips), None)


def test_a_healthy_rig_runs_on():
    interlocks = Interlocks(RIG, POINTS)
    assert all(trip(interlocks, snapshot(float(t)), float(t)) is None for t in range(200))


@pytest.mark.parametrize(("value", "trips"), [(74.9, False), (75.1, True), (-5.1, True)])
def test_alarm_limits_trip_on_the_same_tick(value, trips):
    reason = trip(Interlocks(RIG, POINTS), snapshot(T_pm3=value))
    assert (reason is not None) == trips
    if trips:
        assert "T_pm3" in reason
        assert "alarm limits are -5 to 75" in reason


def test_an_implausible_reading_beyond_the_alarm_trips_too():
    reason = trip(Interlocks(RIG, POINTS), snapshot(T_tank=120.0, quality={"T_tank": Quality.OUT_OF_RANGE}), 0.0)
    assert reason is not None


@pytest.mark.parametrize("quality", [Quality.STALE, Quality.SENSOR_FAULT, Quality.LINK_FAULT])
def test_a_thermocouple_that_cannot_be_trusted_ends_the_run_in_time(quality):
    interlocks = Interlocks(RIG, POINTS)
    reasons = [
        trip(interlocks, snapshot(float(t), {"T_heater": quality}, T_heater=math.nan), float(t)) for t in range(8)
    ]
    assert reasons[:5] == [None] * 5
    assert reasons[5] is not None
    assert "T_heater has been without a good value for 5 s" in reasons[5]


def test_a_short_dropout_does_not_end_the_run():
    interlocks = Interlocks(RIG, POINTS)
    for t in range(100):
        bad = {"T_heater": Quality.STALE} if t % 6 < 2 else {}
        assert trip(interlocks, snapshot(float(t), bad), float(t)) is None


@pytest.mark.parametrize("bits", [0b010, 0b100, 0b110])
def test_the_rigs_own_trip_ends_the_run(bits):
    reason = trip(Interlocks(RIG, POINTS), snapshot(plc_status=float(bits)), 0.0)
    assert reason is not None
    assert "tripped by itself" in reason


def test_a_counter_that_stands_still_is_a_dead_rig():
    interlocks = Interlocks(RIG, POINTS)
    reasons = [trip(interlocks, snapshot(counter=5.0), float(t)) for t in range(13)]
    assert reasons[:11] == [None] * 11
    assert reasons[11] is not None
    assert "cycle_counter has not advanced for 10 s" in reasons[11]


def test_a_loose_contact_that_is_good_now_and_then_trips_all_the_same_and_one_that_is_mostly_good_does_not():
    def tripped_after(bad: int, good: int) -> int | None:
        rig = load_rig(Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "virtual.toml")
        points = tuple(point for point in rig.point if point.access == "r")
        interlocks = Interlocks(rig, points)
        index = [point.name for point in points].index("T_heater")
        for tick in range(200):
            quality = [0] * len(points)
            quality[index] = int(Quality.SENSOR_FAULT) if tick % (bad + good) < bad else 0
            values = [30.0 if point.unit == "degC" else 0.0 for point in points]
            values[[point.name for point in points].index("cycle_counter")] = float(tick)
            values[[point.name for point in points].index("plc_uptime")] = float(tick)
            if any("T_heater" in trip for trip in interlocks.judge(Snapshot(values, quality, []), float(tick)).trips):
                return tick
        return None

    assert tripped_after(200, 0) == 5  # abort_after_s of 5 s, as ever
    assert tripped_after(4, 1) is not None
    assert tripped_after(4, 1) < 15
    assert tripped_after(1, 4) is None
