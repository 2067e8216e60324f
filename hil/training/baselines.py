"""Baselines without a network, on the windows of the network's score.

The cheapest baseline is the evidence with shrinkage: each deviation of the fit under the prior that most parameters
have not moved. The amount of shrinkage is learned from the training windows, one law for each parameter. The nearest
baseline is the untrained start of the network (`sparse`). A network that gains nothing from a record would be as good
with the record of another rig, or with none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from twin import NORMAL90
from twin.calibrators.hiera_unet import Windows
from twin.calibrators.hiera_unet.training.score import MOVED
from twin.network import Array

LEAST_SD = 0.003
"""Standard deviation, as a share of the bound, that is added to that of an estimate."""
FEWEST = 30
"""Fewest labels to fit a law from; with fewer an estimate is unchanged."""


@dataclass(frozen=True)
class Shrinkage:
    """Spike-and-slab prior: theta is 0, or with probability `moved` N(0, slab^2); the estimate has error N(0, (wide
    sd)^2 + floor^2). All (P,).
    """

    moved: Array
    slab: Array
    wide: Array
    floor: Array

    def of(self, estimate: Array, sd: Array) -> tuple[Array, Array]:
        """Return posterior mean and standard deviation (N, P) of estimates (N, P) with standard errors (N, P)."""
        noise = (self.wide * sd) ** 2 + self.floor**2
        total = noise + self.slab**2
        odds = np.log(self.moved / (1.0 - self.moved)) + 0.5 * (
            np.log(noise / total) + estimate**2 * (1.0 / noise - 1.0 / total)
        )
        chance = 1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))
        gain = self.slab**2 / total
        mean = chance * gain * estimate
        square = chance * ((gain * estimate) ** 2 + gain * noise)
        return mean, np.sqrt(np.maximum(square - mean**2, 1e-8))

    @classmethod
    def learned(cls, estimate: Array, sd: Array, true: Array, known: np.ndarray) -> Shrinkage:
        """Return the laws with the least squared error on known labels (N, P)."""
        count = estimate.shape[1]
        found = np.tile(np.array([0.5, 1e3, 1e-3, 1e-3]), (count, 1))
        for k in range(count):
            rows = known[:, k] & np.isfinite(true[:, k])
            if rows.sum() < FEWEST:
                continue
            e, s, t = estimate[rows, k], sd[rows, k], true[rows, k]

            def missed(v: Array, e: Array = e, s: Array = s, t: Array = t) -> float:
                return float(np.mean((cls(*_laws(v)).of(e, s)[0] - t) ** 2))

            starts = [
                np.array([-2.0, np.log(slab), np.log(wide), np.log(0.02)]) for slab in (0.1, 0.4) for wide in (1.0, 4.0)
            ]
            best = min((minimize(missed, v, method="Nelder-Mead") for v in starts), key=lambda r: float(r.fun))
            found[k] = _laws(best.x)
        return cls(*found.T)


def _laws(v: Array) -> tuple[Array, Array, Array, Array]:
    """Return probability, slab, widening and floor of free variables (4,)."""
    rest = np.exp(np.clip(v[1:], -9.0, 5.0))
    return 1.0 / (1.0 + np.exp(-np.clip(v[0], -9.0, 9.0))), rest[0], rest[1], rest[2]


def shuffled(windows: Windows) -> Windows:
    """Return the channels of the windows half a split away, with their availability; the evidence is unchanged."""
    rows = np.roll(np.arange(len(windows)), len(windows) // 2)
    return replace(windows, x=windows.x[rows], m=windows.m[rows])


def noisy(windows: Windows) -> Windows:
    """Return channels of white noise, as wide as the channels over all windows."""
    rng = np.random.default_rng(0)
    seen = np.where(windows.m, windows.x, np.nan)[:: max(len(windows) // 50, 1)]
    width = np.nan_to_num(np.nanstd(seen.reshape(-1, seen.shape[-1]), axis=0))
    noise = rng.standard_normal(windows.x.shape, dtype=np.float32) * width.astype(np.float32)
    return replace(windows, x=np.where(windows.m, noise, 0.0).astype(np.float32))


def judged(theta: Array, sd: Array, true: Array, known: np.ndarray) -> dict[str, float | None]:
    """Score estimates (N, P) with standard deviations against known labels, with equal weight for each parameter.

    Winkler's score is of 90 % intervals mean -+ 1.645 sd (Gneiting & Raftery, JASA 102 (2007) 359), less is better;
    `nll` is the mean negative log-likelihood of a normal law.
    """
    good = known & np.isfinite(true)
    error, half = np.where(good, np.abs(theta - np.nan_to_num(true)), 0.0), NORMAL90 * sd
    score = 2.0 * half + 20.0 * np.maximum(error - half, 0.0)
    nll = 0.5 * (error / sd) ** 2 + np.log(sd) + 0.5 * np.log(2.0 * np.pi)
    moved = good & (np.abs(np.nan_to_num(true)) > MOVED)
    found = {
        "parameters": _mean(error, good),
        "moved": _mean(error, moved),
        "rmse": _mean(error**2, good) ** 0.5,
        "inside90": _mean((error <= half).astype(float), good),
        "width90": _mean(2.0 * half, good),
        "winkler90": _mean(score, good),
        "nll": _mean(nll, good),
    }
    return {name: value if np.isfinite(value) else None for name, value in found.items()}


def _mean(values: Array, good: np.ndarray) -> float:
    """Return the mean over parameters of their means over windows; NaN without any entry."""
    told = good.any(axis=0)
    if not told.any():
        return float("nan")
    return float(np.mean([values[good[:, k], k].mean() for k in np.flatnonzero(told)]))


def estimates(config: Any, train: Windows, windows: Windows) -> dict[str, tuple[Array, Array]]:
    """Return baseline -> means and standard deviations (N, P) of deviations, from the evidence of `windows` alone."""

    def told(rows: Windows) -> list[Array]:
        """Return deviations and standard errors of the fit, and the sparse estimates with their probabilities: (N, P)
        each, from the end of the static numbers.
        """
        return np.split(rows.meta[:, -config.told : -1].astype(np.float64), 5, axis=1)

    least = LEAST_SD * np.array(config.bounds)
    before, before_sd, *_ = told(train)
    laws = Shrinkage.learned(before, before_sd, train.theta.astype(np.float64), train.known)
    fit, sd, mean, few_sd, _ = told(windows)
    labels = np.where(train.known, np.nan_to_num(train.theta), 0.0).astype(np.float64)
    spread = np.sqrt((labels**2).sum(axis=0) / np.maximum(train.known.sum(axis=0), 1))
    return {
        "commissioned": (np.zeros_like(fit), np.broadcast_to(spread + least, fit.shape)),
        "Gauss-Newton": (fit, sd + least),
        "Gauss-Newton, shrunk": laws.of(fit, sd),
        "few parameters moved": (mean, np.hypot(few_sd, least)),
    }
