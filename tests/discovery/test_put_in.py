"""A body put in while the rig runs: as warm as the room, it cools what it stands in before it slows it."""

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.kernel import Kernel

CONDUCTANCE, CAPACITY, ONSET_H = 30.0, 5.0e4, 7.0


def put_in(bench: Bench, *, cold: bool) -> Columns:
    """Readings of the loop with a mass in its tank since `ONSET_H`, as warm as the room or as the tank."""
    heavier = bench.with_element(
        "mass", {"kind": "hidden_mass", "node": "tank", "conductance": CONDUCTANCE, "capacity": CAPACITY}
    )
    t, u = bench.inputs(16.0, 3)
    at = int(np.searchsorted(t, ONSET_H * 3600.0))
    nodes = len(bench.network.nodes)
    before, ends = Kernel(bench.network, ()).trace(
        bench.network.values, np.array([37.0, 36.8, 34.5, 34.0]), t[: at + 1], u[: at + 1]
    )
    tank = ends[0][bench.network.nodes.index("tank")]
    begun = np.append(ends[0][:nodes], u[at, 3] if cold else tank)
    after, _ = Kernel(heavier, ()).trace(heavier.values, begun, t[at:], u[at:])
    y = np.vstack([before[0][:at], after[0]])
    return Columns(t, u, y + bench.network.sigma * np.random.default_rng(5).normal(0.0, 1.0, y.shape))


def test_a_record_too_short_for_anything_to_be_put_in_is_diagnosed(bench: Bench, healthy: Columns) -> None:
    found = diagnose(bench.network, bench.record(0.9), healthy)
    assert found.verdict == "adequate"


@pytest.mark.parametrize("cold", [True, False])
def test_a_mass_that_comes_in_is_named_whatever_its_first_temperature(
    bench: Bench, healthy: Columns, cold: bool
) -> None:
    found = diagnose(bench.network, put_in(bench, cold=cold), healthy)
    assert found.verdict == "effect found", found.summary
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver, effect.shape) == ("thermal_mass", "tank", "history", "step")
    assert ("put in" in effect.says) == cold
    # What is cold tells its moment; what is warm shows only when the tank next changes.
    assert effect.onset_s == pytest.approx(ONSET_H * 3600.0, abs=300.0 if cold else 3600.0)
    assert effect.value == pytest.approx(CONDUCTANCE, rel=0.1 if cold else 0.3)
    assert found.network is not None
    mass = found.network.parameters["mass_beside_tank.capacity"].value
    assert mass == pytest.approx(CAPACITY, rel=0.15 if cold else 0.3)
    assert all(e.after < 1.3 * e.noise for e in found.errors.values())
