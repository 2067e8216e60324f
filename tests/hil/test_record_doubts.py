"""Questions about columns that stand still, jump by a unit, or are in tenths, and diagnoses that depend on them."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.session import depending_on_units
from hil.record.reader import Record, read_record, write_record
from hil.record.values.question import UnitQuestion
from hil.record.values.steady import standing_still, unit_jumps
from tests.hil.made_diagnosis import made
from twin.twinfile import load

N = 200
TIME = 10.0 * np.arange(N)
NOISE = np.random.default_rng(4).normal(0.0, 1.0, N)
TANK = np.round(22.0 + 0.05 * np.arange(N) + 0.05 * NOISE, 2)
HEATER = np.round(np.where(np.arange(N) % 60 < 30, 600.0, 900.0) + NOISE, 1)


def frozen(values, first, count=60):
    out = values.copy()
    out[first : first + count] = out[first]
    return out


@pytest.mark.parametrize("first", [40, N - 60])
def test_a_sensor_that_stands_still_is_asked_about(first):
    (said,) = standing_still(TIME, {"T_tank_C": frozen(TANK, first), "heater_power_W": HEATER})
    assert said.startswith("T_tank_C at ") and f"from {10 * first} s on" in said
    assert said.endswith("is the channel stuck?")


def test_all_columns_that_stand_still_at_once_are_one_question():
    columns = {"T_tank_C": frozen(TANK, 40), "heater_power_W": frozen(HEATER, 40), "T_pipe_C": frozen(TANK + 1, 40)}
    (said,) = standing_still(TIME, columns)
    assert all(name in said for name in columns) and said.endswith("is the logger stuck?")


@pytest.mark.parametrize(
    "values",
    [TANK, np.round(2 * TANK) / 2, np.where(np.arange(N) < 100, 20.0, 60.0), np.full(N, 21.0)],
    ids=["noise", "coarse", "levels", "constant"],
)
def test_what_moves_as_before_does_not_stand_still(values):
    assert standing_still(TIME, {"T_tank_C": values}) == []


@pytest.mark.parametrize("level", [0.0, 2000.0])
def test_an_actuator_may_rest_at_zero_and_at_its_end(level):
    values = HEATER.copy()
    values[40:100] = level
    assert standing_still(TIME, {"heater_power_W": values}) == []


@pytest.mark.parametrize(
    ("name", "values", "change", "way"),
    [
        ("T_tank_C", TANK, lambda x: 1.8 * x + 32.0, "degC to degrees Fahrenheit"),
        ("T_tank_C", TANK + 273.15, lambda x: x - 273.15, "kelvin to degC"),
        ("heater_power_W", HEATER, lambda x: x / 1000.0, "thousandfold"),
        ("heater_power_W", HEATER / 1000.0, lambda x: x * 1000.0, "thousandth"),
    ],
)
@pytest.mark.parametrize("at", [100, 120])
def test_a_jump_of_a_unit_that_stays_is_a_question_of_units(name, values, change, way, at):
    jumped = np.where(np.arange(N) < at, values, change(values))
    (said,) = unit_jumps(TIME, {name: jumped})
    assert isinstance(said, UnitQuestion)
    assert way in said and f"at {10 * at} s" in said


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("heater_power_W", HEATER),
        ("heater_power_W", np.where(np.arange(N) < 100, HEATER, 0.0)),
        ("heater_power_W", np.where(np.arange(N) % 100 < 50, HEATER, HEATER / 1000.0)),
        ("T_tank_C", np.where(np.arange(N) == 100, 1.8 * TANK + 32.0, TANK)),
        ("T_tank_C", np.where(np.arange(N) < 100, TANK, TANK + 40.0)),
    ],
    ids=["switched", "off", "standby", "one row", "another jump"],
)
def test_other_jumps_are_no_questions_of_units(name, values):
    assert unit_jumps(TIME, {name: values}) == []


def test_tenths_of_a_degree_are_asked_about_where_a_room_shows_them(tmp_path):
    path = tmp_path / "record.csv"
    columns = {"T_tank_C": np.round(10.0 * TANK), "T_ambient_C": np.full(N, 21.0) + 0.1 * NOISE}
    write_record(Record(TIME, columns), path)
    said = [m for m in read_record(path).messages if "tenths of a degree" in m]
    assert len(said) == 1 and said[0].startswith("T_tank_C")
    write_record(Record(TIME, columns | {"T_tank_C": TANK}), path)
    assert not any("tenths" in m for m in read_record(path).messages)


def test_a_diagnosis_with_an_open_unit_is_not_certain_of_its_effect():
    twin, found = load("profiles/twins/virtual.toml"), made(network=load("profiles/twins/virtual.toml"))
    asked = UnitQuestion("heater_power_W is 0.6 to 0.9 in this record: is it in another unit?")
    open_one = depending_on_units(found, twin, ("a note", asked))
    assert open_one.verdict == "ambiguous" and open_one.network is None
    assert asked in open_one.warnings[0] and "depends on an open question about columns" in open_one.warnings[0]
    assert open_one.summary.startswith(f"{asked} If the columns are right: ")
    other = UnitQuestion("T_elsewhere_C has a median of 300: is it in kelvin?")
    assert depending_on_units(found, twin, ("heater_power_W: a note", other)) is found
