"""Heat exchanger against the effectiveness of the textbook, written out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from twin.kernel import simulate
from twin.network import Network, TwinFileError
from twin.reference_simulation import right_hand_side
from twin.twinfile import parse

FOUR = """
format = 1
name = "two loops"
[inputs]
heater_power_W = { nominal = 500.0 }
pump_speed_pct = { nominal = 100.0 }
pump2_speed_pct = { nominal = 100.0 }
T_ambient_C = { nominal = 20.0 }
[elements]
heater = { kind = "node", capacitance = 2000.0 }
hot = { kind = "node", capacitance = 1000.0 }
cold = { kind = "node", capacitance = 1500.0 }
store = { kind = "node", capacitance = 9000.0 }
first = { kind = "flow", path = ["heater", "hot"], pump = "pump_speed_pct", nominal = 3.0 }
second = { kind = "flow", path = ["store", "cold"], pump = "pump2_speed_pct", nominal = 2.0 }
power = { kind = "heat_source", node = "heater", driver = "heater_power_W" }
loss = { kind = "ambient_loss", node = "store", hA = 20.0 }
T_hot_C = { kind = "sensor", node = "hot", columns = ["T_hot_C"] }
"""
PLATES = '[elements.plates]\nkind = "exchanger"\nfrom = "hot"\nto = "cold"\nUA_100 = 150.0\n'
T = np.array([60.0, 48.0, 40.0, 25.0])  # heater, hot, cold, store
CAPACITY = np.array([2000.0, 1000.0, 1500.0, 9000.0])
MCP = 0.997 / 60.0 * 4180.0


def heat(extra: str, pumps: tuple[float, float] = (100.0, 100.0)) -> np.ndarray:
    """Heat into each node, W, of what `extra` adds."""
    u = np.array([500.0, *pumps, 20.0])

    def into(net: Network) -> np.ndarray:
        return np.array(right_hand_side(net)(T, u, net.values)) * CAPACITY

    bridge = '[elements.bridge]\nkind = "conduction"\nfrom = "hot"\nto = "cold"\nresistance = 1.0e5\n'
    return into(parse(FOUR + bridge + extra)) - into(parse(FOUR + bridge))


def counterflow(ua: float, a: float, b: float) -> float:
    """Return eps * C_min by eq. 11.29a and 11.29b of Incropera."""
    least, ratio = min(a, b), min(a, b) / max(a, b)
    ntu = ua / least
    if ratio == 1.0:
        return least * ntu / (1.0 + ntu)
    e = math.exp(-ntu * (1.0 - ratio))
    return least * (1.0 - e) / (1.0 - ratio * e)


@settings(deadline=None)
@given(pumps=st.tuples(st.floats(2.0, 100.0), st.floats(2.0, 100.0)), ua=st.floats(1.0, 1.0e4))
def test_counterflow_is_the_textbooks(pumps: tuple[float, float], ua: float) -> None:
    text = PLATES.replace("150.0", repr(ua)) + "film = 0.8\nfilm_from = 0.3\nfilm_exponent = 0.6\n"
    a, b = pumps[0] / 100.0, pumps[1] / 100.0
    now = ua / (0.2 + 0.8 * (0.3 * a**-0.6 + 0.7 * b**-0.6))
    expected = counterflow(now, 3.0 * MCP * a, 2.0 * MCP * b) * (60.0 - 25.0)
    assert heat(text, pumps) == pytest.approx([0.0, -expected, expected, 0.0], rel=1e-5, abs=1e-6)


def test_equal_capacity_rates_are_no_gap() -> None:
    pumps = (60.0, 90.0)
    expected = counterflow(150.0, 1.8 * MCP, 1.8 * MCP) * 35.0
    assert heat(PLATES + "film_exponent = 0.0\n", pumps)[2] == pytest.approx(expected, rel=1e-5)


def test_outlet_form_is_a_conduction_that_follows_the_flows() -> None:
    text = PLATES + 'form = "outlet"\nfilm = 1.0\nfilm_from = 1.0\nfilm_exponent = 0.8\n'
    assert heat(text, (50.0, 20.0)) == pytest.approx([0.0, -8.0 * 150.0 * 0.5**0.8, 8.0 * 150.0 * 0.5**0.8, 0.0])


def test_water_behind_a_share_arrives_as_it_is() -> None:
    shared = FOUR.replace("nominal = 3.0 }", "nominal = 3.0, effectiveness_hot = 0.7 }")
    u = np.array([0.0, 100.0, 100.0, 20.0])
    net, none = parse(shared + PLATES), parse(shared + PLATES.replace("150.0", "0.0"))
    into = [np.array(right_hand_side(n)(T, u, n.values)) * CAPACITY for n in (net, none)]
    assert (into[0] - into[1])[2] == pytest.approx(counterflow(150.0, 3.0 * MCP, 2.0 * MCP) * 35.0, rel=1e-5)


@pytest.mark.parametrize("form", ["counterflow", "outlet"])
def test_kernel_agrees_with_solve_ivp_and_stands_still_pumps(form: str) -> None:
    net = parse(FOUR + PLATES + f'form = "{form}"\n')
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(1.0, 9.0, 60))
    inputs = rng.uniform([0.0, 0.0, 0.0, 10.0], [900.0, 100.0, 100.0, 30.0], (60, 4))
    inputs[20:25, 1], inputs[23:30, 2] = 0.0, 0.0
    rhs, x = right_hand_side(net), T.copy()
    for k in range(59):
        span = (0.0, time[k + 1] - time[k])
        x = solve_ivp(lambda _, y, u=inputs[k]: rhs(y, u, net.values), span, x, "LSODA", rtol=1e-9, atol=1e-9).y[:, -1]
    assert simulate(net, time, inputs, T)[-1, 0] == pytest.approx(x[1], abs=1e-4)


def test_corners_of_the_bounds_are_finite() -> None:
    time, inputs = np.arange(0.0, 40.0, 4.0), np.tile([500.0, 0.0, 100.0, 20.0], (10, 1))
    for ua in ("0.0", "1.0e6"):
        for exponent in ("0.0", "1.0"):
            net = parse(FOUR + PLATES.replace("150.0", ua) + f"film_exponent = {exponent}\n")
            assert np.isfinite(simulate(net, time, inputs, T)).all()


def test_a_meter_reads_its_heat() -> None:
    meter = '[elements.Q_W]\nkind = "meter"\nof = "plates"\nquantity = "heat"\ncolumns = ["Q_W"]\nsigma = 1.0\n'
    net = parse(FOUR + PLATES + meter)
    read = simulate(net, [0.0, 1.0], [[0.0, 100.0, 100.0, 20.0]] * 2, T)[0]
    assert read[1] == pytest.approx(counterflow(150.0, 3.0 * MCP, 2.0 * MCP) * 35.0, rel=1e-5)


def test_a_side_without_water_is_refused() -> None:
    dry = '[elements.plain]\nkind = "node"\ncapacitance = 5.0\n'
    with pytest.raises(TwinFileError, match="no flow path names 'plain'; use a conduction"):
        parse(FOUR + PLATES.replace('to = "cold"', 'to = "plain"') + dry)


def test_other_candidates_than_a_constant_conductance_are_offered() -> None:
    from twin.discovery.effects.catalogue import catalogue

    own = [c for c in catalogue(parse(FOUR + PLATES)) if any(k.startswith("plates.") for k in c.changes)]
    assert {(c.kind, c.where) for c in own} == {("coupling", "hot")}
    changed = {next(iter(c.changes)).removeprefix("plates.") for c in own}
    assert changed == {"UA_100", "film", "film_from", "film_exponent"}
