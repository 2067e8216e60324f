"""A twin with effects in it, run piece by piece as they come in."""

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.evidence import part as parts
from twin.discovery.evidence.part import Part, fitted, gains
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


def test_fits_side_by_side_are_those_of_one_after_the_other(
    pair: Bench, pair_healthy: Columns, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = pair.record(8.0, changed=pair.with_values(modules_power__power=120.0), onset_h=3.0)
    grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
    known, found = basis(pair.network, pair_healthy, grid), []
    for at_once in (1, 4):
        monkeypatch.setattr(parts, "SIDE_BY_SIDE", at_once)
        part = Part.of(known, grid)
        labels = [law.candidate for law in part.laws if law.candidate.driver == "constant"][:8]
        tried = [entry(part, (c.kind, c.where, c.driver), Shape("step", 1350.0), c.typical) for c in labels]
        fits = fitted(part, [(one,) for one in tried], 2)
        found.append(([(fit.moved.tolist(), group[0].candidate.id) for fit, group in fits], gains(part, tried)))
    assert len(tried) == 8 and found[0] == found[1]


def test_a_lag_and_a_growing_loss_at_one_place_are_both_found(slow_pair: Bench, slow_pair_healthy: Columns) -> None:
    n = 132
    t, u = slow_pair.inputs(16.0, 2)
    pieces, state = [], np.array(slow_pair.start_C)
    # The loss grows from 5 h on, in steps of five minutes.
    edges = np.searchsorted(t, np.concatenate([[0.0], np.linspace(5.0, 16.0, n) * 3600.0]))
    for k, (low, high) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        net = slow_pair.with_element("leak", {"kind": "ambient_loss", "node": "modules", "hA": LOSS * k / n})
        read, ends = Kernel(net, ()).trace(net.values, state, t[low : high + 1], u[low : high + 1])
        pieces.append(read[0][: high - low])
        state = ends[0][: len(net.nodes)]
    y = np.vstack(pieces)
    seen = y.copy()
    decay = np.exp(-(t[1] - t[0]) / LAG_S)
    j = slow_pair.network.sensor_names.index("T_modules_C")
    for i in range(1, len(y)):
        seen[i, j] = y[i - 1, j] + (seen[i - 1, j] - y[i - 1, j]) * decay
    noise = slow_pair.network.sigma * np.random.default_rng(4).normal(0.0, 1.0, y.shape)
    found = diagnose(slow_pair.network, Columns(t[: len(y)], u[: len(y)], seen + noise), slow_pair_healthy)
    assert {(e.kind, e.where) for e in found.effects} == {("sensor", "T_modules_C"), ("heat_loss", "modules")}, (
        found.summary
    )
    by = {e.kind: e for e in found.effects}
    assert by["sensor"].value == pytest.approx(LAG_S, rel=0.1)
    assert by["heat_loss"].value == pytest.approx(LOSS, rel=0.15)


def test_a_growing_reading_error_of_a_short_record_is_that_of_its_law(bench: Bench, healthy: Columns) -> None:
    record = bench.record(6.0)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    shape = Shape("ramp", 7200.0, 21600.0)
    drift = entry(part, ("sensor", "T_heater_C", "constant"), shape, 2.0).refreshed(part.score_test)
    model = Model.of(part.basis.probe, (drift,))
    with_it, without = (
        model.run(grid.time, grid.inputs, part.state[None, :].copy(), bench.network.values[None, :], np.array([[size]]))
        for size in (2.0, 0.0)
    )
    seen = part.score_test.seen(with_it - without)[0, :, bench.network.sensor_names.index("T_heater_C")]
    (law,) = drift.vector[drift.vector.any(axis=1)]
    a_block = 2.0 * part.score_test.step_s / shape.growth_s
    assert np.abs(seen - 2.0 * law).max() < 0.3 * a_block


def test_a_ramp_that_grew_to_the_end_of_the_fitted_part_grows_on(bench: Bench, healthy: Columns) -> None:
    record = bench.record(6.0)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    fitted_s, record_s, onset_s = 19440.0, 21600.0, 7200.0
    ended = entry(part, ("sensor", "T_heater_C", "constant"), Shape("ramp", onset_s, fitted_s - onset_s), 1.19)
    on = ended.going_on(fitted_s, record_s)

    def at(one: Entry, time_s: float) -> float:
        return one.size * one.shape.mean(time_s - 1.0, time_s)

    assert at(on, fitted_s) == pytest.approx(at(ended, fitted_s), rel=1e-3)
    assert at(on, record_s) == pytest.approx(1.19 * (record_s - onset_s) / (fitted_s - onset_s), rel=1e-3)
    # What had ended well before is known to have ended.
    early = entry(part, ("sensor", "T_heater_C", "constant"), Shape("ramp", onset_s, 3600.0), 1.19)
    assert early.going_on(fitted_s, record_s) == early


def test_the_squares_of_a_fit_are_no_staircase_in_the_onset(bench: Bench, healthy: Columns) -> None:
    """What begins amid a bin is there for a share of it, so that each second of the onset moves the readings."""
    record = bench.record(6.0)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    probe, state, values = part.basis.probe, part.state[None, :], bench.network.values[None, :]
    seen = int(3060.0 / grid.step_s), bench.network.sensor_names.index("T_modules_C")
    ends = []
    for onset_s in np.arange(3001.0, 3010.0, 2.0).tolist():
        heat = entry(part, ("heat_source", "modules", "constant"), Shape("step", onset_s), 500.0)
        model = Model.of(probe, (heat,))
        run = model.run(grid.time, grid.inputs, state.copy(), values, np.array([[500.0]]))[0]
        ends.append(float(run[seen]))
    steps = -np.diff(ends)
    assert steps.min() > 0.0 and np.ptp(steps) < 0.3 * steps.mean()
