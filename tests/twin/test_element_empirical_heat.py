"""A curve of heat: what it is at its knots, between and beyond them, and what is refused."""

import numpy as np
import pytest

from tests.twin.conftest import LOOP
from twin.discovery.effects.formulas import Formulas
from twin.kernel import simulate
from twin.network import Network, TwinFileError
from twin.revisions import with_elements
from twin.twinfile import load

KNOTS, HEATS = (40.0, 50.0, 60.0, 80.0, 100.0), (0.0, 30.0, 90.0, 20.0, -10.0)


def curved(place: dict[str, object], knots: tuple[float, ...] = KNOTS) -> Network:
    numbers = {f"x_{k + 1}": {"value": x} for k, x in enumerate(knots)}
    numbers |= {f"q_{k + 1}": {"value": q} for k, q in enumerate(HEATS)}
    return with_elements(load(LOOP), {"odd": {"kind": "empirical_heat", "node": "tank", **place, **numbers}})


def test_it_runs_through_its_knots_and_stays_level_beyond_them() -> None:
    network, plain = curved({"driver": "fan_speed_pct"}), load(LOOP)
    fan = np.array([10.0, 40.0, 45.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0, 120.0])
    u = np.tile(network.nominal_inputs, (len(fan), 1))
    u[:, network.input_columns.index("fan_speed_pct")] = fan
    t = np.full((len(fan), 4), 35.0)
    more = Formulas(network).heats(t, u, network.values, 10.0) - Formulas(plain).heats(t, u, plain.values, 10.0)
    assert np.allclose(more[:, network.nodes.index("tank")], np.interp(fan, KNOTS, HEATS))
    assert np.allclose(np.delete(more, network.nodes.index("tank"), axis=1), 0.0)


def test_it_may_follow_the_temperature_of_its_own_node_and_stays_finite() -> None:
    """A steep curve of the node's own temperature settles where its heat and the losses balance."""
    network = curved({"of": "tank"}, (30.0, 32.0, 33.0, 34.0, 36.0))
    t = np.arange(0.0, 40_000.0, 10.0)
    run = simulate(network, t, np.tile(network.nominal_inputs, (len(t), 1)), np.array([37.0, 36.8, 34.5, 34.0]))
    assert np.isfinite(run).all() and np.ptp(run[-500:], axis=0).max() < 0.05


@pytest.mark.parametrize(
    ("place", "knots", "said"),
    [
        ({}, KNOTS, "either a driver column or a node"),
        ({"driver": "fan_speed_pct", "of": "tank"}, KNOTS, "either a driver column or a node"),
        ({"driver": "fan_speed_pct"}, (40.0, 60.0, 50.0, 80.0, 100.0), "must rise"),
    ],
)
def test_what_makes_no_sense_is_refused(place: dict[str, object], knots: tuple[float, ...], said: str) -> None:
    with pytest.raises(TwinFileError, match=said):
        curved(place, knots)
