"""Changes of parameters of rigs whose sizes are far from those of the catalogue."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.effects.laws import Book
from twin.discovery.effects.probe import FreeRun
from twin.discovery.engine import diagnose
from twin.discovery.records.grid import on_grid
from twin.elements.candidates import Candidate
from twin.network import Network
from twin.twinfile import parse

LOSS = "tank_loss.hA"


def bounded(bench: Bench, value: float, lower: float, upper: float) -> Bench:
    """The loop with other bounds of the tank's loss."""
    parameters = dict(bench.network.parameters)
    parameters[LOSS] = replace(parameters[LOSS], value=value, lower=lower, upper=upper)
    network: Network = replace(bench.network, parameters=MappingProxyType(parameters), digest="")
    return Bench(network)


def loss_of(network: Network) -> Candidate:
    (found,) = [c for c in catalogue(network) if dict(c.changes) == {LOSS: 1.0}]
    return found


@pytest.mark.parametrize("value", [0.012, 0.05])
def test_a_change_is_no_larger_than_the_parameters_bounds_allow(bench: Bench, value: float) -> None:
    small = bounded(bench, value, 0.001, 0.05)
    candidate = loss_of(small.network)
    assert value + candidate.lower == pytest.approx(0.001) and value + candidate.upper == pytest.approx(0.05)
    assert 0.0 < candidate.typical <= 0.05


@pytest.mark.parametrize("value", [0.012, 0.05])
def test_a_law_at_size_one_is_the_heat_of_one_unit(bench: Bench, value: float) -> None:
    """Also where a typical size of the catalogue lies outside the bounds, on either side."""
    small = bounded(bench, value, 0.001, 0.05)
    t, u = small.inputs(2.0, 1)
    warm = np.full((len(t), len(small.network.nodes)), 60.0)
    grid = on_grid(small.network, t, u, np.full((len(t), len(small.network.sensors)), 60.0))
    run = FreeRun(np.full_like(grid.measured, 60.0), warm[: len(grid.time)])
    (law,) = Book(small.network).laws(grid, run, (loss_of(small.network),))
    assert law.heat is not None
    tank = small.network.nodes.index("tank")
    assert law.heat[:, tank] == pytest.approx(grid.inputs[:, 3] - 60.0, rel=1e-6)


def test_a_change_smaller_than_a_typical_size_is_told(bench: Bench) -> None:
    """A loss of 0.2 W/K becomes 0.6, the most that the parameter may be; a typical change of the catalogue is 1."""
    small = bounded(bench, 0.2, 0.05, 0.6)
    more = small.with_values(tank_loss__hA=0.6)
    healthy, record = small.record(10.0, seed=7, noise=0.1), small.record(16.0, seed=4, changed=more, noise=0.1)
    found = diagnose(small.network, record, healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("heat_loss", "tank")]
    assert found.effects[0].value == pytest.approx(0.4, rel=0.1)


def test_a_volume_too_small_for_a_mass_is_offered_none() -> None:
    small = parse(
        'format = 1\nname = "foil"\n[inputs]\nT_ambient_C = { nominal = 20.0 }\n[elements]\n'
        'foil = { kind = "node", capacitance = 5.0 }\nloss = { kind = "ambient_loss", node = "foil", hA = 0.1 }\n'
        'T_foil_C = { kind = "sensor", node = "foil", columns = ["T_foil_C"] }\n'
    )
    assert all(c.lower < c.upper for c in catalogue(small))
    assert not any(c.begins for c in catalogue(small))
