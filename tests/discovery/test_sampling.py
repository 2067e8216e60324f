"""A healthy record that is sampled seldom, beside a reference that was sampled often."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery import diagnose
from twin.discovery.effects.probe import Probe
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid
from twin.kernel import Kernel


@pytest.mark.parametrize("every", [7, 25])
def test_a_healthy_rig_that_is_sampled_seldom_is_adequate(bench: Bench, healthy: Columns, every: int) -> None:
    """Loads change between two samples, and nothing tells when."""
    full, rows = bench.record(seed=5), slice(3, None, every)
    seldom = Columns(*(np.ascontiguousarray(x[rows]) for x in (full.time_s, full.inputs, full.measured)))
    assert diagnose(bench.network, seldom, healthy).verdict == "adequate"


def switched(bench: Bench, seed: int, late_s: float, every: int = 10) -> Columns:
    """Record of every tenth second, whose loads change up to `late_s` before the sample that shows it."""
    network, rng = bench.network, np.random.default_rng(seed)
    t = np.arange(0.0, 9600.0)
    power = np.empty(len(t))
    for k, level in enumerate(rng.choice([300.0, 900.0, 1500.0], 32)):
        power[k * 300 - round(late_s * rng.random()) if k else 0 :] = level
    u = np.column_stack([power, np.full(len(t), 80.0), np.full(len(t), 70.0), np.full(len(t), 22.0)])
    read, _ = Kernel(network, ()).trace(network.values, np.array([37.0, 36.8, 34.5, 34.0]), t, u)
    rows = slice(None, None, every)
    measured = read[0][rows] + network.sigma * rng.normal(0.0, 1.0, read[0][rows].shape)
    return Columns(t[rows].copy(), np.ascontiguousarray(u[rows]), measured)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_loads_that_change_between_samples_are_no_fault_where_those_in_health_changed_on_them(
    bench: Bench, seed: int
) -> None:
    """A step that is logged up to ten seconds late leaves as much as a fault that lasts for half a minute."""
    assert diagnose(bench.network, switched(bench, seed, 9.0), switched(bench, 7, 0.0)).verdict == "adequate"


@pytest.mark.parametrize("bias_K", [0.0, 1.0])
def test_half_degrees_are_no_fault_where_health_was_logged_in_hundredths(
    pair: Bench, pair_healthy: Columns, bias_K: float
) -> None:
    """The error of rounding follows the temperature from step to step; a bias of two steps is seen beside it."""
    record = pair.record(seed=3)
    off = np.outer(record.time_s > 6.0 * pair.hour_s, [bias_K, 0.0])
    rounded = replace(record, measured=0.5 * np.round(2.0 * (record.measured + off)))
    found = diagnose(pair.network, rounded, pair_healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("sensor", pair.network.sensor_names[0])] * bool(bias_K)
    assert bias_K or found.verdict == "adequate"


def test_a_bin_has_the_mean_over_time_of_a_held_input(bench: Bench) -> None:
    """Every seven seconds a bin of ten holds one sample or two, and the last of them may belong to the next bin."""
    network = bench.network
    t = np.arange(0.0, 7200.0, 7.0)
    t = t[(t < 2000.0) | (t > 2100.0)]
    u = np.tile(network.nominal_inputs, (len(t), 1))
    u[:, 0] = np.where(t >= 3606.0, 900.0, 300.0)
    grid = on_grid(network, t, u, np.full((len(t), len(network.sensors)), 30.0))
    row = int((float(t[t >= 3606.0][0]) - t[0]) // grid.step_s)
    began = float(t[t >= 3606.0][0]) - t[0] - row * grid.step_s
    assert grid.inputs[row, 0] == pytest.approx((300.0 * began + 900.0 * (grid.step_s - began)) / grid.step_s)
    energy = float(np.sum(u[:-1, 0] * np.diff(t)))
    whole = int((t[-1] - t[0]) // grid.step_s)
    rest = (t[-1] - t[0] - whole * grid.step_s) * 900.0
    assert grid.step_s * float(grid.inputs[:whole, 0].sum()) + rest == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("every", [1, 5, 10, 30])
def test_a_reading_is_compared_at_its_own_time(bench: Bench, every: int) -> None:
    """Where a bin has one sample, its middle would be wrong by 0.09 to 0.25 K, as of a thermometer that lags."""
    whole = switched(bench, 3, 0.0, 1)
    rows = slice(None, None, every)
    t, u = whole.time_s[rows].copy(), np.ascontiguousarray(whole.inputs[rows])
    state = np.array([37.0, 36.8, 34.5, 34.0])
    read, _ = Kernel(bench.network, ()).trace(bench.network.values, state, t, u)
    grid = on_grid(bench.network, t, u, read[0])
    run = Probe(bench.network, bench.network.tunables()).run(grid, state)
    assert np.sqrt(np.mean((run.readings - grid.measured)[:-1] ** 2)) < 0.02
