"""Cells of the virtual station: balances, fan against resistance, degradation, and the gap to a Merkel twin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from drivers.virtual.tower.physics import cell as physics
from drivers.virtual.tower.physics.moist_air import CP_WATER, enthalpy, saturation, wet_bulb
from drivers.virtual.tower.sites import CHICAGO_SITE, MIAMI_SITE, BuiltStation, EnteringAir, build, design_air
from twin.tower import air as other_air
from twin.tower.cell import Design, Inputs, solve_cell


@pytest.fixture(scope="module")
def built() -> BuiltStation:
    """Return the Chicago station of one seed."""
    return build(CHICAGO_SITE, np.random.default_rng(5))


def at_design(built: BuiltStation, state: list[float], speed: float = 1.0, wind: float = 0.0) -> physics.Leaving:
    """Return what leaves the first cell at design conditions."""
    site = built.site
    dry, ratio = design_air(site)
    air = EnteringAir(dry, ratio, site.pressure, wind)
    return built.steady(0, np.array(state), site.water, speed, site.hot, air)


CLEAN = [1.0, 1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("site", [CHICAGO_SITE, MIAMI_SITE], ids=["A", "B"])
def test_a_cell_as_built_cools_its_design_water_about_as_its_datasheet_says(site) -> None:  # type: ignore[no-untyped-def]
    built = build(site, np.random.default_rng(1))
    t_out, _, m_a, *_ = at_design(built, CLEAN)
    assert t_out == pytest.approx(site.cold, abs=1.0)
    assert m_a == pytest.approx(site.air, rel=0.08)


@pytest.mark.parametrize("speed", [1.0, 0.5, 0.0])
def test_a_cell_closes_its_balances_of_water_and_heat(built: BuiltStation, speed: float) -> None:
    site = built.site
    dry, ratio = design_air(site)
    t_out, m_out, m_a, t_exit, w_exit, _, lost = at_design(built, CLEAN, speed)
    assert site.water - m_out == pytest.approx(lost)
    assert m_a * (w_exit - ratio) == pytest.approx(lost, rel=2e-3)
    ps = saturation(t_exit)
    ws = min(0.62198 * ps / (site.pressure - ps), w_exit)
    exit_enthalpy = enthalpy(t_exit, ws) + (w_exit - ws) * CP_WATER * t_exit
    given = CP_WATER * (site.water * site.hot - m_out * t_out)
    assert m_a * (exit_enthalpy - enthalpy(dry, ratio)) == pytest.approx(given, rel=3e-3)


def test_each_degradation_warms_the_outlet_as_such_towers_do(built: BuiltStation) -> None:
    clean = at_design(built, CLEAN)[0]
    rise = {
        "fill": at_design(built, [0.85, 1.0, 0.0, 0.0, 0.0])[0] - clean,
        "uniformity": at_design(built, [1.0, 0.93, 0.0, 0.0, 0.0])[0] - clean,
        "slip": at_design(built, [1.0, 1.0, 0.1, 0.0, 0.0])[0] - clean,
        "blockage": at_design(built, [1.0, 1.0, 0.0, 0.0, 0.2])[0] - clean,
    }
    assert all(0.1 < value < 0.9 for value in rise.values()), rise


def test_a_slipping_belt_takes_power_and_a_blocked_eliminator_does_not(built: BuiltStation) -> None:
    power = at_design(built, CLEAN)[5]
    assert at_design(built, [1.0, 1.0, 0.1, 0.0, 0.0])[5] < 0.8 * power
    assert at_design(built, [1.0, 1.0, 0.0, 0.0, 0.2])[5] > 0.97 * power


def test_air_follows_wind_speed_and_draft(built: BuiltStation) -> None:
    still, windy = at_design(built, CLEAN)[2], at_design(built, CLEAN, wind=8.0)[2]
    assert 0.9 * still < windy < still
    flows = [at_design(built, CLEAN, speed)[2] for speed in (0.0, 0.3, 0.6, 1.0)]
    assert flows == sorted(flows)
    assert 0.01 * still < flows[0] < 0.2 * still


def test_multipliers_of_the_truth_are_those_of_the_physics(built: BuiltStation) -> None:
    state = np.array([1.0, 0.95, 0.02, 0.05, 0.1])
    assert built.air_multiplier(0, state) == pytest.approx(
        at_design(built, list(state))[2] / at_design(built, CLEAN)[2], rel=0.02
    )
    assert built.uniformity(0, state) == pytest.approx(0.95, abs=0.01)


def test_moist_air_agrees_with_that_of_the_twin_to_a_thousandth() -> None:
    temperatures = np.linspace(0.0, 45.0, 40)
    own = np.array([saturation(t) for t in temperatures])
    assert np.abs(own / other_air.saturation_pressure(temperatures) - 1.0).max() < 1e-3
    for dry, humidity in ((35.0, 0.3), (25.0, 0.8), (5.0, 0.6)):
        ratio = float(other_air.humidity_ratio(humidity * other_air.saturation_pressure(dry), 100.0))
        assert wet_bulb(dry, ratio, 100.0) == pytest.approx(float(other_air.wet_bulb(dry, humidity, 100.0)), abs=0.1)


def test_a_fitted_merkel_twin_keeps_a_gap_to_the_plant(built: BuiltStation) -> None:
    rng = np.random.default_rng(0)
    site, n = built.site, 160
    t_in, m_w, speed = rng.uniform(24.0, 40.0, n), site.water * rng.uniform(0.7, 1.1, n), rng.uniform(0.3, 1.0, n)
    dry = rng.uniform(2.0, 32.0, n)
    humidity = rng.uniform(0.4, 0.95, n)
    ratio = other_air.humidity_ratio(humidity * other_air.saturation_pressure(dry), site.pressure)
    wet = other_air.wet_bulb(dry, humidity, site.pressure)
    rows = np.flatnonzero(t_in > wet + 4.0)
    clean, p = np.array(CLEAN), site.pressure
    air = [EnteringAir(dry[k], ratio[k], p, 2.0) for k in range(n)]
    out = np.array([built.steady(0, clean, m_w[k], speed[k], t_in[k], air[k])[0] for k in rows])
    u = Inputs(t_in, m_w, speed, dry, wet, np.full(n, site.pressure)).take(rows)

    def miss(p: np.ndarray) -> np.ndarray:
        design = Design(site.water, site.air * p[2], p[0], p[1], site.power, 1.1)
        return np.asarray(solve_cell(u, design).t_out - out)

    fitted = least_squares(miss, [1.5, 0.6, 1.0])
    assert 0.08 < np.abs(fitted.fun).mean() < 0.6
