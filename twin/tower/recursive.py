"""Recursive Gauss-Newton of a cell: the belief of its deviations every two hours, from readings before that time alone.

The state is that of `twin.tower.smoother` at one time: slow deviations, level of the fan's power, constants of the
record with the weights of the discrepancy. A healthy record gives its first mean and covariance. Each cycle adds what
the walk, events and undeclared changes may have moved, then updates by the steady blocks of the cycle and by labels:

    z <- z + drift,  P <- P + Q,    K = P H' (H P H' + R)^-1,    z <- z + K (y - h(z)),  P <- (I - K H) P

h is linearised at the belief at the start of each chunk of days. Residuals are correlated, so R is the variance of a
block times the autocorrelation time of the healthy record.

Source: Jazwinski, Stochastic Processes and Filtering Theory, 1970, sec. 8.3 (extended Kalman filter as recursive
Gauss-Newton); Bell, SIAM J. Optim. 4 (1994) 626.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.calibration import WINDOW_S
from twin.tower.cell_observations import AMPLITUDE, Label, interval_as_gaussian
from twin.tower.change_detection import RATE_D
from twin.tower.clean_cell import FEATURES
from twin.tower.estimates import DAY_S, JUMP, TREND, WALK, Blocks, Estimate, Opening, Priors
from twin.tower.identifiability.identify import TOLERANCE
from twin.tower.minutes import Minutes, first_order_lag
from twin.tower.model import DEVIATIONS, GLOBALS, NAMES, SLOW, CellModel
from twin.tower.smoother import HUBER, STEPS

CHUNK_S = 3.0 * DAY_S
"""Time for which one linearisation holds; the deviations walk by less than a percent in it."""
CONTEXT_S = DAY_S
FREE = slice(0, 3)
"""Deviations that the water's temperature depends on: fill, air, uniformity."""
POWER_BLOCKS = 6.0
"""Autocorrelation time of the fan power's residuals, blocks: the mean of a cycle counts as two of them."""
Rows = NDArray[np.intp]
_S, _LEVEL = len(SLOW), len(SLOW)
_LOAD = slice(_S + 1, _S + 1 + FEATURES)
"""Weights of the power's own error, `twin.tower.cell_observations.fan_power`."""
_FIRST = _S + 1 + FEATURES


@dataclass(frozen=True)
class Recursion:
    """Beliefs of a cell by cycle (k,), and the twin by minute (n,), linearised at the chunk's belief.

    Attributes
    ----------
    start_s
        Of the cycles' target intervals.
    mean, sd
        (k, 4) of the deviations, by readings before it.
    fit, fit_sd
        (k, 4) of the day before it alone, with the prior of a worn part.
    condition
        (k,) of that day.
    age_s
        (k,) since the last reading that was used.
    seen
        (k,) blocks of the day before.
    water
        (n,) outlet degC at the chunk's reference, followed; NaN where the inputs are not known.
    slopes
        (n, 3) of it by fill, air and uniformity.
    chunk
        (n,) number of the chunk.
    reference
        (chunks, 3).
    """

    start_s: Array
    mean: Array
    sd: Array
    fit: Array
    fit_sd: Array
    condition: Array
    age_s: Array
    seen: Array
    water: Array
    slopes: Array
    chunk: NDArray[np.int64]
    reference: Array


def filter_cell(
    model: CellModel,
    minutes: Minutes,
    blocks: Blocks,
    priors: Priors,
    healthy: Estimate,
    end_s: float,
    labels: Sequence[Label],
    openings: Sequence[Opening],
) -> Recursion:
    """Return the beliefs of a cell from the end of its healthy record on.

    Parameters
    ----------
    healthy
        Posterior of the days before `end_s`, s since 1970, on which the cell was clean.
    labels
        Each is used from its own time on.
    """
    filtered = _Filter(model, priors, healthy, openings)
    last = float(minutes.time_s[-1])
    first = np.ceil(end_s / WINDOW_S) * WINDOW_S
    starts = np.arange(first, last - WINDOW_S + 61.0, WINDOW_S)
    n, k = len(minutes.time_s), len(starts)
    water, slopes, chunk = np.full(n, np.nan), np.full((n, 3), np.nan), np.zeros(n, dtype=np.int64)
    reference: list[Array] = []
    means, sds, fits, fit_sds = (np.zeros((k, len(DEVIATIONS))) for _ in range(4))
    condition, age, seen = np.zeros(k), np.full(k, 7.0 * DAY_S), np.zeros(k)
    waiting = sorted((one for one in labels if one.time_s > end_s), key=lambda one: one.time_s)
    past: list[tuple[float, Array, float]] = []
    at = float(minutes.time_s[0])
    while at < last + 60.0:
        # The healthy part is one chunk: its belief is the posterior.
        until = first if at < first else at + CHUNK_S
        inside = slice(*(int(i) for i in np.searchsorted(minutes.time_s, (at, until))))
        water[inside], slopes[inside] = filtered.by_minute(minutes, inside)
        chunk[inside] = len(reference)
        reference.append(filtered.mean[FREE].copy())
        rows = np.flatnonzero((blocks.time_s >= at) & (blocks.time_s < until))
        filtered.linearise(blocks, rows)
        if at < first:
            past = filtered.rows(rows, blocks, first - CONTEXT_S)
        for i in np.flatnonzero((starts >= at) & (starts < until)):
            start = float(starts[i])
            means[i], sds[i] = filtered.belief()
            past = [one for one in past if one[0] >= start - CONTEXT_S]
            seen[i] = len(past)
            age[i] = start - past[-1][0] if past else float(age[max(int(i) - 1, 0)]) + WINDOW_S
            fits[i], fit_sds[i], condition[i] = filtered.of_day(past)
            filtered.predict(start, WINDOW_S)
            mine = rows[(blocks.time_s[rows] >= start) & (blocks.time_s[rows] < start + WINDOW_S)]
            past += filtered.rows(mine, blocks, start)
            filtered.update(blocks, mine)
            while waiting and waiting[0].time_s < start + WINDOW_S:
                filtered.label(waiting.pop(0))
        at = until
    water = first_order_lag(water, minutes.known)
    slopes = np.stack([first_order_lag(column, minutes.known) for column in slopes.T], axis=1)
    return Recursion(starts, means, sds, fits, fit_sds, condition, age, seen, water, slopes, chunk, np.array(reference))


class _Filter:
    """State z = [slow (5), level of the power, weights of the power's error, constants], its covariance, and the linear
    equations of a chunk."""

    def __init__(self, model: CellModel, priors: Priors, healthy: Estimate, openings: Sequence[Opening]) -> None:
        self.model, self.priors, self.openings = model, priors, tuple(openings)
        k, g = len(healthy.slow), len(healthy.constant)
        own = np.r_[(k - 1) * _S : k * _S, k * _S : k * _S + g]
        keep = np.r_[0:_S, _FIRST : _FIRST + g]
        self.mean = np.zeros(_FIRST + g)
        self.mean[keep] = np.r_[healthy.slow[-1], healthy.constant]
        self.covariance = np.zeros((len(self.mean), len(self.mean)))
        self.covariance[np.ix_(keep, keep)] = healthy.covariance[np.ix_(own, own)]
        load = np.arange(_LOAD.start, _LOAD.stop)
        self.covariance[load, load] = AMPLITUDE**2 / FEATURES
        kappa = _FIRST + NAMES.index("kappa")
        # The power of the air in the fan's power is kept; its spread is that of the level
        # (`twin.tower.cell_observations.fan_power`).
        self.covariance[kappa], self.covariance[:, kappa] = 0.0, 0.0
        self.variance = healthy.sigma[0] ** 2 * healthy.time_correlation
        self.power_variance = healthy.sigma[1] ** 2 * POWER_BLOCKS
        self.row_of: dict[int, int] = {}

    def belief(self) -> tuple[Array, Array]:
        """Return mean and standard deviation of the deviations (4,)."""
        four = len(DEVIATIONS)
        return self.mean[:four].copy(), np.sqrt(np.maximum(np.diag(self.covariance)[:four], 1e-12))

    def by_minute(self, minutes: Minutes, inside: slice) -> tuple[Array, Array]:
        """Return outlet and its slopes at the belief, of the minutes `inside`."""
        known = np.flatnonzero(minutes.known[inside]) + inside.start
        count = inside.stop - inside.start
        water, slopes = np.full(count, np.nan), np.full((count, 3), np.nan)
        if len(known):
            o = minutes.operation.take(known)
            slow = np.tile(self.mean[:_S], (len(known), 1))
            law = self.mean[_FIRST : _FIRST + len(NAMES)]
            base = self.model.outlet(o, slow, law)
            rest = self.mean[_FIRST + len(NAMES) :]
            features = self.model.features(o) @ rest * (1.0 - o.bypass) if len(rest) else 0.0
            water[known - inside.start] = base + features
            for j in range(3):
                moved = slow.copy()
                moved[:, j] += STEPS[j]
                slopes[known - inside.start, j] = (self.model.outlet(o, moved, law) - base) / STEPS[j]
        return water, slopes

    def linearise(self, blocks: Blocks, rows: Rows) -> None:
        """Evaluate reading, power and their slopes at the belief, for blocks `rows`."""
        o, g = blocks.operation.take(rows), self.mean[_FIRST:]
        self.row_of = {int(row): i for i, row in enumerate(rows)}
        self.at = self.mean.copy()
        self.slopes = np.zeros((len(rows), len(self.mean)))
        if not len(rows):
            return
        slow = np.tile(self.mean[:_S], (len(rows), 1))
        # The features enter linearly: slopes are those of the law without them.
        law = g[: len(NAMES)]
        base = self.model.reading(o, slow, law)
        for j in range(_S):
            moved = slow.copy()
            moved[:, j] += STEPS[j]
            self.slopes[:, j] = 1.0 if SLOW[j] == "bias" else (self.model.reading(o, moved, law) - base) / STEPS[j]
        for j, one in enumerate(GLOBALS):
            if one.name in ("kappa", "power_gain"):
                continue
            there = law.copy()
            there[j] += 0.1 * one.sd
            self.slopes[:, _FIRST + j] = (self.model.reading(o, slow, there) - base) / (0.1 * one.sd)
        self.features = self.model.features(o)
        self.reading = base
        if len(g) > len(NAMES):
            self.slopes[:, _FIRST + len(NAMES) :] = self.features * (1.0 - o.bypass)[:, None]
            self.reading = base + self.slopes[:, _FIRST + len(NAMES) :] @ g[len(NAMES) :]
        self.power = self.model.log_power(o, slow, g)
        self.shaft = 1.0 - self.model.design.idle / np.exp(self.power)

    def predict(self, start_s: float, length_s: float) -> None:
        """Let a cycle's time pass: drift, walk, undeclared changes at their usual rate, and events."""
        days = length_s / DAY_S
        for j, name in enumerate(SLOW):
            more = WALK[name] ** 2 * days + JUMP[name] ** 2 * RATE_D.get(name, 0.0) * days
            for opening in self.openings:
                if opening.parameter == name and opening.start_s < start_s + length_s and opening.end_s > start_s:
                    more += JUMP[name] ** 2 * min(length_s / max(opening.end_s - opening.start_s, length_s), 1.0)
            self.mean[j] += TREND[name] * days
            self.covariance[j, j] += more
            if name == "air":
                self.covariance[_LEVEL, _LEVEL] += GLOBALS[NAMES.index("kappa")].sd ** 2 * more

    def rows(self, rows: Rows, blocks: Blocks, since_s: float) -> list[tuple[float, Array, float]]:
        """Return time, slopes by the deviations and residual at the linearisation of blocks with a reading."""
        four, found = len(DEVIATIONS), []
        for row in rows:
            i = self.row_of[int(row)]
            error = float(blocks.outlet[row] - self.reading[i])
            if np.isfinite(error) and blocks.time_s[row] >= since_s:
                # About deviations of zero, so that rows of two chunks have one origin.
                found.append(
                    (
                        float(blocks.time_s[row]),
                        self.slopes[i, :four],
                        error + float(self.slopes[i, :four] @ self.at[:four]),
                    )
                )
        return found

    def of_day(self, past: Sequence[tuple[float, Array, float]]) -> tuple[Array, Array, float]:
        """Return estimate and standard deviations of a day alone (4,), and the condition number of what it shows."""
        prior = np.array([self.priors.slow(name) for name in DEVIATIONS])
        precision, right = np.diag(1.0 / prior[:, 1] ** 2), prior[:, 0] / prior[:, 1] ** 2
        information = np.zeros_like(precision)
        if past:
            slopes = np.stack([one[1] for one in past])
            information = slopes.T @ slopes / self.variance
            right = right + slopes.T @ np.array([one[2] for one in past]) / self.variance
        covariance = np.linalg.inv(precision + information)
        bounds = np.array([self.priors.bounds[name] for name in DEVIATIONS])
        values = np.linalg.eigvalsh(information * np.outer(bounds, bounds) / TOLERANCE["outlet"] ** 2 * self.variance)
        condition = float(np.sqrt(values[-1] / values[0])) if values[0] > 1e-12 * max(values[-1], 1e-12) else 1e6
        return covariance @ right, np.sqrt(np.diag(covariance)), min(condition, 1e6)

    def update(self, blocks: Blocks, rows: Rows) -> None:
        """Update by the blocks of a cycle: outlet readings, and the mean of the fan's power."""
        at = np.array([self.row_of[int(row)] for row in rows], dtype=np.int64)
        if not len(at):
            return
        error = blocks.outlet[rows] - self.reading[at] - self.slopes[at] @ (self.mean - self.at)
        there = np.isfinite(error)
        if there.any():
            self._add(self.slopes[at][there], error[there], np.full(int(there.sum()), self.variance))
        # Slopes of the power: by air, by level and by gain.
        kappa, air = self.mean[_FIRST + NAMES.index("kappa")], self.at[SLOW.index("air")]
        gain = _FIRST + NAMES.index("power_gain")
        power = blocks.log_power[rows] - self.power[at]
        there = np.isfinite(power)
        if there.any():
            shaft = float(self.shaft[at][there].mean())
            row = np.zeros((1, len(self.mean)))
            row[0, SLOW.index("air")], row[0, _LEVEL], row[0, gain] = -kappa / (1.0 + air) * shaft, shaft, shaft
            row[0, _LOAD] = shaft * self.features[at][there].mean(axis=0)
            left = float(power[there].mean()) - float((row @ (self.mean - self.at))[0])
            # Level and own error are part of the state and none of the model's power.
            left -= float(row[0, _LEVEL : _LOAD.stop] @ self.at[_LEVEL : _LOAD.stop])
            self._add(row, np.array([left]), np.array([self.power_variance / 2.0]))

    def label(self, label: Label) -> None:
        """Update by an inspection, a traverse or a certificate."""
        j = SLOW.index(label.parameter)
        value, sd = label.low, label.sd
        if sd is None:
            value, sd = interval_as_gaussian(
                label.low, label.high, float(self.mean[j]), float(np.sqrt(self.covariance[j, j]))
            )
        row = np.zeros((1, len(self.mean)))
        row[0, j] = 1.0
        self._add(row, np.array([value - self.mean[j]]), np.array([sd**2]), robust=False)

    def _add(self, slopes: Array, error: Array, variance: Array, robust: bool = True) -> None:
        spread = slopes @ self.covariance
        inner = spread @ slopes.T
        if robust:
            size = np.abs(error) / np.sqrt(np.diag(inner) + variance)
            variance = variance * np.maximum(size / HUBER, 1.0)
        gain = np.linalg.solve(inner + np.diag(variance), spread).T
        self.mean = self.mean + gain @ error
        self.mean[FREE] = np.clip(self.mean[FREE], -0.6, 0.5)
        self.covariance = self.covariance - gain @ spread
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
