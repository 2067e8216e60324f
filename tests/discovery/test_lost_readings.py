"""Thermometers that are missing, drop out or err: what the others tell, and in which words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.commissioning import commission
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.network import Array, mean_of_sensors


def without(record: Columns, bench: Bench, sensor: str) -> Columns:
    measured = record.measured.copy()
    measured[:, bench.network.sensor_names.index(sensor)] = np.nan
    return replace(record, measured=measured)


@pytest.mark.parametrize("offset", [0.9, -0.9])
def test_a_room_thermometer_in_error_is_told_the_right_way_round(
    slow_pair: Bench, slow_pair_healthy: Columns, offset: float
) -> None:
    record = slow_pair.record(10.0, 3)
    inputs = record.inputs.copy()
    inputs[:, slow_pair.network.input_columns.index("T_ambient_C")] += offset
    found = diagnose(slow_pair.network, replace(record, inputs=inputs), slow_pair_healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("sensor", "T_ambient_C", "constant")
    assert effect.value == pytest.approx(offset, rel=0.1)
    assert f"too {'high' if offset > 0.0 else 'low'}" in found.summary
    # The twin with it undoes the error, and does not double it.
    assert found.network is not None
    assert all(e.after < 1.15 * e.noise for e in found.errors.values())


def test_a_thermometer_that_errs_above_room_temperature_is_told_in_that_form(
    pair: Bench, pair_healthy: Columns
) -> None:
    changed = pair.with_values(T_tank_C__gain=1.06, T_tank_C__bias_K=-1.5)
    found = diagnose(pair.network, pair.record(16.0, 5, changed, onset_h=4.0), pair_healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("sensor", "T_tank_C", "temperature")
    assert effect.value == pytest.approx(0.06, rel=0.15) and "above 25 degC" in effect.says


def test_a_sensor_that_is_missing_everywhere_is_no_refusal(brisk: Bench, brisk_healthy: Columns) -> None:
    gone = "T_radiator_C"
    known = without(brisk_healthy, brisk, gone)
    twin = commission(brisk.network, known.time_s, known.inputs, known.measured)
    assert any(gone in note for note in twin.notes)
    changed = brisk.with_values(modules_power__power=60.0)
    record = without(brisk.record(16.0, 1, changed, onset_h=5.0), brisk, gone)
    found = diagnose(twin.network, record, known)
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("heat_source", "modules")
    assert effect.value == pytest.approx(60.0, rel=0.1)
    assert any(gone in note for note in found.notes) and gone not in found.errors


def test_a_sensor_that_the_healthy_record_lacks_claims_nothing(brisk: Bench, brisk_healthy: Columns) -> None:
    record = brisk.record(16.0, 4, brisk.with_values(T_tank_C__bias_K=1.0), onset_h=0.0)
    found = diagnose(brisk.network, record, without(brisk_healthy, brisk, "T_tank_C"))
    assert found.verdict == "adequate"
    assert any("T_tank_C" in note and "healthy record" in note for note in found.notes)


def _six(hours: float, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    rows = int(hours * 720)
    return 30.0 + np.sin(np.arange(rows) / 300.0)[:, None] + np.linspace(-0.5, 0.5, 6) + rng.normal(0, 0.02, (rows, 6))


@pytest.mark.parametrize("lost", [(0,), (5,), (0, 1), (1, 4, 5)])
def test_the_mean_of_several_does_not_jump_where_some_drop_out(lost: tuple[int, ...]) -> None:
    each = _six(4.0, 1)
    whole = mean_of_sensors(each)
    broken = each.copy()
    broken[1400:, lost] = np.nan
    assert mean_of_sensors(broken) == pytest.approx(whole, abs=0.06)
    assert np.abs(np.nanmean(broken, axis=1) - whole).max() > 0.06 or lost == (1, 4, 5)


def test_one_that_raves_before_it_fails_does_not_move_the_others() -> None:
    each = _six(4.0, 3)
    whole = mean_of_sensors(each)
    broken = each.copy()
    broken[1000:1300, 2], broken[1300:, 2] = 85.0, np.nan
    assert mean_of_sensors(broken)[1300:] == pytest.approx(whole[1300:], abs=0.06)


def test_the_mean_of_several_is_missing_where_all_are() -> None:
    each = _six(1.0, 2)
    each[10] = np.nan
    mean = mean_of_sensors(each)
    assert np.isnan(mean[10]) and np.isfinite(np.delete(mean, 10)).all()
