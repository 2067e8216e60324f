"""The tower against Merkel's equations written out by hand, and its limits."""

from pathlib import Path

import numpy as np
import pytest

from twin.kernel import simulate
from twin.network import TwinFileError
from twin.reference_simulation import right_hand_side
from twin.steady import steady_readings
from twin.twinfile import load, parse, read_text

FILE = Path(__file__).resolve().parents[2] / "profiles" / "twins" / "wet_tower_constant.toml"
COLUMNS = ("T_in_C", "T_ambient_C", "humidity_pct", "fan_speed_pct", "flow_pct")
U = np.array([38.0, 25.0, 40.0, 60.0, 50.0])


def steam(t: float) -> float:
    return 611.2 * np.exp(17.62 * t / (243.12 + t))


def enthalpy(t: float, pressure: float, humidity: float = 1.0) -> float:
    """J/kg of dry air, at a pressure in Pa."""
    p = humidity * steam(t)
    w = 0.622 * p / (pressure - p)
    return 1006.0 * t + w * (2.501e6 + 1860.0 * t)


def test_heat_is_that_of_merkels_effectiveness() -> None:
    net = load(FILE)
    assert net.input_columns == COLUMNS
    here, pressure = 30.0, 95400.0
    air, water = -0.7251 + 0.6 * (8.715 - 3.5 * 0.6), 400.0 / 60.0 * 0.5 * 0.997
    mid = 0.5 * (38.0 + here)
    slope = (enthalpy(mid + 0.01, pressure) - enthalpy(mid - 0.01, pressure)) / 0.02
    m = air * slope / (water * 4180.0)
    ntu = 1.0 * water / air
    decay = np.exp(-ntu * (1.0 - m))
    eps = (1.0 - decay) / (1.0 - m * decay)
    heat = eps * air * (enthalpy(38.0, pressure) - enthalpy(25.0, pressure, 0.4))
    expected = (water * 4180.0 * (38.0 - here) - heat) / 1.0e6
    assert right_hand_side(net)(np.array([here]), U, net.values)[0] == pytest.approx(expected, rel=1e-6)


def test_merkels_law_of_the_fill_is_two_exponents() -> None:
    net = load(FILE)
    law = net.with_values({"fill.flow_exponent": -0.6, "fill.fan_exponent": 0.6})
    air = (-0.7251 + 0.6 * (8.715 - 3.5 * 0.6)) / (-0.7251 + 8.715 - 3.5)
    same = net.with_values({"fill.Me_100": float((air / 0.5) ** 0.6)})
    assert steady_readings(law, U[None, :]) == pytest.approx(steady_readings(same, U[None, :]), abs=1e-9)


def test_water_leaves_between_the_wet_bulb_and_the_inlet_and_colder_with_more_air() -> None:
    net = load(FILE).with_values({"fill.Me_100": 2.0})
    rows = np.tile(U, (4, 1))
    rows[:, 3] = [0.0, 20.0, 60.0, 100.0]
    out = steady_readings(net, rows)[:, 0]
    assert (np.diff(out) < 0.0).all() and out[0] == pytest.approx(38.0, abs=0.1)
    # The wet bulb of 25 degC at 40 % is 16.0 degC.
    assert out[-1] > 16.0
    run = simulate(net, np.arange(0.0, 20000.0, 10.0), np.tile(rows[2], (2000, 1)), np.array([38.0]))
    assert run[-1, 0] == pytest.approx(out[2], abs=1e-3)


@pytest.mark.parametrize(
    "row", [(0.0, -20.0, 0.0, 0.0, 0.0), (80.0, 50.0, 100.0, 100.0, 150.0), (5.0, 40.0, 90.0, 1.0, 150.0)]
)
def test_it_stays_finite_where_nobody_runs_a_tower(row: tuple[float, ...]) -> None:
    net = load(FILE).with_values({"fill.Me_100": 10.0, "fill.flow_exponent": -2.0, "fill.fan_exponent": -2.0})
    run = simulate(net, np.arange(0.0, 3000.0, 10.0), np.tile(row, (300, 1)), np.array([30.0]))
    assert np.isfinite(run).all()


def test_a_fan_that_blows_no_air_is_refused() -> None:
    text = read_text(FILE).replace("value = 8.715", "value = 1.0")
    with pytest.raises(TwinFileError, match="air flow at full fan speed"):
        parse(text)
