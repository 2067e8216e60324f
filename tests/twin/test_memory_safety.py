"""Compiled kernels stay inside their arrays, and what they give does not depend on how a record is cut or laid out."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.twin.conftest import ROOT
from twin.kernel import Kernel, mask_measurements, simulate
from twin.kernel.codegen import LANES, kernel_source
from twin.network import Network, TwinFileError
from twin.twinfile import load, parse

TWINS = ROOT / "profiles" / "twins"

# Pumps that stop, creep and jump, stamps that stand still and leap, windows from one sample to more than a delay line
# can hold, one particle and several that differ.
CHECKED = """
import sys
from pathlib import Path
import numpy as np
from twin.kernel import Kernel, mask_measurements, simulate
from twin.twinfile import load
net = load(Path(sys.argv[1]))
ids = net.tunables()
kernel = Kernel(net, ids)
rng = np.random.default_rng(0)
low, high = net.bounds(ids)
at = net.index(ids)
pump = [k for k, c in enumerate(net.input_columns) if "pump" in c or "flow" in c][0]
for n in (1, 2, 300):
    for step in (1.0, 13.0):
        time = np.cumsum(step * rng.choice([0.0, 0.2, 1.0, 7.0], n))
        u = np.tile(net.nominal_inputs, (n, 1)) * rng.uniform(0.8, 1.0, (n, 1))
        u[:, pump] *= rng.choice([0.0, 1e-6, 0.1, 1.0], n)
        full = np.tile(net.values, (3, 1))
        full[1:, at] = np.clip(full[1:, at] * rng.uniform(0.7, 1.4, (2, len(ids))), low, high)
        state = np.full(len(net.nodes), 30.0)
        y, weight = mask_measurements(np.full((n, len(net.sensors)), 30.0))
        for rows in (full[:1], full):
            first, end = kernel.trace(rows, state, time, u)
            again, end = kernel.trace(rows, end, time + time[-1], u)
            assert np.isfinite(first).all() and np.isfinite(again).all()
            kernel.cost(rows, end, time, u, y, weight)
print("inside")
"""


# A closed loop with all that makes a kernel address memory: two pipes, a film, a dead time, a lag, and as many nodes as
# make its integrator sum terms in a loop. Each further node adds seconds of compiling and no other kind of address.
RING = """
format = 1
name = "ring"
[inputs]
heater_power_W = { nominal = 700.0 }
pump_speed_pct = { nominal = 90.0 }
fan_speed_pct = { nominal = 70.0 }
T_ambient_C = { nominal = 22.0 }
[elements.heater]
kind = "node"
capacitance = { value = 3000.0, lower = 1000.0, upper = 9000.0 }
[elements.radiator]
kind = "node"
capacitance = { value = 5000.0, lower = 1000.0, upper = 9000.0 }
[elements.first]
kind = "node"
capacitance = 2000.0
[elements.second]
kind = "node"
capacitance = 2000.0
[elements.third]
kind = "node"
capacitance = 2000.0
[elements.fourth]
kind = "node"
capacitance = 2000.0
[elements.circuit]
kind = "flow"
path = ["heater", "first", "second", "third", "fourth", "radiator"]
pump = "pump_speed_pct"
nominal = { value = 3.8 }
factor = { value = 1.0, lower = 0.5, upper = 1.6 }
film = ["heater"]
film_exponent = { value = 0.4 }
effectiveness_heater = { value = 0.6, lower = 0.02, upper = 0.98 }
[elements.out]
kind = "pipe"
to = "first"
volume = { value = 0.3, lower = 0.0, upper = 5.0 }
[elements.back]
kind = "pipe"
to = "heater"
volume = { value = 0.5, lower = 0.0, upper = 5.0 }
[elements.fins]
kind = "radiator"
node = "radiator"
fan = "fan_speed_pct"
pump = "pump_speed_pct"
UA_100 = { value = 60.0, lower = 1.0, upper = 500.0 }
[elements.heater_power]
kind = "heat_source"
node = "heater"
driver = "heater_power_W"
[elements.relay]
kind = "actuator"
column = "heater_power_W"
dead_time_s = { value = 20.0, lower = 0.0, upper = 60.0 }
lag_s = { value = 15.0, lower = 0.0, upper = 60.0 }
[elements.T_radiator_C]
kind = "sensor"
node = "radiator"
columns = ["T_radiator_C"]
"""


def test_no_kernel_reads_or_writes_outside_its_arrays(tmp_path: Path) -> None:
    twin = tmp_path / "ring.toml"
    twin.write_text(RING, encoding="utf-8")
    ring = parse(RING)
    source = kernel_source(ring, "trace", ring.tunables(), LANES, False)
    assert all(f"def {part}(" in source for part in ("arrived", "two_terms", "tabulate", "fill_water"))
    # Every access is checked before LLVM optimises, which would take two thirds of the time here.
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "0", "XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", CHECKED, str(twin)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "inside"


@pytest.fixture(scope="module")
def pipe() -> Kernel:
    net = load(TWINS / "heated_pipe.toml")
    return Kernel(net, net.tunables("commission"))


def record(net: Network, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Irregular stamps, and inputs in steps with a pump that stops at times."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.choice([0.5, 1.0, 1.0, 4.0, 20.0], n))
    levels = np.repeat(rng.uniform(0.7, 1.0, (n // 20 + 1, len(net.input_columns))), 20, axis=0)[:n]
    inputs = net.nominal_inputs * levels
    inputs[:, 0] *= np.repeat(rng.choice([0.0, 0.05, 1.0, 1.0], n // 30 + 1), 30)[:n]
    return time, inputs


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(seed=459, cuts=[1])  # a piece of one interval of 20 s, in a record of mostly 1 s
@given(seed=st.integers(0, 1000), cuts=st.lists(st.integers(1, 239), max_size=5))
def test_cutting_a_record_changes_nothing(pipe: Kernel, seed: int, cuts: list[int]) -> None:
    net = pipe.network
    time, inputs = record(net, 240, seed)
    start = np.full(len(net.nodes), 18.0)
    whole, _ = pipe.trace(net.values, start, time, inputs)
    edges = [0, *sorted(set(cuts)), 239]
    state, rows = start, []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        part, state = pipe.trace(net.values, state, time[low : high + 1], inputs[low : high + 1])
        rows.append(part[0, (low > 0) :])
    assert np.abs(np.vstack(rows) - whole[0]).max() < 1e-9


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 1000), count=st.integers(2, 70))
def test_the_number_of_particles_changes_nothing(pipe: Kernel, seed: int, count: int) -> None:
    net = pipe.network
    time, inputs = record(net, 120, seed)
    start = np.full(len(net.nodes), 18.0)
    alone, end = pipe.trace(net.values, start, time, inputs)
    together, ends = pipe.trace(np.tile(net.values, (count, 1)), start, time, inputs)
    assert np.abs(together - alone).max() < 1e-9
    assert np.nanmax(np.abs(ends - end)) < 1e-9
    y, weight = mask_measurements(alone[0] + 0.1, 1.0)
    sse, _ = pipe.cost(np.tile(net.values, (count, 1)), start, time, inputs, y, weight)
    assert sse == pytest.approx(np.tile(sse[:1], (count, 1)), rel=1e-12)
    assert sse[0, 0] == pytest.approx(0.01 * len(time), rel=1e-6)


@pytest.mark.parametrize(
    ("noise", "dead_s", "rms", "most"), [(0.0, 600.0, 1e-7, 1e-6), (5.0, 150.0, 1e-7, 1e-6), (5.0, 600.0, 0.01, 0.3)]
)
def test_a_command_under_way_is_the_same_in_pieces_whether_it_is_smooth_or_measured(
    noise: float, dead_s: float, rms: float, most: float
) -> None:
    """A measured input changes with every sample, so that more changes are under way than a state remembers."""
    text = (TWINS / "loop.toml").read_text() + (
        f'\n[elements.late]\nkind = "actuator"\ncolumn = "heater_power_W"\ndead_time_s = {dead_s}\n'
    )
    network = parse(text)
    kernel, n = Kernel(network, ()), 1201
    t = np.arange(n, dtype=float)
    u = np.tile(network.nominal_inputs, (n, 1))
    u[:, 0] = np.where((t // 200) % 2 == 0, 1500.0, 200.0) + noise * np.random.default_rng(0).standard_normal(n)
    state = np.full((1, len(network.nodes)), 25.0)
    whole = kernel.trace(network.values, state, t, u)[0][0]
    # As one reading after the other, and in windows: means of means must not smear what is on its way.
    for width in (7, 330):
        at, rows = state, []
        for first in range(0, n - 1, width):
            part = slice(first, min(first + width + 1, n))
            readings, at = kernel.trace(network.values, at, t[part], u[part])
            rows.append(readings[0][:-1])
        off = np.concatenate(rows) - whole[:-1]
        assert np.sqrt(np.mean(off**2)) < rms and np.abs(off).max() < most


@pytest.mark.parametrize(
    ("form", "parameters"),
    [
        ("memory", "gain = -0.02\nlag_s = 50.0"),
        ("threshold", "size = -1.0\non = 60.0\noff = 50.0"),
        ("rate", "gain = 1.0\nlag_s = 100.0"),
    ],
)
def test_a_meter_reads_what_an_element_remembers_at_its_own_sample(form: str, parameters: str) -> None:
    """The same for every particle, and in pieces as in one go."""
    text = (TWINS / "loop.toml").read_text() + (
        f'\n[elements.wear]\nkind = "law_flow"\nflow = "circuit"\ndriver = "fan_speed_pct"\nform = "{form}"\n'
        f'change_in = "L_min"\n{parameters}\n'
        '\n[elements.M]\nkind = "meter"\nof = "circuit"\nquantity = "mass_flow"\ncolumns = ["M_kg_s"]\nsigma = 0.01\n'
    )
    network = parse(text)
    kernel, t, at = Kernel(network), 10.0 * np.arange(61.0), network.sensor_names.index("M")
    u = np.tile(network.nominal_inputs, (61, 1))
    u[:, network.input_columns.index("fan_speed_pct")] = np.where(t < 300.0, 100.0, 0.0)
    state = np.full((70, len(network.nodes)), 30.0)
    whole = kernel.trace(np.tile(network.values, (70, 1)), state, t, u)[0]
    assert np.ptp(whole[:, :, at], axis=0).max() < 1e-12
    _, end = kernel.trace(network.values, state[:1], t[:31], u[:31])
    later, _ = kernel.trace(network.values, end, t[30:], u[30:])
    np.testing.assert_allclose(later[0], whole[0, 30:], rtol=1e-9)
    if form == "memory":  # at rest it is its driver
        assert whole[0, 0, at] == pytest.approx(whole[0, 1, at], rel=1e-4)


def test_arrays_of_another_length_are_refused_before_a_kernel_reads_beyond_them() -> None:
    network = load(TWINS / "loop.toml")
    kernel, t = Kernel(network, ()), np.arange(1000.0)
    u, x = np.tile(network.nominal_inputs, (1000, 1)), np.full(len(network.nodes), 25.0)
    few = np.zeros((10, len(network.instruments)))
    with pytest.raises(TwinFileError, match="1000 stamps need as many rows"):
        simulate(network, t, u[:10], x)
    with pytest.raises(TwinFileError, match="finite parameters"):
        simulate(network, t, u, x, network.values[:3])
    with pytest.raises(TwinFileError, match="finite parameters"):
        simulate(network, t, u, x, np.where(np.arange(len(network.values)) == 1, np.nan, network.values))
    with pytest.raises(ValueError, match="must have the shape"):
        kernel.cost(network.values, x, t, u, few, few)
    with pytest.raises(ValueError, match="as many rows of inputs"):
        kernel.trace(network.values, x, t, u[:10])
    for cuts in ([0, 500], [0, -5], [3]):
        pieces = network.values[None, None] if cuts != [0, -5] else np.tile(network.values, (2, 1, 1))
        with pytest.raises(ValueError, match="as many cuts"):
            kernel.trace_pieces(pieces, x, t, u, cuts)
