"""Maximum a posteriori estimate of slow deviations over a whole record: Gauss-Newton on a grid of time.

The deviations are constant within a cell of the grid and walk at random from one to the next (`estimates`). The prior
of a deviation is that of a part that wears: its mean a third of the bound on the lossy side, its standard deviation a
third of the bound, so that the bound is two standard deviations below and a gain of a third of it two above. A
thermometer's bias has mean 0. Residuals of the model are correlated in time, so a block of them counts as less than one
observation, by their integrated autocorrelation time (Geyer 1992).

Scale and autocorrelation time of the residuals, and the amplitude of the discrepancy, are estimated in the first passes
and kept in the others. A step is halved until it lowers the objective of its pass, so that the estimate is a mode.

Sources: Bell, SIAM J. Optim. 4 (1994) 626 (Gauss-Newton as the iterated Kalman smoother); Schmidt, Adv. Control Syst. 3
(1966) 293 (considered constants); MacKay, Neural Comput. 4 (1992) 415 (amplitude by the marginal likelihood).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotri

from twin.tower.air import Array
from twin.tower.cell_observations import Label, PowerErrors, PowerRows, interval_as_gaussian
from twin.tower.estimates import (
    DAY_S,
    Blocks,
    Estimate,
    Opening,
    Priors,
    time_grid,
    unread_days,
    walk_precision,
    walk_variance,
)
from twin.tower.model import GLOBALS, NAMES, SLOW, CellModel

PASSES = 20
RESCALED = 5
"""Passes in which scale and autocorrelation time of the residuals, and the discrepancy's amplitude, are taken anew."""
STATED = 2.0
"""Weights that the stated amplitude of the discrepancy counts as: the prior of its square is inverse chi-square with
two degrees of freedom, so that it is known within a factor of two."""
HALVINGS = 8
"""Most halvings of a step that does not lower the objective."""
FLAT = 0.02
"""Largest change of a step below which the sensitivities of the step before are used again."""
CONVERGED = 2e-4
"""Largest change of an unknown, in its unit of `_Solver.unit`, at which the passes end."""
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


class _Solver:
    """Normal equations of [slow deviations by grid cell (k * s,), constants (g,)] of a record, and their solution.

    Names that end in `_t` are of the outlet's temperature, those in `_p` of the fan's power.
    """

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
        self.amplitude = 1.0
        self._hold()
        # Changes of the constants count in tenths of their priors' standard deviations.
        self.unit = np.concatenate([np.ones(self.k * self.s), 10.0 * self.sd_g])
        o = blocks.operation
        self.features = model.features(o) * (1.0 - o.bypass)[:, None] if self.g > len(NAMES) else None
        # A healthy record gives the weights a prior of their own.
        self.weighs_features = self.features is not None and priors.learned is None
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
            inner, drift = walk_precision(self.edges, name, openings, self.unread_d, self.priors.rates.get(name, 0.0))
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
        """Return the posterior by Gauss-Newton passes, from an estimate or from the prior's mean."""
        if start is None:
            x = cho_solve(cho_factor(self.precision), self.prior_mean)
        else:
            x = np.concatenate([start.slow.ravel(), start.constant])
            self.sigma = list(start.sigma)
            if self.weighs_features:
                self._set_amplitude(start.amplitude)
        variance: Array = np.zeros(0)
        jac_t, change = np.zeros((0, 0)), np.inf
        res_t, rows_p, res_p = self._residuals(x)
        left_p = res_p
        for number in range(PASSES):
            if change > FLAT:
                jac_t = self._outlet(*self._at_blocks(x))
            if number < RESCALED:
                # Later the scale stays: an objective that changes with each step has no minimum to converge to.
                self._rescale(res_t, left_p)
            w_t = self._outlet_weights(res_t)
            w_p = _weights(left_p, self.sigma[1]) / (self.sigma[1] ** 2 * self.tau_power)
            rows_p = replace(rows_p, weights=w_p)
            normal, right = self.precision.copy(), self.prior_mean.copy()
            self._add_labels(normal, right, x, variance)
            known = normal.copy(), right.copy()
            self._add_outlet(normal, right, x, jac_t, w_t, res_t)
            self._add_power(normal, right, x, rows_p, res_p)
            factor = cho_factor(normal)
            new = self._bounded(cho_solve(factor, right))
            linear = self._linear_residual(res_t, jac_t, x - new)
            before = x
            x, res_t, rows_p, res_p, left_p = self._descended(x, new, known, w_t, w_p, (res_t, rows_p, res_p))
            change = float((np.abs(x - before) / self.unit).max())
            if number == PASSES - 1 or (number >= (RESCALED if start is None else 2) and change < CONVERGED):
                break
            variance = self._label_variance(factor, self._considered(factor, normal))
            if number < RESCALED and self.weighs_features:
                self._set_amplitude(self._likely_amplitude(factor, x))
        return self._posterior(x, factor, normal, (jac_t, linear, w_t))

    def _posterior(
        self, x: Array, factor: tuple[Array, bool], normal: Array, of_outlet: tuple[Array, Array, Array]
    ) -> Estimate:
        """Return the estimate at the last point, with the slopes, linear residual and weights of its last pass."""
        jac_t, linear, w_t = of_outlet
        considered, covariance = self._considered(factor, normal), _inverse(factor[0])
        slow, g = self._parts(x)
        residual = self.blocks.outlet - self.model.reading(self.blocks.operation, slow[self.cell], g)
        return Estimate(
            self.edges,
            slow,
            g,
            covariance,
            (self.sigma[0], self.sigma[1]),
            residual,
            np.where(np.isfinite(residual), self._outlet_weights(residual), 0.0),
            self.cell,
            jac_t,
            self.tau,
            linear,
            w_t,
            considered,
            tuple((one, *self._sites[i]) for i, one in enumerate(self.labels)),
            amplitude=self.amplitude,
        )

    def _set_amplitude(self, amplitude: float) -> None:
        """Give the weights of the discrepancy the prior of this amplitude."""
        rows = np.arange(self.k * self.s + len(NAMES), len(self.prior_mean))
        self.amplitude = amplitude
        self.precision[rows, rows] = (amplitude * self.sd_g[len(NAMES) :]) ** -2.0

    def _likely_amplitude(self, factor: tuple[Array, bool], x: Array) -> float:
        """Return the discrepancy's amplitude over the stated one by its marginal likelihood, and by what was stated.

        Each weight counts by the share of its prior variance that the readings take away.
        """
        at, sd = self.k * self.s + len(NAMES), self.sd_g[len(NAMES) :]
        # The weights are the last unknowns, so that the end of the factor is that of their own precision.
        variance = (np.linalg.inv(np.triu(factor[0][at:, at:])) ** 2).sum(axis=1)
        seen = float((1.0 - variance / (self.amplitude * sd) ** 2).sum())
        return float(np.sqrt((STATED + float(((x[at:] / sd) ** 2).sum())) / (STATED + seen)))

    def _parts(self, x: Array) -> tuple[Array, Array]:
        """Return the slow deviations (k, s) and the constants (g,) of x."""
        return x[: self.k * self.s].reshape(self.k, self.s), x[self.k * self.s :]

    def _at_blocks(self, x: Array) -> tuple[Array, Array]:
        """Return the slow deviations (n, s) at each block, and the constants (g,)."""
        slow, g = self._parts(x)
        return slow[self.cell], g

    def _outlet_weights(self, residual: Array) -> Array:
        """Return the weights (n,), 1/K^2, of the outlet's readings."""
        return _weights(residual, self.sigma[0]) / (self.sigma[0] ** 2 * self.tau)

    def _linear_residual(self, residual: Array, jac: Array, moved: Array) -> Array:
        """Return the outlet's residuals (n,) after a move of all unknowns by less `moved`, to first order."""
        slow, g = self._at_blocks(moved)
        return np.asarray(residual + np.einsum("ij,ij->i", jac[:, : self.s], slow) + jac[:, self.s :] @ g)

    def _outlet(self, here: Array, g: Array) -> Array:
        """Return the slopes of the outlet's reading."""
        base = self.model.reading(self.blocks.operation, here, g)
        return self._slopes(lambda s, c: self.model.reading(self.blocks.operation, s, c), base, here, g)

    def _residuals(self, x: Array) -> tuple[Array, PowerRows, Array]:
        """Return the residuals of the outlet, slopes of the power without their weights, and its residuals."""
        (here, g), o = self._at_blocks(x), self.blocks.operation
        base = self.model.log_power(o, here, g)
        kappa, air = g[NAMES.index("kappa")], here[:, 1]
        shaft = 1.0 - self.model.design.idle / np.exp(base)
        rows = PowerRows(-kappa / (1.0 + air) * shaft, shaft, np.zeros(len(base)))
        return self.blocks.outlet - self.model.reading(o, here, g), rows, self.blocks.log_power - base

    def _add_power(self, normal: Array, right: Array, x: Array, rows: PowerRows, residual: Array) -> None:
        """Add the equations of the fan's power, linearised at x, to the normal equations."""
        here, g = self._at_blocks(x)
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

    def _add_outlet(self, normal: Array, right: Array, x: Array, jac: Array, w: Array, residual: Array) -> None:
        """Add the outlet's readings, linearised at x with weights w (n,), grid cell by grid cell."""
        s, end = self.s, self.k * self.s
        here, g = self._at_blocks(x)
        full = np.concatenate([here, np.broadcast_to(g, (len(here), self.g))], axis=1)
        target = np.nan_to_num(residual) + np.einsum("ij,ij->i", jac, full)
        weighted = jac * w[:, None]
        order = np.argsort(self.cell, kind="stable")
        starts = np.searchsorted(self.cell[order], np.arange(self.k + 1))
        for k in range(self.k):
            rows = order[starts[k] : starts[k + 1]]
            if not len(rows):
                continue
            h = weighted[rows].T @ jac[rows]
            b = weighted[rows].T @ target[rows]
            own = slice(k * s, (k + 1) * s)
            normal[own, own] += h[:s, :s]
            normal[own, end:] += h[:s, s:]
            normal[end:, own] += h[s:, :s]
            normal[end:, end:] += h[s:, s:]
            right[own] += b[:s]
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
        slow, _ = self._parts(x)
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
