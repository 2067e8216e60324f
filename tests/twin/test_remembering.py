"""Elements that remember: pipes, walls, hidden masses, lagging sensors, actuators; each against another solution."""

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from twin.gauss_newton import FitData, linearise
from twin.kernel import Kernel, mask_measurements, simulate
from twin.network import Network
from twin.twinfile import dump, parse

LINE = """
format = 1
name = "line"
[inputs]
pump_speed_pct = { nominal = 100.0 }
T_in_C = { nominal = 20.0 }
heater_power_W = { nominal = 0.0 }
T_ambient_C = { nominal = 15.0 }
[elements.a]
kind = "node"
capacitance = 8000.0
[elements.b]
kind = "node"
capacitance = 9000.0
[elements.stream]
kind = "flow"
path = ["a", "b"]
pump = "pump_speed_pct"
inlet = "T_in_C"
nominal = 6.0
[elements.tube]
kind = "pipe"
to = "b"
volume = 1.03
[elements.mass]
kind = "hidden_mass"
node = "b"
capacity = 0.0
conductance = { value = 0.0, status = "fixed" }
[elements.power]
kind = "heat_source"
node = "a"
driver = "heater_power_W"
[elements.relay]
kind = "actuator"
column = "heater_power_W"
[elements.T_a_C]
kind = "sensor"
node = "a"
columns = ["T_a_C"]
[elements.T_b_C]
kind = "sensor"
node = "b"
columns = ["T_b_C"]
other = "a"
"""
ALL = (
    "tube.volume",
    "tube.wall_capacity",
    "tube.wall_hA",
    "tube.loss_hA",
    "stream.factor",
    "mass.capacity",
    "mass.conductance",
    "relay.gain",
    "relay.droop",
    "relay.dead_time_s",
    "relay.lag_s",
    "T_b_C.lag_s",
    "T_b_C.bias_K",
    "T_b_C.drift_K_per_h",
    "T_b_C.gain",
    "T_b_C.cross_talk",
)
MCP = 6.0 / 60.0 * 0.997 * 4180.0
REST = np.array([20.0, 20.0])
N = 401
TIME = np.arange(N) * 0.5


def drive(seed: int = 0) -> np.ndarray:
    """Pump, inlet, power and room in steps."""
    rng = np.random.default_rng(seed)

    def steps(low: float, high: float, hold: int) -> np.ndarray:
        return np.repeat(rng.uniform(low, high, N // hold + 1), hold)[:N]

    return np.column_stack([steps(40.0, 100.0, 80), steps(19.0, 21.0, 100), steps(0.0, 900.0, 60), np.full(N, 15.0)])


@pytest.fixture(scope="module")
def line() -> Network:
    return parse(LINE)


@pytest.fixture(scope="module")
def kernel(line: Network) -> Kernel:
    """One kernel with every parameter of every kind that remembers free."""
    return Kernel(line, ALL)


def run(kernel: Kernel, values: dict[str, float], inputs: np.ndarray, time: np.ndarray = TIME) -> np.ndarray:
    full = kernel.network.values.copy()
    for name, value in values.items():
        full[kernel.network.index([name])[0]] = value
    return kernel.trace(full, REST, time, inputs)[0][0]


def step_response(*constants: float) -> np.ndarray:
    """Rise of two first-order volumes in a row after an inlet step of 1 K at time 0, at TIME."""
    p, q = constants
    rise: np.ndarray = 1.0 - (p * np.exp(-TIME / p) - q * np.exp(-TIME / q)) / (p - q)
    return rise


def finely(net: Network, values: dict[str, float], u: np.ndarray, pieces: int) -> np.ndarray:
    """[T_a, T_b, wall, mass, lag] at the samples: Heun's method with small steps, plug flow by interpolation."""
    p = {name: net.parameters[name].value for name in net.ids} | values
    every = np.minimum(np.arange((N - 1) * pieces + 1) // pieces, N - 2)
    dt = (TIME[1] - TIME[0]) / pieces
    flow = 0.1 * p["stream.factor"] * u[every, 0] / 100.0
    moved = np.concatenate([[0.0], np.cumsum(flow[:-1] * dt)])
    shift = np.clip(np.arange(every.size) - round(p["relay.dead_time_s"] / dt), 0, None)
    command, power = u[every[shift], 2], np.empty(every.size)
    z = u[0, 2]
    for i in range(every.size):
        power[i] = z if p["relay.lag_s"] else command[i]
        z = command[i] + (z - command[i]) * math.exp(-dt / max(p["relay.lag_s"], 1e-9))
    power = p["relay.gain"] * power * (1.0 - p["relay.droop"] * power / p["relay.full"])
    gone = p["mass.conductance"]
    speed = gone / (p["mass.capacity"] + gone + 1e-9)

    def slopes(i: int, y: np.ndarray, water: float) -> np.ndarray:
        a, b, wall, mass, seen = y
        mcp = flow[i] * 0.997 * 4180.0
        full = 1.0 - math.exp(-p["tube.wall_hA"] / mcp)
        top = mcp * full / (p["tube.wall_capacity"] + mcp * full + 1e-9)
        out = water - full * p["tube.wall_capacity"] / (p["tube.wall_capacity"] + mcp * full + 1e-9) * (water - wall)
        out = 15.0 + (out - 15.0) * math.exp(-p["tube.loss_hA"] / mcp)
        mix = b + p["T_b_C.cross_talk"] * (a - b)
        lag = p["T_b_C.lag_s"]
        return np.array(
            [
                (mcp * (u[every[i], 1] - a) + power[i]) / 8000.0,
                (mcp * (out - b) + speed * p["mass.capacity"] * (mass - b)) / 9000.0,
                top * (water - wall),
                speed * (b - mass),
                (mix - seen) / lag if lag else 0.0,
            ]
        )

    y = np.full((every.size, 5), 20.0)
    for i in range(every.size - 1):
        at = moved[i : i + 2] - p["tube.volume"]
        water = np.interp(at, moved[: i + 1], y[: i + 1, 0], left=20.0)
        first = slopes(i, y[i], water[0])
        y[i + 1] = y[i] + 0.5 * dt * (first + slopes(i, y[i] + dt * first, water[1]))
    return y[::pieces]


CASES = {
    "pipe": {"tube.volume": 1.03},
    "wall": {"tube.volume": 0.6, "tube.wall_capacity": 2500.0, "tube.wall_hA": 300.0},
    "loss": {"tube.volume": 0.8, "tube.loss_hA": 20.0},
    "hidden mass": {"mass.capacity": 4000.0, "mass.conductance": 150.0},
    "sensor": {"T_b_C.lag_s": 12.0, "T_b_C.cross_talk": 0.2},
    "actuator": {"relay.gain": 0.9, "relay.droop": 0.1, "relay.lag_s": 9.0, "relay.dead_time_s": 4.5},
}


@pytest.mark.parametrize("case", CASES)
def test_agrees_with_small_steps(kernel: Kernel, case: str) -> None:
    u = drive()
    # The lagging relay takes steps of its power as it finds them, so that it needs smaller ones.
    pieces = 100 if case == "actuator" else 25
    got, fine = run(kernel, CASES[case], u), finely(kernel.network, CASES[case], u, pieces)
    reading = fine[:, 4] if case == "sensor" else fine[:, 1]
    assert np.abs(got[:, 0] - fine[:, 0]).max() < 1e-4
    assert np.abs(got[:, 1] - reading).max() < 1e-4


def test_plug_flow_and_lag_in_closed_form(kernel: Kernel) -> None:
    u = np.tile([100.0, 30.0, 0.0, 15.0], (N, 1))
    rise = 20.0 + 10.0 * step_response(8000.0 / MCP, 9000.0 / MCP)
    late = np.interp(TIME - 1.2 / 0.1, TIME, rise, left=20.0)  # 12 s are whole samples
    got = run(kernel, {"tube.volume": 1.2}, u)
    assert np.abs(got[:, 1] - late).max() < 2e-4
    read = run(kernel, {"tube.volume": 0.0, "T_b_C.cross_talk": 1.0, "T_b_C.lag_s": 30.0}, u)[:, 1]
    assert np.abs(read - 20.0 - 10.0 * step_response(8000.0 / MCP, 30.0)).max() < 1e-5


def test_gain_bias_and_drift_of_a_sensor(kernel: Kernel) -> None:
    u = drive()
    plain = run(kernel, {}, u)[:, 1]
    read = run(kernel, {"T_b_C.gain": 1.02, "T_b_C.bias_K": -0.3, "T_b_C.drift_K_per_h": 0.5}, u)[:, 1]
    assert read == pytest.approx(1.02 * plain - 0.3 + 0.5 * TIME / 3600.0)


NEUTRAL = {"tube.volume": 0.0, "mass.capacity": 500.0, "mass.conductance": 0.0}


def test_neutral_parameters_change_nothing(line: Network, kernel: Kernel) -> None:
    u = drive()
    without = parse(LINE.split("[elements.tube]")[0] + LINE[LINE.index("[elements.power]") :].replace("other = ", "#"))
    plain = simulate(without, TIME, u, REST)
    assert np.abs(run(kernel, NEUTRAL, u) - plain).max() < 1e-9
    assert np.abs(run(kernel, NEUTRAL | {"mass.capacity": 0.0, "mass.conductance": 90.0}, u) - plain).max() < 1e-9
    left_out = simulate(parse(LINE.replace("volume = 1.03", "volume = 0.0")), TIME, u, REST)
    assert np.abs(left_out - plain).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "value", "step"),
    [
        ("tube.volume", 0.7, 1e-4),
        ("tube.volume", 0.01, 1e-5),
        ("tube.wall_capacity", 900.0, 1e-2),
        ("tube.wall_capacity", 0.0, 1e-3),
        ("mass.capacity", 3000.0, 1e-1),
        ("relay.dead_time_s", 3.2, 1e-4),
        ("relay.lag_s", 0.4, 1e-4),
        ("T_b_C.lag_s", 0.0, 1e-4),
        ("T_b_C.lag_s", 11.0, 1e-3),
        ("stream.factor", 1.1, 1e-5),
    ],
)
def test_jacobian_is_that_of_central_differences(kernel: Kernel, name: str, value: float, step: float) -> None:
    u, net = drive(), kernel.network
    index = net.index([name])[0]
    base = net.values.copy()
    base[net.index(["mass.conductance"])[0]] = 80.0
    base[index] = value
    full = np.tile(base, (2, 1))
    full[1, index] += 1e-6
    y, weight = mask_measurements(np.full((N, 2), 20.0))
    out = linearise(kernel, full, np.tile(REST, (2, 1)), np.array([1e-6]), FitData(TIME, u, y, weight))
    low = base.copy()
    low[index] = max(value - step, 0.0)
    high = base.copy()
    high[index] = value + step
    readings = [kernel.trace(row, REST, TIME, u)[0][0] for row in (low, high, base)]
    slope = (readings[1] - readings[0]) / (high[index] - low[index])
    assert out.jtr[0] == pytest.approx(((readings[2] - y) * slope).sum(), rel=5e-3, abs=1e-6)
    assert out.jtj[0, 0] == pytest.approx((slope**2).sum(), rel=5e-3, abs=1e-9)


def test_swarm_of_different_pipes_equals_one_by_one(kernel: Kernel) -> None:
    u, net = drive(), kernel.network
    full = np.tile(net.values, (35, 1))
    full[:, net.index(["tube.volume"])[0]] = np.linspace(0.2, 1.4, 35)
    full[:, net.index(["stream.factor"])[0]] = np.linspace(1.5, 0.5, 35)
    full[:, net.index(["relay.dead_time_s"])[0]] = np.linspace(0.0, 9.0, 35)
    together = kernel.trace(full, REST, TIME, u)[0]
    for k in (0, 1, 17, 34):
        # lanes of a block share their step, a particle alone has its own
        assert np.abs(together[k] - kernel.trace(full[k], REST, TIME, u)[0][0]).max() < 5e-4


def test_a_run_cut_into_pieces_goes_on_where_it_was(line: Network) -> None:
    own = line.with_values(
        {"tube.wall_capacity": 800.0, "relay.dead_time_s": 6.0, "relay.lag_s": 5.0, "T_b_C.lag_s": 7.0}
        | {"mass.capacity": 2000.0, "mass.conductance": 50.0}
    )
    whole, u = Kernel(own, ()), drive()
    readings, end = whole.trace(own.values, REST, TIME, u)
    state, rows = REST, []
    for first in range(0, N - 1, 37):
        part, state = whole.trace(own.values, state, TIME[first : first + 38], u[first : first + 38])
        rows.append(part[0, (first > 0) :])
    assert np.abs(np.vstack(rows) - readings[0]).max() < 1e-9
    assert state.shape == (1, whole.size)
    assert np.nanmax(np.abs(state - end)[0, : whole.size - 128]) < 1e-9


def test_heat_is_neither_made_nor_lost_in_pipes_and_masses() -> None:
    closed = parse(
        LINE.replace('inlet = "T_in_C"', "")
        .replace("capacity = 0.0", "capacity = 3000.0")
        .replace("{ value = 0.0, status", "{ value = 60.0, status")
        .replace("volume = 1.03", "volume = 1.5\nwall_capacity = 1200.0")
    )
    u = drive()
    u[:, 0] = 70.0  # a pipe in which the flow stands holds water that the balance below does not count
    kernel = Kernel(closed, ())
    _, end = kernel.trace(closed.values, np.array([50.0, 20.0]), TIME, u)
    # at the end everything is mixed: the heat put in, over all capacities
    later = np.arange(8000.0)
    rest = np.tile([70.0, 20.0, 0.0, 15.0], (8000, 1))
    final = kernel.trace(closed.values, end, later, rest)[0][0, -1]
    put_in = (u[:-1, 2] * np.diff(TIME)).sum() + u[-1, 2] * 0.0
    capacity = 8000.0 + 9000.0 + 3000.0 + 1200.0 + 1.5 * 0.997 * 4180.0
    stored = 8000.0 * 50.0 + (9000.0 + 3000.0) * 20.0 + (1200.0 + 1.5 * 0.997 * 4180.0) * 50.0
    assert final == pytest.approx(np.full(2, (stored + put_in) / capacity), abs=2e-3)


@settings(max_examples=60, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(data=st.data())
def test_no_corner_of_the_bounds_gives_nan(kernel: Kernel, data: st.DataObject) -> None:
    net = kernel.network
    full = net.values.copy()
    for name in ALL:
        p = net.parameters[name]
        edge = st.sampled_from([p.lower, p.upper, p.lower + 1e-9 * (p.upper - p.lower)])
        full[net.index([name])[0]] = data.draw(edge | st.floats(p.lower, p.upper), label=name)
    u = drive()[:40]
    u[:, 0] = data.draw(st.sampled_from([0.0, 1e-3, 5.0, 100.0]), label="pump")
    full = np.vstack([full, net.values])
    readings, _ = kernel.trace(full, REST, TIME[:40] * data.draw(st.sampled_from([1.0, 60.0])), u)
    assert np.isfinite(readings).all()
    assert np.abs(readings[1]).max() < 1e3


def test_a_file_keeps_places_and_shared_parameters() -> None:
    shared = parse(LINE.replace('columns = ["T_a_C"]', 'columns = ["T_a_C"]\nlag_s = { same_as = "T_b_C.lag_s" }'))
    assert parse(dump(shared)).parameters == shared.parameters
    changed = shared.with_values({"T_b_C.lag_s": 8.0})
    assert changed.parameters["T_a_C.lag_s"].value == 8.0


def test_a_kernel_with_whole_memory_goes_on_where_it_was(line: Network) -> None:
    whole = Kernel(line, ALL, whole_memory=True)
    values = line.values.copy()
    for name, value in {
        "tube.wall_capacity": 900.0,
        "tube.wall_hA": 40.0,
        "mass.capacity": 4000.0,
        "mass.conductance": 30.0,
        "relay.dead_time_s": 7.0,
        "relay.lag_s": 11.0,
        "T_b_C.lag_s": 23.0,
    }.items():
        values[line.index([name])[0]] = value
    u, cut = drive(), 170
    at_once, ends = whole.trace(values, REST, TIME, u)
    first, state = whole.trace(values, REST, TIME[: cut + 1], u[: cut + 1])
    second, last = whole.trace(values, state, TIME[cut:], u[cut:])
    assert np.abs(np.hstack([first[:, :cut], second]) - at_once).max() < 1e-9
    assert np.abs(last - ends)[np.isfinite(ends)].max() < 1e-9


@pytest.mark.parametrize("lanes", [1, 35])
def test_parameters_that_change_on_the_way_are_runs_one_after_the_other(line: Network, lanes: int) -> None:
    whole, u, rng = Kernel(line, ALL, whole_memory=True), drive(), np.random.default_rng(3)
    cuts = [0, 60, 61, 170, N - 1]
    full = np.tile(line.values, (len(cuts), lanes, 1))
    for name, high in {
        "tube.volume": 1.4,
        "tube.wall_capacity": 900.0,
        "tube.wall_hA": 40.0,
        "mass.capacity": 4000.0,
        "mass.conductance": 30.0,
        "relay.dead_time_s": 7.0,
        "relay.lag_s": 11.0,
        "T_b_C.lag_s": 23.0,
        "T_b_C.bias_K": 1.0,
        "stream.factor": 1.3,
    }.items():
        full[..., line.index([name])[0]] = high * rng.uniform(0.5, 1.0, (len(cuts), lanes))
    readings, end = whole.trace_pieces(full, np.tile(REST, (lanes, 1)), TIME, u, cuts)
    state, rows = np.tile(REST, (lanes, 1)), []
    for values, first, last in zip(full, cuts, [*cuts[1:], N], strict=True):
        part, state = whole.trace(values, state, TIME[first : last + 1], u[first : last + 1])
        rows.append(part[:, : last - first])
    assert np.abs(np.hstack(rows) - readings).max() < 1e-9
    assert np.abs(state - end)[np.isfinite(end)].max() < 1e-9
