"""The tower cell as an element: equal to the cell's own equations, and candidates of the diagnosis."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from twin.kernel import simulate
from twin.network import Network, Revision
from twin.steady import steady_readings
from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell
from twin.tower.estimates import Priors
from twin.tower.model import NAMES, CellModel, DesignPoint, Operation
from twin.tower.twin_file import BOUNDS, cell_network

DESIGN = Design(250.0, 205.0, 1.5, 0.7, 40.0, 1.15, evaporation=1.05, idle=1.0)


def network(**deviations: float) -> Network:
    net = cell_network(1, "Z", DESIGN, 0.7, 0.1, (0.02, 0.1), Revision())
    return net.with_values({f"cell.{name}": value for name, value in deviations.items()})


def operating_points(n: int, seed: int = 0) -> np.ndarray:
    """Inputs in the order of the twin file: inlet, flow, speed, dry bulb, wet bulb, pressure, bypass."""
    rng = np.random.default_rng(seed)
    dry = rng.uniform(-5.0, 38.0, n)
    wet = dry - rng.uniform(0.0, 5.0, n)
    inlet = np.maximum(wet, 3.0) + rng.uniform(3.0, 25.0, n)
    return np.stack(
        [inlet, rng.uniform(100, 300, n), rng.uniform(0, 100, n), dry, wet, rng.uniform(80, 102, n), np.zeros(n)],
        axis=1,
    )


def test_element_and_cell_agree_at_every_operating_point() -> None:
    u = operating_points(200)
    net = network(fill=0.86, air=0.93, uniformity=0.95)
    found = steady_readings(net, u)[:, 0]
    inputs = Inputs(u[:, 0], u[:, 1], u[:, 2] / 100.0, u[:, 3], u[:, 4], u[:, 5])
    assert found == pytest.approx(solve_cell(inputs, DESIGN, CellDeviations(0.86, 0.93, 0.95)).t_out, abs=1e-6)


def test_bypass_mixes_hot_water_into_the_flume_and_the_bias_shifts_the_reading_alone() -> None:
    u = operating_points(20, seed=1)
    shut = steady_readings(network(), u)[:, 0]
    u[:, 6] = 100.0
    assert steady_readings(network(), u)[:, 0] == pytest.approx(0.3 * shut + 0.7 * u[:, 0], abs=1e-6)
    biased = network().with_values({"outlet.bias_K": 0.4})
    assert steady_readings(biased, u)[:, 0] == pytest.approx(steady_readings(network(), u)[:, 0] + 0.4, abs=1e-9)


def test_a_fortnight_of_minutes_stays_between_wet_bulb_and_inlet() -> None:
    net, u = network(), operating_points(20_000, seed=2)
    outlet = simulate(net, 60.0 * np.arange(len(u)), u, np.array([25.0]))[..., 0].ravel()
    assert np.isfinite(outlet).all()
    assert outlet.min() > u[:, 4].min() and outlet.max() < u[:, 0].max()


def test_each_deviation_is_a_candidate_of_the_diagnosis() -> None:
    net = network(fill=0.9)
    (cell,) = (element for element in net.elements if element.name == "cell")
    values = {name: parameter.value for name, parameter in net.parameters.items()}
    sites = SimpleNamespace(places={"flume": "flume"}, values=values)
    found = {next(iter(c.changes)): c for c in cell.changed_candidates(sites)}
    assert set(found) == {"cell.fill", "cell.air", "cell.uniformity"}
    assert found["cell.fill"].lower == pytest.approx(0.2 - 0.9) and found["cell.fill"].upper == pytest.approx(1.8 - 0.9)


def test_fan_power_of_cell_and_record_follow_one_law_of_the_air() -> None:
    """Apart from the exhaust's density, of which a record tells and a twin file does not."""
    u = operating_points(50, seed=3)
    u[:, 2] = np.maximum(u[:, 2], 10.0)
    design = replace(DESIGN, kappa=-1.3)
    inputs = Inputs(u[:, 0], u[:, 1], u[:, 2] / 100.0, u[:, 3], u[:, 4], u[:, 5])
    cell = solve_cell(inputs, design, CellDeviations(air=0.9)).power
    operation = Operation(inputs, *(np.zeros(50) for _ in range(4)), np.zeros((50, 0)))
    constants = Priors(BOUNDS).constant()[0]
    constants[[NAMES.index(name) for name in ("power_gain", "fan_density")]] = 0.0
    record = np.exp(
        CellModel(design, DesignPoint()).log_power(operation, np.tile([0.0, -0.1, 0.0, 0.0], (50, 1)), constants)
    )
    assert cell == pytest.approx(record, rel=1e-6)
    assert cell - 1.0 == pytest.approx(0.9**1.3 * (solve_cell(inputs, design).power - 1.0), rel=1e-9)


def test_a_twin_has_the_pressure_of_its_site() -> None:
    net = cell_network(1, "Z", DESIGN, 0.7, 0.1, (0.02, 0.1), Revision(), pressure_kPa=84.0)
    assert net.inputs["pressure_kPa"].nominal == 84.0
