"""Noise of a healthy residual, and its weights: one covariance for each band of periods.

The residual of a healthy twin is not white, because the twin is lumped and the rig is not. In the cosine transform
(DCT-II, along time, per sensor) its coefficients are nearly independent, and their covariance across sensors depends on
the period alone. Learned from a healthy record it serves records of any length. Cosines replace the Fourier transform,
because a drift does not leak in them (Makhoul, IEEE Trans. ASSP 28 (1980) 27).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.fft import dct, idct

from twin.network import Array

EDGES_S = (3600.0, 1200.0, 420.0, 120.0, 40.0)
"""Periods, s, between the bands."""
CAUTION = (4.0, 2.0, 1.5, 1.2, 1.1, 1.1)
"""Factor on the variance of each band: a healthy record of ten hours has few of the longest periods."""
LEAST_SHARE, MOST_SHARE = 0.04, 16.0
"""Limits of the model error's variance, as a multiple of that in the healthy record."""
EXPONENTS = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Powers of the readings' power that the model error's power may follow. A judgement: finer steps are hardly
identifiable."""
PARTS = 4
"""Parts of a healthy record, of which some may move less than others. A judgement: each holds some load changes."""
SURELY = 1.92
"""Log likelihood by which a lower power has to be likelier: half the 95 % quantile of chi-squared of one variable."""
PLACES = 8
"""Places between two steps of a rounded reading that are averaged."""
SHRINK = 0.3
"""Relative shrinkage of each covariance's off-diagonal."""


@dataclass(frozen=True)
class Noise:
    """Whitening by band for m sensors.

    `roots` (bands, m, m), symmetric, with roots @ roots = covariance^-1 of one bin of `step_s`; `sd` (bands, m), K;
    `white` (m,), K, noise of the thermometers alone in a bin; `moves` (bands,), K^2, power of the twin's readings in
    the record that it was learned from, or None if it holds for that record alone; `follows`, the power of a calmer
    record's moves that the model error's power goes with; `relative` (bands, m, m), covariance in whitened units that a
    record's own residual leaves of the healthy one (`relative_covariances`), or None; `resolution` (m,), K, of the
    readings that it was learned from, or None.
    """

    roots: Array
    sd: Array
    step_s: float
    white: Array
    moves: Array | None = None
    follows: float = 1.0
    relative: Array | None = None
    resolution: Array | None = None

    def where_moved(self, readings: Array, step_s: float, resolution: Array | None = None) -> Noise:
        """Return the noise to expect in a record in which the twin's readings (n, m), degC, are these.

        The model error of a lumped twin is proportional to the variation: measured on a distributed plant, its
        standard deviation follows that of the twin's readings, band by band, within a few per cent. The part beyond the
        thermometers' own noise is therefore scaled by it. The slowest band, of too few coefficients, is only scaled up.
        A rig may have errors that its twin's readings do not follow, though. If the calm parts of the healthy record
        have more error than by this rule, that of a calmer record falls by a lower power of its moves. Never is the
        noise less than that of the thermometers.

        Readings of a coarser `resolution` (m,), K, than in health have the error of rounding, too. Between two steps of
        the reading it follows the temperature, so that it is not white, and known from the twin's readings.
        """
        if self.moves is None:
            return self
        now = power(readings, step_s) * step_s
        ratio = np.clip(now / np.maximum(self.moves * self.step_s, 1e-12), LEAST_SHARE, MOST_SHARE)
        ratio = np.where(ratio < 1.0, ratio**self.follows, ratio)
        ratio[0] = max(ratio[0], 1.0)
        roots, sd = self.roots.copy(), self.sd.copy()
        floor = np.diag(self.white**2)
        rounded = self._rounded(readings, step_s, resolution) * step_s / self.step_s
        for b in range(len(ratio)):
            inverse = self._inverses[b]
            values, vectors = np.linalg.eigh(inverse.T @ inverse - CAUTION[b] * floor)
            structure = vectors * np.maximum(values, 0.0) @ vectors.T
            covariance = CAUTION[b] * (floor + np.diag(rounded[b])) + ratio[b] * structure
            if self.relative is not None:
                half = _power(covariance, 0.5)
                white = np.outer(self.white, self.white)
                values, vectors = np.linalg.eigh(half @ self.relative[b] @ half / white)
                covariance = (vectors * np.maximum(values, 1.0)) @ vectors.T * white
            roots[b], sd[b] = _root(covariance)
        return Noise(roots, sd, self.step_s, self.white, relative=self.relative)

    def _rounded(self, readings: Array, step_s: float, resolution: Array | None) -> Array:
        """Return the mean square (bands, m), K^2, of the cosine coefficients of rounding that health did not have."""
        if resolution is None:
            return np.zeros((len(EDGES_S) + 1, readings.shape[1]))
        before = np.zeros_like(resolution) if self.resolution is None else self.resolution
        steps = np.maximum(resolution, 1e-9)
        more: Array = np.maximum(1.0 - (before / steps) ** 2, 0.0)
        return rounding_power(readings, steps, step_s) * more

    @property
    def expected(self) -> Array:
        """Return the mean square (bands,) of a whitened coefficient of noise: less than 1 by the factors `CAUTION`.

        What a record's own residual leaves of the noise uses up these factors first.
        """
        caution = np.array(CAUTION)
        if self.relative is None:
            return 1.0 / caution
        found: Array = np.minimum(1.0 / (caution[:, None] * np.linalg.eigvalsh(self.relative)), 1.0).mean(axis=1)
        return found

    def of_thermometers(self) -> Noise:
        """Return the noise of the thermometers alone, without model error."""
        count = len(self.sd)
        roots = np.stack([np.diag(1.0 / self.white)] * count)
        return Noise(roots, np.tile(self.white, (count, 1)), self.step_s, self.white)

    def whiten(self, values: Array, step_s: float | None = None) -> Array:
        """Return whitened cosine coefficients (n, m, ...) of values (n, m, ...) in time.

        Args:
            step_s: of `values` if they are means over longer bins.
        """
        step = step_s or self.step_s
        c = dct(values, type=2, norm="ortho", axis=0)
        flat = c.reshape(c.shape[0], c.shape[1], -1)
        out = np.empty_like(flat)
        roots = np.sqrt(step / self.step_s) * self.roots
        for b, rows in _rows_of_bands(len(c), step):
            if flat.shape[2] == 1:
                np.matmul(flat[rows, :, 0], roots[b], out=out[rows, :, 0])
            else:
                np.matmul(roots[b].T, flat[rows], out=out[rows])
        whitened: Array = out.reshape(c.shape)
        return whitened

    @cached_property
    def _inverses(self) -> Array:
        """Return the inverse (bands, m, m) of each root."""
        return np.asarray(np.linalg.inv(self.roots), dtype=np.float64)

    def rms(self, n: int) -> Array:
        """Return the root mean square (m,), K, of `n` bins in a row."""
        found: Array = np.sqrt((self.sd[bands(n, self.step_s)] ** 2).mean(axis=0))
        return found

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return random noise (n, m), K, of n bins as learned, without the factors `CAUTION` of the weights."""
        whitened = rng.standard_normal((n, len(self.white)))
        return self.colour(whitened / np.sqrt(np.array(CAUTION))[bands(n, self.step_s), None])

    def colour(self, whitened: Array, step_s: float | None = None) -> Array:
        """Invert `whiten`, for (n, m)."""
        step = step_s or self.step_s
        out = np.empty_like(whitened)
        scale = np.sqrt(step / self.step_s)
        for b, rows in _rows_of_bands(len(whitened), step):
            out[rows] = whitened[rows] @ self._inverses[b] / scale
        series: Array = idct(out, type=2, norm="ortho", axis=0)
        return series

    def at_step(self, step_s: float) -> Noise:
        """Return the same noise for means over bins of another length."""
        share = np.sqrt(step_s / self.step_s)
        moves = None if self.moves is None else self.moves / share**2
        white = self.white / share
        return replace(self, roots=self.roots * share, sd=self.sd / share, step_s=step_s, white=white, moves=moves)


def bands(n: int, step_s: float) -> np.ndarray:
    """Return the band (n,) of each of n cosine coefficients; 0 holds the longest periods."""
    period = 2.0 * n * step_s / np.maximum(np.arange(n), 0.5)
    band: np.ndarray = np.searchsorted(-np.array(EDGES_S), -period, side="right")
    return band


@cache
def _rows_of_bands(n: int, step_s: float) -> tuple[tuple[int, slice], ...]:
    """Return the bands among n cosine coefficients with the rows of each, which are next to each other."""
    band = bands(n, step_s)
    found, first = np.unique(band, return_index=True)
    return tuple((int(b), slice(i, j)) for b, i, j in zip(found, first, [*first[1:], n], strict=True))


def power(readings: Array, step_s: float) -> Array:
    """Return the mean square (bands,), K^2, of the cosine coefficients of readings (n, m); 0 for an empty band."""
    c = dct(readings - readings.mean(axis=0), type=2, norm="ortho", axis=0)
    band = bands(len(c), step_s)
    squares = np.bincount(band, (c**2).mean(axis=1), len(EDGES_S) + 1)
    found: Array = squares / np.maximum(np.bincount(band, minlength=len(EDGES_S) + 1), 1)
    return found


def rounding_power(readings: Array, steps: Array, step_s: float) -> Array:
    """Return the mean square (bands, m), K^2, of the cosine coefficients of readings (n, m) rounded to steps (m,).

    The twin tells how far readings move, and not where between two steps they are: all places are equally likely.
    """
    found = []
    for place in (np.arange(PLACES) + 0.5) / PLACES:
        error = (np.round(readings / steps + place) - readings / steps - place) * steps
        found.append(dct(error, type=2, norm="ortho", axis=0) ** 2)
    squares = np.zeros((len(EDGES_S) + 1, readings.shape[1]))
    for b, rows in _rows_of_bands(len(readings), step_s):
        squares[b] = np.mean(found, axis=0)[rows].mean(axis=0)
    return squares


def learn(
    residual: Array, sigma: Array, step_s: float, readings: Array | None = None, resolution: Array | None = None
) -> Noise:
    """Learn the noise from a healthy residual (n, m), K, without NaN.

    Args:
        sigma: (m,) K, white noise of a bin, the least of any band.
        readings: (n, m) degC, the twin's own, if the noise is to be scaled to the variation of other records.
        resolution: (m,) K, of the record's readings.
    """
    n, m = residual.shape
    c = dct(residual, type=2, norm="ortho", axis=0)
    band = bands(n, step_s)
    roots, sd = np.empty((len(EDGES_S) + 1, m, m)), np.empty((len(EDGES_S) + 1, m))
    floor = np.diag(sigma**2)
    below: Array | None = None
    for b in range(len(EDGES_S), -1, -1):
        rows = c[band == b]
        few = floor if below is None else below
        below = rows.T @ rows / len(rows) if len(rows) >= 2 * m else few
        covariance = below * np.where(np.eye(m) > 0, 1.0, 1.0 - SHRINK)
        # The white noise is known; a band quieter than that is chance.
        short = np.maximum(np.diag(floor) - np.diag(covariance), 0.0)
        roots[b], sd[b] = _root((covariance + np.diag(short)) * CAUTION[b])
    if readings is None:
        return Noise(roots, sd, step_s, sigma)
    follows = _exponent(residual, sigma, step_s, readings)
    return Noise(roots, sd, step_s, sigma, power(readings, step_s), follows, resolution=resolution)


def _exponent(residual: Array, sigma: Array, step_s: float, readings: Array) -> float:
    """Return the power of the readings' power, in parts of a healthy record, that the model error's power goes with.

    In each band and part the coefficients of the residual, relative to noise, have the variance 1 + a m^p, with m the
    power of the readings. Of the `EXPONENTS` p it is the first, unless another is surely likelier.
    """
    length = len(residual) // PARTS
    if length < 2:
        return EXPONENTS[0]
    band = bands(length, step_s)
    rows = [slice(k * length, (k + 1) * length) for k in range(PARTS)]
    c = [dct(residual[r] / sigma, type=2, norm="ortho", axis=0) for r in rows]
    squares = np.array([[(part[band == b] ** 2).sum() for b in range(len(EDGES_S) + 1)] for part in c])
    count = np.bincount(band, minlength=len(EDGES_S) + 1) * residual.shape[1]
    moves = np.array([power(readings[r], step_s) for r in rows])
    known = (count > 0) & (moves > 0.0).all(axis=0)
    squares, count, moves = squares[:, known], count[known], moves[:, known]
    found = []
    for exponent in EXPONENTS:
        relative = (moves / moves.mean(axis=0)) ** exponent
        scale = np.maximum(squares - count, 0.0).sum(axis=0) / (count * relative.sum(axis=0))
        variance = 1.0 + scale * relative
        found.append(-0.5 * float((count * np.log(variance) + squares / variance).sum()))
    best = int(np.argmax(found))
    return EXPONENTS[best] if found[best] > found[0] + SURELY else EXPONENTS[0]


def _power(covariance: Array, exponent: float) -> Array:
    """Return the power of a covariance matrix (m, m)."""
    values, vectors = np.linalg.eigh(covariance)
    found: Array = (vectors * np.maximum(values, 1e-12) ** exponent) @ vectors.T
    return found


def _root(covariance: Array) -> tuple[Array, Array]:
    """Return the symmetric whitening matrix (m, m) and standard deviations (m,)."""
    return _power(covariance, -0.5), np.sqrt(np.diag(covariance))


def learn_blocks(left: Array, sigma: Array, block_s: float, step_s: float, before: Noise) -> Noise:
    """Learn the noise per bin of `step_s` from the residual (b, m), K, of block means of `block_s`.

    Periods shorter than two blocks keep the noise `before`.
    """
    share = np.sqrt(block_s / step_s)
    learned = learn(left, sigma / share, block_s)
    slow = np.unique(bands(len(left), block_s))
    roots, sd = before.roots.copy(), before.sd.copy()
    roots[slow], sd[slow] = learned.roots[slow] / share, learned.sd[slow] * share
    return Noise(roots, sd, step_s, sigma)
