"""What is the matter where one thermometer of six differs: its own error, its place, or a lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.discovery.conftest import HOUR, STEP_S, Bench
from tests.discovery.test_thermometers import SENSOR, with_six
from twin.discovery.diagnosis import Diagnosis
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.discovery.thermometers.members import lateness
from twin.network import Array


def slowly(values: Array, lag_s: float) -> Array:
    """What follows values (n,), 5 s apart, with a time constant, from where they begin."""
    keep = np.exp(-STEP_S / lag_s)
    found: Array = lfilter([1.0 - keep], [1.0, -keep], values - values[0]) + values[0]
    return found


def excess(bench: Bench, record: Columns) -> Array:
    """How much warmer the modules are than the room, K."""
    smooth = slowly(record.measured[:, bench.network.sensor_names.index(SENSOR)], 60.0)
    found: Array = smooth - record.inputs[:, 3]
    return found


def diagnosed(bench: Bench, healthy: Columns, record: Columns, off: Array) -> Diagnosis:
    return diagnose(bench.network, with_six(bench, record, 6, lambda _: off), with_six(bench, healthy, 5))


def test_a_place_in_poor_contact_is_not_a_thermometer_that_errs(pair: Bench, pair_healthy: Columns) -> None:
    """It comes to its new temperature within a minute, and is the colder the warmer the modules are."""
    record = pair.record(14.0)
    since = slowly(np.where(record.time_s > 5.0 * HOUR, 1.0, 0.0), 40.0)
    found = diagnosed(pair, pair_healthy, record, -0.04 * since * excess(pair, record))
    assert [(e.kind, e.where, e.driver) for e in found.effects] == [("heat_loss", "pm3", "temperature_difference")]
    assert found.effects[0].unit == "K" and found.effects[0].value < -0.3
    assert not any(a.kind == "sensor" for a in found.indistinguishable)


def test_an_error_that_is_there_at_once_is_the_thermometers(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(14.0)
    found = diagnosed(pair, pair_healthy, record, np.where(record.time_s > 5.0 * HOUR, -0.5, 0.0))
    assert found.verdict == "effect found" and found.indistinguishable == ()
    assert [(e.kind, e.where, e.driver) for e in found.effects] == [("sensor", "T_pm3_C", "constant")]


def test_a_loss_that_grows_is_told_from_a_thermometer_that_drifts(pair: Bench, pair_healthy: Columns) -> None:
    """No onset tells; the modules' temperature beside the room's does."""
    record = pair.record(14.0)
    grown = np.clip((record.time_s / HOUR - 8.0) / 6.0, 0.0, 1.0)
    found = diagnosed(pair, pair_healthy, record, -0.015 * grown * excess(pair, record))
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_loss", "pm3", "elapsed_time")
    assert effect.confidence < 0.99


def test_heat_that_a_clock_switches_at_one_place_is_no_error_of_reading(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(14.0)
    on = slowly(np.where((record.time_s - 460.0) % 1247.0 < 537.0, 0.6, 0.0), 20.0)
    found = diagnosed(pair, pair_healthy, record, on)
    assert found.verdict == "unexplained"
    assert "T_pm3_C" in {e.where for e in found.effects}


def test_two_that_differ_are_told_each_by_itself(pair: Bench, pair_healthy: Columns) -> None:
    """Neither is odd among all, as the other is; each is without it."""
    record = pair.record(16.0)
    record = with_six(pair, record, 6, lambda t: np.where(t > 5.0 * HOUR, 0.6, 0.0))
    each, j = record.members[SENSOR].copy(), pair.network.sensor_names.index(SENSOR)
    each[:, 4] += np.where(record.time_s > 9.0 * HOUR, -0.5, 0.0)
    measured = record.measured.copy()
    measured[:, j] = each.mean(axis=1)
    both = replace(record, measured=measured, members={SENSOR: each})
    found = diagnose(pair.network, both, with_six(pair, pair_healthy, 5))
    told = {e.where: e for e in found.effects}
    assert set(told) == {"T_pm3_C", "T_pm5_C"} and {e.kind for e in found.effects} == {"sensor"}
    assert told["T_pm3_C"].value == pytest.approx(0.6, abs=0.05)
    assert told["T_pm5_C"].value == pytest.approx(-0.5, abs=0.05)
    assert told["T_pm5_C"].onset_s == pytest.approx(9.0 * HOUR, abs=HOUR / 4)


def test_an_error_and_heat_at_the_same_place_are_two(bench: Bench, healthy: Columns) -> None:
    heated = bench.with_element("heat", {"kind": "heat_source", "node": "modules", "power": 60.0})
    record = with_six(bench, bench.record(12.0, changed=heated, onset_h=2.0), 6)
    each, j = record.members[SENSOR].copy(), bench.network.sensor_names.index(SENSOR)
    warmer = slowly(np.where(record.time_s > 2.0 * 3600.0, 1.0, 0.0), 40.0)
    each += warmer[:, None] * np.array([-0.2, -0.2, 1.0, -0.2, -0.2, -0.2])
    each[:, 2] -= np.where(record.time_s > 6.0 * 3600.0, 0.7, 0.0)
    measured = record.measured.copy()
    measured[:, j] = each.mean(axis=1)
    both = replace(record, measured=measured, members={SENSOR: each})
    found = diagnose(bench.network, both, with_six(bench, healthy, 5))
    told = {(e.kind, e.where): e for e in found.effects}
    assert set(told) == {("heat_source", "pm3"), ("sensor", "T_pm3_C")}
    assert told["sensor", "T_pm3_C"].value == pytest.approx(-0.7, abs=0.1)
    assert told["sensor", "T_pm3_C"].onset_s == pytest.approx(6.0 * 3600.0, abs=900.0)


def test_heat_at_one_place_is_told_there_in_words_too(pair: Bench, pair_healthy: Columns) -> None:
    """The thermometer beside it differs for no reason of its own."""
    heated = pair.with_element("heat", {"kind": "heat_source", "node": "modules", "power": 60.0})
    record = pair.record(14.0, changed=heated, onset_h=4.0)
    warmer = slowly(np.where(record.time_s > 4.0 * HOUR, 1.0, 0.0), 40.0)
    found = diagnosed(pair, pair_healthy, record, warmer)
    assert found.verdict == "effect found"
    (heat,) = found.effects
    assert (heat.kind, heat.where) == ("heat_source", "pm3")
    assert "pm3 alone" in heat.says and heat.says in found.summary


def test_one_that_leans_on_a_wall_now_and_then_errs_in_no_known_way(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(16.0)
    leans = slowly(excess(pair, record), 0.5 * HOUR) > np.median(excess(pair, record))
    found = diagnosed(pair, pair_healthy, record, -0.15 * leans * excess(pair, record))
    assert found.verdict == "unexplained" and found.network is None
    assert (found.effects[0].kind, found.effects[0].where) == ("unknown", "T_pm3_C")


@pytest.mark.parametrize("onset_h", [0.0, 5.0])
def test_one_that_follows_late_is_told_with_its_lag(
    slow_pair: Bench, slow_pair_healthy: Columns, onset_h: float
) -> None:
    record = slow_pair.record(16.0)
    true = slowly(record.measured[:, slow_pair.network.sensor_names.index(SENSOR)], 60.0)
    late = np.where(record.time_s > onset_h * 3600.0, slowly(true, 120.0) - true, 0.0)
    found = diagnosed(slow_pair, slow_pair_healthy, record, late)
    assert found.verdict == "effect found"
    (lag,) = found.effects
    assert (lag.kind, lag.where, lag.driver, lag.unit) == ("sensor", "T_pm3_C", "rate_of_change", "s")
    assert lag.value == pytest.approx(120.0, rel=0.15)
    assert lag.onset_s == pytest.approx(onset_h * 3600.0, abs=1200.0)


def test_lateness_is_that_of_each_thermometer() -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, 14_400.0, 10.0)
    mean = 40.0 + 3.0 * np.sin(time_s / 900.0)
    rate = np.gradient(mean, 10.0)
    off = np.array([60.0, -10.0, 0.0, 0.0])
    each = -rate[:, None] * (off - off.mean()) + rng.normal(0.0, 0.005, (len(time_s), 4))
    found = lateness(mean, each, 10.0)
    assert found.shape == (2, 4)
    assert np.diff(found[0]) == pytest.approx(np.diff(off) / 0.75, abs=2.0)
    assert np.isnan(lateness(np.full(len(time_s), 40.0), each, 10.0)).all()
