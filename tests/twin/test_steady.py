"""Steady states against a long simulation, and networks that have none."""

import numpy as np
import pytest

from tests.twin.two_nodes import U, network
from twin.kernel import simulate
from twin.network import Network, TwinFileError
from twin.steady import steady_readings, steady_state

WARM = '[elements.s]\nkind = "heat_source"\nnode = "a"\ndriver = "heater_power_W"\n'
LOSS = '[elements.l]\nkind = "ambient_loss"\nnode = "b"\nhA = 8.0\n'
RADIATION = '[elements.r]\nkind = "radiation"\nnode = "b"\nambient = "T_ambient_C"\narea = 1.5\n'
VALVE = (
    '[elements.v]\nkind = "law_conductance"\nnode = "b"\nambient = "T_ambient_C"\nof = "b"\nform = "dead_band"\n'
    "gain = 100.0\nreference = 0.0\nwidth = 40.0\n"
)
"""Cooling by water through a valve that opens from 40 degC on, which takes no more than 100 kW."""


@pytest.mark.parametrize("extra", [WARM + LOSS, WARM + RADIATION, WARM + LOSS + RADIATION, WARM + LOSS + VALVE])
def test_long_simulation_ends_there(extra: str) -> None:
    net = network(extra)
    rest = simulate(net, [0.0, 2.0e5], np.vstack([U, U]), np.array([20.0, 20.0]))[-1]
    assert steady_state(net, U) == pytest.approx(rest, abs=1e-5)


def test_heat_in_is_heat_out() -> None:
    assert steady_state(network(WARM + LOSS), U) == pytest.approx([20.0 + 500.0 / 8.0 + 250.0, 20.0 + 500.0 / 8.0])


def test_many_rows_and_the_loop(loop: Network) -> None:
    u = np.array([[700.0, 100.0, 70.0, 22.0], [900.0, 70.0, 40.0, 25.0]])
    readings = steady_readings(loop, u)
    assert readings.shape == (2, 4)
    for row, state in zip(u, readings, strict=True):
        rest = simulate(loop, [0.0, 1.0e6], np.vstack([row, row]), np.full(4, 30.0))[-1]
        assert state == pytest.approx(rest, abs=1e-5)


def test_heat_without_a_way_out_is_told() -> None:
    with pytest.raises(TwinFileError, match="no way out"):
        steady_state(network(WARM), U)
