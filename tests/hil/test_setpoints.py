"""Set-points: never outside their limits, never faster than their slew rate, and there in the end."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.rig_file.reader import load_rig
from drivers.signals.points import ConfigurationError
from hil.run.outputs.setpoints import Setpoints, bind, setpoint_columns

PROJECT = Path(__file__).resolve().parents[2]
RIG = load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml")


@given(
    targets=st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=40),
    period=st.floats(0.05, 5.0),
)
def test_every_step_stays_within_limits_and_slew(targets, period):
    setpoints = Setpoints(RIG)
    for target in targets:
        before = dict(setpoints.values)
        setpoints.move({"heater_power_set": target, "fan_speed_set": target}, period)
        for point in RIG.setpoints:
            value = setpoints.values[point.name]
            assert point.limits[0] <= value <= point.limits[1]
            assert abs(value - before[point.name]) <= point.max_rate * period * (1 + 1e-12)


@given(target=st.floats(0, 1000), period=st.floats(0.1, 2.0))
def test_a_held_target_is_reached_exactly(target, period):
    setpoints = Setpoints(RIG)
    for _ in range(math.ceil(1000 / (100 * period)) + 1):
        setpoints.move({"heater_power_set": target}, period)
    assert setpoints.values["heater_power_set"] == target
    assert setpoints.move({"heater_power_set": target}, period) == {}


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(ConfigurationError, match="heater_power_set cannot be set to"):
        Setpoints(RIG).move({"heater_power_set": value}, 1.0)


def test_safe_values_come_heater_first():
    assert list(Setpoints(RIG).safe_values().items()) == [
        ("heater_power_set", 0.0),
        ("pump_speed_set", 100.0),
        ("fan_speed_set", 100.0),
    ]


def test_profile_columns_name_the_point_that_moves():
    assert [p.name for p in bind(RIG, ("heater_power_W", "fan_speed_set_pct"))] == ["heater_power_set", "fan_speed_set"]
    assert list(setpoint_columns(RIG)) == ["heater_power_W", "pump_speed_pct", "fan_speed_pct"]


@pytest.mark.parametrize("column", ["heater_power_kW", "heater_power", "valve_pct", "T_tank_C"])
def test_unknown_set_points_are_refused_with_those_there_are(column):
    with pytest.raises(ConfigurationError, match="it has heater_power_W, pump_speed_pct, fan_speed_pct"):
        bind(RIG, (column,))
