"""Radiator by effectiveness: against NTU tables' formulas, its limits, and the kernel."""

import math

import numpy as np
import pytest

from tests.twin.two_nodes import U, heat, network, worst_error
from twin.network import TwinFileError

COMMON = '[elements.x]\nkind = "radiator"\nnode = "b"\nfan = "fan_speed_pct"\nUA_100 = 60.0\nfan_exponent = 0.6\n'
CORE = (
    COMMON
    + 'form = "effectiveness"\npump = "pump_speed_pct"\ninlet = "a"\nflow_100 = 4.0\nair_100 = 0.2\nair_0 = 0.01\n'
)


def effectiveness(ua: float, air: float, water: float) -> float:
    least, ratio = min(air, water), min(air, water) / max(air, water)
    ntu = ua / least
    return 1.0 - math.exp(ntu**0.22 / ratio * (math.exp(-ratio * ntu**0.78) - 1.0))


def test_cross_flow_effectiveness() -> None:
    air, water = (0.01 + 0.19 * 0.5) * 1007.0, 0.8 * 4.0 * 0.997 / 60.0 * 4180.0
    expected = effectiveness(60.0 * 0.5**0.6, air, water) * min(air, water) * 20.0
    assert heat(CORE) == pytest.approx([0.0, -expected], rel=1e-9)


def test_inlet_from_a_column_and_flow_in_its_own_unit() -> None:
    text = (
        COMMON + 'form = "effectiveness"\npump = "q_m3_h"\nsupply = "T_supply_C"\nflow_100 = 1.5\nair_100 = 0.2\n'
        "flow_exponent = 0.3\nUA_still = 2.0\n"
    )
    air, water = 0.1 * 1007.0, 0.9 * 0.997 / 3.6 * 4180.0
    ua = 60.0 * 0.5**0.6 * (0.9 / 1.5) ** 0.3
    expected = effectiveness(ua, air, water) * min(air, water) * 15.0 + 2.0 * 10.0
    assert heat(text) == pytest.approx([0.0, -expected], rel=1e-9)


def test_never_more_than_the_lesser_stream_can_carry() -> None:
    huge = heat(CORE.replace("UA_100 = 60.0", "UA_100 = 1e5"))[1]
    assert -huge == pytest.approx((0.01 + 0.095) * 1007.0 * 20.0, rel=1e-2)


def test_weak_core_is_the_plain_conductance() -> None:
    weak = heat(CORE.replace("UA_100 = 60.0", "UA_100 = 0.01"))[1]
    assert weak == pytest.approx(-0.01 * 0.5**0.6 * 20.0, rel=1e-2)


@pytest.mark.parametrize(("fan", "pump"), [(0.0, 80.0), (50.0, 0.0), (0.0, 0.0)])
def test_fan_or_pump_at_rest_leaves_natural_convection(fan: float, pump: float) -> None:
    u = U.copy()
    u[1], u[2] = pump, fan
    rest = heat(CORE.replace("air_0 = 0.01", "UA_still = 3.0"), inputs=u)[1]
    assert rest == pytest.approx(-3.0 * 10.0, abs=0.05)


def test_kernel_agrees_with_solve_ivp() -> None:
    assert worst_error(CORE) < 1e-6


def test_places_that_make_no_sense() -> None:
    with pytest.raises(TwinFileError, match="give either `inlet`"):
        network(CORE.replace('inlet = "a"\n', ""))
    with pytest.raises(TwinFileError, match="its own inlet"):
        network(CORE.replace('inlet = "a"', 'inlet = "b"'))
    with pytest.raises(TwinFileError, match="belong to the form"):
        network(COMMON + 'pump = "pump_speed_pct"\ninlet = "a"\n')
    with pytest.raises(TwinFileError, match="neither a speed nor a flow"):
        network(COMMON + 'pump = "T_supply_C"\n')


def test_default_form_is_the_conductance_at_the_outlet() -> None:
    assert heat(COMMON + 'pump = "pump_speed_pct"\n') == pytest.approx([0.0, -10.0 * 60.0 * 0.5**0.6])
    assert np.isfinite(heat(CORE)).all()
