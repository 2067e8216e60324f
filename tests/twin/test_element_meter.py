"""Meters: equal to the element's own quantity in every kernel, and weighed in a fit as a thermometer is."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.conftest import drive
from tests.twin.two_nodes import TWO, U, drivers
from twin.calibrators import make_calibrator
from twin.commissioning import CommissionOptions, commission
from twin.kernel import Kernel, mask_measurements, simulate
from twin.network import Network, Revision, TwinFileError
from twin.reference_simulation import simulate_fine_steps
from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell
from twin.tower.twin_file import cell_network
from twin.tracking import TwinTracker
from twin.twinfile import dump, from_tables, parse, to_tables

DESIGN = Design(250.0, 205.0, 1.5, 0.7, 40.0, 1.15, kappa=-0.9, evaporation=1.05, idle=1.0)
HEATED = """
[elements.heater]
kind = "heat_source"
node = "a"
driver = "heater_power_W"
factor = { value = 0.8, status = "tunable" }
[elements.loss]
kind = "ambient_loss"
node = "b"
hA = { value = 8.0, lower = 1.0, upper = 50.0, status = "tunable" }
"""
METER = """
[elements.heater_meter]
kind = "meter"
of = "heater"
quantity = "heat"
columns = ["heater_meter_kW"]
sigma = 0.005
"""


def with_meters(net: Network, **of: tuple[str, str, str, dict[str, float]]) -> Network:
    """Return the network with meters: name -> (element, quantity, column, parameters)."""
    tables = to_tables(net)
    for name, (element, quantity, column, values) in of.items():
        tables["elements"][name] = {
            "kind": "meter",
            "of": element,
            "quantity": quantity,
            "columns": [column],
            "sigma": 1.0,
            **values,
        }
    return from_tables(tables, "made")


def test_a_tower_cells_meters_read_what_the_cells_own_equations_give() -> None:
    clean = cell_network(1, "Z", DESIGN, 0.7, 0.1, (0.02, 0.1), Revision())
    net = with_meters(
        clean.with_values({"cell.fill": 0.86, "cell.air": 0.93, "cell.uniformity": 0.95}),
        makeup=("cell", "evaporation", "makeup_kg_s", {}),
        fan=("cell", "fan_power", "fan_W", {}),
        rejected=("cell", "heat_rejected", "rejected_kW", {}),
    )
    rng, n = np.random.default_rng(3), 300
    dry = rng.uniform(-5.0, 38.0, n)
    wet = dry - rng.uniform(0.1, 5.0, n)
    inlet = np.maximum(wet, 3.0) + rng.uniform(3.0, 25.0, n)
    u = np.stack(
        [inlet, rng.uniform(100, 300, n), rng.uniform(0, 100, n), dry, wet, rng.uniform(80, 102, n), np.zeros(n)],
        axis=1,
    )
    read = dict(zip(net.sensor_names, simulate(net, 60.0 * np.arange(n), u, np.array([20.0])).T, strict=True))
    own = solve_cell(
        Inputs(u[:, 0], u[:, 1], u[:, 2] / 100.0, u[:, 3], u[:, 4], u[:, 5]), DESIGN, CellDeviations(0.86, 0.93, 0.95)
    )
    assert read["makeup"] == pytest.approx(own.evaporation, rel=1e-6, abs=1e-9)
    assert read["fan"] == pytest.approx(1000.0 * own.power, rel=1e-9)
    assert read["rejected"] == pytest.approx(own.heat / 1000.0, rel=1e-6)


def test_a_meter_reads_its_own_sample_and_not_the_interval_before() -> None:
    net = parse(TWO + HEATED + METER)
    t, u = drivers(40)
    read = simulate(net, t, u, np.array([40.0, 30.0]))[:, net.sensor_names.index("heater_meter")]
    assert read == pytest.approx(0.8 * u[:, 0] / 1000.0, rel=1e-12)


def test_all_kernels_and_the_reference_agree_with_a_pump_a_lag_and_gain_and_bias() -> None:
    text = TWO + HEATED + METER.replace("sigma = 0.005", "sigma = 0.005\ngain = 1.1\nbias = 0.02")
    net = parse(text.replace("lag_s = 0", "lag_s = 5"))
    t, u = drivers(60)
    start = np.array([40.0, 30.0])
    one = simulate(net, t, u, start)
    assert one == pytest.approx(simulate_fine_steps(net, t, u, start), abs=1e-3)
    kernel = Kernel(net, net.tunables())
    swarm = np.tile(net.values, (40, 1))
    swarm[:, net.index(["heater.factor"])[0]] = np.linspace(0.5, 1.5, 40)
    several, _ = kernel.trace(swarm, start, t, u)
    j = net.sensor_names.index("heater_meter")
    expected = 1.1 * np.linspace(0.5, 1.5, 40)[:, None] * u[:, 0] / 1000.0 + 0.02
    assert several[:, :, j] == pytest.approx(expected, rel=1e-9)
    y, weight = mask_measurements(one, net.sigma)
    sse, _ = kernel.cost(swarm, start, t, u, y, weight)
    assert sse[:, j] == pytest.approx((((several[:, :, j] - one[:, j]) / 0.005) ** 2).sum(axis=1), rel=1e-6)


def test_a_meter_follows_the_actuator_that_delivers_late() -> None:
    late = '[elements.supply]\nkind = "actuator"\ncolumn = "heater_power_W"\nlag_s = 30.0\ngain = 0.9\n'
    net = parse(TWO + HEATED + METER + late)
    t = np.arange(0.0, 200.0, 1.0)
    u = np.tile(U, (t.size, 1))
    u[:, 0] = np.where(t < 50.0, 0.0, 800.0)
    read = simulate(net, t, u, np.array([40.0, 30.0]))[:, net.sensor_names.index("heater_meter")]
    expected = 0.8 * 0.9 * 0.8 * (1.0 - np.exp(-np.maximum(t - 50.0, 0.0) / 30.0))
    assert read == pytest.approx(expected, abs=1e-6)
    dead = parse(TWO + HEATED + METER + late.replace("lag_s = 30.0", "dead_time_s = 30.0"))
    read = simulate(dead, t, u, np.array([40.0, 30.0]))[:, dead.sensor_names.index("heater_meter")]
    assert read == pytest.approx(np.where(t < 80.0, 0.0, 0.8 * 0.9 * 0.8), abs=1e-9)


def heated_record(net: Network, n: int = 3000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    t = np.arange(n, dtype=float)
    u = np.tile(U, (n, 1))
    u[:, 0] = np.repeat(rng.uniform(100.0, 900.0, n // 300), 300)
    clean = simulate(net, t, u, np.array([40.0, 30.0]))
    return t, u, clean + net.sigma * rng.standard_normal(clean.shape)


@pytest.fixture(scope="module")
def plant() -> Network:
    return parse(TWO + HEATED + METER).with_values({"heater.factor": 0.7, "loss.hA": 9.5})


FREE = ("heater.factor", "loss.hA", "a.capacitance", "b.capacitance", "link.resistance")


def test_a_fit_learns_from_the_meter_what_temperatures_only_know_as_a_ratio(plant: Network) -> None:
    t, u, y = heated_record(plant)
    guess = parse(TWO + HEATED + METER)
    options = CommissionOptions(tunables=FREE, starts=1)
    fitted = commission(guess, t, u, y, options)
    assert fitted.values["heater.factor"] == pytest.approx(0.7, abs=0.005)
    assert fitted.values["loss.hA"] == pytest.approx(9.5, rel=0.02)
    blind = y.copy()
    blind[:, guess.sensor_names.index("heater_meter")] = np.nan
    without = commission(guess, t, u, blind, options)
    assert without.standard_error["heater.factor"] > 20.0 * fitted.standard_error["heater.factor"]


@pytest.mark.parametrize("calibrator", ["least_squares", "kalman", "pso"])
def test_tracking_weighs_the_meter_and_states_its_errors_in_its_own_unit(plant: Network, calibrator: str) -> None:
    t, u, y = heated_record(plant)
    guess = parse(TWO + HEATED + METER)
    tracker = TwinTracker(guess, make_calibrator(calibrator, guess, ("heater.factor", "loss.hA")))
    update = tracker.push(t, u, y)
    assert tracker.values["heater.factor"] == pytest.approx(0.7, abs=0.02)
    first, last = update.calibrations[0], update.calibrations[-1]
    assert first.kind != "calibrated" and last.error_K < 0.1
    assert last.rmse["heater_meter"] == pytest.approx(0.005, rel=0.4)


def test_a_twin_with_a_meter_survives_its_file(plant: Network) -> None:
    again = parse(dump(plant))
    assert again.elements == plant.elements and again.parameters == plant.parameters
    assert again.meters[0].unit == "kW" and list(again.kelvin_per_unit) == [1.0, 1.0, 10.0]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (('of = "heater"', 'of = "heeter"'), "heater_meter: of 'heeter' is no element of kind heat_source or"),
        (('"heat"', '"mass_flow"'), "heater_meter.quantity: heater has no mass_flow; it has heat"),
        (("_meter_kW", "_meter_kg_s"), "is in kg/s and the heat of heater in W; read a column of that unit"),
        (("_meter_kW", "_meter_degF"), "has no unit that a meter reads: end its name in _kg_s, _kW, _W, _pct"),
        (("sigma = 0.005", ""), "sigma is missing; give a value in kW"),
        (('"heater_meter_kW"', '"heater_meter_kW", "other_W"'), "'other_W' has no unit that a meter reads"),
        (('"heater_meter_kW"', '"T_a_C"'), "has no unit that a meter reads"),
    ],
)
def test_a_meter_that_cannot_be_is_refused_with_its_remedy(change: tuple[str, str], sentence: str) -> None:
    text = METER.replace(*change)
    assert text != METER
    with pytest.raises(TwinFileError) as caught:
        parse(TWO + HEATED + text)
    assert sentence in str(caught.value) and "line" in str(caught.value)


def test_the_network_calibrator_refuses_a_twin_with_a_meter(loop_text: str) -> None:
    net = parse(loop_text + METER.replace('of = "heater"', 'of = "heater_power"'))
    assert np.isfinite(simulate(net, *drive(100), np.array([37.0, 36.8, 34.5, 34.0]))).all()
    with pytest.raises(TwinFileError, match=r"takes thermometers only, and twin .* has the meter 'heater_meter'"):
        make_calibrator("hiera_unet", net)
