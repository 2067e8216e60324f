"""Errors over the part of a record that no fit saw."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.discovery.basis import Columns
from twin.discovery.diagnosis import SensorError
from twin.discovery.grid import Grid, bridged
from twin.discovery.model import Model
from twin.discovery.noise import Noise
from twin.discovery.ranking import Finding
from twin.network import Array, Network

FAR_OFF, UNUSUAL, FAR_SHARE = 3.0, 1.5, 0.25
"""Times a thermometer's noise, and what is usual there, that block means may be off where a fit was not shown them, and
the share of the squares that re-tuning alone leaves: beyond all of them an answer is contradicted."""


def far_off(found: Mapping[str, SensorError], network: Network) -> bool:
    """Whether an answer is off by more than is usual where no fit was shown the record.

    The mean of several thermometers is off by more of its noise than one is: what a twin leaves does not average out.
    """
    single = {name: network.parameters[f"{name}.sigma"].value for name in found}
    return any(e.means[2] > max(FAR_OFF * single[name], UNUSUAL * e.usual) for name, e in found.items())


def contradicted(found: Mapping[str, SensorError], network: Network) -> bool:
    """Whether it is, and hardly better than re-tuning alone: its form, or what it follows, is another."""
    before, after = (sum((e.means[k] / e.noise) ** 2 for e in found.values()) for k in (1, 2))
    return far_off(found, network) and after > FAR_SHARE * before


def errors(
    finding: Finding, network: Network, record: Columns, grid: Grid, split: int, healthy: Noise | None = None
) -> dict[str, SensorError]:
    """RMSE per sensor over the held-out part, of free runs from the record's beginning.

    Args:
        healthy: noise with all that the twin's structure leaves, as a healthy record tells it.
    """
    time, inputs = record.time_s, bridged(network, record.time_s, record.inputs)
    late = time >= grid.time[split]
    runs = []
    for values, state, entries in (
        (network.values, finding.state, ()),
        (finding.retuned.values, finding.retuned.state, ()),
        *(((finding.fit.values, finding.fit.state, finding.fit.entries),) if finding.fit else ()),
    ):
        model = Model.of(finding.contest.probe, entries)
        sizes = np.array([[e.size for e in entries]])
        runs.append(model.run(time, inputs, state[None, : len(network.nodes)], values[None, :], sizes)[0])
    if finding.fit is None:
        runs.append(runs[1])
    usual = np.zeros(len(network.sensors))
    if healthy is not None:
        here = finding.contest.probe.run(grid, finding.state).readings[split:]
        usual = healthy.where_moved(here, grid.step_s).rms(len(here))
    out = {}
    for j, name in enumerate(network.sensor_names):
        off = [np.where(late, record.measured[:, j] - run[:, j], np.nan) for run in runs]
        raw = [_rms(x) for x in off]
        means = [_rms(binned(x, time, grid)) for x in off]
        if np.isfinite(raw[0]):
            of_means = (means[0], means[1], means[2])
            out[name] = SensorError(raw[0], raw[1], raw[2], float(network.sigma[j]), of_means, float(usual[j]))
    return out


def binned(values: Array, time: Array, grid: Grid) -> Array:
    where = np.minimum(((time - grid.time[0]) / grid.step_s + 1e-9).astype(np.intp), len(grid.time) - 1)
    good = np.isfinite(values)
    count = np.bincount(where[good], minlength=len(grid.time))
    total = np.bincount(where[good], values[good], len(grid.time))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _rms(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if good.size else float("nan")
