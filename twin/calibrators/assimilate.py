"""Measurement updates of a Kalman filter, one reading after the other, compiled."""

from __future__ import annotations

import numpy as np

from twin.kernel import compile_kernel

_SOURCE = '''
@typed('void(f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], '
       'f8[::1], f8[:,::1])')
def kernel(jacobian, predicted, measured, variance, estimate, covariance, filtered, spread, found, work):
    """Rows of `work`: the gain, and the covariance of the estimate with the reading. A reading counts if finite."""
    size = jacobian.shape[2]
    for i in range(jacobian.shape[0]):
        for j in range(jacobian.shape[1]):
            y = measured[i, j]
            if y - y == 0.0:
                error, expected = y - predicted[i, j], variance[i, j]
                for a in range(size):
                    error -= jacobian[i, j, a] * estimate[a]
                    s = 0.0
                    for b in range(size):
                        s += covariance[a, b] * jacobian[i, j, b]
                    work[1, a] = s
                for a in range(size):
                    expected += jacobian[i, j, a] * work[1, a]
                found[0] += error * error / expected
                found[1] += 1.0
                for a in range(size):
                    work[0, a] = work[1, a] / expected
                    estimate[a] += work[0, a] * error
                for a in range(size):
                    for b in range(a, size):
                        value = covariance[a, b] - work[0, a] * work[1, b] - work[1, a] * work[0, b]
                        value = value + work[0, a] * work[0, b] * expected
                        covariance[a, b] = value
                        covariance[b, a] = value
        for j in range(jacobian.shape[1]):
            reading, square = predicted[i, j], 0.0
            for a in range(size):
                reading += jacobian[i, j, a] * estimate[a]
                s = 0.0
                for b in range(size):
                    s += covariance[a, b] * jacobian[i, j, b]
                square += jacobian[i, j, a] * s
            filtered[i, j] = reading
            spread[i, j] = max(square, 0.0) ** 0.5
'''


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
        (n, m), or (m,) for all samples.
    estimate, covariance
        (N,) and (N, N), updated in place.
    filtered, spread
        (n, m) output: the readings after each sample, and their standard deviations.

    Returns
    -------
    tuple
        Sum of the normalised innovations squared, and their number.
    """
    found, work = np.zeros(2), np.empty((2, jacobian.shape[2]))
    variance = np.broadcast_to(variance, measured.shape)
    given = [np.ascontiguousarray(a, dtype=np.float64) for a in (jacobian, predicted, measured, variance)]
    compile_kernel(_SOURCE)(*given, estimate, covariance, filtered, spread, found, work)
    return float(found[0]), int(found[1])
