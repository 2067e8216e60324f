"""A run that did not do what its profile asks: what the meters say in the mean, whatever the rig acknowledges."""

from __future__ import annotations

import math

import pytest

from hil.run.outputs.deviations import ReadbackDeviations
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import SHIPPED, rig_with

HOUR = 3600


def run(reading_of, asked_of=lambda tick: 700.0, ticks: int = HOUR) -> list[str]:
    """What deviates after `ticks` seconds; `reading_of(tick, asked)` is what the power meter shows."""
    deviations = ReadbackDeviations(SHIPPED)
    for tick in range(ticks):
        asked = {"heater_power_set": asked_of(tick), "pump_speed_set": 90.0, "fan_speed_set": 70.0}
        readings = {"heater_power": reading_of(tick, asked["heater_power_set"]), "pump_speed": 90.0, "fan_speed": 70.0}
        deviations.tick(asked, {name: value for name, value in readings.items() if not math.isnan(value)})
    return deviations.found(1.0)


def test_a_heater_that_was_never_heated_deviates():
    (said,) = run(lambda tick, asked: -0.4)
    assert "heater_power_set asked for 700 W in the mean and heater_power read -0.4 W" in said


def test_a_meter_that_lags_within_its_declared_time_does_not():
    state = 0.0

    def lagging(tick: int, asked: float) -> float:
        nonlocal state
        state += (asked - state) / 12.0  # within 60 s it is 99 % there
        return state

    assert run(lagging) == []
    state = 0.0
    assert run(lagging, lambda tick: 850.0 if tick // 300 % 2 else 100.0) == []


def test_a_scale_that_is_ten_times_too_small_deviates_even_where_it_moves():
    assert run(lambda tick, asked: 0.1 * asked, lambda tick: 850.0 if tick // 900 % 2 else 300.0)


def test_a_meter_without_a_good_value_leaves_open_what_happened():
    (said,) = run(lambda tick, asked: math.nan)
    assert said == "heater_power had no good value: what heater_power_set did is not known"


@pytest.mark.parametrize(("reads_W", "verdict"), [(None, "done"), (0.0, "done with deviations")])
def test_a_run_that_deviates_is_not_in_order(reads_W, verdict):
    with EngineBench(rig_with(interlocks=()), duration_s=400.0) as bench:
        bench.rig.readings |= {"pump_speed": 91.0, "fan_speed": 71.0}
        if reads_W is not None:
            bench.rig.readings["heater_power"] = reads_W
        bench.ticks(420)
        bench.ticks(120)
        outcome = bench.outcome
        assert (outcome.status, outcome.safe, outcome.verdict) == ("done", True, verdict)
        assert bool(outcome.deviations) == (reads_W is not None)
        assert not outcome.in_order  # pump and fan do not get to their safe values
