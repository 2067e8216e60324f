"""A size that ends on its bound is not known, and so is no claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery import diagnose
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.healthy.basis import Columns
from twin.elements.ambient_loss import AmbientLoss


def test_an_error_beyond_what_a_thermometer_may_have_is_not_claimed(brisk: Bench, brisk_healthy: Columns) -> None:
    record = brisk.record(10.0)
    j = brisk.network.sensor_names.index("T_tank_C")
    measured = record.measured.copy()
    measured[:, j] += 26.0
    found = diagnose(brisk.network, replace(record, measured=measured), brisk_healthy)
    assert found.verdict == "unexplained" and found.network is None
    assert found.effects[0].where == "T_tank_C"
    assert found.effects[0].value == pytest.approx(26.0, abs=0.5)


@pytest.mark.parametrize(("kind", "where"), [("actuator", "heater_power"), ("sensor", "T_tank_C")])
def test_all_or_nothing_of_a_share_is_a_size_like_others(brisk: Bench, kind: str, where: str) -> None:
    """A heater may give nothing, and a thermometer may miss every change."""
    ends = [
        c.lower if kind == "actuator" else c.upper
        for c in catalogue(brisk.network)
        if (c.kind, c.where) == (kind, where) and (c.sticks or (kind == "actuator" and c.lower == -1.0 and c.adds))
    ]
    assert ends and set(np.abs(ends)) == {1.0}
    for c in catalogue(brisk.network):
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
