"""Structural error of a twin: the part of its error that no number of samples averages away.

A healthy twin is off by some hundredths of a kelvin, and stays so for minutes. Samples are weighed accordingly: an
error that is correlated over a minute counts once, whatever the sampling rate. Errors that last longer move parameters
without showing in the residuals. So the spread that they cause is computed apart, from the twin's error before it saw
the window. This is the sandwich of White, Econometrica 50 (1982) 1, with an error of given size and duration in place
of the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.base import Window
from twin.calibrators.posterior import STATE_SD, WindowPosterior
from twin.gauss_newton import FitProblem
from twin.network import Array, Network

MODEL_K = 0.02
"""Structural error of a healthy twin, K."""
CORRELATED_S = 60.0
"""Time over which a healthy twin's error is correlated, s: the samples in between count as one."""
PERSISTENCE_S = 300.0
"""Assumed duration of an error for its effect on parameters, s."""


@dataclass(frozen=True)
class HeldParameters:
    """Parameters that a fit did not move: `which` (q,) bool, and the `variance` (q,) in z with which each is known."""

    which: np.ndarray
    variance: Array

    @classmethod
    def of(cls, fitted: WindowPosterior) -> HeldParameters:
        """Return those of a fit, with the variances that they had before it."""
        return cls(fitted.held, np.diag(fitted.covariance))


def model_error(network: Network) -> Array:
    """Return the structural error of a healthy twin (m,): `MODEL_K`, of a meter as much in its own unit."""
    return np.asarray(MODEL_K / network.kelvin_per_unit)


def sample_sd(network: Network, time: Array) -> Array:
    """Return the standard deviation (m,), K or the reading's unit, of one of the samples at `time` (n,) s, noise
    included.
    """
    correlated = max(CORRELATED_S / _pace(time), 1.0)
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


def persistent_error_covariance(
    problem: FitProblem, v: Array, precision: Array, error: Array, chi: float = 1.0
) -> Array:
    """Return the covariance (q + k, q + k) that persistent errors cause in a fit at v.

    Parameters
    ----------
    problem, v
        The fitted window, and the fit.
    precision
        (q + k, q + k) of the fit; zero rows for held variables.
    error
        (m,) K, constant over `PERSISTENCE_S` and independent from one such segment, and from one sensor, to the next.
    chi
        Divisor of the squares.
    """
    data = problem.data
    pull = problem.jacobian(v) * (data.weight**2 / chi)[:, :, None]
    each = max(round(PERSISTENCE_S / _pace(data.time)), 1)
    sums = np.add.reduceat(pull, np.arange(0, len(pull), each), axis=0) * error[:, None]
    meat = np.einsum("bja,bjc->ac", sums, sums)
    covariance = np.linalg.pinv(precision, hermitian=True)
    found: Array = covariance @ meat @ covariance
    return found


def structural_covariance(
    problem: FitProblem,
    v: Array,
    normal: Array,
    held: HeldParameters,
    window: Window,
    wide: Array,
    chi: float = 1.0,
) -> Array:
    """Return the covariance (q, q) in z that a window's fit gets from what it does not estimate.

    That is the twin's structural error, and the values at which parameters are held: the others then stand for their
    errors too (consider parameters; Schmidt, Advances in Control Systems 3 (1966) 293). Neither is averaged over
    windows, so no more than the widest prior counts against them.

    Parameters
    ----------
    problem, v
        The window, with the weights of its fit, and the fit.
    normal
        (q + k, q + k) J'J at v.
    held
        Parameters that the fit did not move.
    window
        The window.
    wide
        (q,) widest prior standard deviations.
    chi
        As for `persistent_error_covariance`.
    """
    q, k = held.which.size, v.size - held.which.size
    apart = np.concatenate([wide, np.full(k, max(window.error_K, STATE_SD))])
    off = np.concatenate([held.which, np.zeros(k, dtype=bool)])
    precision = normal / chi
    cross = precision[:, off].copy()
    cross[off] = 0.0
    precision[off] = 0.0
    precision[:, off] = 0.0
    precision += np.diag(np.where(off, 0.0, apart**-2.0))
    shift = np.linalg.pinv(precision, hermitian=True) @ cross * np.sqrt(held.variance[held.which])
    error = error_size(window, problem.kernel.network)
    found: Array = (persistent_error_covariance(problem, v, precision, error, chi) + shift @ shift.T)[:q, :q]
    return found


def _pace(time: Array) -> float:
    """Return the sampling interval, s."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 1.0
