"""A twin with effects in it, run piece by piece as they come in."""

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry
from twin.kernel import Kernel

LAG_S, LOSS = 90.0, 6.0


def entry(part: Part, label: tuple[str, str, str], shape: Shape, size: float) -> Entry:
    """A candidate of the part's catalogue as an effect of such a size."""
    law = next(w for w in part.laws if (w.candidate.kind, w.candidate.where, w.candidate.driver) == label)
    return Entry(law, shape, part.score_test.vector(law), size, 0.0, 0.0)


def test_a_thermometer_that_lags_goes_on_lagging_while_something_else_grows(bench: Bench, healthy: Columns) -> None:
    record = bench.record(6.0)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    lag = entry(part, ("sensor", "T_heater_C", "rate_of_change"), Shape("step"), LAG_S)
    grows = entry(part, ("heat_loss", "heater", "temperature_difference"), Shape("ramp", 1800.0, 14400.0), 0.0)
    probe, state, values = part.basis.probe, part.state[None, :], bench.network.values[None, :]
    alone = Model.of(probe, (lag,)).run(record.time_s, record.inputs, state.copy(), values, np.array([[LAG_S]]))
    beside = Model.of(probe, (lag, grows)).run(
        record.time_s, record.inputs, state.copy(), values, np.array([[LAG_S, 0.0]])
    )
    assert np.abs(beside - alone).max() < 1e-9


def test_a_lag_and_a_growing_loss_at_one_place_are_both_found(bench: Bench, healthy: Columns) -> None:
    n = 132
    t, u = bench.inputs(16.0, 2)
    pieces, state = [], np.array([37.0, 36.8, 34.5, 34.0])
    # The loss grows from 5 h on, in steps of five minutes.
    edges = np.searchsorted(t, np.concatenate([[0.0], np.linspace(5.0, 16.0, n) * 3600.0]))
    for k, (low, high) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        net = bench.with_element("leak", {"kind": "ambient_loss", "node": "heater", "hA": LOSS * k / n})
        read, ends = Kernel(net, ()).trace(net.values, state, t[low : high + 1], u[low : high + 1])
        pieces.append(read[0][: high - low])
        state = ends[0][: len(net.nodes)]
    y = np.vstack(pieces)
    seen = y.copy()
    decay = np.exp(-(t[1] - t[0]) / LAG_S)
    j = bench.network.sensor_names.index("T_heater_C")
    for i in range(1, len(y)):
        seen[i, j] = y[i - 1, j] + (seen[i - 1, j] - y[i - 1, j]) * decay
    noise = bench.network.sigma * np.random.default_rng(4).normal(0.0, 1.0, y.shape)
    found = diagnose(bench.network, Columns(t[: len(y)], u[: len(y)], seen + noise), healthy)
    assert {(e.kind, e.where) for e in found.effects} == {("sensor", "T_heater_C"), ("heat_loss", "heater")}, (
        found.summary
    )
    by = {e.kind: e for e in found.effects}
    assert by["sensor"].value == pytest.approx(LAG_S, rel=0.1)
    assert by["heat_loss"].value == pytest.approx(LOSS, rel=0.15)
