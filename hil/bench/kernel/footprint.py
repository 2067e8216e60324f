"""Long runs, memory and start-up cost: the parts of `hil bench twin` that need a process of their own."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from hil.bench.kernel import contestants
from hil.bench.kernel.windows import Job, drive, job
from hil.bench.measure import Cell, ReportTable, cpu_s, in_new_process
from hil.bench.peers.formulas import sensor_rows
from twin import Network

if TYPE_CHECKING:
    from hil.bench.kernel.speed import SpeedSize

LEVEL_S = 600
"""Time in s for which inputs keep a level in the long run."""

_START = """
import time, numpy as np
from pathlib import Path
began = time.process_time()
from twin.twinfile import load
from twin.kernel import Kernel
net = load(Path("profiles/twins/loop.toml"))
t = np.arange(600.0); u = np.tile(net.nominal_inputs, (600, 1)); y = np.zeros((600, len(net.sensors)))
Kernel(net, net.tunables("paper4")).cost(net.values, np.full(len(net.nodes), 30.0), t, u, y, y + 1.0)
print(time.process_time() - began)
"""

# Writing 5 to clear_refs sets the peak of the resident set back to what it is now (Linux).
_MEMORY = """
import numpy as np
from pathlib import Path
from twin.twinfile import load
from twin.kernel import Kernel
net = load(Path("profiles/twins/loop.toml"))
t = np.arange(600.0); u = np.tile(net.nominal_inputs, (600, 1)); y = np.zeros((600, len(net.sensors)))
kernel, state, w = Kernel(net, net.tunables("paper4")), np.full(len(net.nodes), 30.0), y + 1.0
kernel.cost(np.tile(net.values, (64, 1)), state, t, u, y, w)

def status(key):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1024.0 for line in lines if line.startswith(key))

bare = status("VmRSS")
particles = np.empty((COUNT, len(net.ids)))
particles[:] = net.values
asked = status("VmRSS")
Path("/proc/self/clear_refs").write_text("5")
kernel.cost(particles, state, t, u, y, w)
print(asked - bare, status("VmHWM") - asked)
"""


def process_steps(count: int, facts: dict[str, float]) -> Iterable[tuple[str, Callable[[], None]]]:
    """Measure memory of a swarm of `count`, and the first call in a new process without and with cached code."""

    def start() -> None:
        with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
            for name in ("cold_s", "cached_s"):
                facts[name] = in_new_process(_START, {"XDG_CACHE_HOME": folder})[0]

    def memory() -> None:
        facts["parameters_MB"], facts["memory_MB"] = in_new_process(_MEMORY.replace("COUNT", str(count)))

    return [("start of a new process", start), ("memory", memory)]


def whole_steps(
    network: Network, size: SpeedSize, seed: int, rows: list[tuple[Cell, ...]]
) -> Iterable[tuple[str, Callable[[], None]]]:
    """Return rows (method, CPU ms, error K, ratio) of one vector over `size.whole_h` hours."""
    from hil.bench.peers import scipy_ode

    samples = int(size.whole_h * 3600)
    window = job(network, "constant", count=1, samples=samples, seed=seed)
    inputs = np.repeat(drive(network, "each s", -(-samples // LEVEL_S), seed)[1], LEVEL_S, axis=0)[:samples]
    window = Job(
        network,
        window.ids,
        "levels",
        window.time,
        inputs,
        window.measured,
        window.weight,
        window.state,
        window.particles,
    )
    reads = sensor_rows(network)
    exact: list[np.ndarray] = []

    def step(name: str, prepare: Callable[[], Callable[[], np.ndarray]], *, states: bool) -> Callable[[], None]:
        def measure() -> None:
            if not exact:
                exact.append(contestants.oracle(window)[:, reads])
            call = prepare()
            out = call()
            readings = out[:, reads] if states else out
            error = float(np.abs(readings - exact[0]).max()) if readings.ndim == 2 else None
            ms = 1e3 * cpu_s(call, budget_s=size.budget_s, warm=False)
            first = rows[0][1] if rows else ms
            assert isinstance(first, float)
            rows.append((name, ms, error, ms / first))

        return measure

    def c() -> Callable[[], np.ndarray]:
        from hil.bench.peers.c_peer import prepared

        return prepared(window, 1, order=5)[1]

    plan = [
        ("ours, all readings", lambda: contestants.our_readings(window), False),
        ("ours, cost only", lambda: contestants.ours(window), False),
        ("C, all states", c, True),
        ("ivp LSODA, defaults", lambda: scipy_ode.ivp(window, "LSODA"), True),
        ("ivp LSODA 1e-9, restarted", lambda: scipy_ode.ivp_restarted(window, "LSODA", rtol=1e-9, atol=1e-9), True),
        ("odeint, defaults", lambda: scipy_ode.lsoda(window), True),
    ]
    for name, prepare, states in plan:
        yield f"{size.whole_h:g} h, {name}", step(name, prepare, states=states)


def whole_table(rows: list[tuple[Cell, ...]], hours: float) -> ReportTable:
    """Return the table of the long run."""
    return ReportTable(
        "whole",
        f"{hours:g} h at 1 Hz in one go, one parameter vector",
        ("method", "CPU ms", "error K", "x ours"),
        tuple(rows),
        (f"Inputs keep each level for {LEVEL_S} s.",),
    )
