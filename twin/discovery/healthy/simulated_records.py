"""Simulated healthy records of a twin, with the noise that it was commissioned with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twin.discovery.effects.probe import free_run
from twin.discovery.healthy.basis import Basis, Columns
from twin.discovery.healthy.health import WIDEN
from twin.discovery.records.grid import on_grid
from twin.kernel import simulate
from twin.network import Array, Network


def simulated_records(known: Basis, healthy: Columns, rng: np.random.Generator) -> Iterator[Columns]:
    """Yield records of one rig under the inputs of the healthy one, without end.

    The rig is the twin with parameters drawn from their commissioned distribution. A record has coloured noise of all
    periods, white noise in every sample, and the gaps of the healthy record. Single thermometers of a sensor keep their
    mean offset.
    """
    network = known.probe.network
    grid = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
    noise = (known.plain or known.noise).at_step(grid.step_s)
    state, *_ = free_run(known.probe, grid)
    q, scaling = known.probe.q, known.probe.scaling
    spread = np.linalg.inv(known.prior.precision[:q, :q]) / WIDEN
    z = rng.multivariate_normal(scaling.to_z(network.values[scaling.index]), spread, method="cholesky")
    values = network.values.copy()
    values[scaling.index] = scaling.to_values(np.clip(z, scaling.to_z(scaling.lower), scaling.to_z(scaling.upper)))
    time = healthy.time_s
    truth = simulate(network, time, healthy.inputs, state[: len(network.nodes)], values)
    bins = np.minimum(((time - time[0]) / grid.step_s + 1e-9).astype(np.intp), len(grid.time) - 1)
    while True:
        slow = noise.draw(len(grid.time), rng)[bins]
        white = network.sigma * rng.standard_normal(truth.shape)
        measured = truth + slow + white - _bin_means(white, bins)
        measured[~np.isfinite(healthy.measured)] = np.nan
        members = {
            name: _members(measured[:, network.sensor_names.index(name)], each, network, name, rng)
            for name, each in healthy.members.items()
        }
        yield Columns(time, healthy.inputs, measured, members)


def _members(mean: Array, healthy: Array, network: Network, name: str, rng: np.random.Generator) -> Array:
    """Return single readings (N, c) with the mean `mean` (N,) and the mean offsets of the healthy record."""
    count = healthy.shape[1]
    own = network.sigma[network.sensor_names.index(name)] * np.sqrt(count) * rng.standard_normal(healthy.shape)
    whole = healthy[np.isfinite(healthy).all(axis=1)]
    away = (whole - whole.mean(axis=1, keepdims=True)).mean(axis=0) if len(whole) else np.zeros(count)
    single: Array = mean[:, None] + away + own - own.mean(axis=1, keepdims=True)
    single[~np.isfinite(healthy)] = np.nan
    return single


def _bin_means(values: Array, bins: np.ndarray) -> Array:
    count = np.maximum(np.bincount(bins), 1)
    means = np.stack([np.bincount(bins, column) / count for column in values.T], axis=1)
    found: Array = means[bins]
    return found
