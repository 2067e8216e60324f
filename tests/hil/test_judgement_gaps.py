"""Missing values at the ends of a window, in thermometers of one sensor, and in times that a limit measures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.testing.judgement.judging import judge
from hil.testing.run_data import StandingTicks, longest_piece, ticks_within
from tests.hil.made_plan import bound, made_run

WHOLE = np.arange(401.0)
GAP_1_S = 'gap_at_most = "1 s"'
GAP_10_S = 'gap_at_most = "10 s"'


def judged(tmp_path, sentence, data=None, more=""):
    return judge(bound(tmp_path, sentence, more), data or made_run())


def without(column: str, *ticks: int):
    """A run in which a column lacks these ticks."""
    values = made_run().columns[column].copy()
    values[list(ticks)] = np.nan
    return made_run(**{column: values})


@pytest.mark.parametrize(
    ("sentence", "tick"),
    [
        ("T_tank_C < 99", 400),
        ("T_tank_C < 99", 0),
        ("T_tank_C < 99 from 50 s to 100 s", 100),
        ("T_tank_C < 99 from 50 s to 100 s", 50),
        ("T_tank_C < 99 before 2 min", 120),
        ("mean of T_tank_C < 99", 400),
        ("rmse of twin at T_tank_C < 1 K", 400),
        ("T_tank_C < 99 while heater_power_W > 0", 400),
        ("T_tank_C settles within 70 s to 0.5 K of 40 degC after 200 s", 400),
    ],
)
def test_the_ticks_at_both_ends_of_a_window_belong_to_it(tmp_path, sentence, tick):
    assert judged(tmp_path, sentence).verdict == "pass"
    found = judged(tmp_path, sentence, without("T_tank_C", tick))
    assert found.verdict == "inconclusive" and "missing" in found.text
    beside = judged(tmp_path, sentence.replace("before", "after"), without("T_tank_C", tick + 1 if tick == 0 else 30))
    assert beside.verdict == ("pass" if "from 50" in sentence or "after" in sentence or tick == 120 else "inconclusive")


@pytest.mark.parametrize("times", ["from 50.1 s to 99.9 s", "from 50.9 s to 99.1 s"])
def test_times_between_two_ticks_need_only_the_ticks_between_them(tmp_path, times):
    data = without("T_tank_C", 50, 100)
    assert judged(tmp_path, f"T_tank_C < 99 {times}", data).verdict == "pass"
    assert judged(tmp_path, f"T_tank_C < 99 {times}", without("T_tank_C", 51)).verdict == "inconclusive"


def test_the_ticks_of_a_window_include_both_ends():
    assert list(ticks_within(2.0, 4.0, 1.0)) == [2, 3, 4]
    assert list(ticks_within(0.3, 0.7, 0.1)) == [3, 4, 5, 6, 7]
    assert list(ticks_within(0.5, 0.7, 1.0)) == []
    assert longest_piece(np.array([True, False, True, True])) == (2, 2)
    assert longest_piece(np.zeros(0, dtype=bool)) == (0, 0)


def test_the_error_of_a_twin_needs_all_thermometers_of_a_sensor(tmp_path):
    for sentence in ("rmse of twin at T_modules_C < 1 K", "largest error of twin at T_modules_C < 1 K"):
        assert judged(tmp_path, sentence).verdict == "pass"
        assert judged(tmp_path, sentence, without("T_pm2_C", 300)).verdict == "inconclusive"
        assert judged(tmp_path, sentence, without("T_pm2_C", 300), GAP_1_S).verdict == "pass"
    lost = made_run(T_pm2_C=np.full(401, np.nan))
    assert judged(tmp_path, "bias of twin at T_modules_C < 1 K", lost).verdict == "inconclusive"


HOT = np.where((WHOLE >= 100) & (WHOLE < 300), 60.0, 20.0)
"""A tank above 50 °C for 200 s."""


@pytest.mark.parametrize(
    ("sentence", "verdict"),
    [
        ("longest time of T_tank_C above 50 < 150 s", "inconclusive"),  # 110 s and 89 s, or 200 s
        ("longest time of T_tank_C above 50 < 201 s", "pass"),
        ("longest time of T_tank_C above 50 < 100 s", "fail"),
        ("longest time of T_tank_C above 50 > 150 s", "inconclusive"),
        ("longest time of T_tank_C above 50 > 100 s", "pass"),
        ("longest time of T_tank_C above 50 > 250 s", "fail"),
        ("longest time of T_tank_C above 50 between 100 s and 150 s", "inconclusive"),
        ("longest time of T_tank_C above 50 between 250 s and 300 s", "fail"),
        ("time of T_tank_C above 50 < 199.5 s", "inconclusive"),
        ("time of T_tank_C above 50 < 200.5 s", "pass"),
        ("time of T_tank_C above 50 < 198 s", "fail"),
        ("time of T_tank_C below 50 < 201.5 s", "inconclusive"),
    ],
)
def test_an_admitted_gap_counts_on_both_sides_of_a_threshold(tmp_path, sentence, verdict):
    hot = HOT.copy()
    hot[210] = np.nan
    found = judged(tmp_path, sentence, made_run(T_tank_C=hot), GAP_1_S)
    assert found.verdict == verdict, found.text


def test_ticks_that_are_not_there_count_like_missing_values(tmp_path):
    data = made_run(T_tank_C=HOT)
    there = WHOLE != 210
    lost = replace(data, time_s=WHOLE[there], columns={name: x[there] for name, x in data.columns.items()})
    assert judged(tmp_path, "longest time of T_tank_C above 50 < 150 s", lost, GAP_1_S).verdict == "inconclusive"
    assert judged(tmp_path, "T_tank_C < 99", lost).verdict == "inconclusive"


def test_a_gap_after_the_last_value_outside_of_the_band_may_prolong_settling(tmp_path):
    sentence = "T_tank_C settles within 62 s to 0.5 K of 40 degC after 200 s"
    assert judged(tmp_path, sentence).value == pytest.approx(60.0)
    assert judged(tmp_path, sentence, without("T_tank_C", 262, 263), GAP_10_S).verdict == "pass"
    found = judged(tmp_path, sentence, without("T_tank_C", 260, 261, 262), GAP_10_S)
    assert found.verdict == "inconclusive" and "60 s to 63 s" in found.text


def test_a_missing_set_point_hides_no_reading_after_it(tmp_path):
    wanted, read = made_run().columns["heater_power_set_W"].copy(), made_run().columns["heater_power_W"].copy()
    wanted[320], read[350] = np.nan, 0.0
    data = made_run(heater_power_set_W=wanted, heater_power_W=read)
    sentence = "heater_power measured within 5 % of set-point once constant for 60 s"
    assert judged(tmp_path, sentence, data, GAP_1_S).verdict == "fail"


def test_a_missing_set_point_begins_no_hold(tmp_path):
    wanted, tank = made_run().columns["heater_power_set_W"].copy(), made_run().columns["T_tank_C"].copy()
    wanted[240], tank[255] = np.nan, 99.0
    data = made_run(heater_power_set_W=wanted, T_tank_C=tank)
    assert judged(tmp_path, "T_tank_C settles within 50 s to 0.5 K", data).verdict == "fail"


def test_values_too_large_to_be_squared_have_an_error_still(tmp_path):
    tank = made_run().columns["T_tank_C"].copy()
    tank[200] = 1e300
    data = replace(made_run(T_tank_C=tank), twins=made_run().twins)
    found = judged(tmp_path, "rmse of twin at T_tank_C < 1 K", data)
    assert found.verdict == "fail" and found.value == pytest.approx(1e300 / np.sqrt(401))
    tank[201] = -1.7e308
    tank[202] = 1.7e308
    wide = judged(tmp_path, "range of T_tank_C > 1 K", made_run(T_tank_C=tank))
    assert wide.verdict == "inconclusive" and wide.value is None and "too large" in wide.text


def stood(value: float, *, as_profile: bool):
    """A run that stood on one tick, with this temperature of the tank and a flow of 0."""
    columns = {name: np.array([x[0]]) for name, x in made_run().columns.items()}
    columns |= {"T_tank_C": np.array([value]), "flow_L_per_min": np.array([0.0])}
    return replace(made_run(), standing=StandingTicks(np.array([70.0]), columns, np.array([as_profile])))


@pytest.mark.parametrize(
    ("sentence", "as_profile", "verdict"),
    [
        ("T_tank_C < 75", True, "fail"),
        ("T_tank_C < 75", False, "fail"),
        ("max of T_tank_C < 75", False, "fail"),
        ("T_tank_C between 10 and 75", False, "fail"),
        ("T_tank_C < 75 before 300 s", True, "pass"),
        ("T_tank_C < 75 while heater_power_W > 900", True, "inconclusive"),
        ("T_tank_C < 81", True, "pass"),
        ("mean of T_tank_C < 75", True, "pass"),
        ("flow > 2 L/min", True, "fail"),
        ("flow > 2 L/min", False, "pass"),  # a pump at its safe value is no failure
    ],
)
def test_a_limit_without_times_also_holds_while_the_profile_stands(tmp_path, sentence, as_profile, verdict):
    found = judged(tmp_path, sentence, stood(80.0, as_profile=as_profile))
    assert found.verdict == verdict, found.text
    if verdict == "fail":
        assert "while the profile stood at 70 s" in found.text


@pytest.mark.parametrize(
    ("sentence", "as_profile", "verdict"),
    [
        ("time of T_tank_C above 35 < 200 s", False, "inconclusive"),
        ("longest time of T_tank_C above 35 < 200 s", True, "inconclusive"),
        ("longest time of T_tank_C above 35 < 250 s", True, "pass"),  # 187 s and 50 s
        ("time of T_tank_C above 35 < 180 s", True, "fail"),
        ("time of T_tank_C above 35 > 3 min", True, "pass"),
        ("time of T_tank_C above 35 < 200 s before 300 s", True, "pass"),
        ("time of flow below 3 L/min < 10 s", False, "pass"),  # a pump at its safe value
        ("time of flow below 3 L/min < 10 s", True, "inconclusive"),
    ],
)
def test_a_time_beyond_a_threshold_is_not_passed_where_the_profile_stood_beyond_it(
    tmp_path, sentence, as_profile, verdict
):
    columns = {name: np.full(50, 60.0) for name in made_run().columns} | {"flow_L_per_min": np.zeros(50)}
    stood = StandingTicks(np.full(50, 350.0), columns, np.full(50, as_profile))
    found = judged(tmp_path, sentence, replace(made_run(), standing=stood))
    assert found.verdict == verdict, found
    assert verdict != "inconclusive" or "50 s more while the profile stood" in found.text


def stood_at(tick: int, **columns):
    """A run whose profile stood for long before `tick`: the tank has cooled meanwhile."""
    run = made_run()
    tank = run.columns["T_tank_C"] - np.where(tick <= WHOLE, 8.0 * np.exp(-(WHOLE - tick) / 5.0), 0.0)
    return replace(made_run(T_tank_C=tank, **columns), parts=np.cumsum(tick == WHOLE))


def test_no_ramp_spans_a_time_at_which_the_profile_stood(tmp_path):
    data = stood_at(150)
    assert judged(tmp_path, "fall of T_tank_C < 1 K/min before 180 s", data).verdict == "pass"
    assert judged(tmp_path, "fall of T_tank_C < 1 K/s before 180 s", data).verdict == "pass"
    found = judged(tmp_path, "ramp of T_tank_C over 20 s < 1 K/min from 140 s to 165 s", data)
    assert found.verdict == "inconclusive" and "the profile stood" in found.text


def test_a_reading_follows_its_set_point_anew_after_the_profile_has_stood(tmp_path):
    read = np.where((WHOLE >= 150) & (WHOLE < 155), 0.0, made_run().columns["heater_power_W"])
    sentence = "heater_power measured within 5 % of set-point once constant for 10 s"
    assert judged(tmp_path, sentence, stood_at(150, heater_power_W=read)).verdict == "pass"
    assert judged(tmp_path, sentence, made_run(heater_power_W=read)).verdict == "fail"


@pytest.mark.parametrize(
    ("tick", "sentence", "verdict"),
    [
        (210, "T_tank_C settles within 70 s to 0.5 K", "inconclusive"),
        (210, "T_tank_C settles within 70 s to 0.5 K of 40 degC after 200 s", "inconclusive"),
        (240, "T_tank_C settles within 10 s to 0.5 K of 40 degC after 200 s", "fail"),
        (200, "T_tank_C settles within 70 s to 0.5 K of 40 degC after 200 s", "pass"),
        (100, "T_tank_C settles within 70 s to 0.5 K", "inconclusive"),
    ],
)
def test_a_hold_in_which_the_profile_stood_does_not_show_that_a_value_settles(tmp_path, tick, sentence, verdict):
    found = judged(tmp_path, sentence, stood_at(tick))
    assert found.verdict == verdict and (verdict != "inconclusive" or "the profile stood" in found.text)


def test_a_ramp_is_the_change_over_the_time_between_its_two_ticks(tmp_path):
    tank = made_run(T_tank_C=0.1 * WHOLE)
    for over in ("1400 ms", "1500 ms", "10 s"):
        assert judged(tmp_path, f"ramp of T_tank_C over {over} < 7 K/min", tank).value == pytest.approx(6.0)
    found = judged(tmp_path, "ramp of T_tank_C < 0.09 K/s", tank)
    assert (found.value, found.unit, found.verdict) == (pytest.approx(0.1), "K/s", "fail") and "0.09 K/s" in found.text
