"""Baselines of a cell's calibration behind one interface: fitted on one part of the blocks, asked about windows of
another.

Every baseline predicts the reading of the outlet thermometer in a target interval of two hours whose readings are
hidden. It may use the inputs in it, and all readings that end before it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.calibration.outlet_interval import WINDOW_S
from twin.tower.cell import STARVING, solve_cell
from twin.tower.cell_observations import Label
from twin.tower.estimates import DAY_S, Blocks, Estimate, Opening, Priors
from twin.tower.estimates import WALK as DAILY
from twin.tower.model import DEVIATIONS, NAMES, SLOW, CellModel
from twin.tower.smoother import estimate

TRAIN, GAP_S = 9.0 / 14.0, DAY_S
TEST = 3.0 / 14.0
"""Parts of a record: 9, 2 and 3 of 14 months for training, choice and test, a day apart."""
MONTH_S = 30.0 * DAY_S
BLOCK_SIGMA = 0.3
"""Standard deviation of a block's outlet, K, for a fit that does not learn the twin's own error:
about the difference of Merkel's method from a real cell over all weather."""
PERSISTENT_BLOCKS = 3
NEUTRAL = {"fill_share": 1.0, "wetting": 1.0, "starving": STARVING, "draft": 0.02, "rest": 1.0, "kappa": -1.3}
"""Global quantities with which the model is the clean cell's; the others are 0."""
TREES = {"n_estimators": 120, "min_samples_leaf": 5, "n_jobs": 1}


@dataclass(frozen=True)
class CellDataset:
    """A cell's blocks with the model of its clean cell, priors, evidence, and the blocks of training and test."""

    model: CellModel
    blocks: Blocks
    priors: Priors
    labels: Sequence[Label]
    openings: Sequence[Opening]
    train: NDArray[np.bool_]
    test: NDArray[np.bool_]


class Baseline(Protocol):
    """A way to predict readings: returns those of the test blocks, NaN elsewhere (n,)."""

    def __call__(self, case: CellDataset) -> Array: ...


def split(blocks: Blocks) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the blocks for training and for test, in time, with a day between them at least."""
    start, end = float(blocks.time_s[0]), float(blocks.time_s[-1])
    train = blocks.time_s <= start + TRAIN * (end - start)
    test = blocks.time_s >= max(end - TEST * (end - start), start + TRAIN * (end - start) + GAP_S)
    return train & np.isfinite(blocks.outlet), test & np.isfinite(blocks.outlet)


def clean_reading(case: CellDataset) -> Array:
    """Return the readings by the clean cell."""
    u = case.blocks.operation.inputs
    out = solve_cell(u, case.model.design).t_out
    return np.asarray(out + case.blocks.operation.bypass * (u.t_in - out))


def commissioned(case: CellDataset) -> Array:
    """Predict by the clean cell as commissioned."""
    return np.where(case.test, clean_reading(case), np.nan)


def persistence(case: CellDataset) -> Array:
    """Predict by the clean cell and its error in the last half hour before the window."""
    clean = clean_reading(case)
    error = case.blocks.outlet - clean
    there = np.flatnonzero(np.isfinite(error))
    found = np.full(len(clean), np.nan)
    for start, rows in _windows(case):
        before = there[case.blocks.time_s[there] < start][-PERSISTENT_BLOCKS:]
        found[rows] = clean[rows] + (float(error[before].mean()) if len(before) else 0.0)
    return found


def monthly_least_squares(case: CellDataset) -> Array:
    """Predict by deviations that least squares give on the month before each day, without priors."""
    return _linear(case, _reference(case, None), MONTH_S, None, DAY_S)


def gauss_newton(case: CellDataset) -> Array:
    """Predict by deviations that a MAP estimate gives on the day before, the twin taken as right."""
    return _linear(
        case, _reference(case, None), DAY_S, np.array([case.priors.slow(n)[1] for n in DEVIATIONS]), WINDOW_S
    )


def with_discrepancy(case: CellDataset) -> Array:
    """Predict by the same about the training part's posterior, its discrepancy subtracted and its walk as the prior."""
    rows = np.flatnonzero(case.train)
    blocks = _take(case.blocks, rows)
    end = float(blocks.time_s[-1])
    labels = [label for label in case.labels if label.time_s <= end]
    posterior = estimate(case.model, blocks, case.priors, labels, [o for o in case.openings if o.start_s <= end])
    days = (float(case.blocks.time_s[-1]) - end) / DAY_S
    sd = np.hypot(posterior.sd()[-1, :4] * 0.5, np.array([DAILY[n] for n in DEVIATIONS]) * np.sqrt(days))
    return _linear(case, _reference(case, posterior), DAY_S, sd, WINDOW_S, sigma=posterior.sigma[0])


def random_forest(case: CellDataset) -> Array:
    """Predict the clean cell's error by a random forest of the operating point and the error before the window."""
    from sklearn.ensemble import RandomForestRegressor

    return _learned(case, lambda: RandomForestRegressor(random_state=0, **TREES))


def gradient_boosting(case: CellDataset) -> Array:
    """Predict the clean cell's error by gradient boosting of the same features."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    return _learned(case, lambda: HistGradientBoostingRegressor(random_state=0, max_iter=200, learning_rate=0.06))


BASELINES: dict[str, Baseline] = {
    "commissioned": commissioned,
    "persistence": persistence,
    "monthly least squares": monthly_least_squares,
    "Gauss-Newton MAP": gauss_newton,
    "Gauss-Newton MAP with discrepancy": with_discrepancy,
    "random forest": random_forest,
    "gradient boosting": gradient_boosting,
}


def without_discrepancy(priors: Priors) -> Priors:
    """Return the priors of a fit that takes the twin as right: its global quantities are held at what the clean cell
    has."""
    means, sds = (values[: len(NAMES)] for values in priors.constant())
    free = ("kappa", "power_gain")
    held = {n: (m, s) if n in free else (NEUTRAL.get(n, 0.0), 1e-6) for n, m, s in zip(NAMES, means, sds, strict=True)}
    return Priors(priors.bounds, held, discrepancy=False)


def _windows(case: CellDataset, length_s: float = WINDOW_S) -> list[tuple[float, NDArray[np.intp]]]:
    rows = np.flatnonzero(case.test)
    number = np.floor(case.blocks.time_s[rows] / length_s).astype(np.int64)
    return [(float(k) * length_s, rows[number == k]) for k in np.unique(number)]


def _take(b: Blocks, rows: NDArray[np.intp]) -> Blocks:
    return Blocks(b.time_s[rows], b.operation.take(rows), b.outlet[rows], b.log_power[rows])


def _reference(case: CellDataset, posterior: Estimate | None) -> tuple[Array, Array]:
    """Return readings and their slopes by the deviations (n, 4) about a reference: the clean cell, or a posterior's
    end."""
    if posterior is None:
        constants, slow = np.array([NEUTRAL.get(name, 0.0) for name in NAMES]), np.zeros(len(SLOW))
    else:
        constants, slow = posterior.constant, posterior.slow[-1]
    here = np.tile(slow, (len(case.blocks.time_s), 1))
    base = case.model.reading(case.blocks.operation, here, constants)
    slopes = np.ones((len(base), len(DEVIATIONS)))
    for j in range(3):
        moved = here.copy()
        moved[:, j] += 0.01
        slopes[:, j] = (case.model.reading(case.blocks.operation, moved, constants) - base) / 0.01
    return base, slopes


def _linear(
    case: CellDataset,
    reference: tuple[Array, Array],
    context_s: float,
    prior_sd: Array | None,
    every_s: float,
    sigma: float = BLOCK_SIGMA,
) -> Array:
    """Predict by deviations that the context before each window gives; `prior_sd` None is least squares."""
    base, slopes = reference
    error = case.blocks.outlet - base
    there = np.isfinite(error)
    found = np.full(len(base), np.nan)
    penalty = np.zeros(4) if prior_sd is None else 1.0 / prior_sd**2
    for start, rows in _windows(case, every_s):
        context = there & (case.blocks.time_s >= start - context_s) & (case.blocks.time_s < start)
        j = slopes[context] / (sigma * np.sqrt(3.0))  # blocks of ten minutes, errors of half an hour
        if prior_sd is None:
            change = (
                np.linalg.lstsq(slopes[context], error[context], rcond=1e-6)[0] if context.sum() >= 8 else np.zeros(4)
            )
        else:
            right = j.T @ (error[context] / (sigma * np.sqrt(3.0)))
            change = np.linalg.solve(j.T @ j + np.diag(penalty), right)
        found[rows] = base[rows] + slopes[rows] @ change
    return found


def _learned(case: CellDataset, make: Callable[[], Any]) -> Array:
    """Predict the clean cell's error by a regression that is trained on windows of the training part."""
    clean = clean_reading(case)
    error = case.blocks.outlet - clean
    o, u = case.blocks.operation, case.blocks.operation.inputs
    features = np.stack(
        [
            u.t_in,
            u.m_w,
            u.speed,
            u.dry,
            u.wet,
            u.pressure,
            o.wind,
            np.sin(np.radians(o.wind_deg)),
            np.cos(np.radians(o.wind_deg)),
            o.neighbours,
            o.bypass,
            clean,
            _before_window(case.blocks, error),
        ],
        axis=1,
    )
    model = make()
    usable = case.train & np.isfinite(error)
    model.fit(np.nan_to_num(features[usable]), error[usable])
    found = np.full(len(clean), np.nan)
    rows = np.flatnonzero(case.test)
    if len(rows):
        found[rows] = clean[rows] + model.predict(np.nan_to_num(features[rows]))
    return found


def _before_window(blocks: Blocks, error: Array) -> Array:
    """Return the mean error of the last half hour before each block's window (n,)."""
    start = np.floor(blocks.time_s / WINDOW_S) * WINDOW_S
    there = np.flatnonzero(np.isfinite(error))
    last = np.searchsorted(blocks.time_s[there], start)
    total = np.concatenate([[0.0], np.cumsum(error[there])])
    first = np.maximum(last - PERSISTENT_BLOCKS, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(last > first, (total[last] - total[first]) / (last - first), 0.0)
