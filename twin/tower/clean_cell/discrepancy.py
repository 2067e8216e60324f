"""Discrepancy of a clean cell's twin: a Gaussian process over the operating point, as a finite sum of Fourier features.

    delta(u) = sum over j of w_j (phi_j(u) - phi_j(u_design)),    phi = cos(omega_j x), sin(omega_j x)

x are the coordinates of the operating point in their correlation lengths; omega_j are drawn from the spectral density
of a Gaussian kernel by a low-discrepancy sequence, so that every record has the same features. The weights have
independent priors, so delta has standard deviation `AMPLITUDE_K` far from the design point and none at it, where the
clean cell was measured. A record corrects that amplitude (`twin.tower.smoother`). The weights are marginalised with the
deviations: a month of blocks at few operating points then teaches no more than the error at those points.

Sources: Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425 (model discrepancy); Rahimi & Recht, NIPS 2007 (features).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from twin.tower.air import Array

FREQUENCIES = 32
FEATURES = 2 * FREQUENCIES
AMPLITUDE_K = 0.1
"""Standard deviation of the twin's error that the terms of `twin.tower.model` leave: a third of the 0.3 K that Merkel's
method leaves of a Poppe tower in all weather. It is where the estimate of the amplitude begins."""
LENGTHS = (8.0, 5.0, 0.3, 0.3, 4.0)
"""Correlation lengths: wet bulb K, inlet above it K, shares of full speed and of design flow, wind m/s; about a third
of the range that a cell sees in a year."""
_PRIMES = (2, 3, 5, 7, 11)


def coordinates(wet: Array, drive: Array, speed: Array, flow: Array, wind: Array) -> Array:
    """Return operating points (n, 5) in correlation lengths."""
    return np.stack([wet, drive, speed, flow, wind], axis=1) / np.array(LENGTHS)


def features(points: Array, design: Array) -> Array:
    """Return the features of operating points (n, 5), less those of the design point (1, 5), as (n, `FEATURES`)."""
    return np.asarray(_waves(points) - _waves(design))


def prior_sd() -> float:
    """Return the standard deviation of a weight: that of delta far from the design point is `AMPLITUDE_K`."""
    # phi(u) - phi(design) of independent phases has twice the variance of phi, which is a half.
    return AMPLITUDE_K / float(np.sqrt(FEATURES))


def _waves(points: Array) -> Array:
    phase = points @ _OMEGA.T
    return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)


def _halton(count: int, base: int) -> Array:
    """Return terms 1 to `count` of van der Corput's sequence."""
    found = np.zeros(count)
    for i in range(count):
        k, share = i + 1, 1.0
        while k:
            share /= base
            found[i] += share * (k % base)
            k //= base
    return found


_OMEGA = np.stack([ndtri(_halton(FREQUENCIES, base)) for base in _PRIMES], axis=1)
