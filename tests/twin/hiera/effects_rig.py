"""Records of the shipped loop's own twin, with and without hidden heat, for the tests of the effects network."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from twin.calibrators.disturbance import with_power_probes
from twin.kernel import simulate
from twin.network import Array, Network
from twin.twinfile import load

PROJECT = Path(__file__).resolve().parents[3]
PERIOD_S, SIGMA_K = 5.0, 0.02
HEATED = "modules"


@cache
def twin() -> Network:
    return load(PROJECT / "profiles" / "twins" / "virtual.toml")


def record(
    hours: float, seed: int, power_W: float = 0.0, since_s: float = 0.0, bias_K: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return time, inputs and readings: `power_W` enters the modules from `since_s` on, `bias_K` the tank's reading."""
    rng = np.random.default_rng(seed)
    network = twin()
    t = np.arange(0.0, 3600.0 * hours + 0.5 * PERIOD_S, PERIOD_S)
    levels = rng.uniform(0.4, 1.0, (len(t) // 360 + 1, 3))
    shares = np.repeat(levels, 360, axis=0)[: len(t)]
    room = 22.0 + np.sin(t / 9000.0)
    inputs = np.column_stack([1000.0 * shares[:, 0], 100.0 * shares[:, 1], 100.0 * shares[:, 2], room])
    probed, powers = with_power_probes(network)
    state = network.initial_state(np.full(len(network.instruments), 35.0))
    acts = int(np.searchsorted(t, since_s))
    run = simulate(network, t, inputs, state)
    if power_W:
        heated = probed.with_values({powers[network.nodes.index(HEATED)]: power_W})
        run[acts:] = simulate(heated, t[acts:], inputs[acts:], run[acts])
    readings = run + SIGMA_K * rng.normal(size=run.shape)
    readings[acts:, network.nodes.index("tank")] += bias_K
    return t, inputs, readings
