"""Each kind against its formula written out by hand, and the balance that all of them must keep."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.twin.conftest import LOOP
from twin.elements import KINDS
from twin.kernel import simulate
from twin.network import Network, TwinFileError
from twin.reference_simulation import right_hand_side, simulate_exact
from twin.twinfile import load, parse

TWO = """
format = 1
name = "two"
[inputs]
heater_power_W = { nominal = 500.0 }
pump_speed_pct = { nominal = 100.0 }
fan_speed_pct = { nominal = 50.0 }
T_ambient_C = { nominal = 20.0 }
[elements.a]
kind = "node"
capacitance = 1000.0
[elements.b]
kind = "node"
capacitance = 4000.0
[elements.T_a_C]
kind = "sensor"
node = "a"
columns = ["T_a_C"]
[elements.link]
kind = "conduction"
from = "a"
to = "b"
resistance = 0.5
"""
U = np.array([500.0, 80.0, 50.0, 20.0])


def rates(extra: str, temperatures: tuple[float, float] = (40.0, 30.0)) -> np.ndarray:
    """Heat into a and b, W, of what `extra` adds to two linked nodes."""

    def heat(net: Network) -> np.ndarray:
        return np.array(right_hand_side(net)(np.array(temperatures), U, net.values)) * [1000.0, 4000.0]

    return heat(parse(TWO + extra)) - heat(parse(TWO))


def test_conduction() -> None:
    net = parse(TWO)
    assert right_hand_side(net)(np.array([40.0, 30.0]), U, net.values) == pytest.approx([-20.0 / 1000.0, 20.0 / 4000.0])


def test_ambient_loss() -> None:
    assert rates('[elements.x]\nkind="ambient_loss"\nnode="a"\nhA=3.0') == pytest.approx([-60.0, 0.0])


def test_heat_source_constant_and_driven() -> None:
    assert rates('[elements.x]\nkind="heat_source"\nnode="b"\npower=25.0') == pytest.approx([0.0, 25.0])
    driven = '[elements.x]\nkind="heat_source"\nnode="a"\ndriver="heater_power_W"\nfactor=0.9'
    assert rates(driven) == pytest.approx([450.0, 0.0])


def test_radiator_follows_fan_and_pump() -> None:
    text = (
        '[elements.x]\nkind="radiator"\nnode="b"\nfan="fan_speed_pct"\npump="pump_speed_pct"\n'
        "UA_100=30.0\nfan_exponent=0.6\nflow_exponent=0.2\nUA_still=1.5"
    )
    ua = 30.0 * 0.5**0.6 * 0.8**0.2 + 1.5
    assert rates(text) == pytest.approx([0.0, -10.0 * ua])


@pytest.mark.parametrize("outlet", ["exchanged", "volume"])
def test_well_mixed_flow_is_the_advective_term_of_eq_1(outlet: str) -> None:
    text = f'[elements.x]\nkind="flow"\npath=["a","b"]\npump="pump_speed_pct"\nnominal=3.0\noutlet="{outlet}"'
    mcp = 3.0 * 0.997 / 60.0 * 4180.0 * 0.8
    assert rates(text) == pytest.approx([mcp * (30.0 - 40.0), mcp * (40.0 - 30.0)])


FILM = (
    '[elements.x]\nkind="flow"\npath=["a","b"]\npump="pump_speed_pct"\nnominal=3.0\nfilm=["b"]\n'
    "effectiveness_b=0.2\nfilm_exponent=0.3\n"
)


def test_a_film_changes_its_share_with_the_flow() -> None:
    at = {}
    for pump in (100.0, 50.0):
        net = parse(TWO + FILM)
        u = np.array([0.0, pump, 0.0, 20.0])
        with_flow = np.array(right_hand_side(net)(np.array([40.0, 30.0]), u, net.values))[1] * 4000.0 - 20.0
        at[pump] = with_flow / (3.0 / 60.0 * 0.997 * 4180.0 * pump / 100.0 * 10.0)
    assert at[100.0] == pytest.approx(0.2, rel=1e-9)
    # hA follows flow^0.3, so NTU = hA / m cp follows flow^-0.7
    assert at[50.0] == pytest.approx(1.0 - math.exp(math.log(0.8) * 0.5**-0.7), rel=1e-6)


def test_a_film_is_simulated_as_its_formula_says() -> None:
    net = parse(TWO + FILM)
    time = np.arange(0.0, 300.0)
    inputs = np.tile(U, (300, 1))
    inputs[:, 1] = np.repeat([100.0, 30.0, 0.0, 60.0, 5.0, 80.0], 50)
    start = np.array([60.0, 20.0])
    expected = simulate_exact(net, time, inputs, start)[:, :1]
    assert np.abs(simulate(net, time, inputs, start) - expected).max() < 1e-6


def test_a_film_off_the_path_is_refused() -> None:
    with pytest.raises(TwinFileError, match="'c' has a film but is not on the path"):
        parse(TWO + FILM.replace('film=["b"]', 'film=["c"]').replace("effectiveness_b=0.2\n", ""))


def test_flow_with_effectiveness_hands_on_what_is_left() -> None:
    text = (
        '[elements.x]\nkind="flow"\npath=["a","b"]\npump="pump_speed_pct"\nnominal=3.0\n'
        "effectiveness_a={value=0.4}\neffectiveness_b=0.7"
    )
    mcp = 3.0 * 0.997 / 60.0 * 4180.0 * 0.8
    # two equations by hand: w1 = w0 - 0.4 (w0 - 40), w0 = w1 - 0.7 (w1 - 30)
    w1, w0 = np.linalg.solve([[1.0, -0.6], [-0.3, 1.0]], [16.0, 21.0])
    assert rates(text) == pytest.approx([mcp * 0.4 * (w0 - 40.0), mcp * 0.7 * (w1 - 30.0)])
    assert rates(text).sum() == pytest.approx(0.0, abs=1e-9)


def test_loop_is_the_papers_equation_1() -> None:
    net = load(LOOP)
    v = {name: p.value for name, p in net.parameters.items()}
    th, tm, tr, tt = temps = (39.0, 38.0, 35.0, 34.0)
    power, pump, fan, room = u = (750.0, 90.0, 60.0, 21.0)
    mcp = 3.785 / 60.0 * 0.997 * 4180.0 * pump / 100.0
    r1, r2, r3 = (v[f"{k}.resistance"] for k in ("heater_to_modules", "modules_to_radiator", "radiator_to_tank"))
    ua = v["fins.UA_100"] * (fan / 100.0) ** v["fins.fan_exponent"] + v["fins.UA_still"]
    by_hand = [
        (mcp * (tt - th) + power - (th - tm) / r1 - v["heater_loss.hA"] * (th - room)) / v["heater.capacitance"],
        (mcp * (th - tm) + (th - tm) / r1 - (tm - tr) / r2 - v["modules_loss.hA"] * (tm - room))
        / v["modules.capacitance"],
        (mcp * (tm - tr) + (tm - tr) / r2 - (tr - tt) / r3 - ua * (tr - room)) / v["radiator.capacitance"],
        (mcp * (tr - tt) + (tr - tt) / r3 - v["tank_loss.hA"] * (tt - room)) / v["tank.capacitance"],
    ]
    assert right_hand_side(net)(np.array(temps), np.array(u), net.values) == pytest.approx(by_hand)


@given(
    temperatures=st.lists(st.floats(-20.0, 95.0), min_size=4, max_size=4),
    shares=st.lists(st.floats(0.1, 1.8), min_size=4, max_size=4),
    power=st.floats(0.0, 2000.0),
    pump=st.floats(0.0, 100.0),
    fan=st.floats(0.0, 100.0),
    room=st.floats(-20.0, 45.0),
)
def test_stored_heat_is_what_comes_in_less_what_is_lost(temperatures, shares, power, pump, fan, room) -> None:  # type: ignore[no-untyped-def]
    net = load_loop()
    nodes = net.nodes
    net = net.with_values({f"circuit.effectiveness_{n}": s for n, s in zip(nodes, shares, strict=True)})
    v = {name: p.value for name, p in net.parameters.items()}
    T, u = np.array(temperatures), np.array([power, pump, fan, room])
    capacity = np.array([v[f"{n}.capacitance"] for n in nodes])
    stored = float(np.array(right_hand_side(net)(T, u, net.values)) @ capacity)
    ua = v["fins.UA_100"] * math.pow(max(fan, 0.1) / 100.0, v["fins.fan_exponent"]) + v["fins.UA_still"]
    loss = np.array([v["heater_loss.hA"], v["modules_loss.hA"], ua, v["tank_loss.hA"]]) @ (T - room)
    assert stored == pytest.approx(power - loss, rel=1e-9, abs=1e-6)


_LOADED: list[Network] = []


def load_loop() -> Network:
    if not _LOADED:
        _LOADED.append(load(LOOP))
    return _LOADED[0]


def test_every_kind_says_where_its_parameters_come_from() -> None:
    assert set(KINDS) >= {"node", "flow", "conduction", "ambient_loss", "heat_source", "radiator", "sensor"}
    for cls in KINDS.values():
        for spec in cls.parameters:
            assert spec.unit and spec.source and "\n" not in spec.source
            assert spec.lower < spec.upper
            if spec.default is not None:
                assert spec.lower <= spec.default <= spec.upper


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_of_element_has_no_hook_that_nobody_calls(kind: str) -> None:
    # A hook under another name than that of the base class is never asked, and no type checker sees it.
    public = {name: value for name, value in vars(KINDS[kind]).items() if not name.startswith("_") and callable(value)}
    hooks = {name for name, value in public.items() if "sites" in value.__code__.co_varnames[:2]}
    assert hooks <= {"changed_candidates"}
