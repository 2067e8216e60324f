"""Readings that may not be believed: a sensor that is stuck, one that jumps, and what is no fault."""

from __future__ import annotations

import random

import pytest

from drivers.bus.sensor_watch import SensorWatch, watches
from drivers.rig_file.model import Point
from drivers.signals.points import Quality

GOOD, FAULT = Quality.GOOD, Quality.SENSOR_FAULT


def watch(**options: float) -> SensorWatch:
    return SensorWatch(Point(name="T", bus="b", unit="degC", message="M", signal="S", **options))


def test_a_value_that_repeats_itself_is_a_fault_when_its_time_is_up_and_good_when_it_moves():
    sensor = watch(stuck_after_s=3.0)
    said = [sensor.judge(20.0, GOOD, t) for t in (0.0, 1.0, 2.0, 3.0, 4.0)]
    assert said == [GOOD, GOOD, GOOD, FAULT, FAULT]
    assert sensor.judge(20.01, GOOD, 5.0) == GOOD


def test_noise_alone_is_never_stuck():
    sensor, generator = watch(stuck_after_s=1.0), random.Random(1)
    for k in range(200_000):
        assert sensor.judge(round(20.0 + generator.gauss(0.0, 0.05), 2), GOOD, k * 0.1) == GOOD


def test_a_jump_is_not_believed_until_it_is_back_or_could_have_got_there():
    sensor = watch(max_change_per_s=2.0)
    assert sensor.judge(20.0, GOOD, 0.0) == GOOD
    assert sensor.judge(32.0, GOOD, 0.1) == FAULT
    assert sensor.judge(20.3, GOOD, 0.2) == GOOD
    assert [sensor.judge(32.0, GOOD, 0.2 + t) for t in (1.0, 3.0, 5.8, 5.9)] == [FAULT, FAULT, FAULT, GOOD]


def test_a_value_that_moves_as_fast_as_it_may_is_good_however_often_it_is_read():
    for period_s in (0.1, 1.0, 5.0):
        sensor = watch(max_change_per_s=2.0)
        assert all(sensor.judge(2.0 * k * period_s, GOOD, k * period_s) == GOOD for k in range(50))


@pytest.mark.parametrize("quality", [Quality.OUT_OF_RANGE, Quality.SENSOR_FAULT])
def test_what_is_not_good_as_such_stays_what_it_is_and_is_nothing_to_compare_with(quality):
    sensor = watch(max_change_per_s=2.0, stuck_after_s=2.0)
    sensor.judge(20.0, GOOD, 0.0)
    assert [sensor.judge(327.67, quality, t) for t in (1.0, 2.0, 3.0, 4.0)] == [quality] * 4
    assert sensor.judge(20.1, GOOD, 5.0) == GOOD


def test_after_a_silence_an_instrument_has_to_move_before_it_is_believed():
    sensor = watch(stuck_after_s=2.0, stale_after_s=1.0)
    assert [sensor.judge(v, GOOD, t) for v, t in ((20.0, 0.0), (20.1, 0.1), (20.2, 0.2))] == [GOOD] * 3
    # It moved in the silence, and got stuck in it too: nothing is good again, and at last it is a fault.
    stuck = [sensor.judge(20.5, GOOD, 1.5 + 0.1 * k) for k in range(25)]
    assert stuck == [Quality.STALE] * 20 + [FAULT] * 5
    assert sensor.judge(20.6, GOOD, 4.0) == GOOD
    assert sensor.judge(20.6, GOOD, 4.9) == GOOD


@pytest.mark.parametrize("period_s", [0.5, 5.0, 60.0])
def test_what_is_read_seldom_is_no_silence(period_s):
    sensor = watch(stuck_after_s=10.0 * period_s, stale_after_s=1.0)
    values = [20.0, 20.0, 20.1, 20.1, 20.1, 20.2]
    assert [sensor.judge(value, GOOD, k * period_s) for k, value in enumerate(values)] == [GOOD] * 6


def test_only_points_that_ask_for_it_are_watched():
    plain = Point(name="T", bus="b", unit="degC", message="M", signal="S")
    asks = plain.model_copy(update={"stuck_after_s": 2.0})
    assert [item is not None for item in watches((plain, asks))] == [False, True]
