"""What a twin errs by that is no noise: its structure, which no number of samples averages away.

A healthy twin is off by some hundredths of a kelvin, and stays so for minutes. Samples are weighed accordingly: what is
alike for a minute counts once, whatever the sampling rate. What lasts longer moves parameters without showing in the
residuals, so the spread that it gives them is worked out apart, from how far the twin was off before it saw the window
(the sandwich of White, Econometrica 50 (1982) 1, with an error of given size and duration in place of the residuals).
"""

from __future__ import annotations

import numpy as np

from twin.calibrators.base import Window
from twin.calibrators.posterior import STATE_SD
from twin.gauss_newton import FitProblem
from twin.network import Array

MODEL_K = 0.02
"""What a healthy twin errs by, which no number of samples averages away."""
CORRELATED_S = 60.0
"""A healthy twin's error stays alike for so long: the samples in between count as one."""
PERSISTENCE_S = 300.0
"""How long an error is taken to last where its effect on parameters is worked out."""


def sample_sd(sigma: Array, time: Array) -> Array:
    """Standard deviation (m,), K, that one of the samples at `time` (n,) s counts with, noise `sigma` (m,) included."""
    alike = max(CORRELATED_S / _pace(time), 1.0)
    weighed: Array = np.sqrt(sigma**2 + MODEL_K**2 * alike)
    return weighed


def error_size(window: Window, sigma: Array) -> Array:
    """The twin's error (m,), K: what the live twin missed the window by beyond noise, `MODEL_K` at least."""
    squares = (window.live - window.measured) ** 2
    good = np.isfinite(squares)
    count = good.sum(axis=0)
    mean = np.where(good, squares, 0.0).sum(axis=0) / np.maximum(count, 1)
    found: Array = np.sqrt(MODEL_K**2 + np.where(count > 0, np.maximum(mean - sigma**2, 0.0), 0.0))
    return found


def persistent_error_covariance(
    problem: FitProblem, v: Array, precision: Array, error: Array, chi: float = 1.0
) -> Array:
    """Covariance (q + k, q + k) that errors which last give a fit at v.

    Args:
        precision: (q + k, q + k) of the fit; zero rows for what was held. error: (m,) K, constant over `LASTS_S` and
            independent from one such stretch, and from one sensor, to the next. chi: what the squares are divided by.
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
    problem: FitProblem, v: Array, normal: Array, held: np.ndarray, window: Window, wide: Array, chi: float = 1.0
) -> Array:
    """Covariance (q, q) in z that the twin's structure gives what a window was fitted by.

    An error that lasts is not averaged over windows, so no more than the widest prior holds against it.

    Args:
        problem, v: the window, with the weights that it was fitted with, and the fit. normal: (q + k, q + k) J'J there.
        held: (q,) bool, what the fit did not move. wide: (q,) widest prior standard deviations. chi: as for `spread`.
    """
    q, k = held.size, v.size - held.size
    apart = np.concatenate([wide, np.full(k, max(window.error_K, STATE_SD))])
    off = np.concatenate([held, np.zeros(k, dtype=bool)])
    precision = normal / chi
    precision[off] = 0.0
    precision[:, off] = 0.0
    precision += np.diag(np.where(off, 0.0, apart**-2.0))
    found: Array = persistent_error_covariance(
        problem, v, precision, error_size(window, problem.kernel.network.sigma), chi
    )[:q, :q]
    return found


def _pace(time: Array) -> float:
    """Sampling interval, s."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 1.0
