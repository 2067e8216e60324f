"""A size that ends on its bound is not known, and so is no claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import STEP_S, Bench
from twin.discovery import diagnose
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.effects.shapes import Shape
from twin.discovery.evidence.part import Part, fitted
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.scoring.search import Entry
from twin.elements.ambient_loss import AmbientLoss
from twin.kernel import Kernel


def test_an_error_beyond_what_a_thermometer_may_have_is_not_claimed(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(10.0)
    j = pair.network.sensor_names.index("T_tank_C")
    measured = record.measured.copy()
    measured[:, j] += 26.0
    found = diagnose(pair.network, replace(record, measured=measured), pair_healthy)
    assert found.verdict == "unexplained" and found.network is None
    assert found.effects[0].where == "T_tank_C"
    assert found.effects[0].value == pytest.approx(26.0, abs=0.5)


def test_what_grows_is_held_against_its_bound_as_far_as_the_record_goes(brisk: Bench, brisk_healthy: Columns) -> None:
    """A pump that lost three quarters of its speed by the record's end would have lost all of it later."""
    record = brisk.record(10.0)
    moved = record.inputs.copy()
    moved[:, 1] *= np.linspace(1.0, 0.25, len(moved))
    state = record.measured[:1].mean(axis=0)
    read, _ = Kernel(brisk.network, ()).trace(brisk.network.values, state, record.time_s, moved)
    noise = brisk.network.sigma * np.random.default_rng(7).normal(0.0, 1.0, read[0].shape)
    measured = read[0] + noise
    grid = on_grid(brisk.network, record.time_s, record.inputs, measured)
    part = Part.of(basis(brisk.network, brisk_healthy, grid, STEP_S), grid)
    law = next(x for x in part.laws if (x.candidate.kind, x.candidate.driver) == ("actuator", "pump_speed"))
    grows = Shape("ramp", 0.0, grid.span_s).going_on(grid.span_s)
    ((fit, _),) = fitted(part, [(Entry(law, grows, np.empty(0), 0.5, 0.0, 0.0).refreshed(part.score_test),)])
    (effect,) = fit.entries
    assert effect.size > law.candidate.upper and not effect.on_bound
    assert effect.size * effect.shape.reached(grid.span_s) == pytest.approx(0.7, abs=0.1)


@pytest.mark.parametrize(("kind", "where"), [("actuator", "heater_power"), ("sensor", "T_tank_C")])
def test_all_or_nothing_of_a_share_is_a_size_like_others(pair: Bench, kind: str, where: str) -> None:
    """A heater may give nothing, and a thermometer may miss every change."""
    ends = [
        c.lower if kind == "actuator" else c.upper
        for c in catalogue(pair.network)
        if (c.kind, c.where) == (kind, where) and (c.sticks or (kind == "actuator" and c.lower == -1.0 and c.adds))
    ]
    assert ends and set(np.abs(ends)) == {1.0}
    for c in catalogue(pair.network):
        if (c.kind, c.where, c.driver) == ("sensor", where, "constant"):
            assert c.at_bound(c.upper) and c.at_bound(c.lower) and not c.at_bound(0.5 * c.upper)
        if (c.kind, c.where) == (kind, where) and c.sticks:
            assert not c.at_bound(1.0) and c.at_bound(0.0)


@pytest.mark.parametrize("changed", ["tank_loss.hA", "fins.UA_still"])
def test_a_loss_may_grow_up_to_the_bound_of_its_parameter(bench: Bench, changed: str) -> None:
    """A rig of kilowatts loses more than one of watts."""
    for upper in (50.0, 400.0):
        p = replace(bench.network.parameters[changed], upper=upper)
        network = replace(bench.network, parameters={**bench.network.parameters, changed: p})
        (found,) = (c for c in catalogue(network) if [*c.changes] == [changed])
        assert found.upper == upper - p.value


def test_the_bound_of_a_new_loss_is_that_of_its_parameter(bench: Bench) -> None:
    new = {c.driver: c for c in catalogue(bench.network) if c.kind == "heat_loss" and c.where == "radiator" and c.adds}
    assert new["temperature_difference"].upper == AmbientLoss.upper_of("hA") == 1000.0
