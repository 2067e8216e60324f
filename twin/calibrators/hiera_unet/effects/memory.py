"""Memory of a healthy record: the power that a twin lacks in health, by operating point, and its covariance.

The power at each node is regressed on the operating point: inputs, their rates and their distance from their own past.
Readings are no regressors, since the power itself is a linear function of them. The regression is Bayesian; its prior's
precision has the largest marginal likelihood (Bishop, Pattern Recognition and Machine Learning, 2006, sec. 3.5).

Residuals come from ten contiguous folds. Their variance grows in transitions, in which a lumped twin errs most:
v (1 + b q), with q the mean square of the rates over their usual one and b of the largest likelihood. Their
autocorrelation enters the variance of a sum of m windows by Bartlett's weights (Newey and West, Econometrica 55 (1987)
703).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.effects.balance import EVERY_S, Figures
from twin.calibrators.hiera_unet.model.config import HieraError
from twin.network import Array

FOLDS = 10
LEAST_WINDOWS = 36
"""Three hours: fewer windows teach no covariance of nodes and no memory of operating points."""
PRECISIONS = np.geomspace(1e-2, 1e5, 15)
LAGS = (1, 2, 3, 4, 6, 9, 14, 24, 48)
"""Numbers of windows since a possible onset."""
PAST_S = (1800.0, 7200.0)
"""Time constants of the past that the operating point is compared with, s."""
MOST_CORRELATED = 24
"""Largest number of windows over which correlation is followed."""
GROWTHS = (1.0, 3.0, 10.0, 30.0)
"""Growths b that are compared. The least one is a prior: a healthy record with slow changes alone does not show how
much a lumped twin errs in fast ones.
"""
MOST_UNREST = 1000.0
"""Largest square of a rate in healthy standard deviations that counts."""
FAR = 4.0
"""Distance from the healthy mean, in standard deviations, beyond which the memory is not extrapolated."""


@dataclass(frozen=True)
class Memory:
    """Memory of one rig's healthy record.

    Attributes
    ----------
    centre, scale
        Mean and standard deviation of the operating point (X,).
    usual
        Root mean square of the rates of inputs and temperatures (c + N,).
    weight
        Weights of the regression (N, X), W.
    spread
        Covariance of the weights (N, X, X), W^2.
    unrest
        Growth of each node's variance with the rates (N,).
    rate
        Covariance of the sum of m windows over m (M, N, N), W^2, for each of `LAGS`, at rest.
    """

    centre: Array
    scale: Array
    usual: Array
    weight: Array
    spread: Array
    unrest: Array
    rate: Array

    def read(self, figures: Figures) -> tuple[Array, Array, Array]:
        """Return the power beyond that of health (K, N), W, the operating point in deviations (K, X), and the variance
        of each node over that at rest (K, N).
        """
        point = np.clip((_operating(figures) - self.centre) / self.scale, -FAR, FAR)
        growth = 1.0 + self.unrest * _unrest(figures, self.usual)[:, None]
        return figures.power - point @ self.weight.T, point, growth


def learn(figures: Figures) -> Memory:
    """Return the memory of a healthy record.

    Raises
    ------
    HieraError
        The record has too few windows.
    """
    valid = figures.valid
    count = int(valid.sum())
    if count < LEAST_WINDOWS:
        raise HieraError(
            f"the healthy record has {count} valid windows of {EVERY_S / 60:g} min; give at least {LEAST_WINDOWS}"
        )
    power, operating = figures.power[valid], _operating(figures)[valid]
    centre, scale = operating.mean(axis=0), operating.std(axis=0)
    # A column that stands still in health teaches nothing; the first one is the intercept.
    still = scale <= 1e-9 * np.maximum(np.abs(centre), 1e-6)
    scale = np.where(still, np.inf, scale)
    centre[0], scale[0] = 0.0, 1.0
    point = (operating - centre) / scale
    nodes = power.shape[1]
    fold = np.arange(count) * FOLDS // count
    weight, spread = np.empty((nodes, point.shape[1])), np.empty((nodes, point.shape[1], point.shape[1]))
    left = np.empty_like(power)
    for i in range(nodes):
        precision = _best_precision(point, power[:, i])
        weight[i], spread[i] = _fitted(point, power[:, i], precision)
        for f in range(FOLDS):
            out = fold == f
            partly, _ = _fitted(point[~out], power[~out, i], precision)
            left[out, i] = power[out, i] - point[out] @ partly
    usual = np.sqrt(np.mean(figures.rates[valid] ** 2, axis=0))
    usual = np.where(usual > 0.0, usual, np.inf)
    q = _unrest(figures, usual)[valid]
    unrest = np.array([_best_growth(q, left[:, i]) for i in range(nodes)])
    return Memory(centre, scale, usual, weight, spread, unrest, _rates(left / np.sqrt(1.0 + np.outer(q, unrest))))


def _unrest(figures: Figures, usual: Array) -> Array:
    """Return the mean square (K,) of the rates in this window and the one before, over the usual one."""
    square = np.minimum((figures.rates / usual) ** 2, MOST_UNREST).mean(axis=1)
    found: Array = 0.5 * (square + np.concatenate([square[:1], square[:-1]]))
    return found


def _best_growth(q: Array, left: Array) -> float:
    """Return the growth of the variance with q of the largest likelihood; the variance at rest is profiled out."""
    best, found = -np.inf, 0.0
    for growth in GROWTHS:
        scaled = 1.0 + growth * q
        likelihood = -0.5 * len(q) * np.log(np.mean(left**2 / scaled) + 1e-30) - 0.5 * np.log(scaled).sum()
        if likelihood > best:
            best, found = float(likelihood), growth
    return found


def _operating(figures: Figures) -> Array:
    """Return the operating point (K, X): 1, inputs, their rates now and a window ago, their distance from their past.

    Metal, layers and water on its way follow a change over minutes to hours, which a lumped twin does not.
    """
    level = figures.levels
    rate = figures.rates[:, : level.shape[1]]
    found = [np.ones((len(level), 1)), level, rate, np.vstack([rate[:1], rate[:-1]])]
    for constant in PAST_S:
        keep = np.exp(-EVERY_S / constant)
        slow = level.copy()
        for k in range(1, len(slow)):
            slow[k] = keep * slow[k - 1] + (1.0 - keep) * level[k]
        found.append(level - slow)
    return np.concatenate(found, axis=1)


def _fitted(x: Array, y: Array, precision: float) -> tuple[Array, Array]:
    """Return weights and their covariance; the intercept has no prior to speak of."""
    prior = np.full(x.shape[1], precision)
    prior[0] = 1e-6
    inverse = np.linalg.inv(x.T @ x + np.diag(prior))
    weight = inverse @ (x.T @ y)
    variance = float(np.mean((y - x @ weight) ** 2)) * len(y) / max(len(y) - np.trace(inverse @ x.T @ x), 0.2 * len(y))
    return weight, inverse * variance


def _best_precision(x: Array, y: Array) -> float:
    """Return the prior's precision, over that of the noise, with the largest marginal likelihood."""
    values, vectors = np.linalg.eigh(x[:, 1:].T @ x[:, 1:])
    values = np.maximum(values, 0.0)
    centred = y - y.mean()
    seen = vectors.T @ (x[:, 1:].T @ centred)
    total = float(centred @ centred)
    best, found = -np.inf, PRECISIONS[-1]
    for precision in PRECISIONS:
        misfit = max(total - float((seen**2 / (values + precision)).sum()), 1e-12 * total + 1e-30)
        evidence = -0.5 * len(y) * np.log(misfit) - 0.5 * np.log1p(values / precision).sum()
        if evidence > best:
            best, found = evidence, precision
    return float(found)


def _rates(left: Array) -> Array:
    """Return the covariance of a sum of m windows over m, for each of `LAGS`, from residuals (k, N)."""
    count, nodes = left.shape
    reach = min(MOST_CORRELATED, count // 6)
    gamma = [left[lag:].T @ left[: count - lag] / count for lag in range(reach + 1)]
    found = np.empty((len(LAGS), nodes, nodes))
    single = gamma[0]
    floor = np.diag(np.diag(single))
    for k, m in enumerate(LAGS):
        total = gamma[0].copy()
        for lag in range(1, min(m, reach + 1)):
            total += (1.0 - lag / m) * (gamma[lag] + gamma[lag].T)
        # Shrunk to its own diagonal, and kept positive: a hundred windows do not teach a covariance of nine nodes.
        diagonal = np.maximum(np.diag(total), 0.1 * np.diag(single))
        scale = np.sqrt(diagonal)
        correlation = total / np.outer(scale, scale)
        shrunk = (1.0 - nodes / (nodes + 0.1 * count)) * (correlation - np.eye(nodes)) + np.eye(nodes)
        values, vectors = np.linalg.eigh(0.5 * (shrunk + shrunk.T))
        shrunk = (vectors * np.maximum(values, 0.05)) @ vectors.T
        found[k] = shrunk * np.outer(scale, scale) + 1e-9 * floor
    return found
