"""One thermometer of six: when it is the answer, and when it is only one thing among others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench, stopped
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.network import Array

SENSOR, COUNT = "T_modules_C", 6


def with_six(bench: Bench, record: Columns, seed: int, fault: Callable[[Array], Array] | None = None) -> Columns:
    """The record with the six thermometers behind the modules' reading; `fault` (K) is added to the third."""
    j = bench.network.sensor_names.index(SENSOR)
    mean = record.measured[:, j]
    sigma = bench.network.parameters[f"{SENSOR}.sigma"].value
    noise = np.random.default_rng(seed).normal(0.0, sigma, (len(mean), COUNT))
    along = (mean - record.inputs[:, 3])[:, None] * np.linspace(-0.02, 0.02, COUNT)
    each = mean[:, None] + along + noise - noise.mean(axis=1, keepdims=True)
    if fault is not None:
        each[:, 2] += fault(record.time_s)
    measured = record.measured.copy()
    measured[:, j] = each.mean(axis=1)
    return replace(record, measured=measured, members={SENSOR: each})


def comes_and_goes(time_s: Array) -> Array:
    hours = time_s / HOUR
    return np.where(((hours > 2) & (hours < 3.5)) | ((hours > 5) & (hours < 6)) | ((hours > 7) & (hours < 9)), 3.0, 0.0)


def test_a_thermometer_that_explains_everything_is_all_that_is_told(pair: Bench, pair_healthy: Columns) -> None:
    """No error of the catalogue comes and goes, but where it is, and that nothing else is missing, is known."""
    record = with_six(pair, pair.record(10.0), 6, comes_and_goes)
    found = diagnose(pair.network, record, with_six(pair, pair_healthy, 5))
    assert found.verdict == "unexplained" and found.network is None
    assert [(e.kind, e.where) for e in found.effects] == [("unknown", "T_pm3_C")]
    assert found.effects[0].value == pytest.approx(3.0, rel=0.1)
    assert "Without that the twin is adequate" in found.summary


@pytest.mark.parametrize("node", ["tank", "modules"])
def test_what_is_found_beside_one_that_comes_and_goes_is_told_too(
    pair: Bench, pair_healthy: Columns, node: str
) -> None:
    """In the mean the one would be half of the answer, and put the heat where that thermometer is."""
    heated = pair.with_element("heat", {"kind": "heat_source", "node": node, "power": 60.0})
    record = with_six(pair, pair.record(16.0, changed=heated, onset_h=4.0), 6, comes_and_goes)
    found = diagnose(pair.network, record, with_six(pair, pair_healthy, 5))
    assert found.verdict == "unexplained" and found.network is None  # what comes and goes is of no catalogue
    one, heat = found.effects
    assert (one.kind, one.where) == ("unknown", "T_pm3_C")
    assert (heat.kind, heat.where, heat.driver) == ("heat_source", node, "constant")
    assert heat.value == pytest.approx(60.0, rel=0.05) and heat.onset_s == pytest.approx(4.0 * HOUR, abs=HOUR / 30)
    assert "T_pm3_C is off by up to" in found.summary and "Beside that: " in found.summary


def test_a_standstill_beside_one_that_comes_and_goes_is_told_as_what_it_is(
    brisk: Bench, brisk_healthy: Columns
) -> None:
    record = with_six(brisk, stopped(brisk.record()), 6, comes_and_goes)
    found = diagnose(brisk.network, record, with_six(brisk, brisk_healthy, 5))
    assert found.verdict == "unexplained" and "Without that the twin is adequate" in found.summary
    assert any(" stood for " in note for note in found.notes)
    assert not any("the inputs are unknown" in note for note in found.notes)


@pytest.mark.parametrize(("from_h", "for_h"), [(5.0, 5.0), (1.0, 6.0)])
def test_one_that_drifts_is_told_with_what_it_comes_to(
    slow_pair: Bench, slow_pair_healthy: Columns, from_h: float, for_h: float
) -> None:
    record = with_six(slow_pair, slow_pair.record(10.0), 6, lambda t: np.clip((t / 3600.0 - from_h) / for_h, 0.0, 1.0))
    found = diagnose(slow_pair.network, record, with_six(slow_pair, slow_pair_healthy, 5))
    assert found.verdict == "effect found"
    (drift,) = found.effects
    assert (drift.kind, drift.where, drift.driver, drift.shape) == ("sensor", "T_pm3_C", "elapsed_time", "ramp")
    assert drift.value == pytest.approx(1.0, rel=0.1) and drift.onset_s == pytest.approx(from_h * 3600.0, abs=3600.0)
    low, high = drift.onset_interval90_s
    assert low <= from_h * 3600.0 <= high < low + 5400.0


def test_a_thermometer_beside_something_else_does_not_explain_it_away(pair: Bench, pair_healthy: Columns) -> None:
    heated = pair.with_element("heat", {"kind": "heat_source", "node": "tank", "power": 150.0})
    record = pair.record(8.0, changed=heated, onset_h=2.0, until_h=5.0)
    record = with_six(pair, record, 6, lambda t: np.where(t > 2.5 * HOUR, 2.0, 0.0))
    found = diagnose(pair.network, record, with_six(pair, pair_healthy, 5))
    assert found.verdict == "effect found"
    error, heat = found.effects
    assert (error.kind, error.where) == ("sensor", "T_pm3_C") and error.value == pytest.approx(2.0, rel=0.1)
    assert (heat.kind, heat.where, heat.shape) == ("heat_source", "tank", "transient")
    assert found.summary.startswith("T_pm3_C reads") and "Beside that: " in found.summary


def test_a_loose_contact_that_is_right_on_average_is_not_adequate(pair: Bench, pair_healthy: Columns) -> None:
    def jumps(time_s: Array) -> Array:
        off = np.zeros(len(time_s))
        for k, begins in enumerate(np.linspace(100.0, time_s[-1] - 200.0, 12)):
            off[(time_s > begins) & (time_s < begins + 60.0)] = (0.8, -0.8)[k % 2]
        return off

    known = with_six(pair, pair_healthy, 5)
    found = diagnose(pair.network, with_six(pair, pair.record(10.0), 6, jumps), known)
    assert found.verdict == "unexplained" and found.network is None
    assert [(e.kind, e.where) for e in found.effects if e.where != SENSOR] == [("unknown", "T_pm3_C")]
    assert "T_pm3_C is off by up to" in found.summary
    assert diagnose(pair.network, with_six(pair, pair.record(10.0), 6), known).verdict == "adequate"


def test_the_error_of_one_is_not_taken_for_heat_at_its_place_alone(pair: Bench, pair_healthy: Columns) -> None:
    heated = pair.with_element("heat", {"kind": "heat_source", "node": "modules", "power": 60.0})
    record = pair.record(14.0, changed=heated, onset_h=2.0)
    record = with_six(pair, record, 6, lambda t: np.where(t > 5.0 * HOUR, 1.0, 0.0))
    found = diagnose(pair.network, record, with_six(pair, pair_healthy, 5))
    assert sorted((e.kind, e.where) for e in found.effects) == [("heat_source", "modules"), ("sensor", "T_pm3_C")]
    error = next(e for e in found.effects if e.kind == "sensor")
    assert error.value == pytest.approx(1.0, rel=0.1) and error.onset_s == pytest.approx(5.0 * HOUR, abs=HOUR / 6)


def test_a_thermometer_that_drifts_beside_a_mass_at_its_place_is_a_fault_of_its_own(
    pair: Bench, pair_healthy: Columns
) -> None:
    """The mass is at the modules, not at the one whose thermometer drifts."""
    table = {"kind": "hidden_mass", "node": "modules", "conductance": 45.0, "capacity": 9000.0}
    made = pair.record(16.0, 8, pair.with_element("block", table))
    record = with_six(pair, made, 6, lambda t: -0.6 * np.clip((t / HOUR - 2.0) / 14.0, 0.0, 1.0))
    found = diagnose(pair.network, record, with_six(pair, pair_healthy, 5))
    assert [(e.kind, e.where) for e in found.effects] == [("sensor", "T_pm3_C"), ("thermal_mass", "modules")]
    assert found.effects[0].value == pytest.approx(-0.6, abs=0.1)


@pytest.mark.parametrize(("about_c", "gain"), [(20.0, 0.03), (0.0, -0.02), (37.0, 0.08)])
def test_a_gain_is_told_right_wherever_its_thermometer_is_right(
    pair: Bench, pair_healthy: Columns, about_c: float, gain: float
) -> None:
    """A thermometer that sticks a little at several levels has an error of any gain; no twin lacks that in health."""
    record = pair.record(16.0)
    j = pair.network.sensor_names.index(SENSOR)
    measured = record.measured.copy()
    measured[:, j] += gain * (measured[:, j] - about_c)
    found = diagnose(pair.network, replace(record, measured=measured), pair_healthy)
    (effect,) = found.effects
    assert (found.verdict, effect.kind, effect.where, effect.driver) == (
        "effect found",
        "sensor",
        SENSOR,
        "temperature",
    )
    assert effect.interval90[0] - 0.002 < gain < effect.interval90[1] + 0.002
