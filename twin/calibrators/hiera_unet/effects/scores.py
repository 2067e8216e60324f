"""Window scores of all hypotheses: fitted size over its standard deviation, for each possible onset.

For an onset m windows ago and covariance S of one window (`Memory.rate`, with what the memory itself leaves open),

    z = sum d' S^-1 r / sqrt(sum d' S^-1 d),      information = sum d' S^-1 d,

with d the direction of the hypothesis in each window and r the power beyond that of health, both over the growth of
the standard deviation in transitions. This is the generalised
likelihood ratio of a jump at an unknown time (Willsky and Jones, IEEE Trans. Automatic Control 21 (1976) 108). The
largest score is the linear rival of the network.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.calibrators.hiera_unet.effects.balance import EVERY_S, Figures
from twin.calibrators.hiera_unet.effects.memory import LAGS, Memory
from twin.network import Array

NOTHING = 1e-18
"""Information of a hypothesis that a window does not show, over the square of its unit."""
Index = NDArray[np.intp]
HOUR = 12
"""Windows in an hour."""
QUIET = 4
"""Latest windows that do not count as the past: an effect is to be found within them."""
REMEMBERED = 144
"""Windows after which the past is forgotten: half a day."""
ASSUMED = 12.0
"""Windows that the healthy record counts as, beside the past of the record."""
MOST_SQUARE = 100.0


@dataclass(frozen=True)
class Scores:
    """Scores of K windows, H hypotheses, M onsets.

    Attributes
    ----------
    z
        Fitted size over its standard deviation (K, H, M).
    information
        Inverse variance of the size (K, H, M).
    misfit
        Squares of the power beyond health, over its covariance, summed since each onset (K, M).
    count
        Windows since each onset (K, M), fewer at the beginning of a record.
    novelty
        Share of the variance that the memory leaves open at this operating point (K,).
    unrest, unrest_before
        Growth of the variance with the rates of the operating point, mean over nodes (K,): now, and its largest value
        in the hour before.
    past
        Mean square of the power over its covariance in the record so far, up to `QUIET` windows ago (K,); at least 1.
    """

    z: Array
    information: Array
    misfit: Array
    count: Array
    novelty: Array
    unrest: Array
    unrest_before: Array
    past: Array

    @property
    def size(self) -> Array:
        """Return fitted sizes (K, H, M) in the units of the hypotheses."""
        found: Array = np.where(
            self.information > NOTHING, self.z / np.sqrt(np.maximum(self.information, NOTHING)), 0.0
        )
        return found


def window_scores(figures: Figures, memory: Memory) -> Scores:
    """Return the scores of all windows of a record; those of a window depend on it and earlier ones alone."""
    beyond, point, growth = memory.read(figures)
    valid = figures.valid.astype(np.float64)
    calm = valid[:, None] / np.sqrt(growth)
    r = beyond * calm
    d = figures.direction * calm[:, None, :]
    k, h, n = d.shape
    # Cumulated products; the first row is zero, so that a difference is a sum of windows.
    cross = _cumulated(d[:, :, :, None] * r[:, None, None, :])
    square = _cumulated(d[:, :, :, None] * d[:, :, None, :])
    power = _cumulated(r[:, :, None] * r[:, None, :])
    points = _cumulated(point * valid[:, None])
    z, information = np.empty((k, h, len(LAGS))), np.empty((k, h, len(LAGS)))
    misfit, count = np.empty((k, len(LAGS))), np.empty((k, len(LAGS)))
    novelty = np.zeros(k)
    at = np.arange(k)
    for j, m in enumerate(LAGS):
        first = np.maximum(at + 1 - m, 0)
        length = (at + 1 - first).astype(np.float64)
        mean = (points[at + 1] - points[first]) / length[:, None]
        open_ = np.einsum("kx,nxy,ky->kn", mean, memory.spread, mean)
        covariance = memory.rate[j] + np.eye(n) * (length[:, None] * open_)[:, :, None]
        inverse = np.linalg.inv(covariance)
        if m == 1:
            novelty = (open_ / np.diagonal(memory.rate[j])).mean(axis=1)
        onset: Array = figures.kick / EVERY_S * np.where(at > first, 0.5, 1.0)[:, None, None] * calm[first][:, None, :]
        dr = cross[at + 1] - cross[first] + onset[:, :, :, None] * _mean_of(r, first, at)[:, None, None, :]
        dd = square[at + 1] - square[first] + _kick_squares(d, onset, first, at)
        pulled = np.einsum("kij,khij->kh", inverse, dr)
        known = np.einsum("kij,khij->kh", inverse, dd)
        information[:, :, j] = np.maximum(known, NOTHING)
        z[:, :, j] = np.where(known > NOTHING, pulled / np.sqrt(np.maximum(known, NOTHING)), 0.0)
        misfit[:, j] = np.einsum("kij,kij->k", inverse, power[at + 1] - power[first])
        count[:, j] = length
    past = _past(misfit[:, 0] / n)
    unrest = growth.mean(axis=1)
    before = np.concatenate([np.full(HOUR, unrest[0]), unrest])
    hour = np.lib.stride_tricks.sliding_window_view(before, HOUR)[:k].max(axis=1)
    return Scores(z, information, misfit, count, novelty, unrest, hour, past)


def _past(square: Array) -> Array:
    """Return the mean of earlier squares (k,), up to `QUIET` windows ago, with `ASSUMED` windows of 1 before them.

    Single windows count `MOST_SQUARE` at most, so that one transition does not make a rig deaf.
    """
    earlier = np.concatenate([np.zeros(QUIET), np.minimum(square, MOST_SQUARE)[: max(len(square) - QUIET, 0)]])
    seen = np.concatenate([np.zeros(QUIET), np.ones(max(len(square) - QUIET, 0))])[: len(square)]
    keep = np.exp(-1.0 / REMEMBERED)
    total, weight = 0.0, 0.0
    found = np.empty(len(square))
    for k in range(len(square)):
        total, weight = keep * total + earlier[k], keep * weight + seen[k]
        found[k] = max((total + ASSUMED) / (weight + ASSUMED), 1.0)
    return found


def _cumulated(values: Array) -> Array:
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def _mean_of(r: Array, first: Index, at: Index) -> Array:
    """Return the sum of the powers (k, n) of the window of the onset and the next one."""
    second = np.minimum(first + 1, at)
    return r[first] + np.where(second > first, 1.0, 0.0)[:, None] * r[second]


def _kick_squares(d: Array, onset: Array, first: Index, at: Index) -> Array:
    """Return what the step at the onset adds to the squares of the direction (k, h, n, n)."""
    second = np.minimum(first + 1, at)
    two = np.where(second > first, 1.0, 0.0)
    both = d[first] + two[:, None, None] * d[second]
    mixed = onset[:, :, :, None] * both[:, :, None, :]
    own = onset[:, :, :, None] * onset[:, :, None, :] * (1.0 + two)[:, None, None, None]
    found: Array = mixed + np.swapaxes(mixed, 2, 3) + own
    return found
