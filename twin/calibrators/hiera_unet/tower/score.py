"""Scores of predictions on unseen cells: deviations, outlet, intervals, and the rivals on the same windows.

All errors are against the truth of a simulated station, with the target's own readings hidden from every method.
Rivals:
the commissioned twin; persistence of its last error; recursive Gauss-Newton with the learned discrepancy; and gradient
boosting that corrects the latter's deviations and outlet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from twin.calibrators.hiera_unet.model.trees import Trees
from twin.calibrators.hiera_unet.tower.predict import BLOCK_CYCLES, Predicted, corrections_of, interval
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower.windows import BLOCK_MIN, CONTEXT, LAST_MIN, TARGET, Fleet
from twin.quantiles import NORMAL90
from twin.tower.air import Array
from twin.tower.model import DEVIATIONS

AFTER_CHANGE_MIN, CHANGED = 30, 0.15
"""Minutes after a change of the fan's speed by this share of full within five minutes."""
LEVEL = 0.9


@dataclass(frozen=True)
class Targets:
    """Targets of K windows: truth and prior. Arrays (K, 120) in degC, (K, 4) deviations.

    Attributes:
        water: by the twin at the prior mean. slopes: (K, 120, 3). true_water, reading, commissioned: NaN where none.
        changed: minutes soon after a change of the fan. recent: (K, 3) mean residual of readings before the target, K.
        features: (K, F) of the window for a booster. minutely: (K, 120, 5) operating point and lead.
    """

    rows: NDArray[np.int64]
    cell: Array
    mean: Array
    sd: Array
    true: Array
    water: Array
    slopes: Array
    true_water: Array
    reading: Array
    commissioned: Array
    changed: Array
    recent: Array
    features: Array
    minutely: Array

    @property
    def block(self) -> NDArray[np.int64]:
        """Number of the week and cell of each window."""
        return self.cell.astype(np.int64) * 100000 + self.rows // BLOCK_CYCLES


def targets_of(fleet: Fleet, rows: NDArray[np.int64], size: int = 256) -> Targets:
    """Return the targets of cycles `rows` (K,)."""
    parts: list[dict[str, Array]] = []
    for at in range(0, len(rows), size):
        chosen = torch.from_numpy(rows[at : at + size]).to(fleet.device)
        batch = fleet.batch(chosen)
        index = fleet.start[chosen][:, None] + torch.arange(TARGET - CONTEXT, TARGET, device=fleet.device)
        point = fleet.arrays["point"][index].float()
        speed = torch.nan_to_num(point[..., 2], nan=-1.0)
        step = torch.zeros_like(speed, dtype=torch.bool)
        step[:, 5:] = (speed[:, 5:] - speed[:, :-5]).abs() > 2.0 * CHANGED
        changed = torch.nn.functional.max_pool1d(step.float()[:, None], AFTER_CHANGE_MIN, 1)[:, 0]
        parts.append(
            {
                k: v.float().cpu().numpy()
                for k, v in {
                    "cell": fleet.cell[chosen],
                    "mean": batch.mean,
                    "sd": batch.sd,
                    "true": batch.true,
                    "water": batch.water,
                    "slopes": batch.slopes,
                    "true_water": batch.true_water,
                    "reading": batch.reading,
                    "commissioned": fleet.arrays["commissioned"][index][:, -TARGET:],
                    "changed": changed[:, -TARGET:],
                    "recent": batch.features[:, -len(LAST_MIN) :],
                    "features": batch.features[:, : -len(LAST_MIN)],
                    "minutely": batch.minutely,
                }.items()
            }
        )
    joined = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    return Targets(rows=rows, **joined)


@dataclass(frozen=True)
class MethodPrediction:
    """A method's deviations (K, 4) and water (K, 120) degC; half widths of 90 % intervals, or None."""

    theta: Array
    water: Array
    theta_half: Array | None = None
    water_half: Array | None = None


def believed(t: Targets) -> MethodPrediction:
    """Return recursive Gauss-Newton with the learned discrepancy, with its own intervals of the deviations."""
    return MethodPrediction(t.mean, t.water, NORMAL90 * t.sd)


def commissioned(t: Targets) -> MethodPrediction:
    """Return the commissioned twin."""
    return MethodPrediction(np.zeros_like(t.mean), t.commissioned)


def persistent(t: Targets) -> MethodPrediction:
    """Return Gauss-Newton with its mean error of the last half hour, where there were readings."""
    return MethodPrediction(t.mean, t.water + t.recent[:, :1])


def mixed(t: Targets, members: Sequence[Predicted]) -> tuple[MethodPrediction, Array, Array]:
    """Return the ensemble's answer, and its standard deviations of deviations (K, 4) and of the water (K, 120).

    The water is the twin at the belief, moved by the members' deviations along its slopes, plus their corrections.
    """
    bounds = _bounds()
    theta = np.mean([p.theta for p in members], axis=0)
    variance = np.mean([np.exp(p.log_variance) for p in members], axis=0) * bounds**2
    sd = np.sqrt(variance + np.var([p.theta for p in members], axis=0))
    waters = [t.water + np.einsum("kij,kj->ki", t.slopes, (p.theta - t.mean)[:, :3]) + p.delta for p in members]
    water = np.mean(waters, axis=0)
    scale = np.mean([2.0 * (np.exp(np.clip(p.log_scale, -6, 6)) * 0.3) ** 2 for p in members], axis=0)
    return MethodPrediction(theta, water), sd, np.sqrt(scale + np.var(waters, axis=0))


def started(fleet: Fleet, t: Targets) -> MethodPrediction:
    """Return the answer that a network on this fleet corrects: that of its trees, else the belief."""
    if fleet.base is None:
        return MethodPrediction(t.mean, t.water)
    rows = torch.from_numpy(t.rows).to(fleet.device)
    theta, water = (one[rows].cpu().numpy() for one in fleet.base)
    return MethodPrediction(t.mean + theta, t.water + water.repeat(BLOCK_MIN, axis=1))


def boosted(trees: Trees, fleet: Fleet, rows: NDArray[np.int64], size: int = 64) -> MethodPrediction:
    """Return the answer to cycles `rows` (K,) of trees that correct the belief."""
    trees.to(fleet.device)
    theta, water = [], []
    for at in range(0, len(rows), size):
        batch = fleet.batch(torch.from_numpy(rows[at : at + size]))
        begun = batch.begun(*corrections_of(trees, batch))
        theta.append(begun.base_theta.cpu().numpy())
        water.append(begun.base_water.cpu().numpy())
    return MethodPrediction(np.concatenate(theta), np.concatenate(water))


def shrink_factors(t: Targets, base: MethodPrediction, found: MethodPrediction) -> tuple[Array, float]:
    """Return the factors, 0 to 1, of the corrections of deviations (4,) and outlet with the least absolute error.

    With e the error of the base and c a correction it is the median of e / c, weighted by |c|. So no mean error on
    these windows is larger than the base's.
    """
    theta = [
        _least_absolute((t.true - base.theta)[:, j], (found.theta - base.theta)[:, j]) for j in range(len(DEVIATIONS))
    ]
    return np.array(theta), _least_absolute((t.true_water - base.water).ravel(), (found.water - base.water).ravel())


def shrunk(base: MethodPrediction, found: MethodPrediction, theta: Array, water: float) -> MethodPrediction:
    """Return an answer whose corrections of the base have these factors."""
    return MethodPrediction(
        base.theta + theta * (found.theta - base.theta), base.water + water * (found.water - base.water)
    )


def _least_absolute(error: Array, correction: Array) -> float:
    there = np.isfinite(error) & (np.abs(correction) > 1e-9)
    if not there.any():
        return 1.0
    ratio, weight = error[there] / correction[there], np.abs(correction[there])
    order = np.argsort(ratio)
    total = np.cumsum(weight[order])
    return float(np.clip(ratio[order][np.searchsorted(total, 0.5 * total[-1])], 0.0, 1.0))


def _bounds() -> Array:
    return np.array([one.bound for one in SUBJECT.deviations])


@dataclass(frozen=True)
class IntervalFactors:
    """Factors by which standard deviations become 90 % intervals on windows outside of training: deviations (4,),
    water.
    """

    theta: Array
    water: float

    @classmethod
    def of(cls, t: Targets, found: MethodPrediction, sd: Array, water_sd: Array) -> IntervalFactors:
        """Return the factors by split conformal prediction: one score a window, of a minute drawn by a fixed seed."""
        theta = np.nanquantile(np.abs(found.theta - t.true) / sd, LEVEL, axis=0)
        minute = np.random.default_rng(0).integers(0, TARGET, len(t.rows))
        k = np.arange(len(t.rows))
        score = (np.abs(found.water - t.true_water) / water_sd)[k, minute]
        return cls(theta, float(np.nanquantile(score, LEVEL)))

    def applied(self, found: MethodPrediction, sd: Array, water_sd: Array) -> MethodPrediction:
        """Return the answer with its intervals."""
        return MethodPrediction(found.theta, found.water, self.theta * sd, self.water * water_sd)


class Booster:
    """Gradient boosting that corrects the figures of Gauss-Newton: the water by blocks of ten minutes, and deviations.

    Raises:
        ImportError: scikit-learn is not installed.
    """

    def __init__(self, t: Targets, seed: int = 0, most: int = 200_000) -> None:
        from sklearn.ensemble import HistGradientBoostingRegressor

        x, y = self._minutes(t), (t.true_water - t.water)[:, BLOCK_MIN // 2 :: BLOCK_MIN].ravel()
        there = np.flatnonzero(np.isfinite(y))
        chosen = np.random.default_rng(seed).permutation(there)[:most]
        options: dict[str, Any] = {"random_state": seed, "max_iter": 200, "learning_rate": 0.06}
        self.water = HistGradientBoostingRegressor(loss="absolute_error", **options).fit(x[chosen], y[chosen])
        own = self._windows(t)
        self.theta = []
        for j in range(len(DEVIATIONS)):
            error = t.true[:, j] - t.mean[:, j]
            good = np.isfinite(error)
            self.theta.append(HistGradientBoostingRegressor(**options).fit(own[good], error[good]))

    @staticmethod
    def _windows(t: Targets) -> Array:
        return np.concatenate([t.features, t.recent], axis=1)

    @classmethod
    def _minutes(cls, t: Targets) -> Array:
        points = t.minutely[:, BLOCK_MIN // 2 :: BLOCK_MIN]
        own = np.repeat(cls._windows(t)[:, None], points.shape[1], axis=1)
        return np.concatenate([own, points], axis=2).reshape(-1, own.shape[2] + points.shape[2])

    def __call__(self, t: Targets) -> MethodPrediction:
        """Return Gauss-Newton's answer, corrected."""
        more = self.water.predict(self._minutes(t)).reshape(len(t.rows), -1).repeat(BLOCK_MIN, axis=1)
        own = self._windows(t)
        theta = t.mean + np.stack([one.predict(own) for one in self.theta], axis=1)
        return MethodPrediction(theta, t.water + more)


def scores(t: Targets, found: MethodPrediction, rival: MethodPrediction | None = None, seed: int = 0) -> dict[str, Any]:
    """Return the scores of an answer as plain data.

    `worse_than_rival`: water error over the rival's, less one, with its 95 % interval; likewise each deviation's.
    """
    rng = np.random.default_rng(seed)
    error = found.water - t.true_water
    size = np.abs(error)
    blind = np.abs(found.water + found.theta[:, 3:4] - t.reading)
    window = _window_mean(size)
    after = t.changed > 0.5
    out: dict[str, Any] = {
        "windows": len(t.rows),
        "water_mae_K": _mean(size),
        "water_rmse_K": float(np.sqrt(_mean(error**2))),
        "water_median_K": _quantile(error, 0.5),
        "water_p90_K": _quantile(size, 0.9),
        "water_p99_K": _quantile(size, 0.99),
        "water_mae_after_fan_change_K": _mean(np.where(after, size, np.nan)),
        "reading_mae_K": _mean(blind),
        "deviation_mae": {n: _mean(np.abs(found.theta - t.true)[:, j]) for j, n in enumerate(DEVIATIONS)},
    }
    if found.theta_half is not None:
        inside = np.abs(found.theta - t.true) <= found.theta_half
        out["deviation_inside_90"] = {n: float(inside[:, j].mean()) for j, n in enumerate(DEVIATIONS)}
        out["deviation_width"] = {n: float(2.0 * found.theta_half[:, j].mean()) for j, n in enumerate(DEVIATIONS)}
    if found.water_half is not None:
        there = np.isfinite(size)
        out["water_inside_90"] = float((size <= found.water_half)[there].mean())
        out["water_width_K"] = float(2.0 * found.water_half[there].mean())
        out["water_interval_score_K"] = float(
            (2.0 * found.water_half + 20.0 * np.maximum(size - found.water_half, 0.0))[there].mean()
        )
    if rival is not None:
        theirs = np.abs(rival.water - t.true_water)
        out["worse_than_rival"] = {
            "water": interval(window, _window_mean(theirs), t.block, rng),
            "water_after_fan_change": interval(
                _window_mean(np.where(after, size, np.nan)), _window_mean(np.where(after, theirs, np.nan)), t.block, rng
            ),
            **{
                n: interval(np.abs(found.theta - t.true)[:, j], np.abs(rival.theta - t.true)[:, j], t.block, rng)
                for j, n in enumerate(DEVIATIONS)
            },
        }
    return out


def by_cell(t: Targets, names: Sequence[str], answers: Mapping[str, MethodPrediction]) -> dict[str, dict[str, float]]:
    """Return the mean absolute water error, K, of each method by cell."""
    found: dict[str, dict[str, float]] = {}
    for cell in np.unique(t.cell.astype(int)):
        rows = t.cell.astype(int) == cell
        found[names[cell]] = {n: _mean(np.abs(a.water - t.true_water)[rows]) for n, a in answers.items()}
    return found


def _window_mean(values: Array) -> Array:
    there = np.isfinite(values)
    total = np.where(there, values, 0.0).sum(axis=1)
    count = there.sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _quantile(values: Array, share: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else float("nan")


def joined(parts: Sequence[Targets]) -> Targets:
    """Return the targets of several fleets as one; cells are numbered anew."""
    values = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Targets)}
    return Targets(**values)


def taken(t: Targets, rows: Array) -> Targets:
    """Return the targets of some windows (K,) bool."""
    return Targets(**{f.name: getattr(t, f.name)[rows] for f in fields(Targets)})


def taken_answer(one: MethodPrediction, rows: Array) -> MethodPrediction:
    """Return an answer to some windows (K,) bool."""
    theta_half = None if one.theta_half is None else one.theta_half[rows]
    return MethodPrediction(
        one.theta[rows], one.water[rows], theta_half, None if one.water_half is None else one.water_half[rows]
    )
