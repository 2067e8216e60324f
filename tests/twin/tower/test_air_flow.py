"""Air flow of a cell: pressures that add, the fan in the exhaust, a fan at rest, and wind that stalls the draft."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from twin.tower import air as moist
from twin.tower.air_flow import CALM, effective_speed, exhaust_density, exhaust_density_at
from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell
from twin.tower.model import FORCED, GLOBALS, INDUCED, NAMES, CellModel, DesignPoint, Operation

DESIGN = Design(250.0, 205.0, 1.5, 0.57, 45.0, 1.13)
SITE = DesignPoint()
KPA = 98.9
MEAN = {one.name: one.mean for one in GLOBALS}


def _inputs(t_in: float, wet: float, speed: float, m_w: float = 250.0, dry: float = 4.0) -> Inputs:
    return Inputs(*(np.array([v]) for v in (t_in, m_w, speed, wet + dry, wet, KPA)))


AT_DESIGN = exhaust_density_at(DESIGN, SITE.inlet, SITE.wet)


@pytest.mark.parametrize(("t_in", "wet", "speed"), [(36.0, 25.0, 1.0), (30.0, 12.0, 0.6), (24.0, -8.0, 0.3)])
def test_the_exhaust_is_as_light_as_the_heat_that_it_takes_up_makes_it(t_in: float, wet: float, speed: float) -> None:
    u = _inputs(t_in, wet, speed)
    found = solve_cell(u, DESIGN, CellDeviations())
    ratio = moist.ratio_from_wet_bulb(u.dry, u.wet, u.pressure)
    h = float((moist.enthalpy(u.dry, ratio) + found.heat / found.m_a)[0])
    t = brentq(lambda t: float(moist.saturated_enthalpy(t, KPA)) - h, wet, t_in)
    outside = float(moist.density(u.dry, ratio, u.pressure)[0])
    wanted = float(moist.density(t, moist.saturated_ratio(t, KPA), KPA)) / outside
    assert float(exhaust_density(DESIGN, u, 0.0)[0]) == pytest.approx(wanted, abs=0.007)


def _mass_flow(speed: float, before: float, after: float, exhaust: bool) -> float:
    """Air flow at which the fan's pressure is that of the resistance, with densities before the fill and after it."""
    at_fan = after if exhaust else before
    middle = float(np.sqrt(before * after))

    def missing(m: float) -> float:
        volume = m / at_fan
        fan = at_fan * (1.7 * speed**2 - 0.2 * speed * volume - 0.5 * volume**2)
        return fan - m**2 / middle

    return float(brentq(missing, 1e-3, 5.0))


@pytest.mark.parametrize(("exhaust", "prior"), [(True, INDUCED), (False, FORCED)])
def test_a_fan_moves_a_volume_where_it_stands(exhaust: bool, prior: tuple[float, float]) -> None:
    warm, cold = (1.13, 1.10), (1.32, 1.19)
    ratio = _mass_flow(0.5, *cold, exhaust) / _mass_flow(0.5, *warm, exhaust)
    lighter = (cold[1] / cold[0]) / (warm[1] / warm[0])
    power = np.log(ratio / (cold[0] / warm[0])) / np.log(lighter)
    assert abs(power - prior[0]) < prior[1]


def test_the_pressures_of_fan_buoyancy_and_wind_add() -> None:
    q = MEAN | {"draft": 0.2, "wind_air": -0.01}
    speed, lighter = np.array([0.3, 0.5, 1.0]), np.array([0.9, 0.93, 0.96])
    found = effective_speed(speed, lighter, np.full(3, 6.0), q, AT_DESIGN)
    design = 1.0 + 0.04 * (1.0 - AT_DESIGN) / 0.05 - 0.02 * (CALM / 5.0) ** 2
    wanted = speed**2 + 0.04 * (1.0 - lighter) / 0.05 - 0.02 * 1.2**2
    assert found**2 * design == pytest.approx(wanted)
    at_design = effective_speed(np.ones(1), np.array([AT_DESIGN]), np.array([CALM]), q, AT_DESIGN)
    assert at_design == pytest.approx(np.ones(1))


def test_wind_stalls_the_draft_of_a_fan_at_rest_and_hardly_slows_one_that_turns() -> None:
    q = MEAN | {"wind_air": -0.02}
    wind = np.array([0.0, 3.0, 12.0])
    rest = effective_speed(np.zeros(3), np.full(3, 0.9), wind, q, AT_DESIGN)
    assert rest[0] > rest[1] > rest[2] == pytest.approx(q["stalled"])
    turning = effective_speed(np.ones(3), np.full(3, 0.9), wind, q, AT_DESIGN)
    assert turning[2] / turning[0] > 0.85


def test_a_fan_at_rest_takes_its_share_of_the_draft() -> None:
    q = MEAN | {"stalled": 0.0}
    rest, turning = effective_speed(np.array([0.0, 0.1]), np.full(2, 0.9), np.zeros(2), q, AT_DESIGN)
    assert rest == pytest.approx(q["rest"] * np.sqrt(turning**2 - 0.01 * turning**2 / (0.01 + 2 * 0.16**2)), rel=0.02)


def test_the_air_flow_at_design_is_the_commissioned_one() -> None:
    u = _inputs(SITE.inlet, SITE.wet, 1.0)
    o = Operation(u, np.zeros(1), np.full(1, CALM), np.zeros(1), np.ones(1))
    g = np.array([MEAN[name] for name in NAMES])
    g[[NAMES.index("recirculation"), NAMES.index("starving")]] = 0.0, 1.5
    clean = solve_cell(u, DESIGN, CellDeviations()).t_out
    model = CellModel(DESIGN, SITE).outlet(o, np.zeros((1, 5)), g)
    # Half the design range is `range_1`, whose mean is 0, so only the air could differ.
    assert model == pytest.approx(clean, abs=0.01)
