"""Windows to be fitted: synthetic ones of a changed loop, or cut from a record."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hil.bench.kernel.windows import drive, steady_start
from twin import Array, Kernel, Network, mask_measurements, simulate
from twin.calibrators import Window, WindowSamples, make_window

SIGMA_K = 0.05
LEAST_RESISTANCE = 0.1
"""Least resistance, K/W; below it lies only the stiff corner of the box, where every method needs substeps."""


@dataclass(slots=True)
class Problem:
    """Window, the tunables `ids` (q,) and their box; counts the requested simulations.

    Positions lie in [0, 1]: shares of a parameter's range, of its logarithm where the bounds span a decade.

    Attributes
    ----------
    window
        Of kind calibrated, so that everyone minimises the RMSE over all of it.
    tunables
        Name of the twin's set.
    start
        (q,) positions of the live twin.
    truth
        (q,) positions that made the window, None for a measured one.
    """

    network: Network
    tunables: str
    window: Window
    truth: Array | None = None
    evaluations: int = 0
    ids: tuple[str, ...] = field(init=False)
    kernel: Kernel = field(init=False)
    _low: Array = field(init=False)
    _high: Array = field(init=False)
    _log: np.ndarray = field(init=False)
    _data: tuple[Array, Array] = field(init=False)

    def __post_init__(self) -> None:
        self.ids = self.network.tunables(self.tunables)
        self.kernel = Kernel(self.network, self.ids)
        self._low, self._high = box(self.network, self.ids)
        self._log = (self._low > 0.0) & (self._high >= 10.0 * self._low)
        self._data = mask_measurements(self.window.measured)

    @property
    def start(self) -> Array:
        """Return positions (q,) of the twin before the fit."""
        return self.positions(self.window.parameters[self.network.index(self.ids)])

    def values(self, positions: Array) -> Array:
        """Convert positions (..., q) in [0, 1] to physical values."""
        x = np.clip(positions, 0.0, 1.0)
        safe = np.where(self._log, self._low, 1.0)
        ratio = np.where(self._log, self._high, 1.0) / safe
        return np.where(self._log, safe * ratio**x, self._low + (self._high - self._low) * x)

    def positions(self, values: Array) -> Array:
        """Convert physical values (..., q) to positions."""
        safe = np.where(self._log, self._low, 1.0)
        ratio = np.where(self._log, self._high, np.e) / safe
        logarithmic = np.log(np.where(self._log, np.maximum(values, 1e-300), 1.0) / safe) / np.log(ratio)
        found = np.where(self._log, logarithmic, (values - self._low) / (self._high - self._low))
        return np.clip(found, 0.0, 1.0)

    def full(self, positions: Array) -> Array:
        """Return full parameter vectors (P, p) at positions (P, q)."""
        rows = np.atleast_2d(positions)
        full = np.tile(self.window.parameters, (len(rows), 1))
        full[:, self.network.index(self.ids)] = self.values(rows)
        return full

    def rmse(self, positions: Array, state: Array | None = None) -> Array:
        """Return the RMSE in K (P,) over all finite readings, at positions (P, q)."""
        full, w = self.full(positions), self.window
        self.evaluations += len(full)
        y, weight = self._data
        at = w.state if state is None else state
        sse, _ = self.kernel.cost(full, at, w.time, w.inputs, y, weight)
        found: Array = np.sqrt(np.maximum(sse.sum(axis=1), 0.0) / max(float(weight.sum()), 1.0))
        return np.where(np.isfinite(found), found, 1e6)

    def residuals(self, positions: Array, states: Array | None = None) -> Array:
        """Return residuals (P, r) in K at positions (P, q), over finite readings, each divided by the root of their
        number.
        """
        w = self.window
        full = self.full(positions)
        self.evaluations += len(full)
        readings, _ = self.kernel.trace(full, w.state if states is None else states, w.time, w.inputs)
        y, weight = self._data
        good = weight > 0.0
        found: Array = (readings - y)[:, good] / np.sqrt(max(int(good.sum()), 1))
        return found


def box(network: Network, ids: tuple[str, ...]) -> tuple[Array, Array]:
    """Return bounds (q,) that all contestants share: the twin file's, without the stiff corner."""
    low, high = network.bounds(ids)
    stiff = np.array([name.endswith("resistance") for name in ids])
    return np.where(stiff, np.maximum(low, LEAST_RESISTANCE), low), high


def equal_noise(network: Network) -> Network:
    """Return the network with the same noise at every sensor, so that weighted and plain squares have one optimum."""
    return network.with_values({f"{s.name}.sigma": SIGMA_K * np.sqrt(len(s.measured)) for s in network.sensors})


def made_up(network: Network, tunables: str, count: int, seed: int, samples: int = 600) -> list[Problem]:
    """Return `count` windows of a loop whose tunables have moved, with noise; the twin still has the network's values.

    Each tunable moves by a uniform share of its range (of its logarithm) of up to 0.15 either way.
    """
    network = equal_noise(network)
    problems = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        time, inputs = drive(network, "stepped", samples, seed=1000 * (seed + 1) + k)
        state = steady_start(network) + rng.normal(0.0, 0.5, len(network.nodes))
        empty = _window(network, time, inputs, np.zeros((samples, len(network.sensors))), state)
        problem = Problem(network, tunables, empty)
        truth = np.clip(problem.start + rng.uniform(-0.15, 0.15, len(problem.ids)), 0.02, 0.98)
        clean = simulate(network, time, inputs, state, problem.full(truth)[0])
        noisy = clean + SIGMA_K * rng.standard_normal(clean.shape)
        problems.append(Problem(network, tunables, _window(network, time, inputs, noisy, state), truth))
    return problems


def measured(network: Network, tunables: str, record: Path, count: int) -> list[Problem]:
    """Return `count` whole windows, evenly spread over a record; each starts at the state of its first readings."""
    from hil.record import read_record

    network = equal_noise(network)
    data = read_record(record)
    data.require(*network.input_columns)
    inputs, readings = network.select(data.columns)
    length = network.rules.window_s
    edges = np.arange(data.time_s[0], data.time_s[-1] - length, length)
    problems = []
    for begin in edges[np.unique(np.linspace(0, len(edges) - 1, min(count, len(edges))).astype(int))]:
        rows = slice(*np.searchsorted(data.time_s, [begin, begin + length]))
        if rows.stop - rows.start < 60 or not np.isfinite(inputs[rows]).all():
            continue
        state = network.initial_state(readings[rows][:30])
        window = _window(network, data.time_s[rows].copy(), inputs[rows].copy(), readings[rows].copy(), state)
        problems.append(Problem(network, tunables, window))
    return problems


def _window(network: Network, time: Array, inputs: Array, readings: Array, state: Array) -> Window:
    live = simulate(network, time, inputs, state)
    window = make_window(0, WindowSamples(time, inputs, readings), state, network.values.copy(), live, network.rules)
    return replace(window, kind="calibrated")
