"""A loop, and records made by it with something added that the loop does not know of.

The records come from the equations of the twin, so that a test runs in seconds; rigs with other physics are in
`tests/hil/test_diagnose.py` and `test_strangers.py`. A search costs by the minutes of a record, up to four hours. So
many tests ask a loop with little water, whose day is two hours long (`brisk`). It also costs by volumes, thermometers
and inputs, and so most of these take one of two volumes (`pair`). Where it matters how well a long record is told, they
take the loop as it is shipped (`bench`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.twin.conftest import LOOP
from twin.discovery.healthy.basis import Columns
from twin.kernel import Kernel
from twin.network import Array, Network
from twin.revisions import with_elements
from twin.twinfile import load

PAIR = Path(__file__).with_name("pair.toml")
STEP_S = 5.0
HOUR = 450.0
"""What an hour is to the loop with little water: loads change eight times as often, s."""
TANK, NOISE_K = 30_000.0, 0.02
"""Its heat capacity, J/K, and the noise of its thermometers: an eighth of the samples tells about as much."""


@dataclass(frozen=True)
class Bench:
    """Makes records of the loop; `inputs` are power, pump, fan and room, which change by the hour of `hour_s`."""

    network: Network
    hour_s: float = 3600.0
    start_C: tuple[float, ...] = (37.0, 36.8, 34.5, 34.0)

    def of(self, network: Network) -> Bench:
        """The bench of another rig."""
        return replace(self, network=network)

    def inputs(self, hours: float, seed: int) -> tuple[Array, Array]:
        rng = np.random.default_rng(seed)
        n = int(hours * self.hour_s / STEP_S)
        t = np.arange(n) * STEP_S
        pace = self.hour_s / 3600.0

        def levels(choices: list[float], hold_s: float) -> Array:
            drawn = rng.choice(choices, int(t[-1] / (pace * hold_s)) + 1)
            return np.asarray(drawn[(t / (pace * hold_s)).astype(int)], dtype=np.float64)

        power = levels([620.0, 700.0, 780.0, 860.0], 2400.0)
        pump, fan = levels([70.0, 85.0, 100.0], 5400.0), levels([50.0, 70.0, 100.0], 4500.0)
        return t, np.column_stack([power, pump, fan, 22.0 + 1.5 * np.sin(t / (pace * 14000.0))])

    def record(
        self,
        hours: float = 16.0,
        seed: int = 1,
        changed: Network | None = None,
        onset_h: float = 0.0,
        until_h: float = 1e9,
        noise: float = 1.0,
    ) -> Columns:
        """Readings of the loop, or of `changed` between two times; `noise` in that of its thermometers."""
        t, u = self.inputs(hours, seed)
        rng = np.random.default_rng(seed + 100)
        state: Array = np.array(self.start_C)
        parts, begun = [], 0
        cuts = [c for c in (onset_h * self.hour_s, until_h * self.hour_s) if 0.0 < c < t[-1]]
        for low, high in zip([0.0, *cuts], [*cuts, t[-1] + STEP_S], strict=True):
            on = changed is not None and onset_h * self.hour_s <= low < until_h * self.hour_s
            net = changed if on and changed is not None else self.network
            last = int(np.searchsorted(t, high))
            until = min(last + 1, len(t))
            read, ends = Kernel(net, ()).trace(net.values, state, t[begun:until], u[begun:until])
            parts.append(read[0][: last - begun])
            state, begun = ends[0][: len(net.nodes)], last
        y = np.vstack(parts)
        return Columns(t, u, y + noise * self.network.sigma * rng.normal(0.0, 1.0, y.shape))

    def with_element(self, name: str, table: dict[str, object]) -> Network:
        return with_elements(self.network, {name: table})

    def with_values(self, **values: float) -> Network:
        return self.network.with_values({k.replace("__", "."): v for k, v in values.items()})


def stopped(record: Columns) -> Columns:
    """The record with two stops of pump and heater, in which water stands in the sun."""
    inputs, measured = record.inputs.copy(), record.measured.copy()
    for first in (500, 1000):
        rows = slice(first, first + 50)
        inputs[rows, :3] = 0.0
        measured[rows] += np.linspace(0.0, 4.0, 50)[:, None]
    return replace(record, inputs=inputs, measured=measured)


@pytest.fixture(scope="session")
def bench() -> Bench:
    """The loop as it is shipped."""
    return Bench(load(LOOP))


@pytest.fixture(scope="session")
def healthy(bench: Bench) -> Columns:
    return bench.record(10.0, seed=7)


@pytest.fixture(scope="session")
def brisk() -> Bench:
    """A loop with little water and good thermometers, whose days are two hours long."""
    return Bench(well_read(load(LOOP)).with_values({"tank.capacitance": TANK}), HOUR)


@pytest.fixture(scope="session")
def brisk_healthy(brisk: Bench) -> Columns:
    return brisk.record(10.0, seed=7)


@pytest.fixture(scope="session")
def pair() -> Bench:
    """The same of two volumes: the heated modules, and the tank, which the fan cools."""
    return Bench(well_read(load(PAIR)), HOUR, (36.8, 34.0))


@pytest.fixture(scope="session")
def pair_healthy(pair: Bench) -> Columns:
    return pair.record(10.0, seed=7)


@pytest.fixture(scope="session")
def slow_pair(pair: Bench) -> Bench:
    """The loop of two volumes with the days, the water and the thermometers of the shipped one."""
    usual = load(LOOP).parameters
    names = (*(f"{s.name}.sigma" for s in pair.network.sensors), "tank.capacitance")
    return Bench(pair.network.with_values({name: usual[name].value for name in names}), start_C=pair.start_C)


@pytest.fixture(scope="session")
def slow_pair_healthy(slow_pair: Bench) -> Columns:
    return slow_pair.record(10.0, seed=7)


def well_read(network: Network) -> Network:
    """The network with good thermometers."""
    return network.with_values({f"{s.name}.sigma": NOISE_K for s in network.sensors})
