"""Likelihood of a residual with unknown noise: its own spectrum is profiled out.

Without a healthy record the noise of a record is unknown. Cosine coefficients (DCT-II, per sensor) are taken as
independent, with the spectrum of white noise and of an exponentially correlated error,

    S(k) = sigma^2 (w + a / (1 + (k / k0)^2)),      w at least 1,

and each hypothesis has the w, a and k0 that maximise its likelihood. Twice the difference of two such likelihoods
compares two hypotheses, however slow their misfit is. Three numbers replace a variance for each band of periods: the
slowest bands hold so few cosines that an effect can explain them by chance.

Source: Whittle's likelihood with estimated spectrum (Whittle, J. R. Stat. Soc. B 15 (1953) 125); cosines instead of
sines and cosines, because a drift does not leak in them (Makhoul, IEEE Trans. ASSP 28 (1980) 27).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import dct

from twin.discovery.records.grid import filled
from twin.network import Array

RATIO = 1.5
"""Ratio of the end of a band to that of the next one; the likelihood is summed by bands."""
WHITE = 1.5 ** np.arange(12)
SLOW = np.concatenate([[0.0], 2.0 ** np.arange(-2.0, 22.0)])
"""Levels of white noise and of slow error that are tried, over the declared variance."""
CORNERS = 14
"""Values of w, of a, and the number of values of k0 that are tried."""


@dataclass(frozen=True)
class Spectrum:
    """Variance (n, m), K^2, of each sensor's cosine coefficients."""

    variance: Array

    @classmethod
    def white(cls, sigma: Array, n: int) -> Spectrum:
        """Return the spectrum of the declared noise (m,), K, alone, for n samples."""
        return cls(np.tile(sigma**2, (n, 1)))

    @property
    def roots(self) -> Array:
        """Return the standard deviation of each coefficient (n, m), K."""
        root: Array = np.sqrt(self.variance)
        return root


def cosines(values: Array, present: np.ndarray) -> Array:
    """Return the cosine coefficients (n, m, ...) of series (n, m, ...); gaps are interpolated first."""
    out: Array = dct(filled(values, present, 3), type=2, norm="ortho", axis=0)
    return out


@dataclass(frozen=True)
class SpectrumTable:
    """Table of spectra of n cosines, in units of sigma^2: `shapes` (s, n), by band `inverse` and `log` (s, b)."""

    shapes: Array
    starts: np.ndarray
    inverse: Array
    log: Array

    def sums(self, squares: Array) -> Array:
        """Return sums by band (bands, ...) of squares (n, ...)."""
        summed: Array = np.add.reduceat(squares, self.starts, axis=0)
        return summed

    def best(self, sums: Array) -> tuple[Array, np.ndarray]:
        """Return -2 log likelihood (c,) of sums of squares by band (bands, c), and the index of its spectrum."""
        cost = self.inverse @ sums + self.log.sum(axis=1)[:, None]
        which: np.ndarray = cost.argmin(axis=0)
        return cost[which, np.arange(sums.shape[1])], which


@lru_cache(maxsize=8)
def table(n: int) -> SpectrumTable:
    """Return the table of spectra of n cosines."""
    k = np.arange(n)
    starts = np.unique(np.concatenate([[0, 1, 2], np.floor(RATIO ** np.arange(2.0, 60.0))]).astype(int))
    starts = starts[starts < n]
    count = np.diff(np.append(starts, n))
    corners = np.geomspace(0.7, max(0.5 * n, 2.0), CORNERS)
    fall = 1.0 / (1.0 + (k / corners[:, None]) ** 2)
    rest = WHITE[:, None, None, None] + SLOW[1:, None, None] * fall
    shapes = np.vstack([np.repeat(WHITE[:, None], n, axis=1), rest.reshape(-1, n)])
    inverse = np.add.reduceat(1.0 / shapes, starts, axis=1) / count
    return SpectrumTable(shapes, starts, inverse, np.add.reduceat(np.log(shapes), starts, axis=1))


def judged(coefficients: Array, sigma: Array) -> tuple[float, Spectrum]:
    """Return -2 log likelihood of a residual (n, m) in cosines, up to a constant, and its likeliest spectrum."""
    tried = table(len(coefficients))
    cost, which = tried.best(tried.sums((coefficients / sigma) ** 2))
    return float(cost.sum()), Spectrum(tried.shapes[which].T * sigma**2)
