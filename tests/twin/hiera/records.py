"""Short records of the loop, made by the twin itself, for tests of what the network is fed with."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from twin.calibrators.hiera_unet.data.channels import table
from twin.calibrators.hiera_unet.data.features import Features
from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries
from twin.kernel import Kernel
from twin.steady import steady_state
from twin.twinfile import load

NETWORK = load("profiles/twins/virtual.toml")
SIGMA_K = 0.02


@lru_cache(maxsize=1)
def features() -> Features:
    return Features(NETWORK, table(NETWORK), Deviations.of(NETWORK))


def operated(n: int, seed: int = 0) -> np.ndarray:
    """Inputs (n, c) with steps of everything."""
    rng = np.random.default_rng(seed)
    u = np.tile(NETWORK.nominal_inputs, (n, 1))
    for column, low, high, every in ((0, 450.0, 850.0, 170), (1, 60.0, 100.0, 410), (2, 50.0, 100.0, 290)):
        levels = rng.uniform(low, high, n // every + 1)
        u[:, column] = np.repeat(levels, every)[:n]
    return u


def made(n: int, theta: np.ndarray | None = None, onset: int = 0, seed: int = 0) -> ResampledSeries:
    """A record of the loop whose parameters deviate by `theta` from step `onset` on, with a little noise."""
    deviations = Deviations.of(NETWORK)
    u, kernel = operated(n, seed), Kernel(NETWORK, deviations.ids)
    state = steady_state(NETWORK, u[0])
    time = np.arange(n) * STEP_S
    changed = deviations.full(np.zeros(len(deviations)) if theta is None else theta, NETWORK.values)
    out = np.empty((n, len(NETWORK.sensors)))
    if onset > 0:
        rows, end = kernel.trace(NETWORK.values, state, time[: onset + 1], u[: onset + 1])
        out[: onset + 1], state = rows[0], end[0]
    out[onset:] = kernel.trace(changed, state, time[onset:], u[onset:])[0][0]
    noise = SIGMA_K * np.random.default_rng(seed + 1).standard_normal(out.shape)
    return ResampledSeries(time, u, out + noise, np.full(out.shape, np.nan))


def deviation(**values: float) -> np.ndarray:
    """theta (P,) with the named parameters moved; dots are written as two underscores."""
    deviations = Deviations.of(NETWORK)
    theta = np.zeros(len(deviations))
    for name, value in values.items():
        theta[deviations.ids.index(name.replace("__", "."))] = value
    return theta
