"""An open stream: what it brings less what it takes away is what the nodes gain."""

import numpy as np
import pytest

from tests.twin.two_nodes import U, drivers, heat, network, worst_error
from twin.kernel import simulate
from twin.network import TwinFileError

OPEN = '[elements.x]\nkind = "stream"\npath = ["a", "b"]\npump = "{}"\nsupply = "T_supply_C"\n'


def test_each_node_gets_the_difference_to_the_one_before() -> None:
    mcp = 0.9 * 0.997 / 3.6 * 4180.0
    assert heat(OPEN.format("q_m3_h")) == pytest.approx([mcp * (35.0 - 40.0), mcp * (40.0 - 30.0)])
    assert heat(OPEN.format("q_m3_h")).sum() == pytest.approx(mcp * (35.0 - 30.0))


def test_speed_scales_the_nominal_flow() -> None:
    mcp = 0.8 * 6.0 * 0.997 / 60.0 * 4180.0 * 1.1
    text = OPEN.format("pump_speed_pct") + "nominal = 6.0\nfactor = 1.1\n"
    assert heat(text) == pytest.approx([mcp * (35.0 - 40.0), mcp * (40.0 - 30.0)])


def test_kernel_agrees_with_solve_ivp() -> None:
    assert worst_error(OPEN.format("q_m3_h")) < 1e-5


def test_water_at_rest_brings_nothing() -> None:
    u = U.copy()
    u[7] = 0.0
    assert heat(OPEN.format("q_m3_h"), inputs=u) == pytest.approx([0.0, 0.0])
    t, rows = drivers(40)
    assert np.isfinite(
        simulate(network(OPEN.format("q_m3_h") + "factor = 3.0\n"), t, rows, np.array([70.0, 25.0]))
    ).all()


def test_places_that_make_no_sense() -> None:
    with pytest.raises(TwinFileError, match="neither a speed nor a flow"):
        network(OPEN.format("T_ambient_C"))
    with pytest.raises(TwinFileError, match="names a node twice"):
        network(OPEN.format("q_m3_h").replace('"b"]', '"a"]'))
