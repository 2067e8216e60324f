"""Held-out weeks: the outlet's error in them, and the predictive density that a refit with an effect gains.

A week without its readings is predicted with the slow deviations of the weeks around it, so its error is correlated:
with W the weights of blocks, J their Jacobian and C the covariance of the fit

    S = W^-1 + J C J' + offsets,    gain = (e_0' S^-1 e_0 - e_1' S^-1 e_1) / 2

for the errors e_0 without and e_1 with the effect. An offset of each part is open by as much as a thermometer may
step. Source: Geisser & Eddy, J. Am. Stat. Assoc. 74 (1979) 153 (predictive density of left-out samples).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from twin.tower.air import Array
from twin.tower.calibration import Fitted
from twin.tower.estimates import JUMP, Estimate
from twin.tower.minutes import blocks_of
from twin.tower.model import SLOW
from twin.tower.smoother import HUBER

WEEK_S = 7 * 86400.0
TimeSpans = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class HeldOutBlocks:
    """Steady held-out blocks (m,): row of the fit, part, and reading minus prediction K."""

    rows: NDArray[np.intp]
    part: NDArray[np.intp]
    error: Array

    def mean_absolute(self) -> float:
        """Return the mean absolute error, K."""
        return float(np.mean(np.abs(self.error))) if len(self.error) else float("nan")

    def without_offset(self) -> float:
        """Return the mean absolute error about the median of each part, K: no fit predicts a thermometer's step."""
        if not len(self.error):
            return float("nan")
        return float(np.mean(np.abs(self.error - self._medians())))

    def _medians(self) -> Array:
        found = np.zeros(len(self.error))
        for k in np.unique(self.part):
            found[self.part == k] = np.median(self.error[self.part == k])
        return found

    def weights(self, p: Estimate) -> Array:
        """Return the weights of the blocks, Huber's about the median of each part (m,)."""
        size = np.abs(self.error - self._medians()) / p.sigma[0]
        return np.minimum(1.0, HUBER / np.maximum(size, 1e-9)) / (p.sigma[0] ** 2 * p.time_correlation)


def held_out_parts(time_s: Array) -> TimeSpans:
    """Return the parts of a record that no fit sees: every third week, the second first; thirds if it is short."""
    start, end = float(time_s[0]), float(time_s[-1]) + 60.0
    length = min(WEEK_S, (end - start) / 3.0)
    count = round((end - start) / length)
    return tuple((start + k * length, min(start + (k + 1) * length, end)) for k in range(1, count, 3))


def inside(time_s: Array, parts: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return the times that lie in a held-out part (n,)."""
    return part_of(time_s, parts) >= 0


def part_of(time_s: Array, parts: Sequence[tuple[float, float]]) -> NDArray[np.intp]:
    """Return the held-out part of each time, -1 for none (n,)."""
    found = np.full(len(time_s), -1, dtype=np.intp)
    for k, (start, end) in enumerate(parts):
        found[(time_s >= start) & (time_s < end)] = k
    return found


def held_out(fitted: Fitted, outlet: Array, parts: TimeSpans) -> HeldOutBlocks:
    """Return the errors of a fit in its held-out parts.

    Parameters
    ----------
    outlet
        Readings by minute, held-out ones too, degC (n,).
    """
    blocks, _ = blocks_of(replace(fitted.minutes, outlet=outlet))
    p = fitted.posterior
    error = blocks.outlet - fitted.model.reading(blocks.operation, p.slow[p.cell], p.constant)
    part = part_of(blocks.time_s, parts)
    rows = np.flatnonzero(np.isfinite(error) & (part >= 0))
    return HeldOutBlocks(rows, part[rows], np.asarray(error[rows]))


def predictive_gain(fitted: Fitted, old: HeldOutBlocks, new: HeldOutBlocks) -> float:
    """Return the log predictive density of the held-out blocks that the errors `new` gain over `old`.

    Parameters
    ----------
    fitted
        Fit without the effect, whose covariance both share.
    """
    p = fitted.posterior
    if not len(old.rows):
        return 0.0
    j = jacobian_of(p)[old.rows]
    w = old.weights(p)
    inner = np.eye(j.shape[1]) + p.covariance @ (j.T @ j.multiply(w[:, None])).toarray()
    offsets = JUMP["bias"] * (old.part[:, None] == np.unique(old.part)).astype(float)
    x = np.column_stack([old.error, new.error, offsets])
    weighted = x * w[:, None]
    solved = weighted - w[:, None] * (j @ np.linalg.solve(inner, p.covariance @ (j.T @ weighted)))
    q = x[:, :2].T @ solved[:, :2]
    cross = offsets.T @ solved[:, :2]
    q = q - cross.T @ np.linalg.solve(np.eye(offsets.shape[1]) + offsets.T @ solved[:, 2:], cross)
    return 0.5 * float(q[0, 0] - q[1, 1])


def jacobian_of(p: Estimate) -> csr_matrix:
    """Return the Jacobian of the blocks by [slow row by row, constant], as the covariance is ordered."""
    n, s, k, g = len(p.cell), len(SLOW), p.slow.size, p.constant.size
    slow = p.cell[:, None] * s + np.arange(s)
    index = np.concatenate([slow, np.broadcast_to(k + np.arange(g), (n, g))], axis=1)
    rows = np.repeat(np.arange(n), s + g)
    return csr_matrix((np.nan_to_num(p.jacobian).ravel(), (rows, index.ravel())), shape=(n, k + g))
