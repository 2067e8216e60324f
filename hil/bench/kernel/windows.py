"""Seeded windows of the coolant loop: courses of the inputs, swarms of parameter vectors, noisy measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin import Array, Network, mask_measurements, simulate

SCHEDULES = ("constant", "stepped", "each s")
LEVELS = 8
"""Distinct levels of a stepped window."""


@dataclass(frozen=True, slots=True)
class Job:
    """Window and swarm, the input of every contestant.

    Attributes
    ----------
    ids
        Parameters that differ between particles.
    particles
        (P, p) full vectors in the network's order.
    time
        (n,) s.
    inputs
        (n, c).
    measured, weight
        (n, m).
    state
        (k,) degC at the first sample.
    """

    network: Network
    ids: tuple[str, ...]
    schedule: str
    time: Array
    inputs: Array
    measured: Array
    weight: Array
    state: Array
    particles: Array

    def of(self, count: int) -> Job:
        """Return the same job for the first `count` particles."""
        return replace(self, particles=np.ascontiguousarray(self.particles[:count]))


def drive(network: Network, schedule: str, samples: int, seed: int) -> tuple[Array, Array]:
    """Return stamps (n,) at 1 Hz and inputs (n, c): heater power, pump, fan, room; anything else stays nominal."""
    rng = np.random.default_rng(seed)
    hold = {"constant": samples, "stepped": -(-samples // LEVELS), "each s": 1}[schedule]
    count = -(-samples // hold)
    columns = []
    for column, spec in network.inputs.items():
        if column == "heater_power_W":
            levels = rng.uniform(600.0, 900.0, count)
        elif column == "pump_speed_pct":
            levels = rng.uniform(70.0, 100.0, count)
        elif column == "fan_speed_pct":
            levels = rng.uniform(40.0, 100.0, count)
        elif column == "T_ambient_C":
            levels = 22.0 + 0.2 * rng.standard_normal(count)
        else:
            levels = np.full(count, spec.nominal)
        columns.append(np.repeat(levels, hold)[:samples])
    return np.arange(samples, dtype=np.float64), np.column_stack(columns)


def swarm(network: Network, tunables: str, count: int, seed: int) -> tuple[tuple[str, ...], Array]:
    """Return ids of a set of the twin and particles (P, p); particle 0 is the network itself.

    Positions are uniform in the set's initial ranges, held inside the parameters' bounds. A resistance keeps
    away from 0, where every explicit method pays with substeps.
    """
    chosen = network.sets[tunables]
    rng = np.random.default_rng(seed)
    low, high = network.bounds(chosen.members)
    initial = np.array(chosen.initial) * np.array(chosen.scale)[:, None]
    floor = np.where([name.endswith("resistance") for name in chosen.members], 0.2, -np.inf)
    values = np.clip(rng.uniform(initial[:, 0], initial[:, 1], (count, len(low))), np.maximum(low, floor), high)
    particles = np.tile(network.values, (count, 1))
    particles[1:, network.index(chosen.members)] = values[1:]
    return chosen.members, particles


def job(
    network: Network, schedule: str, *, count: int, samples: int = 600, tunables: str = "paper4", seed: int = 0
) -> Job:
    """Return a window measured on the network itself with its declared noise, and a swarm to be compared with it."""
    time, inputs = drive(network, schedule, samples, seed)
    state = steady_start(network)
    rng = np.random.default_rng(seed + 1)
    truth = simulate(network, time, inputs, state)
    measured, weight = mask_measurements(truth + network.sigma * rng.standard_normal(truth.shape))
    ids, particles = swarm(network, tunables, count, seed + 2)
    return Job(network, ids, schedule, time, inputs, measured, weight, state, particles)


def corners(window: Job) -> Job:
    """Return the same job with a particle in every corner of the bounds of its tunables."""
    low, high = window.network.bounds(window.ids)
    q = len(window.ids)
    upper = (np.arange(2**q)[:, None] >> np.arange(q)) & 1
    particles = np.tile(window.network.values, (2**q, 1))
    particles[:, window.network.index(window.ids)] = np.where(upper == 1, high, low)
    return replace(window, particles=particles)


def steady_start(network: Network) -> Array:
    """Return a plausible warm state (k,): falling along the network's order of nodes."""
    return np.linspace(38.0, 34.0, len(network.nodes))
