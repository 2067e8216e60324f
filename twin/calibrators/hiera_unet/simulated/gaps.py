"""Defects of a logger: gaps, bursts of missing samples, stuck values, coarse resolution, few samples."""

from __future__ import annotations

import numpy as np

from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.network import Array

SAMPLE_S = (1.0, 2.0, 5.0, 10.0)
SAMPLE_SHARES = (0.75, 0.08, 0.1, 0.07)
RESOLUTIONS_K = (0.01, 0.05, 0.1)
RESOLUTION_SHARES = (0.85, 0.1, 0.05)
CLEAN = 0.55
"""Share of records without any gap or stuck reading."""
DROPPED = (0.1, 0.25)
"""Share of the channels that are lost in records that lose channels."""

INPUTS_LOST = 0.25
"""Ratio of lost inputs to lost sensors."""


def logged(rng: np.random.Generator, readings: Array, sigma: Array) -> Array:
    """Return readings (n, Y), degC, with noise (Y,) K of one sample, averaged over the samples of a step, and
    rounded.
    """
    period = float(rng.choice(SAMPLE_S, p=SAMPLE_SHARES))
    resolution = float(rng.choice(RESOLUTIONS_K, p=RESOLUTION_SHARES))
    per_step = max(STEP_S / period, 1.0)
    noise = np.sqrt(sigma**2 + resolution**2 / 12.0) / np.sqrt(per_step)
    out = readings + noise * rng.standard_normal(readings.shape)
    if per_step == 1.0:
        out = np.round(out / resolution) * resolution
    if period > STEP_S:
        out[np.arange(len(out)) % int(period / STEP_S) != 0] = np.nan
    return out


def damaged(rng: np.random.Generator, inputs: Array, measured: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Return inputs (n, c) and measured (n, Y) with gaps and stuck values, and a description of them."""
    inputs, measured, said = inputs.copy(), measured.copy(), []
    if rng.uniform() < CLEAN:
        return inputs, measured, ()
    n, sensors = measured.shape
    count = sensors + inputs.shape[1]
    if rng.uniform() < 0.45:
        share = float(rng.uniform(*DROPPED))
        likely = np.concatenate([np.ones(sensors), np.full(count - sensors, INPUTS_LOST)])
        lost = rng.choice(count, size=max(round(share * count), 1), replace=False, p=likely / likely.sum())
        for k in lost:
            begin = int(rng.uniform(0.0, 0.6) * n) if rng.uniform() < 0.6 else 0
            if k < sensors:
                measured[begin:, k] = np.nan
            else:
                inputs[begin:, k - sensors] = np.nan
        said.append(f"{len(lost)} channels lost")
    if rng.uniform() < 0.5:
        for _ in range(int(rng.integers(1, 8))):
            begin, length = int(rng.uniform(0, n)), int(np.exp(rng.uniform(np.log(4), np.log(360))))
            rows = slice(begin, begin + length)
            if rng.uniform() < 0.5:
                measured[rows], inputs[rows] = np.nan, np.nan
            else:
                measured[rows, int(rng.integers(sensors))] = np.nan
        said.append("bursts missing")
    if rng.uniform() < 0.3:
        j, begin = int(rng.integers(sensors)), int(rng.uniform(0.2, 0.95) * n)
        end = n if rng.uniform() < 0.6 else min(begin + int(rng.uniform(60, 720)), n)
        measured[begin:end, j] = measured[begin, j]
        said.append("a reading stuck")
    if rng.uniform() < 0.15:
        lost_rows = rng.uniform(size=(n, sensors)) < rng.uniform(0.02, 0.4)
        measured[lost_rows] = np.nan
        said.append("samples missing here and there")
    return inputs, measured, tuple(said)
