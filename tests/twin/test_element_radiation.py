"""Radiation: the first element whose heat is not affine, so also the test of the Runge-Kutta path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.twin.two_nodes import U, drivers, heat, network, worst_error
from twin.gauss_newton import FitData, linearise
from twin.kernel import Kernel, mask_measurements, simulate
from twin.network import TwinFileError
from twin.reference_simulation import right_hand_side, simulate_exact

ROOM = '[elements.x]\nkind = "radiation"\nnode = "a"\nambient = "T_ambient_C"\narea = 2.0\nemissivity = 0.8\n'
PAIR = '[elements.x]\nkind = "radiation"\nnode = "a"\nto = "b"\narea = 3.0\n'


def test_to_the_room() -> None:
    expected = 0.8 * 5.670374419e-8 * 2.0 * ((40.0 + 273.15) ** 4 - (20.0 + 273.15) ** 4)
    assert heat(ROOM) == pytest.approx([-expected, 0.0])


def test_between_nodes_nothing_is_lost() -> None:
    expected = 0.9 * 5.670374419e-8 * 3.0 * ((40.0 + 273.15) ** 4 - (30.0 + 273.15) ** 4)
    assert heat(PAIR) == pytest.approx([-expected, expected])
    assert heat(PAIR).sum() == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None)
@given(a=st.floats(-40.0, 150.0), b=st.floats(-40.0, 150.0))
def test_heat_flows_from_hot_to_cold(a: float, b: float) -> None:
    q = heat(PAIR, (a, b))[0]
    assert q * (b - a) >= 0.0


@pytest.mark.parametrize("extra", [ROOM, PAIR, ROOM + PAIR.replace("elements.x", "elements.y")])
def test_kernel_agrees_with_solve_ivp(extra: str) -> None:
    assert worst_error(extra) < 5e-6


def test_strong_radiation_takes_more_substeps() -> None:
    strong = ROOM.replace("area = 2.0", "area = 100.0")
    assert worst_error(strong, (400.0, 25.0), n=40) < 1e-3
    assert worst_error(strong, (90.0, 25.0), n=40) < 1e-5


def test_no_area_is_no_radiation() -> None:
    t, u = drivers(60)
    start = np.array([70.0, 25.0])
    none = simulate(network(ROOM.replace("area = 2.0", "area = 0.0")), t, u, start)
    assert np.abs(none - simulate(network(""), t, u, start)).max() < 1e-6


def test_gradient_at_no_area_is_that_of_a_small_one() -> None:
    net = network(ROOM.replace("area = 2.0", "area = 0.0"))
    t, u = drivers(60)
    kernel = Kernel(net, ("x.area",))
    y, weight = mask_measurements(np.zeros((60, 2)))
    steps = np.array([1e-4])
    full = np.tile(net.values, (2, 1))
    full[1, net.index(["x.area"])] += steps
    linear = linearise(kernel, full, np.tile([70.0, 25.0], (2, 1)), steps, FitData(t, u, y, weight))
    readings = kernel.trace(np.vstack([net.values, full[1]]), np.array([70.0, 25.0]), t, u)[0]
    slope = (readings[1] - readings[0]) / 1e-4
    assert linear.jtj[0, 0] == pytest.approx(float((slope**2).sum()), rel=1e-6)


@pytest.mark.parametrize("start", [(-273.15, 2000.0), (5000.0, -200.0)])
def test_absurd_temperatures_stay_finite(start: tuple[float, float]) -> None:
    t, u = drivers(60)
    extreme = ROOM.replace("area = 2.0", "area = 100.0") + PAIR.replace("elements.x", "elements.y").replace(
        "3.0", "100.0"
    )
    assert np.isfinite(simulate(network(extreme), t, u, np.array(start))).all()


def test_oracle_for_linear_networks_refuses_it() -> None:
    t, u = drivers(5)
    with pytest.raises(TwinFileError, match="not linear"):
        simulate_exact(network(ROOM), t, u, np.array([70.0, 25.0]))


def test_swarm_and_single_agree() -> None:
    net = network(ROOM)
    t, u = drivers(50)
    kernel = Kernel(net, ("x.area", "x.emissivity"))
    full = np.tile(net.values, (70, 1))
    full[:, net.index(["x.area"])[0]] = np.linspace(0.0, 20.0, 70)
    many = kernel.trace(full, np.array([70.0, 25.0]), t, u)[0]
    for k in (0, 33, 69):
        single = simulate(net, t, u, np.array([70.0, 25.0]), full[k])
        assert np.abs(many[k] - single).max() < 1e-6


def test_places_that_make_no_sense() -> None:
    with pytest.raises(TwinFileError, match="either `to`"):
        network('[elements.x]\nkind = "radiation"\nnode = "a"\narea = 1.0\n')
    with pytest.raises(TwinFileError, match="same node"):
        network('[elements.x]\nkind = "radiation"\nnode = "a"\nto = "a"\narea = 1.0\n')
    assert U.size == len(network(ROOM).inputs)


def test_lagging_sensor_follows_a_radiating_node() -> None:
    lagging = '[elements.T_slow_C]\nkind = "sensor"\nnode = "a"\ncolumns = ["T_slow_C"]\nlag_s = 20.0\n'
    net = network(ROOM + lagging)
    t, u = drivers(40)
    readings = simulate(net, t, u, np.array([70.0, 25.0]))
    rhs = right_hand_side(net)
    state = np.array([70.0, 25.0, 70.0])
    for i in range(t.size - 1):
        done = solve_ivp(
            lambda _, x, now: [*rhs(x[:2], now, net.values), (x[0] - x[2]) / 20.0],
            (0.0, float(t[i + 1] - t[i])),
            state,
            args=(u[i],),
            rtol=1e-9,
            atol=1e-9,
        )
        state = done.y[:, -1]
        assert readings[i + 1, 2] == pytest.approx(state[2], abs=1e-3)
