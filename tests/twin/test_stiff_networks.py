"""The linearly implicit method for networks with volumes that are fast against a sample interval."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import twin.kernel.simulation as simulation
from twin.kernel import Kernel, simulate
from twin.network import Array, Network
from twin.reference_simulation import simulate_exact
from twin.twinfile import parse

THIN_WALL = """
format = 1
name = "thin wall beside a tank"
[inputs]
heater_power_W = { nominal = 500.0, upper = 1000.0 }
pump_speed_pct = { nominal = 100.0, upper = 100.0 }
T_ambient_C = { nominal = 20.0, upper = 40.0 }
[elements]
wall = { kind = "node", capacitance = 5.0 }
heater = { kind = "node", capacitance = 300.0 }
radiator = { kind = "node", capacitance = 400.0 }
tank = { kind = "node", capacitance = 2.0e6 }
loop = { kind = "flow", path = ["heater", "radiator", "tank"], pump = "pump_speed_pct", nominal = 4.0 }
power = { kind = "heat_source", node = "wall", driver = "heater_power_W" }
film = { kind = "conduction", from = "wall", to = "heater", resistance = { value = 0.01, upper = 0.1 } }
loss = { kind = "ambient_loss", node = "radiator", hA = 20.0 }
T_wall_C = { kind = "sensor", node = "wall", columns = ["T_wall_C"] }
T_radiator_C = { kind = "sensor", node = "radiator", columns = ["T_radiator_C"] }
T_tank_C = { kind = "sensor", node = "tank", columns = ["T_tank_C"] }
"""
CONVECTION = '[elements.more]\nkind = "natural_convection"\nnode = "wall"\ncoefficient = 2.0\n'
PIPE = '[elements.more]\nkind = "pipe"\nto = "radiator"\nvolume = 2.0\nwall_capacity = 4000.0\n'
LATE = THIN_WALL.replace('["T_radiator_C"] }', '["T_radiator_C"], lag_s = 25.0 }')
WARM = np.full(4, 30.0)


def steps(n: int = 300) -> tuple[Array, Array]:
    """Stamps (n,) 12 s apart, and inputs (n, 3) that change at every tenth of them."""
    rng = np.random.default_rng(5)
    held = (np.repeat(rng.choice(levels, n // 10), 10) for levels in ([0.0, 300.0, 900.0], [40.0, 70.0, 100.0]))
    return 12.0 * np.arange(n), np.column_stack([*held, 20.0 + np.sin(np.arange(n) / 40.0)])


@pytest.fixture
def explicit(monkeypatch: pytest.MonkeyPatch) -> Callable[[Network], Array]:
    """Return a simulation that takes as many explicit substeps as the fastest volume asks for."""

    def run(network: Network) -> Array:
        with monkeypatch.context() as patch:
            patch.setattr(simulation, "STIFF", np.inf)
            return simulate(network, *steps(), WARM)

    return run


def test_a_linear_network_is_simulated_as_exactly_as_promised() -> None:
    network, (time, inputs) = parse(THIN_WALL), steps()
    off = simulate(network, time, inputs, WARM) - simulate_exact(network, time, inputs, WARM)[:, [0, 2, 3]]
    # A step of 900 W moves the wall by 9 K against the water, and all by some 25 K.
    assert np.abs(off).max() < 2.2e-4 * 34.0
    assert np.sqrt((off**2).mean()) < 5e-4


@pytest.mark.parametrize("text", [THIN_WALL + CONVECTION, THIN_WALL + PIPE, LATE], ids=["power law", "pipe", "lag"])
def test_other_networks_are_simulated_as_by_many_small_steps(text: str, explicit: Callable[[Network], Array]) -> None:
    network = parse(text)
    off = simulate(network, *steps(), WARM) - explicit(network)
    assert 0.0 < np.abs(off).max() < 2.2e-4 * 34.0
    assert np.sqrt((off**2).mean()) < 5e-4


@pytest.mark.parametrize("text", [THIN_WALL, THIN_WALL + CONVECTION], ids=["linear", "power law"])
def test_an_interval_of_hours_is_simulated_to_its_end(text: str) -> None:
    network, hours = parse(text), 3600.0 * np.arange(0.0, 80.0, 8.0)
    inputs = np.tile([700.0, 80.0, 20.0], (len(hours), 1))
    fine = np.arange(0.0, hours[-1] + 1.0, 48.0)
    expected = simulate(network, fine, np.tile(inputs[0], (len(fine), 1)), WARM)[np.searchsorted(fine, hours)]
    assert np.diff(expected[:, 2])[:3].min() > 1.0  # the tank goes on warming up for days
    assert simulate(network, hours, inputs, WARM) == pytest.approx(expected, abs=0.01)


def test_readings_are_smooth_in_the_fast_volumes_parameters() -> None:
    network, (time, inputs) = parse(THIN_WALL), steps(60)
    kernel = Kernel(network, ("wall.capacitance",))
    column = network.index(["wall.capacitance"])[0]
    values = np.tile(network.values, (41, 1))
    values[:, column] = np.linspace(4.0, 6.0, 41)
    readings = kernel.trace(values, np.tile(WARM, (41, 1)), time, inputs)[0]
    slopes = np.diff(readings, axis=0)
    assert np.abs(np.diff(slopes, axis=0)).max() < 0.1 * np.abs(slopes).max()


def test_samples_that_follow_fast_volumes_keep_the_exact_method() -> None:
    network, time = parse(THIN_WALL), np.arange(0.0, 60.0, 0.5)
    inputs = np.tile([700.0, 80.0, 20.0], (len(time), 1))
    off = simulate(network, time, inputs, WARM) - simulate_exact(network, time, inputs, WARM)[:, [0, 2, 3]]
    assert np.abs(off).max() < 1e-6


def test_every_lane_and_the_corners_of_the_bounds_are_finite() -> None:
    network, (time, inputs) = parse(THIN_WALL), steps(60)
    inputs[20:30, 1] = 0.0
    kernel = Kernel(network, ("wall.capacitance", "film.resistance", "loss.hA"))
    at = network.index(["wall.capacitance", "film.resistance", "loss.hA"])
    corners = np.array([(c, r, g) for c in (1.0, 1.0e9) for r in (2.0e-3, 0.1) for g in (0.0, 1000.0)])
    values = np.tile(network.values, (len(corners), 1))
    values[:, at] = corners
    readings = kernel.trace(values, WARM[None], time, inputs)[0]
    assert np.isfinite(readings).all()
    alone = kernel.trace(values[:1], WARM[None], time, inputs)[0][0]
    assert readings[0] == pytest.approx(alone, abs=1e-9)


def test_the_sum_of_squares_is_that_of_the_trace() -> None:
    network, (time, inputs) = parse(THIN_WALL), steps(60)
    kernel, measured = Kernel(network, ("loss.hA",)), np.full((60, 3), 40.0)
    values = np.tile(network.values, (3, 1))
    values[:, network.index(["loss.hA"])[0]] = (10.0, 20.0, 30.0)
    squares = kernel.cost(values, WARM[None], time, inputs, measured, np.ones((60, 3)))[0]
    traced = ((kernel.trace(values, WARM[None], time, inputs)[0] - 40.0) ** 2).sum(axis=1)
    assert squares == pytest.approx(traced, rel=1e-9)
