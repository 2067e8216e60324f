"""Evaporation: saturation pressure against tables, the rate, condensation, and the kernel."""

import math

import numpy as np
import pytest

from tests.twin.two_nodes import U, drivers, heat, network, worst_error
from twin.elements.evaporation import saturation_pressure
from twin.kernel import simulate

POOL = '[elements.x]\nkind = "evaporation"\nnode = "a"\narea = 0.5\n'


def pressure(celsius: float) -> float:
    return float(eval(saturation_pressure(repr(celsius)), {"exp": math.exp}))


@pytest.mark.parametrize(
    ("celsius", "pascal"),
    # IAPWS-95 saturation line
    [(0.01, 611.66), (20.0, 2339.3), (40.0, 7384.9), (60.0, 19946.0), (80.0, 47414.0), (99.974, 101325.0)],
)
def test_saturation_pressure(celsius: float, pascal: float) -> None:
    assert pressure(celsius) == pytest.approx(pascal, rel=1.5e-3)


def test_rate_with_fixed_and_measured_humidity() -> None:
    expected = 0.089 * 0.5 * (pressure(40.0) - 0.4 * pressure(20.0))
    assert heat(POOL + "relative_humidity = 40.0\n") == pytest.approx([-expected, 0.0])
    assert heat(POOL + 'humidity = "humidity_pct"\n') == pytest.approx([-expected, 0.0])


def test_a_warm_pool_loses_what_the_handbook_says() -> None:
    # 30 degC water, 30 degC air of 50 %: 189 W/m2, i.e. 0.28 kg/(m2 h) of water at 2430 kJ/kg
    u = U.copy()
    u[3] = 30.0
    per_area = -heat(POOL + "relative_humidity = 50.0\n", (30.0, 30.0), u)[0] / 0.5
    assert per_area / 2.43e6 * 3600.0 == pytest.approx(0.28, abs=0.01)


def test_cold_surface_condenses() -> None:
    humid = U.copy()
    humid[3], humid[5] = 30.0, 90.0
    assert heat(POOL + 'humidity = "humidity_pct"\n', (10.0, 30.0), humid)[0] > 0.0


@pytest.mark.parametrize("extra", ["", 'humidity = "humidity_pct"\n'])
def test_kernel_agrees_with_solve_ivp(extra: str) -> None:
    assert worst_error(POOL + extra) < 1e-6


def test_no_area_is_no_evaporation_and_extremes_stay_finite() -> None:
    t, u = drivers(60)
    start = np.array([70.0, 25.0])
    none = simulate(network(POOL.replace("0.5", "0.0")), t, u, start)
    assert np.abs(none - simulate(network(""), t, u, start)).max() < 1e-6
    strong = network(POOL.replace("0.5", "10.0") + "coefficient = 1.0\n")
    assert np.isfinite(simulate(strong, t, u, np.array([900.0, -100.0]))).all()
