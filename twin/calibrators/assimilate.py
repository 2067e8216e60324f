"""Measurement updates of a Kalman filter, one reading after the other, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from twin.kernel import numba_may_cache


@njit(cache=numba_may_cache())  # type: ignore[untyped-decorator, unused-ignore]
def assimilate(
    jacobian: np.ndarray,
    predicted: np.ndarray,
    measured: np.ndarray,
    variance: np.ndarray,
    estimate: np.ndarray,
    covariance: np.ndarray,
    filtered: np.ndarray,
    spread: np.ndarray,
) -> tuple[float, int]:
    """Update an estimate of N quantities with n samples of m sensors, in place.

    Scalar updates, the noise of the sensors being independent, with the covariance in Joseph's form: symmetric and
    never negative in spite of rounding (Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and
    Navigation, 2001, sec. 7.3).

    Parameters
    ----------
    jacobian
        (n, m, N).
    predicted
        (n, m) at estimate 0.
    measured
        (n, m), NaN where masked.
    variance
        (m,).
    estimate, covariance
        (N,) and (N, N), updated in place.
    filtered, spread
        (n, m) output: the readings after each sample, and their standard deviations.

    Returns
    -------
    tuple
        Sum of the normalised innovations squared, and their number.
    """
    n, m, size = jacobian.shape
    total, count = 0.0, 0
    gain, shared = np.empty(size), np.empty(size)
    for i in range(n):
        for j in range(m):
            y = measured[i, j]
            if not np.isfinite(y):
                continue
            row = jacobian[i, j]
            error, expected = y - predicted[i, j], variance[j]
            for a in range(size):
                error -= row[a] * estimate[a]
                s = 0.0
                for b in range(size):
                    s += covariance[a, b] * row[b]
                shared[a] = s
            for a in range(size):
                expected += row[a] * shared[a]
            total += error * error / expected
            count += 1
            for a in range(size):
                gain[a] = shared[a] / expected
                estimate[a] += gain[a] * error
            for a in range(size):
                for b in range(a, size):
                    value = covariance[a, b] - gain[a] * shared[b] - shared[a] * gain[b] + gain[a] * gain[b] * expected
                    covariance[a, b] = value
                    covariance[b, a] = value
        for j in range(m):
            row = jacobian[i, j]
            reading, square = predicted[i, j], 0.0
            for a in range(size):
                reading += row[a] * estimate[a]
                s = 0.0
                for b in range(size):
                    s += covariance[a, b] * row[b]
                square += row[a] * s
            filtered[i, j] = reading
            spread[i, j] = np.sqrt(max(square, 0.0))
    return total, count
