"""A bypass rearranges heat and loses none; past one node it is an effectiveness."""

import numpy as np
import pytest

from tests.twin.conftest import START, drive
from twin.kernel import simulate
from twin.network import Network, TwinFileError
from twin.reference_simulation import right_hand_side, simulate_exact
from twin.twinfile import parse

PAST = '\n[elements.short]\nkind = "bypass"\naround = {}\nfraction = {{ value = {}, status = "tunable" }}\n'
U = np.array([750.0, 90.0, 60.0, 21.0])
T = np.array([39.0, 37.0, 35.0, 34.0])


def past(loop_text: str, around: str, fraction: float) -> Network:
    return parse(loop_text + PAST.format(around, fraction))


def rates(net: Network) -> np.ndarray:
    return np.array(right_hand_side(net)(T, U, net.values))


def test_past_one_node_it_is_an_effectiveness(loop: Network, loop_text: str) -> None:
    net = past(loop_text, '["modules"]', 0.3)
    same = loop.with_values({"circuit.effectiveness_modules": 0.7})
    assert rates(net) == pytest.approx(rates(same), rel=1e-12)
    t, u = drive(900)
    assert np.abs(simulate(net, t, u, START) - simulate(same, t, u, START)).max() < 1e-9


def test_heat_is_only_rearranged(loop: Network, loop_text: str) -> None:
    net = past(loop_text, '["modules", "radiator"]', 0.4)
    capacity = np.array([loop.parameters[f"{node}.capacitance"].value for node in loop.nodes])
    moved = (rates(net) - rates(loop)) * capacity
    mcp = 3.785 * 0.997 / 60.0 * 4180.0 * 0.9
    assert moved == pytest.approx([0.0, -0.4 * mcp * 2.0, -0.4 * mcp * 2.0, 0.4 * mcp * 4.0], abs=1e-6)
    assert moved.sum() == pytest.approx(0.0, abs=1e-6)


def test_kernel_is_exact_and_neutral_at_zero(loop: Network, loop_text: str) -> None:
    t, u = drive(900, every=True)
    net = past(loop_text, '["tank"]', 0.9)
    assert np.abs(simulate(net, t, u, START) - simulate_exact(net, t, u, START)).max() < 1e-6
    none = past(loop_text, '["tank"]', 0.0)
    assert np.abs(simulate(none, t, u, START) - simulate(loop, t, u, START)).max() < 1e-6


def test_places_that_make_no_sense(loop_text: str) -> None:
    with pytest.raises(TwinFileError, match="named twice"):
        past(loop_text, '["heater", "heater"]', 0.1)
    for around in ('["heater", "tank"]', '["modules", "heater"]'):
        with pytest.raises(TwinFileError, match=r"short: .*do not follow one another"):
            past(loop_text, around, 0.0)
    past(loop_text, '["tank", "heater"]', 0.1)  # round the corner where the loop closes
    aside = loop_text + '[elements.shelf]\nkind = "node"\ncapacitance = 900.0\n'
    aside += '[elements.bracket]\nkind = "conduction"\nfrom = "shelf"\nto = "tank"\nresistance = 1.0\n'
    with pytest.raises(TwinFileError, match="do not follow one another"):
        past(aside, '["shelf"]', 0.1)
