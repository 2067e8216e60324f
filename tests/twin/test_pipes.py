"""Networks with pipes against small plain steps that follow every piece of water."""

import numpy as np
import pytest

from tests.twin.conftest import ROOT
from tests.twin.test_remembering import LINE
from twin.kernel import Kernel, simulate
from twin.network import Network, TwinFileError
from twin.reference_simulation import simulate_fine_steps
from twin.twinfile import load, parse

TWINS = ROOT / "profiles" / "twins"


@pytest.fixture(scope="module")
def six() -> Network:
    return load(TWINS / "loop_six.toml")


def drive(net: Network, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Power, pump, fan and room, new each second."""
    rng = np.random.default_rng(1)
    inputs = np.tile(net.nominal_inputs, (n, 1)) * rng.uniform(0.75, 1.0, (n, len(net.inputs)))
    return np.arange(float(n)), inputs


def test_the_loop_of_six_modules_agrees_with_small_steps(six: Network) -> None:
    time, inputs = drive(six, 61)
    start = np.linspace(38.0, 34.0, len(six.nodes))  # so water of other temperatures stands in the pipes: jumps
    for share, most in ((0.6, 2e-4), (0.95, 2e-4)):
        net = six.with_values({"circuit.effectiveness_pm1": share})
        fine = simulate_fine_steps(net, time, inputs, start, 100)
        assert np.abs(fine - simulate_fine_steps(net, time, inputs, start, 50)).max() < most
        assert np.abs(simulate(net, time, inputs, start) - fine).max() < most


def test_a_swarm_on_the_loop_of_six_modules_agrees_with_one_by_one(six: Network) -> None:
    time, inputs = drive(six, 61)
    start = np.linspace(38.0, 34.0, len(six.nodes))
    ids = six.sets["paper4"].members
    kernel, index = Kernel(six, ids), six.index(ids)
    full = np.tile(six.values, (5, 1))
    full[:, index[0]] *= [0.5, 0.8, 1.0, 1.2, 1.5]
    for row in full:  # a parameter that others share is one parameter
        for name, p in six.parameters.items():
            if p.same_as:
                row[six.index([name])[0]] = row[six.index([p.same_as])[0]]
    together, _ = kernel.trace(full, start, time, inputs)
    for k, row in enumerate(full):
        assert (
            np.abs(together[k] - kernel.trace(row, start, time, inputs)[0][0]).max() < 1e-4
        )  # lanes of a block share their order


def test_steps_of_inlet_and_flow_in_a_pipe_agree_with_small_steps() -> None:
    net = load(TWINS / "heated_pipe.toml")
    time = np.arange(0.0, 240.0, 2.0)
    inputs = np.tile(net.nominal_inputs, (len(time), 1))
    inputs[5:, net.input_columns.index("T_water_in_C")] = 45.0
    inputs[40:60, net.input_columns.index("flow_pct")] = 20.0
    inputs[60:70, net.input_columns.index("flow_pct")] = 0.0
    inputs[90:, net.input_columns.index("T_water_in_C")] = 25.0
    start = np.full(len(net.nodes), 18.0)
    fine, finer = (simulate_fine_steps(net, time, inputs, start, pieces) for pieces in (100, 200))
    got = simulate(net, time, inputs, start)
    assert np.abs(finer - fine).max() < 1e-2
    # A step of 27 K loses its shape in the slot of 1/60 of the pipe that it falls into, but no heat.
    assert np.abs(got - finer).max() < 0.1
    assert np.abs(got - finer).mean() < 5e-3


def test_water_that_has_been_pushed_differently_is_taken_up_by_every_lane(six: Network) -> None:
    time, inputs = drive(six, 31)
    start = np.linspace(38.0, 34.0, len(six.nodes))
    apart, alike = Kernel(six, ("circuit.factor",)), Kernel(six, ("fins.UA_100",))
    full = np.tile(six.values, (3, 1))
    full[:, six.index(["circuit.factor"])[0]] = [0.7, 1.0, 1.3]
    _, ends = apart.trace(full, start, time, inputs)
    together, _ = alike.trace(np.tile(six.values, (3, 1)), ends, time, inputs)
    for k in range(3):
        alone, _ = alike.trace(six.values, ends[k], time, inputs)
        assert np.abs(together[k] - alone[0]).max() < 1e-3


def test_the_slow_simulation_refuses_actuators() -> None:
    net = parse(LINE).with_values({"relay.lag_s": 5.0})
    with pytest.raises(TwinFileError, match="actuators"):
        simulate_fine_steps(net, [0.0, 1.0], np.tile(net.nominal_inputs, (2, 1)), np.full(len(net.nodes), 20.0))
