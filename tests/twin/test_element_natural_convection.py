"""Natural convection against its power law, also where the difference changes sign."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.two_nodes import U, drivers, heat, network, worst_error
from twin.kernel import simulate

LOSS = '[elements.x]\nkind = "natural_convection"\nnode = "a"\ncoefficient = 2.0\n'


def test_power_law() -> None:
    assert heat(LOSS) == pytest.approx([-2.0 * 20.0**1.25, 0.0], rel=1e-6)
    assert heat(LOSS + "exponent = 1.3333\n") == pytest.approx([-2.0 * 20.0**1.3333, 0.0], rel=1e-6)


def test_exponent_one_is_the_linear_loss() -> None:
    linear = '[elements.x]\nkind = "ambient_loss"\nnode = "a"\nhA = 2.0\n'
    assert heat(LOSS + "exponent = 1.0\n") == pytest.approx(heat(linear))


@settings(deadline=None)
@given(difference=st.floats(-60.0, 60.0))
def test_odd_in_the_difference_and_close_to_the_law(difference: float) -> None:
    warm = heat(LOSS, (20.0 + difference, 20.0))[0]
    cold = heat(LOSS, (20.0 - difference, 20.0))[0]
    assert warm == pytest.approx(-cold, abs=1e-9)
    if abs(difference) > 0.2:
        assert abs(warm) == pytest.approx(2.0 * abs(difference) ** 1.25, rel=1e-3)
    else:
        assert abs(warm) <= 2.0 * 0.2**1.25 * 1.001


@pytest.mark.parametrize("exponent", [1.0, 1.25, 1.5])
def test_kernel_agrees_with_solve_ivp(exponent: float) -> None:
    assert worst_error(LOSS + f"exponent = {exponent}\n") < 5e-6


def test_crossing_the_room_temperature_is_smooth() -> None:
    cold = U.copy()
    cold[3] = 20.0
    assert heat(LOSS, (20.0, 20.0), cold) == pytest.approx([0.0, 0.0])
    assert worst_error(LOSS, start=(21.0, 19.0), n=60) < 1e-5


def test_no_coefficient_is_no_loss_and_the_strongest_is_finite() -> None:
    t, u = drivers(60)
    start = np.array([70.0, 25.0])
    none = simulate(network(LOSS.replace("2.0", "0.0")), t, u, start)
    assert np.abs(none - simulate(network(""), t, u, start)).max() < 1e-6
    strongest = simulate(network(LOSS.replace("2.0", "500.0") + "exponent = 1.5\n"), t, u, np.array([900.0, -200.0]))
    assert np.isfinite(strongest).all()
