"""A healthy record that is sampled seldom, beside a reference that was sampled often."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery import diagnose
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid


@pytest.mark.parametrize("every", [7, 25])
def test_a_healthy_rig_that_is_sampled_seldom_is_adequate(bench: Bench, healthy: Columns, every: int) -> None:
    """Loads change between two samples, and nothing tells when."""
    full, rows = bench.record(seed=5), slice(3, None, every)
    seldom = Columns(*(np.ascontiguousarray(x[rows]) for x in (full.time_s, full.inputs, full.measured)))
    assert diagnose(bench.network, seldom, healthy).verdict == "adequate"


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
