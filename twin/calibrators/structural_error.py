"""Structural error of a twin: the part of its error that no number of samples averages away.

A healthy twin is off by some hundredths of a kelvin, and stays so for minutes. Samples are weighed accordingly: an
error that is correlated over a minute counts once, whatever the sampling rate. Errors that last longer move parameters
without showing in the residuals. So the spread that they cause is computed apart, from the twin's error before it saw
the window. This is the sandwich of White, Econometrica 50 (1982) 1, with an error of given size and duration in place
of the residuals.
"""

from __future__ import annotations

import numpy as np

from twin.calibrators.base import Window
from twin.gauss_newton import FitProblem
from twin.network import Array, Network

MODEL_K = 0.02
"""Structural error of a healthy twin, K."""
CORRELATED_S = 60.0
"""Time over which a healthy twin's error is correlated, s: the samples in between count as one."""
PERSISTENCE_S = 300.0
"""Assumed duration of an error for its effect on parameters, s."""


def model_error(network: Network) -> Array:
    """Return the structural error of a healthy twin (m,): `MODEL_K`, of a meter as much in its own unit."""
    return np.asarray(MODEL_K / network.kelvin_per_unit)


def sample_sd(network: Network, interval: Array | float) -> Array:
    """Return the standard deviation (..., m), K or the reading's unit, of one sample, noise included.

    Parameters
    ----------
    network
        The twin.
    interval
        (...) s from the sample before.
    """
    correlated = np.maximum(CORRELATED_S / np.asarray(interval), 1.0)[..., None]
    found: Array = np.sqrt(network.sigma**2 + model_error(network) ** 2 * correlated)
    return found


def error_size(window: Window, network: Network) -> Array:
    """Return the twin's error (m,), K or the reading's unit: that of the live twin in the window beyond noise,
    `model_error` at least.
    """
    squares = (window.live - window.measured) ** 2
    good = np.isfinite(squares)
    count = good.sum(axis=0)
    mean = np.where(good, squares, 0.0).sum(axis=0) / np.maximum(count, 1)
    found: Array = np.sqrt(
        model_error(network) ** 2 + np.where(count > 0, np.maximum(mean - network.sigma**2, 0.0), 0.0)
    )
    return found


def persistent_error_covariance(problem: FitProblem, v: Array, gain: Array, error: Array) -> Array:
    """Return the covariance (q + k, q + k) that persistent errors cause in a fit at v.

    Parameters
    ----------
    problem, v
        The fitted window, and the fit.
    gain
        (q + k, q + k) change of the estimate by a unit of the weighted squares' gradient: the inverse of the cost's
        curvature, prior included, with zero rows for held variables.
    error
        (m,) K, constant over `PERSISTENCE_S` and independent from one such segment, and from one sensor, to the next.
    """
    data = problem.data
    pull = problem.jacobian(v) * (data.weight**2)[:, :, None]
    each = max(round(PERSISTENCE_S / sampling_interval(data.time)), 1)
    sums = np.add.reduceat(pull, np.arange(0, len(pull), each), axis=0) * error[:, None]
    meat = np.einsum("bja,bjc->ac", sums, sums)
    found: Array = gain @ meat @ gain
    return found


def sampling_interval(time: Array) -> float:
    """Return the sampling interval, s."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 1.0
