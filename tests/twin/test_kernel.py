"""The generated kernel against solve_ivp, against the matrix exponential, and in the corners."""

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.twin.conftest import LOOP, START, drive
from twin.gauss_newton import FitData, linearise
from twin.kernel import Kernel, clean_time, hold_inputs, mask_measurements, simulate
from twin.kernel.codegen import LANES
from twin.kernel.functions import LOG, SUBSTEPS
from twin.network import Network, TwinFileError
from twin.reference_simulation import right_hand_side, simulate_exact
from twin.twinfile import parse

FAST = """
format = 1
name = "fast"
[inputs]
T_ambient_C = {{ nominal = 20.0, lower = -40.0, upper = 60.0 }}
[elements.volume]
kind = "node"
capacitance = {capacitance}
[elements.loss]
kind = "ambient_loss"
node = "volume"
hA = {{ value = 100.0, lower = 1.0, upper = 1000.0 }}
[elements.shine]
kind = "radiation"
node = "volume"
ambient = "T_ambient_C"
area = {{ value = 1.0e-9, lower = 0.0, upper = 1.0 }}
[elements.T_C]
kind = "sensor"
node = "volume"
columns = ["T_C"]
"""


@pytest.fixture(scope="module")
def twelve(loop: Network) -> Kernel:
    return Kernel(loop, loop.sets["twelve"].members)


def spread(net: Network, ids: tuple[str, ...], count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low, high = net.bounds(ids)
    index = net.index(ids)
    full = np.tile(net.values, (count, 1))
    full[:, index] = np.clip(full[:, index] * rng.uniform(0.5, 1.5, (count, len(ids))), low, high)
    return full


def test_agrees_with_solve_ivp(loop: Network) -> None:
    t, u = drive(601, every=True)
    rhs, state = right_hand_side(loop), START.copy()
    rows = [state]
    for i in range(t.size - 1):  # restarted at each sample: an adaptive solver steps over the inputs' jumps
        done = solve_ivp(
            lambda _, T, i=i: rhs(T, u[i], loop.values), (t[i], t[i + 1]), state, "DOP853", rtol=1e-11, atol=1e-11
        )
        state = done.y[:, -1]
        rows.append(state)
    assert np.abs(simulate(loop, t, u, START) - np.array(rows)).max() < 1e-6


def test_agrees_with_the_matrix_exponential_over_the_box(loop: Network, twelve: Kernel) -> None:
    t, u = drive(601, every=True)
    full = spread(loop, twelve.lane_ids, 40)
    readings, end = twelve.trace(full, START, t, u)
    for k in (0, 7, 33, 39):
        exact = simulate_exact(loop, t, u, START, full[k])
        assert np.abs(readings[k] - exact).max() < 1e-6
        assert np.abs(end[k] - exact[-1]).max() < 1e-6


def test_irregular_samples_and_gaps(loop: Network) -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.choice([0.0, 0.3, 1.0, 7.0, 45.0, 600.0, 9000.0], 200))
    _, u = drive(200, every=True)
    assert np.abs(simulate(loop, t, u, START) - simulate_exact(loop, t, u, START)).max() < 1e-5


def test_a_gap_of_years_ends_in_the_steady_state(loop: Network) -> None:
    _, u = drive(2)
    end = simulate(loop, [0.0, 3e8], u, START)[-1]
    steady = simulate_exact(loop, [0.0, 1e6], u, START)[-1]
    assert np.abs(end - steady).max() < 1e-6


def test_stiff_corner_of_the_box_stays_finite_and_right(loop: Network, twelve: Kernel) -> None:
    t, u = drive(601, every=True)
    low, high = loop.bounds(loop.tunables())
    for corner in (low, high):
        net = loop.with_values(dict(zip(loop.tunables(), corner, strict=True)))
        assert np.abs(simulate(net, t, u, START) - simulate_exact(net, t, u, START)).max() < 1e-5
    full = np.tile(loop.values, (2, 1))
    index = loop.index(twelve.lane_ids)
    full[0, index], full[1, index] = loop.bounds(twelve.lane_ids)
    readings, _ = twelve.trace(full, START, t, u)
    assert np.isfinite(readings).all()
    assert np.abs(readings).max() < 1e4


def test_cost_is_the_sum_over_the_trace(loop: Network, twelve: Kernel) -> None:
    t, u = drive(301)
    full = spread(loop, twelve.lane_ids, LANES + 5)
    readings, end = twelve.trace(full, START, t, u)
    measured = simulate(loop, t, u, START)
    measured[40:60, 1] = np.nan
    measured[:, 3] = np.nan
    y, weight = mask_measurements(measured, loop.sigma)
    sse, end2 = twelve.cost(full, START, t, u, y, weight)
    by_hand = np.nansum(((readings - measured) / loop.sigma) ** 2, axis=1)
    assert sse == pytest.approx(by_hand, rel=1e-9, abs=1e-12)
    assert (sse[:, 3] == 0.0).all()
    assert twelve.cost(full[:1], START, t, u, y, weight)[0] == pytest.approx(by_hand[:1], rel=1e-9, abs=1e-12)
    assert np.array_equal(end, end2)


def test_normal_equations_are_those_of_the_jacobian(loop: Network, twelve: Kernel) -> None:
    t, u = drive(301)
    index, q = loop.index(twelve.lane_ids), len(twelve.lane_ids)
    full = np.tile(loop.values, (1 + q, 1))
    steps = 1e-5 * np.maximum(np.abs(loop.values[index]), 1.0)
    full[np.arange(1, 1 + q), index] += steps
    measured = simulate(loop, t, u, START) + 0.1
    measured[::7, 2] = np.nan
    y, weight = mask_measurements(measured, loop.sigma)
    out = linearise(twelve, full, np.tile(START, (1 + q, 1)), steps, FitData(t, u, y, weight))
    readings, _ = twelve.trace(full, START, t, u)
    jacobian = ((readings[1:] - readings[0]) * weight).reshape(q, -1) / steps[:, None]
    residual = ((readings[0] - y) * weight).ravel()
    scale = np.sqrt(np.diag(jacobian @ jacobian.T))
    assert np.allclose(out.jtj / np.outer(scale, scale), jacobian @ jacobian.T / np.outer(scale, scale), atol=1e-8)
    assert np.allclose(out.jtr / scale, jacobian @ residual / scale, rtol=1e-6, atol=1e-6)
    assert out.sse.sum() == pytest.approx(residual @ residual, rel=1e-9)


def test_a_particle_does_not_depend_on_its_place_in_the_swarm(loop: Network, twelve: Kernel) -> None:
    t, u = drive(301)
    full = spread(loop, twelve.lane_ids, 70)
    together = twelve.trace(full, START, t, u)[0]
    alone = twelve.trace(full[66], START, t, u)[0][0]
    assert np.abs(together[66] - alone).max() < 1e-6


def test_missing_inputs_hold_the_last_good_value(loop: Network) -> None:
    _, u = drive(6)
    u[0, 0] = u[2:4, 3] = np.nan
    u[5] = np.inf
    filled = hold_inputs(loop, u)
    assert filled[0, 0] == 700.0
    assert (filled[2:4, 3] == filled[1, 3]).all()
    assert (filled[5] == filled[4]).all()


def test_times_that_go_back_are_refused() -> None:
    with pytest.raises(TwinFileError, match="must not go back"):
        clean_time([0.0, 2.0, 1.0])


def test_values_that_are_not_finite_are_refused(loop: Network, twelve: Kernel) -> None:
    t, u = drive(10)
    with pytest.raises(ValueError, match="finite"):
        twelve.trace(loop.values, np.array([np.nan, 1.0, 1.0, 1.0]), t, u)


SCRIPT = """
import sys, numpy as np
from twin.twinfile import load
from twin.kernel import simulate
net = load(sys.argv[1])
u = np.tile(net.nominal_inputs, (50, 1))
print(repr(float(simulate(net, np.arange(50.0), u, [37.0, 36.0, 34.0, 33.0]).sum())))
"""


def test_two_processes_compile_at_once_and_a_third_finds_the_cache(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT, str(LOOP)]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    answers = {p.communicate(timeout=120)[0] for p in both}
    assert [p.returncode for p in both] == [0, 0]
    machine_code = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.o")}
    assert machine_code
    answers.add(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
    assert len(answers) == 1
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.o")} == machine_code


RADIATION = '\n[elements.glow]\nkind = "radiation"\nnode = "tank"\nambient = "T_ambient_C"\narea = 1.5\n'


def test_a_network_that_is_not_linear_agrees_with_solve_ivp(loop_text: str) -> None:
    net = parse(loop_text + RADIATION)
    t, u = drive(301, every=True)
    kernel = Kernel(net, (*net.sets["nine"].members, "glow.area"))
    rhs, state, rows = right_hand_side(net), START.copy(), [START]
    for i in range(t.size - 1):
        span = (t[i], t[i + 1])
        done = solve_ivp(lambda _, T, i=i: rhs(T, u[i], net.values), span, state, rtol=1e-9, atol=1e-10)
        state = done.y[:, -1]
        rows.append(state)
    assert np.abs(kernel.trace(np.tile(net.values, (2, 1)), START, t, u)[0] - np.array(rows)).max() < 2e-6


def test_an_interval_of_many_time_constants_takes_as_many_substeps_as_stability_asks_for() -> None:
    """Errors of a fast mode decay within the interval; a fixed step per time constant would cost five times as many."""
    made: dict[str, Any] = {"inlined": lambda f: f, "PER_STEP": 5.0, "PER_STABLE": 0.5, "DECAYED": 24.0}
    exec(SUBSTEPS, made)
    assert [made["substeps"](x, 2.0 * x) for x in (0.1, 2.0, 4.8, 10.0, 24.0, 100.0)] == [0.5, 10, 24, 24, 24, 100]
    # Water that overshoots couples states by more than their own rates: then as many as accuracy would have asked for.
    assert made["substeps"](100.0, 600.0) == 300.0 and made["substeps"](100.0, 4000.0) == 500.0


@pytest.mark.parametrize("speed", [0.4, 1.0, 2.0, 8.0])
def test_what_an_interval_leaves_of_a_jump_is_a_millionth_however_fast_a_volume_is(speed: float) -> None:
    """Samples of 12 s; the law that is not affine is too weak to be seen, and selects Runge-Kutta."""
    network = parse(FAST.format(capacitance=100.0 / speed))
    t = np.arange(40) * 12.0
    u = np.column_stack([np.where(np.arange(40) % 7 < 3, 20.0, 21.0)])
    y = simulate(network, t, u, np.array([20.0]))[:, 0]
    expected = [20.0]
    for room in u[:-1, 0]:
        expected.append(room + (expected[-1] - room) * np.exp(-12.0 * speed))
    assert np.abs(y - expected).max() < 1e-6


def test_the_kernels_logarithm_is_exact_to_rounding() -> None:
    made: dict[str, Any] = {"inlined": lambda f: f}
    exec(LOG, made)
    for x in (*np.geomspace(1e-300, 1e300, 601), *np.linspace(0.5, 2.0, 301)):
        assert made["log"](float(x)) == pytest.approx(math.log(x), rel=1e-15, abs=1e-300)
