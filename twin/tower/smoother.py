"""Maximum a posteriori estimate of slow deviations over a whole record: Gauss-Newton on a grid of time.

The deviations are constant within a cell of the grid and walk at random from one to the next, a fill about a rate that
is unknown and lasts; a documented event opens a jump at its date. Where nothing was read for days, a jump that nobody
announced is not detectable, so the walk takes its variance there.
The prior of a deviation is that of a part that wears: its mean a third of the bound on the lossy side, its standard
deviation a third of the bound, so that the bound is two standard deviations below and a gain of a third of it two
above. A thermometer's bias has mean 0. Residuals of the model are correlated in time, so a block of them counts as less
than one observation, by their integrated autocorrelation time (Geyer 1992).

Scale and autocorrelation time are estimated in the first passes and kept in the others. A step is halved until it
lowers the objective of its pass, so that the estimate is a mode.

Sources: Bell, SIAM J. Optim. 4 (1994) 626 (Gauss-Newton as the iterated Kalman smoother); Schmidt, Adv. Control Syst. 3
(1966) 293 (considered constants).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotri

from twin.tower.air import Array
from twin.tower.cell_observations import Label, PowerErrors, PowerRows, interval_as_gaussian
from twin.tower.estimates import DAY_S, Blocks, Estimate, Opening, Priors, time_grid
from twin.tower.model import GLOBALS, NAMES, SLOW, CellModel

WALK = {"fill": 0.002, "air": 0.0015, "uniformity": 0.002, "bias": 0.01, "flow_meter": 0.0005}
"""Standard deviation of a day's change. Fills lose 0.2 to 0.6 % a week, so a month is known to some 1 %; thermometers
drift by some 0.05 K a month, flow meters by some 0.3 %."""
TREND = {"fill": -0.0006, "air": -0.0001, "uniformity": -0.0003, "bias": 0.0, "flow_meter": 0.0}
"""Mean change of a day."""
CLEANED_D = 120.0
"""Days between two cleanings of a cell: some three a year."""
RATE_SD = {"fill": 0.25 / (2.0 * CLEANED_D)}
"""Standard deviation of the mean change of a day, a constant of the record: water that scales fast takes the fill's
bound of 25 % between two cleanings, as two of them. A walk alone has no lasting rate, so it would follow such a fill
late, and give the rest to the other deviations."""
JUMP = {"fill": 0.08, "air": 0.06, "uniformity": 0.05, "bias": 0.4, "flow_meter": 0.0}
"""Standard deviation of a jump that an event opens: a cleaning gives back what was lost, a new thermometer is another
one."""
RATE_D = {"fill": 1.0 / 1200.0, "air": 1.0 / 1200.0, "uniformity": 1.0 / 1200.0, "bias": 1.0 / 120.0}
"""Undeclared changes a day. One thermometer in a plant steps or is exchanged some three times a year; a cell is cleaned
two or three times, and one entry in eight is missing."""
UNREAD_S = 5.0 * DAY_S
"""Days without a reading from which a jump in them is not detectable: the least time between two that a search tells
apart (`change_detection`)."""
PASSES = 20
RESCALED = 5
"""Passes in which scale and autocorrelation time of the residuals are taken anew."""
HALVINGS = 8
"""Most halvings of a step that does not lower the objective."""
FLAT = 0.02
"""Largest change of a step below which the sensitivities of the step before are used again."""
BLOCK_S = 600.0
CORRELATION = (3.0, 144.0)
"""Least and most autocorrelation time, blocks: half an hour, over which weather within an hour is correlated, and a
day. What stays for longer is for the slow deviations to explain: without a limit a bad fit would weigh itself ever
less."""
HUBER = 2.5
"""Standard deviations beyond which a block is weighed down."""
CONSIDERED = ("fill_share", "wetting")
"""Constants that multiply a walk: kept at their means, their spread considered in the intervals (Schmidt 1966)."""
HELD = 1e6
"""Precision at which they are kept, in those of their priors."""
STEPS = np.array([0.01, 0.01, 0.01, 0.01, 0.01])


def estimate(
    model: CellModel,
    blocks: Blocks,
    priors: Priors,
    labels: Sequence[Label],
    openings: Sequence[Opening],
    edges_s: Array | None = None,
    start: Estimate | None = None,
    least_correlation: bool = False,
) -> Estimate:
    """Return the posterior of the deviations over a record.

    Parameters
    ----------
    model, priors
        The cell, and what is known of it before.
    blocks
        Steady blocks of its record.
    labels, openings
        Tests of the fill, and times at which a deviation may jump.
    edges_s
        (k + 1,) s, edges of the time grid; None for that of `time_grid`.
    start
        An estimate on the same time grid to begin at.
    least_correlation
        Residuals count with the shortest autocorrelation time, as they are.
    """
    solver = _Solver(model, blocks, priors, labels, openings, edges_s, least_correlation)
    return solver.run(start)


def unread_days(edges_s: Array, read: NDArray[np.bool_]) -> Array:
    """Return the days of each increment of a time grid that lie in spans of `UNREAD_S` without a reading (k - 1,).

    Parameters
    ----------
    edges_s
        (k + 1,) s.
    read
        Cells of the grid with a reading (k,).
    """
    ends = np.flatnonzero(np.diff(np.concatenate([[False], ~read, [False]]).astype(np.int8)))
    days = np.zeros(len(read))
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        if edges_s[last] - edges_s[first] >= UNREAD_S:
            days[first:last] = np.diff(edges_s[first : last + 1]) / DAY_S
    return np.asarray(0.5 * (days[:-1] + days[1:]))


def walk_variance(
    edges_s: Array, name: str, openings: Sequence[Opening], unread_d: Array | float = 0.0
) -> tuple[Array, Array]:
    """Return variance and mean of a deviation's increments between the cells of a time grid (k - 1,).

    Parameters
    ----------
    edges_s
        (k + 1,) s.
    name
        Of the deviation.
    openings
        Times at which it may jump.
    unread_d
        Days of each increment of which nothing is known (k - 1,): a compound Poisson process of undeclared jumps adds
        its variance there.
    """
    middle = 0.5 * (edges_s[:-1] + edges_s[1:])
    days = np.diff(middle) / DAY_S
    variance = WALK[name] ** 2 * days + RATE_D.get(name, 0.0) * JUMP[name] ** 2 * unread_d + 1e-14
    for opening in openings:
        if opening.parameter != name:
            continue
        inside = (edges_s[1:-1] >= opening.start_s - 0.5 * DAY_S) & (edges_s[1:-1] <= opening.end_s + 0.5 * DAY_S)
        exact = (edges_s[1:-1] >= opening.start_s) & (edges_s[1:-1] <= opening.end_s)
        if exact.any() and opening.end_s - opening.start_s < 0.5 * DAY_S:
            inside = exact  # the grid has an edge at a jump of known time
        if inside.any():
            variance[inside] += JUMP[name] ** 2 / inside.sum()
    return variance, TREND[name] * days


def walk_precision(
    edges_s: Array, name: str, openings: Sequence[Opening], unread_d: Array | float = 0.0
) -> tuple[Array, Array]:
    """Return the precision (k - 1, k - 1) of a deviation's increments between the cells of a time grid, and their mean.

    An unknown rate is marginalised: it adds a variance that is common to all increments (Sherman & Morrison, Ann. Math.
    Stat. 21 (1950) 124).
    """
    variance, drift = walk_variance(edges_s, name, openings, unread_d)
    variance = variance + 1e-14
    precision = np.diag(1.0 / variance)
    if name in RATE_SD:
        days = np.diff(0.5 * (edges_s[:-1] + edges_s[1:])) / DAY_S
        seen = days / variance
        precision -= np.outer(seen, seen) / (1.0 / RATE_SD[name] ** 2 + float(days @ seen))
    return precision, drift


class _Solver:
    def __init__(
        self,
        model: CellModel,
        blocks: Blocks,
        priors: Priors,
        labels: Sequence[Label],
        openings: Sequence[Opening],
        edges_s: Array | None,
        least_correlation: bool,
    ) -> None:
        self.model, self.blocks, self.priors = model, blocks, priors
        if edges_s is None:
            edges_s = time_grid(float(blocks.time_s[0]), float(blocks.time_s[-1]) + 1.0)
        self.edges = edges_s
        self.k, self.s, self.g = len(edges_s) - 1, len(SLOW), len(priors.constant()[0])
        self.cell = np.clip(np.searchsorted(edges_s, blocks.time_s, side="right") - 1, 0, self.k - 1)
        read = np.bincount(self.cell[np.isfinite(blocks.outlet)], minlength=self.k) > 0
        self.unread_d = unread_days(edges_s, read)
        self.labels = [label for label in labels if edges_s[0] - 3 * DAY_S <= label.time_s <= edges_s[-1] + 3 * DAY_S]
        self.mean_g, self.sd_g = priors.constant()
        self.multipliers = np.array([self.k * self.s + NAMES.index(name) for name in CONSIDERED])
        self.precision, self.prior_mean = self._prior(openings)
        self._hold()
        # Changes of the constants count in tenths of their priors' standard deviations.
        self.unit = np.concatenate([np.ones(self.k * self.s), 10.0 * self.sd_g])
        o = blocks.operation
        self.features = model.features(o) * (1.0 - o.bypass)[:, None] if self.g > len(NAMES) else None
        variance, _ = walk_variance(edges_s, "air", openings, self.unread_d)
        self.power_errors = PowerErrors(model.features(o), self.cell, variance * GLOBALS[NAMES.index("kappa")].sd ** 2)
        self.sigma = [0.2, 0.03]
        self._sites: dict[int, tuple[float, float]] = {}
        self.tau = self.tau_power = CORRELATION[0] if least_correlation else 6.0
        self.longest = CORRELATION[0] if least_correlation else CORRELATION[1]

    def _prior(self, openings: Sequence[Opening]) -> tuple[Array, Array]:
        """Return the precision of [slow, constant] and its mean."""
        k, s = self.k, self.s
        n = k * s + self.g
        precision, linear = np.zeros((n, n)), np.zeros(n)
        for j, name in enumerate(SLOW):
            mean, sd = self.priors.slow(name)
            inner, drift = walk_precision(self.edges, name, openings, self.unread_d)
            rows = np.arange(k) * s + j
            precision[rows[0], rows[0]] += 1.0 / sd**2
            linear[rows[0]] += mean / sd**2
            steps = np.zeros((k, k))
            steps[1:, 1:] += inner
            steps[:-1, :-1] += inner
            steps[1:, :-1] -= inner
            steps[:-1, 1:] -= inner
            precision[np.ix_(rows, rows)] += steps
            pull = inner @ drift
            linear[rows] += np.append(0.0, pull) - np.append(pull, 0.0)
            # A walk may not leave the bounds however long it goes on: the prior holds, weakly, at every time.
            precision[rows, rows] += 1.0 / (2.0 * sd) ** 2 / k
            linear[rows] += mean / (2.0 * sd) ** 2 / k
        ends = np.arange(k * s, n)
        precision[ends, ends] = 1.0 / self.sd_g**2
        if self.priors.learned is not None:
            precision[np.ix_(ends, ends)] += np.linalg.inv(self.priors.learned[1]) - np.diag(1.0 / self.sd_g**2)
        linear[ends] = precision[np.ix_(ends, ends)] @ self.mean_g
        return precision, linear

    def _hold(self) -> None:
        """Keep the constants that multiply a walk at their means, and note how their prior moves the others.

        The product of such a constant and a walk fits the same readings with a larger constant and a smaller walk, and
        the determinant that pays for it in the marginal likelihood is absent from a joint mode (Neyman & Scott 1948).
        """
        own = self.multipliers - self.k * self.s
        self.coupling = self.precision[:, self.multipliers].copy()
        learned = self.priors.learned
        spread = np.diag(self.sd_g[own] ** 2) if learned is None else learned[1][np.ix_(own, own)]
        self.spread = np.linalg.cholesky(spread)
        held = HELD / self.sd_g[own] ** 2
        self.precision[self.multipliers, self.multipliers] += held
        self.prior_mean[self.multipliers] += held * self.mean_g[own]

    def _considered(self, factor: tuple[Array, bool], normal: Array) -> Array:
        """Return the changes of all unknowns by a standard deviation of each considered constant (n, m)."""
        columns = normal[:, self.multipliers] - self.precision[:, self.multipliers] + self.coupling
        moved = -cho_solve(factor, columns)
        moved[self.multipliers] = np.eye(len(self.multipliers))
        return np.asarray(moved @ self.spread)

    def run(self, start: Estimate | None) -> Estimate:
        if start is None:
            x = cho_solve(cho_factor(self.precision), self.prior_mean)
        else:
            x = np.concatenate([start.slow.ravel(), start.constant])
            self.sigma = list(start.sigma)
        variance: Array = np.zeros(0)
        jac_t, change = np.zeros((0, 0)), np.inf
        res_t, rows_p, res_p = self._residuals(x)
        left = res_p
        for number in range(PASSES):
            slow, g = x[: self.k * self.s].reshape(self.k, self.s), x[self.k * self.s :]
            here = slow[self.cell]
            if change > FLAT:
                jac_t = self._outlet(here, g)
            if number < RESCALED:
                # Later the scale stays: an objective that changes with each step has no minimum to converge to.
                self._rescale(res_t, left)
            w_t = _weights(res_t, self.sigma[0]) / (self.sigma[0] ** 2 * self.tau)
            w_p = _weights(left, self.sigma[1]) / (self.sigma[1] ** 2 * self.tau_power)
            rows_p = replace(rows_p, weights=w_p)
            normal, right = self.precision.copy(), self.prior_mean.copy()
            self._add_labels(normal, right, x, variance)
            known = normal.copy(), right.copy()
            full = np.concatenate([here, np.broadcast_to(g, (len(here), self.g))], axis=1)
            self._add(normal, right, jac_t, w_t, np.nan_to_num(res_t) + np.einsum("ij,ij->i", jac_t, full))
            self._add_power(normal, right, rows_p, res_p, here, g)
            factor = cho_factor(normal)
            new = self._bounded(cho_solve(factor, right))
            moved = x - new
            linear = (
                res_t
                + np.einsum("ij,ij->i", jac_t[:, : self.s], moved[: self.k * self.s].reshape(self.k, self.s)[self.cell])
                + jac_t[:, self.s :] @ moved[self.k * self.s :]
            )
            before = x
            x, res_t, rows_p, res_p, left = self._descended(x, new, known, w_t, w_p, (res_t, rows_p, res_p))
            change = float((np.abs(x - before) / self.unit).max())
            last = number == PASSES - 1 or (number >= (RESCALED if start is None else 2) and change < 2e-4)
            if last:
                break
            variance = self._label_variance(factor, self._considered(factor, normal))
        considered = self._considered(factor, normal)
        covariance = _inverse(factor[0])
        slow, g = x[: self.k * self.s].reshape(self.k, self.s), x[self.k * self.s :]
        residual = self.blocks.outlet - self.model.reading(self.blocks.operation, slow[self.cell], g)
        weights = np.where(
            np.isfinite(residual), _weights(residual, self.sigma[0]) / (self.sigma[0] ** 2 * self.tau), 0.0
        )
        return Estimate(
            self.edges,
            slow,
            g,
            covariance,
            (self.sigma[0], self.sigma[1]),
            residual,
            weights,
            self.cell,
            jac_t,
            self.tau,
            linear,
            w_t,
            considered,
            tuple((one, *self._sites[i]) for i, one in enumerate(self.labels)),
        )

    def _outlet(self, here: Array, g: Array) -> Array:
        """Return the slopes of the outlet's reading."""
        base = self.model.reading(self.blocks.operation, here, g)
        return self._slopes(lambda s, c: self.model.reading(self.blocks.operation, s, c), base, here, g)

    def _residuals(self, x: Array) -> tuple[Array, PowerRows, Array]:
        """Return the residuals of the outlet, slopes of the power without their weights, and its residuals."""
        slow, g = x[: self.k * self.s].reshape(self.k, self.s), x[self.k * self.s :]
        here, o = slow[self.cell], self.blocks.operation
        base = self.model.log_power(o, here, g)
        kappa, air = g[NAMES.index("kappa")], here[:, 1]
        shaft = 1.0 - self.model.design.idle / np.exp(base)
        rows = PowerRows(-kappa / (1.0 + air) * shaft, shaft, np.zeros(len(base)))
        return self.blocks.outlet - self.model.reading(o, here, g), rows, self.blocks.log_power - base

    def _add_power(self, normal: Array, right: Array, rows: PowerRows, residual: Array, here: Array, g: Array) -> None:
        """Add the equations of the fan's power to the normal equations."""
        end = self.k * self.s
        gain = NAMES.index("power_gain")
        target = np.nan_to_num(residual) + rows.air * here[:, 1] + rows.shaft * g[gain]
        matrix, added = self.power_errors.normal(rows, np.where(rows.weights > 0.0, target, 0.0))
        index = np.concatenate([np.arange(self.k) * self.s + SLOW.index("air"), [end + gain]])
        normal[np.ix_(index, index)] += matrix
        right[index] += added

    def _descended(
        self,
        x: Array,
        new: Array,
        known: tuple[Array, Array],
        w_t: Array,
        w_p: Array,
        current: tuple[Array, PowerRows, Array],
    ) -> tuple[Array, Array, PowerRows, Array, Array]:
        """Return the point between `x` and `new` at which the objective is below that at `x`, halving the step, with
        its residuals, those of the power also less their likeliest errors.

        `known` are the precision and right side of priors and labels. Weights are those of the pass: their sum of
        squares bounds Huber's loss from above, so a step that lowers it lowers the loss.
        """

        def objective(at: Array, res_t: Array, rows: PowerRows, res_p: Array) -> tuple[float, Array]:
            left, power = self.power_errors.remaining(replace(rows, weights=w_p), res_p)
            return float(at @ known[0] @ at - 2.0 * known[1] @ at + w_t @ np.nan_to_num(res_t) ** 2) + power, left

        least = objective(x, *current)[0]
        share = 1.0
        for _ in range(HALVINGS):
            at = x + share * (new - x)
            there = self._residuals(at)
            value, left = objective(at, *there)
            if value <= least + 1e-9 * abs(least):
                break
            share *= 0.5
        return (at, *there, left)

    def _slopes(self, function, base: Array, here: Array, g: Array) -> Array:  # type: ignore[no-untyped-def]
        jac = np.zeros((len(base), self.s + self.g))
        for j in range(self.s):
            moved = here.copy()
            moved[:, j] += STEPS[j]
            jac[:, j] = (function(moved, g) - base) / STEPS[j] if SLOW[j] != "bias" else 1.0
        for j in range(len(NAMES)):
            if NAMES[j] in ("kappa", "power_gain"):
                continue
            moved_g = g.copy()
            step = 0.1 * GLOBALS[j].sd
            moved_g[j] += step
            jac[:, self.s + j] = (function(here, moved_g) - base) / step
        if self.features is not None:
            jac[:, self.s + len(NAMES) :] = self.features
        return jac

    def _rescale(self, res_t: Array, res_p: Array) -> None:
        """Take scale and autocorrelation time of the residuals as they are, never below those of the instruments."""
        for j, (res, least) in enumerate(((res_t, 0.08), (res_p, 0.01))):
            there = np.isfinite(res)
            if there.sum() < 10:
                continue
            r = res[there]
            scale = 1.4826 * float(np.median(np.abs(r - np.median(r))))
            self.sigma[j] = max(scale, least)
            tau = float(np.clip(autocorrelation_time(np.clip(r, -4 * scale, 4 * scale)), CORRELATION[0], self.longest))
            if j == 0:
                self.tau = tau
            else:
                self.tau_power = tau

    def _add(self, normal: Array, right: Array, jac: Array, w: Array, target: Array) -> None:
        """Add weighted rows to the normal equations, grid cell by grid cell."""
        s, end = self.s, self.k * self.s
        weighted = jac * w[:, None]
        order = np.argsort(self.cell, kind="stable")
        starts = np.searchsorted(self.cell[order], np.arange(self.k + 1))
        for k in range(self.k):
            rows = order[starts[k] : starts[k + 1]]
            if not len(rows):
                continue
            h = weighted[rows].T @ jac[rows]
            b = weighted[rows].T @ target[rows]
            here = slice(k * s, (k + 1) * s)
            normal[here, here] += h[:s, :s]
            normal[here, end:] += h[:s, s:]
            normal[end:, here] += h[s:, :s]
            normal[end:, end:] += h[s:, s:]
            right[here] += b[:s]
            right[end:] += b[s:]

    def _label_row(self, label: Label) -> int:
        """Return the row of the deviation and time of a label."""
        k = int(np.clip(np.searchsorted(self.edges, label.time_s, side="right") - 1, 0, self.k - 1))
        return k * self.s + SLOW.index(label.parameter)

    def _label_variance(self, factor: tuple[Array, bool], considered: Array) -> Array:
        """Return the posterior variance of what each label is about (labels,)."""
        rows = [self._label_row(label) for label in self.labels]
        if not rows:
            return np.zeros(0)
        unit = np.zeros((len(self.prior_mean), len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        return np.asarray(cho_solve(factor, unit)[rows, np.arange(len(rows))] + (considered[rows] ** 2).sum(axis=1))

    def _add_labels(self, normal: Array, right: Array, x: Array, variance: Array) -> None:
        """Add the labels as Gaussian observations; `variance` of their deviations, none before the first solution."""
        for number, label in enumerate(self.labels):
            row = self._label_row(label)
            if label.sd is not None:
                value, sd = label.low, label.sd
            elif not len(variance):
                value, sd = 0.5 * (label.low + label.high), 0.5 * (label.high - label.low)
            else:
                mean, spread = self._cavity(number, float(x[row]), float(variance[number]))
                value, sd = interval_as_gaussian(label.low, label.high, mean, spread)
            self._sites[number] = (value, sd)
            normal[row, row] += 1.0 / sd**2
            right[row] += value / sd**2

    def _cavity(self, number: int, mean: float, variance: float) -> tuple[float, float]:
        """Return mean and standard deviation of a deviation without its own label."""
        value, sd = self._sites[number]
        precision = max(1.0 / variance - 1.0 / sd**2, 0.05 / variance)
        return (mean / variance - value / sd**2) / precision, precision**-0.5

    def _bounded(self, x: Array) -> Array:
        """Keep a step within what the model can be evaluated at."""
        slow = x[: self.k * self.s].reshape(self.k, self.s)
        slow[:, :3] = np.clip(slow[:, :3], -0.6, 0.5)
        return x


def _inverse(upper: Array) -> Array:
    """Return the inverse of a matrix by its Cholesky factor as `cho_factor` returns it, with half of the work of
    solving."""
    half, fault = dpotri(upper, lower=0)
    if fault:
        raise np.linalg.LinAlgError("the normal equations are singular")
    inverse = np.triu(half)
    return np.asarray(inverse + np.triu(half, 1).T)


def _weights(residual: Array, sigma: float) -> Array:
    """Return Huber's weights; 0 where a residual is missing."""
    size = np.abs(np.nan_to_num(residual)) / sigma
    return np.where(np.isfinite(residual), np.minimum(1.0, HUBER / np.maximum(size, 1e-9)), 0.0)


def autocorrelation_time(r: Array) -> float:
    """Return the integrated autocorrelation time of residuals (n,) in samples, 1 for white noise."""
    r = r - r.mean()
    spectrum = np.abs(np.fft.rfft(r, 2 * len(r))) ** 2
    correlation = np.fft.irfft(spectrum)[: max(len(r) // 4, 2)]
    correlation = correlation / max(correlation[0], 1e-300)
    low = np.flatnonzero(correlation < 0.1)
    until = int(low[0]) if low.size else len(correlation)
    return 1.0 + 2.0 * float(correlation[1:until].sum())
