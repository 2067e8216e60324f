"""Records of the loop under a load profile, from rest or settled, made as in `conftest`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tests.discovery.conftest import STEP_S
from twin.discovery.healthy.basis import Columns
from twin.kernel import Kernel
from twin.network import Array, Network

ROOM_C = 22.0
STEADY = {"heater_power_W": 700.0, "pump_speed_pct": 85.0, "fan_speed_pct": 70.0}


def steady(hours: float) -> tuple[Mapping[str, float], ...]:
    """A profile in which nothing ever changes."""
    return ({"time_s": 0.0, **STEADY}, {"time_s": 3600.0 * hours, **STEADY})


def inputs_of(network: Network, steps: Sequence[Mapping[str, float]]) -> tuple[Array, Array]:
    """Time (n,) s and inputs (n, c) of a profile whose last row is its end."""
    t: Array = np.arange(int(steps[-1]["time_s"] / STEP_S), dtype=np.float64) * STEP_S
    u = np.full((len(t), len(network.input_columns)), ROOM_C)
    for j, column in enumerate(network.input_columns):
        for step in steps:
            if column in step:
                u[t >= step["time_s"], j] = step[column]
    return t, u


def run(
    network: Network, steps: Sequence[Mapping[str, float]], changed: Network, onset_h: float = 0.0, seed: int = 1
) -> Columns:
    """Readings under a profile, of `network` until the onset and of `changed` from then on; begun settled."""
    t, u = inputs_of(network, steps)
    before = np.arange(0.0, 72_000.0, STEP_S)
    start = np.full(len(network.nodes), 36.0)
    _, ends = Kernel(network, ()).trace(network.values, start, before, np.tile(u[0], (len(before), 1)))
    state = ends[0][: len(network.nodes)]
    cut = int(np.searchsorted(t, 3600.0 * onset_h))
    parts = []
    if cut:
        read, ends = Kernel(network, ()).trace(network.values, state, t[: cut + 1], u[: cut + 1])
        parts.append(read[0][:-1])
        state = ends[0][: len(network.nodes)]
    parts.append(Kernel(changed, ()).trace(changed.values, state, t[cut:], u[cut:])[0][0])
    y = np.vstack(parts)
    return Columns(t, u, y + network.sigma * np.random.default_rng(seed).normal(0.0, 1.0, y.shape))
