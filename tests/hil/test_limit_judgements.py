"""Judgements of limits: pass with all values, fail where known ones prove it, inconclusive otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.journal import NO_TICK, StateRow
from hil.run_folder import DiagnosisVerdict
from hil.testing.judgement.judging import judge
from hil.testing.run_data import Trip, trips_of
from tests.hil.made_plan import bound, made_run

WHOLE = np.arange(401.0)


def judged(tmp_path, sentence, data=None, more="", head=""):
    return judge(bound(tmp_path, sentence, more, head), data or made_run())


@pytest.mark.parametrize(
    ("sentence", "verdict", "value"),
    [
        ("T_tank_C < 41", "pass", 40.0),
        ("T_tank_C < 39", "fail", 40.0),
        ("T_tank_C between 30 and 39", "fail", 40.0),
        ("T_tank_C < 31 before 3 min", "pass", 30.0),
        ("T_modules_C < 46", "fail", 47.0),
        ("mean of T_tank_C < 35", "pass", 34.5),
        ("max of T_tank_C > 39", "pass", 40.0),
        ("min of T_tank_C < 29", "fail", 30.0),
        ("range of T_tank_C < 9 K", "fail", 10.0),
        (
            "deviation of T_tank_C after 300 s < 0.1 K".replace(" after 300 s < 0.1 K", " < 0.1 K after 300 s"),
            "pass",
            0.01,
        ),
        ("95th percentile of T_tank_C < 40", "pass", 40.0),
        ("5th percentile of T_tank_C > 29", "pass", 30.0),
        ("time of T_tank_C above 35 < 3 min", "fail", 187.0),
        ("time of T_tank_C below 35 < 300 s", "pass", 214.0),
        ("longest time of T_tank_C above 35 < 200 s", "pass", 187.0),
        ("ramp of T_tank_C < 12 K/min", "pass", 9.5),
        ("rise of T_tank_C over 10 s < 10 K/min", "fail", 23.6),
        ("fall of T_tank_C < 0.1 K/min", "pass", 0.0),
        ("T_tank_C settles within 70 s to 0.5 K", "pass", 60.0),
        ("T_tank_C settles within 50 s to 0.5 K", "fail", 60.0),
        ("T_tank_C settles within 50 s to 0.5 K before 200 s", "pass", 0.0),
        ("heater_power measured within 2 W of set-point", "pass", -1.0),
        ("heater_power measured within 0.5 % of set-point", "fail", -1.0),
        ("rmse of twin at T_tank_C < 0.3 K", "pass", 0.2),
        ("bias of pso at T_modules_C between -0.05 and 0.05 K", "fail", -0.1),
        ("largest error of twin at T_tank < 0.1 K", "fail", 0.2),
        ("T_tank_C < 31 while heater_power_W < 200", "pass", 30.0),
        ("T_tank_C < 31 while heater_power_W > 0.2 kW", "fail", 40.0),
        ("no trip", "pass", None),
    ],
)
def test_each_statement_is_judged(tmp_path, sentence, verdict, value):
    found = judged(tmp_path, sentence)
    assert found.verdict == verdict, found.text
    if value is not None:
        assert found.value == pytest.approx(value, rel=0.05, abs=0.02)


GAP = np.where((WHOLE > 250) & (WHOLE < 260), np.nan, 0.0)


@pytest.mark.parametrize(
    "sentence",
    [
        "T_tank_C < 99",
        "mean of T_tank_C < 99",
        "mean of T_tank_C > 99",
        "max of T_tank_C > 39",
        "95th percentile of T_tank_C > 99",
        "time of T_tank_C above 90 < 3 min",
        "ramp of T_tank_C < 99 K/min",
        "T_tank_C settles within 70 s to 0.5 K",
        "T_tank_C settles within 20 s to 0.5 K",
        "rmse of twin at T_tank_C < 0.3 K",
        "T_tank_C < 99 while heater_power_W > 0",
        "heater_power < 999 W while T_tank_C > 0",
    ],
)
def test_missing_values_never_pass(tmp_path, sentence):
    data = made_run(T_tank_C=made_run().columns["T_tank_C"] + GAP)
    found = judged(tmp_path, sentence, data)
    assert found.verdict == "inconclusive", found.text
    full = judged(tmp_path, sentence, data, more='gap_at_most = "10 s"')
    assert full.verdict == judged(tmp_path, sentence).verdict, full.text


def test_known_values_prove_a_failure_beside_missing_ones(tmp_path):
    data = made_run(T_tank_C=made_run().columns["T_tank_C"] + GAP)
    for sentence in (
        "T_tank_C < 39",
        "max of T_tank_C < 39",
        "time of T_tank_C above 35 < 60 s",
        "ramp of T_tank_C < 1 K/min",
        "largest error of twin at T_tank_C < 0.1 K",
        "T_tank_C settles within 20 s to 0.5 K of 40 degC",
    ):
        assert judged(tmp_path, sentence, data).verdict == "fail", sentence


@pytest.mark.parametrize(
    "sentence", ["T_tank_C < 99", "mean of flow > 1 L/min", "T_tank_C < 99 after 390 s", "no trip"]
)
def test_an_interrupted_run_is_inconclusive_for_its_rest(tmp_path, sentence):
    assert judged(tmp_path, sentence, made_run(350.0)).verdict == "inconclusive"
    assert judged(tmp_path, "T_tank_C < 99 before 5 min", made_run(350.0)).verdict == "pass"


def test_a_single_missing_tick_counts(tmp_path):
    flow = np.where(WHOLE == 100.0, np.nan, 5.0)
    assert judged(tmp_path, "flow < 9 L/min", made_run(flow_L_per_min=flow)).verdict == "inconclusive"
    assert judged(tmp_path, "flow < 9 L/min after 101 s", made_run(flow_L_per_min=flow)).verdict == "pass"


def test_a_condition_that_never_holds_is_inconclusive(tmp_path):
    found = judged(tmp_path, "T_tank_C < 99 while heater_power_W > 900")
    assert (found.verdict, found.text) == ("inconclusive", "its condition was never fulfilled")


def test_a_reading_counts_only_beside_a_constant_set_point(tmp_path):
    lagging = made_run().columns["heater_power_W"].copy()
    lagging[200:220] = 100.0
    data = made_run(heater_power_W=lagging)
    assert judged(tmp_path, "heater_power measured within 5 % of set-point", data).verdict == "pass"
    assert (
        judged(tmp_path, "heater_power measured within 5 % of set-point once constant for 5 s", data).verdict == "fail"
    )
    lagging[300] = np.nan
    data = made_run(heater_power_W=lagging)
    assert judged(tmp_path, "heater_power measured within 5 % of set-point", data).verdict == "inconclusive"
    zero = made_run(heater_power_set_W=0.0)
    assert judged(tmp_path, "heater_power measured within 5 % of set-point", zero).verdict == "inconclusive"


def test_short_holds_are_left_out_and_counted(tmp_path):
    setpoint = np.where((WHOLE >= 100) & (WHOLE < 110), 50.0, made_run().columns["heater_power_set_W"])
    found = judged(tmp_path, "T_tank_C settles within 70 s to 0.5 K", made_run(heater_power_set_W=setpoint))
    assert found.verdict == "pass" and "1 of 4 holds are shorter" in found.text


def test_a_ramp_of_a_set_point_is_one_change(tmp_path):
    setpoint = np.clip(100.0 + (WHOLE - 200.0) * 10.0, 100.0, 300.0)
    found = judged(tmp_path, "T_tank_C settles within 70 s to 0.5 K", made_run(heater_power_set_W=setpoint))
    assert found.verdict == "pass" and "holds are shorter" not in found.text


@pytest.mark.parametrize(
    ("verdict", "expected"),
    [("adequate", "pass"), ("effect found", "fail"), ("ambiguous", "fail"), ("unexplained", "inconclusive")],
)
def test_a_diagnosis_is_judged_by_its_verdict(tmp_path, verdict, expected):
    assert (
        judged(tmp_path, "no effect found", replace(made_run(), diagnosis=DiagnosisVerdict(verdict, "why"))).verdict
        == expected
    )
    assert judged(tmp_path, "no effect found").verdict == "inconclusive"


def test_a_trip_is_a_failure_with_its_reason(tmp_path):
    found = judged(tmp_path, "no trip", replace(made_run(), trips=(Trip("T_tank is 99 °C", 90.0),)))
    assert (found.verdict, found.text) == ("fail", "T_tank is 99 °C")


def test_the_end_of_a_run_is_named_where_it_did_not_go_to_its_end(tmp_path):
    cut = made_run(100.0)
    assert judged(tmp_path, "no trip", cut).text == "the run did not go to its end"
    text = judged(tmp_path, "no trip", replace(cut, reason="plc cannot be reached")).text
    assert text == "the run did not go to its end: plc cannot be reached"


def test_what_fails_before_the_profile_has_begun_is_no_trip():
    def rows(*steps: tuple[str, str, str]) -> list[StateRow]:
        return [StateRow(k, k, float(k), 0.0, 0.0, *step, f"reason {k}") for k, step in enumerate(steps)]

    off = rows(("idle", "validate", "validating"), ("connecting", "fail", "faulted"))
    assert trips_of(off) == () == trips_of(rows(("restoring", "fail", "finishing"), ("finishing", "fail", "faulted")))
    begun = rows(("restoring", "start", "running"), ("running", "trip", "paused"), ("finishing", "fail", "faulted"))
    assert [trip.reason for trip in trips_of(begun)] == ["reason 1", "reason 2"]


BY_TEST = Trip("tripped: test small: limit L1 (T_tank < 5 degC) failed: 9 °C", 90.0, "test")
BY_BENCH = Trip("the guardian is gone", 95.0, "bench")
BY_TANK = Trip("T_tank is 99 degC, its alarm limits are -5 to 75", 210.0)


def test_who_tripped_a_run_is_read_from_its_transitions():
    begun = StateRow(0, 0, 0.0, 0.0, 0.0, "restoring", "start", "running", "")
    rows = [
        replace(begun, id=1, source="running", event="trip", profile_s=90.0, reason=BY_TEST.reason),
        replace(
            begun, id=2, source="running", event="trip", profile_s=92.0, reason=f"tripped: {NO_TICK} 9.0 s, at most"
        ),
        replace(begun, id=3, source="running", event="fault", profile_s=95.0, reason=BY_BENCH.reason),
        replace(begun, id=4, source="running", event="fail", profile_s=210.0, reason=BY_TANK.reason),
        replace(begun, id=5, source="finishing", event="fail", profile_s=210.0, reason=BY_TANK.reason),
    ]
    found = trips_of([begun, *rows])
    assert [trip.by for trip in found] == ["test", "bench", "bench", "protection"]
    assert (found[0], found[2], found[3]) == (BY_TEST, BY_BENCH, BY_TANK)
    named_test = replace(begun, event="trip", reason="tripped: test is 99 degC, its alarm limits are -5 to 75")
    assert trips_of([begun, named_test])[0].by == "protection"


@pytest.mark.parametrize(
    ("sentence", "trips", "end_s", "verdict"),
    [
        ("no trip", (BY_TEST,), 90.0, "inconclusive"),
        ("no trip", (BY_TEST, BY_BENCH), 400.0, "pass"),
        ("no trip", (BY_BENCH,), 95.0, "inconclusive"),
        ("no trip", (BY_TEST, BY_TANK), 400.0, "fail"),
        ("no trip before 200 s", (BY_TANK,), 210.0, "pass"),
        ("no trip before 210 s", (BY_TANK,), 210.0, "fail"),
        ("no trip after 220 s", (BY_TANK,), 210.0, "inconclusive"),
        ("trip", (BY_TANK,), 210.0, "pass"),
        ("trip of T_tank_C from 200 s to 220 s", (BY_TANK,), 210.0, "pass"),
        ("trip of T_modules_C", (BY_TANK,), 210.0, "fail"),
        ("trip of T_tank before 200 s", (BY_TANK,), 210.0, "fail"),
        ("trip of T_tank after 300 s", (BY_TANK,), 210.0, "inconclusive"),
        ("trip", (), 400.0, "fail"),
        ("trip", (BY_TEST,), 90.0, "inconclusive"),
    ],
)
def test_a_trip_is_judged_by_its_cause_and_its_time(tmp_path, sentence, trips, end_s, verdict):
    run = replace(made_run(end_s), trips=trips)
    assert judged(tmp_path, sentence, run).verdict == verdict


def test_a_result_has_the_levels_of_its_limit_and_the_times_of_its_failure(tmp_path):
    tank = np.where((WHOLE % 100 >= 20) & (WHOLE % 100 < 30), 50.0, 30.0)
    found = judged(tmp_path, "T_tank between 0.01 and 40 degC", made_run(T_tank_C=tank))
    assert found.line == {"columns": ["T_tank_C"], "levels": [0.01, 40.0], "from_s": 0.0, "to_s": 400.0}
    assert found.failed_s == ((20.0, 29.0), (120.0, 129.0), (220.0, 229.0), (320.0, 329.0))
    assert judged(tmp_path, "heater_power < 0.5 kW after 5 s").line["levels"] == [500.0]
    settles = judged(tmp_path, "heater_power settles within 9 s to 10 % of 200 W")
    assert settles.line["levels"] == [180.0, 220.0] and settles.failed_s == ()
    assert judged(tmp_path, "time of T_tank_C above 35 < 3 min").line["levels"] == [35.0]
    assert judged(tmp_path, "ramp of T_tank_C < 12 K/min").line is judged(tmp_path, "no trip").line is None
    often = judged(tmp_path, "T_tank_C < 40", made_run(T_tank_C=np.where(WHOLE % 3 == 0, 50.0, 30.0)))
    assert len(often.failed_s) == 50 and often.failed_s[-1][1] == 399.0
