"""Radiator by effectiveness: against NTU tables' formulas, its limits, and the kernel."""

import math

import numpy as np
import pytest

from tests.twin.two_nodes import U, heat, network, worst_error
from twin.network import TwinFileError

COMMON = (
    '[elements.x]\nkind = "radiator"\nnode = "b"\nfan = "fan_speed_pct"\nUA_100 = 60.0\nfan_exponent = 0.6\n'
    'pump = "pump_speed_pct"\n'
)
CORE = (
    '[elements.w]\nkind = "flow"\npath = ["a", "b"]\ninlet = "T_supply_C"\npump = "pump_speed_pct"\nnominal = 4.0\n'
    + COMMON
    + 'form = "effectiveness"\nair_100 = 0.2\nair_0 = 0.01\n'
)
WATER = 0.8 * 4.0 * 0.997 / 60.0 * 4180.0
AIR = (0.01 + 0.19 * 0.5) * 1007.0


def rejected(text: str, inputs: np.ndarray = U) -> float:
    """Heat that the core alone takes from b, W; the water arrives at 40 degC."""
    none = text.replace("UA_100 = 60.0", "UA_100 = 1e-9").replace("UA_100 = 1e5", "UA_100 = 1e-9")
    none = none.replace("UA_100 = 0.01", "UA_100 = 1e-9").replace("UA_still = 3.0\n", "")
    return float((heat(none, inputs=inputs) - heat(text, inputs=inputs))[1])


def effectiveness(ua: float, air: float, water: float) -> float:
    least, ratio = min(air, water), min(air, water) / max(air, water)
    ntu = ua / least
    return 1.0 - math.exp(ntu**0.22 / ratio * (math.exp(-ratio * ntu**0.78) - 1.0))


def test_cross_flow_effectiveness() -> None:
    ua = 60.0 * (AIR / (0.2 * 1007.0)) ** 0.6
    assert rejected(CORE) == pytest.approx(effectiveness(ua, AIR, WATER) * min(AIR, WATER) * 20.0, rel=1e-6)
    strong = CORE + "flow_exponent = 0.3\n"
    ua *= 0.8**0.3
    assert rejected(strong) == pytest.approx(effectiveness(ua, AIR, WATER) * min(AIR, WATER) * 20.0, rel=1e-6)


def test_inlet_behind_a_partial_exchange() -> None:
    partial = CORE.replace("nominal = 4.0", "nominal = 4.0\neffectiveness_b = { value = 0.5 }")
    assert rejected(partial) == pytest.approx(rejected(CORE), rel=1e-6)


def test_never_more_than_the_lesser_stream_can_carry() -> None:
    assert rejected(CORE.replace("UA_100 = 60.0", "UA_100 = 1e5")) == pytest.approx(AIR * 20.0, rel=1e-2)


def test_weak_core_is_the_plain_conductance() -> None:
    weak = rejected(CORE.replace("UA_100 = 60.0", "UA_100 = 0.01"))
    assert weak == pytest.approx(0.01 * (AIR / (0.2 * 1007.0)) ** 0.6 * 20.0, rel=1e-2)


@pytest.mark.parametrize(("fan", "pump"), [(0.0, 80.0), (50.0, 0.0), (0.0, 0.0)])
def test_fan_or_pump_at_rest_leaves_natural_convection(fan: float, pump: float) -> None:
    u = U.copy()
    u[1], u[2] = pump, fan
    rest = rejected(CORE.replace("air_0 = 0.01", "UA_still = 3.0"), inputs=u)
    assert rest == pytest.approx(3.0 * 10.0, abs=0.5)


def test_kernel_agrees_with_solve_ivp() -> None:
    assert worst_error(CORE) < 1e-5


@pytest.mark.parametrize("form", ["effectiveness", "one_row"])
def test_a_core_needs_water(form: str) -> None:
    with pytest.raises(TwinFileError, match="needs water, but no flow path names 'b'"):
        network(COMMON + f'form = "{form}"\nair_100 = 0.2\n')
    film = CORE.replace("nominal = 4.0", 'nominal = 4.0\nfilm = ["b"]\neffectiveness_b = 0.3')
    with pytest.raises(TwinFileError, match="film of its own"):
        network(film.replace('effectiveness"', f'{form}"'))


@pytest.mark.parametrize("nominal", [1.0, 4.0])
def test_one_row_is_cross_flow_with_mixed_water(nominal: float) -> None:
    """Incropera eqs. 11.33a (the unmixed stream, air, is the lesser) and 11.34a (the mixed one, water, is)."""
    core = CORE.replace("nominal = 4.0", f"nominal = {nominal}").replace('"effectiveness"', '"one_row"')
    water = WATER * nominal / 4.0
    ua = 60.0 * (AIR / (0.2 * 1007.0)) ** 0.6
    least, ratio = min(AIR, water), min(AIR, water) / max(AIR, water)
    ntu = ua / least
    if water > AIR:
        share = (1.0 - math.exp(-ratio * (1.0 - math.exp(-ntu)))) / ratio
    else:
        share = 1.0 - math.exp(-(1.0 - math.exp(-ratio * ntu)) / ratio)
    assert rejected(core) == pytest.approx(share * least * 20.0, rel=1e-6)


def test_one_row_in_the_kernel() -> None:
    assert worst_error(CORE.replace('"effectiveness"', '"one_row"')) < 1e-5


def test_default_form_is_the_conductance_at_the_outlet() -> None:
    assert heat(COMMON) == pytest.approx([0.0, -10.0 * 60.0 * 0.5**0.6])
