"""Thermometers in a row on what is heated and cooled: their healthy differences, and what the whole row shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from tests.discovery.test_fault_hypotheses import slowly
from tests.discovery.test_thermometers import SENSOR
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid
from twin.discovery.thermometers.members import HealthyDifferences
from twin.network import Array

RISE, HOT, NAN = np.array([-0.5, 0.0, 0.5]), np.array([-0.5, 1.0, -0.5]), np.full(3, np.nan)
"""Shares of the rise of the water's temperature at three thermometers, and of what heat makes of the middle one."""


def in_a_row(bench: Bench, record: Columns, seed: int, off: float | Array = 0.0) -> Columns:
    """The record with three thermometers in a row; the middle one is of a hotter cell, and reads `off` K too high.

    The water warms on its way, the more the less of it flows; cells come to their temperatures within minutes.
    """
    j = bench.network.sensor_names.index(SENSOR)
    modules, tank = record.measured[:, j], record.measured[:, 1 - j]
    hot = slowly(record.inputs[:, 0], 120.0) * 1e-3
    each = modules[:, None] + np.outer(modules - tank, RISE) + np.outer(hot, HOT)
    each += np.random.default_rng(seed).normal(0.0, 0.02, each.shape)
    each[:, 1] += off
    measured = record.measured.copy()
    measured[:, j] = each.mean(axis=1)
    return replace(record, measured=measured, members={SENSOR: np.column_stack([each, np.tile(NAN, (len(each), 1))])})


def test_the_error_of_one_shows_beside_differences_that_follow_the_heat(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(14.0, seed=3)
    off = np.where(record.time_s > 5.0 * HOUR, 0.5, 0.0)
    found = diagnose(pair.network, in_a_row(pair, record, 6, off), in_a_row(pair, pair_healthy, 5))
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("sensor", "T_pm2_C") and effect.value == pytest.approx(0.5, abs=0.05)


def test_a_flow_that_fails_is_no_error_at_the_end_of_a_row(pair: Bench, pair_healthy: Columns) -> None:
    """The last thermometer has most of what differs, and all of it is what less flow does in health."""
    record = pair.record(14.0, seed=3, changed=pair.with_values(circuit__factor=0.5), onset_h=5.0)
    (effect,) = diagnose(pair.network, in_a_row(pair, record, 6), in_a_row(pair, pair_healthy, 5)).effects
    assert (effect.kind, effect.where) in {("flow", "loop"), ("actuator", "pump_speed")}


def test_a_row_that_begins_cold_remembers_no_heat(pair: Bench, pair_healthy: Columns) -> None:
    """What its first ten minutes differ by is not what the same power makes of it later."""
    column, network = pair.network.input_columns.index("heater_power_W"), pair.network
    known, begun = (
        on_grid(network, r.time_s, r.inputs, r.measured)
        for r in (pair_healthy, replace(pair, start_C=(22.5, 22.5)).record(10.0, seed=3))
    )
    law = HealthyDifferences(network, (column,), np.zeros(1), np.array([0.017]), 240.0, np.eye(4))
    (rest, cold) = (
        law.differences(g, g.measured[:, 0], np.arange(len(g.time) + 1))[0, 3] / g.inputs[0, column]
        for g in (known, begun)
    )
    assert rest > 0.8 and cold < 0.2
