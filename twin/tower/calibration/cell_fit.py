"""Calibration of one cell over a record: the posterior, and the outlet's prediction with its own window's readings
hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.cell_observations import Label
from twin.tower.estimates import Blocks, Estimate, Opening, Priors
from twin.tower.minutes import Minutes, blocks_of, first_order_lag
from twin.tower.model import DEVIATIONS, SLOW, CellModel
from twin.tower.smoother import estimate

WINDOW_S = 7200.0
"""Target interval of the paper: 120 minutes, whose outlet readings are hidden from the prediction in them."""
QUANTILE = 0.9
NORMAL = 1.6449
"""Half width of a 90 % interval in standard deviations."""
FEWEST_BLOCKS = 36
"""Steady blocks of ten minutes, six hours in all: below them nothing is fitted."""
FEWEST_RESIDUALS = 40
"""Readings of a class of minutes below which it takes the interval of all, half as wide again."""
START_MIN = (5, 20)
"""Minutes after a start that make classes of their own."""
WET_C = (5.0, 12.0, 18.0, 23.0)
"""Wet bulbs between which classes lie: the twin's error grows with the distance from its test points."""
LEAST_SHARE = 0.8
"""Share of a quantile that is left when the noise is taken off it: what differences show is not noise alone."""
LEAST_WIDTH_K = 0.05


class CalibrationError(ValueError):
    """A record that cannot calibrate a cell; the sentence names the reason and the remedy."""


@dataclass(frozen=True)
class Calibrated:
    """Result of a cell's calibration, arrays over its minutes (n,), NaN where withheld.

    Attributes
    ----------
    t_out, low, high
        Outlet of the flume, degC, with its 90 % interval.
    commissioned
        By the clean cell.
    deviations
        (n, 4) fill, air, uniformity as deviations from 1, bias K.
    sd
        Theirs (n, 4).
    posterior, blocks
        Of the fit.
    """

    t_out: Array
    low: Array
    high: Array
    commissioned: Array
    deviations: Array
    sd: Array
    posterior: Estimate
    blocks: Blocks


@dataclass(frozen=True)
class Fitted:
    """Posterior of a cell with what it was made of."""

    model: CellModel
    minutes: Minutes
    blocks: Blocks
    of_minute: NDArray[np.intp]
    posterior: Estimate


def fit_cell(
    model: CellModel,
    minutes: Minutes,
    priors: Priors,
    labels: Sequence[Label],
    openings: Sequence[Opening],
    edges_s: Array | None = None,
    start: Estimate | None = None,
) -> Fitted:
    """Fit the deviations of a cell to its steady blocks, from the estimate `start` on the same time grid if given.

    Parameters
    ----------
    model, priors
        The cell, and the priors of its deviations.
    minutes
        Minutes of its record.
    labels, openings
        Tests of the fill, and times at which a deviation may jump.
    edges_s
        (k + 1,) s, edges of the time grid; None for that of `time_grid`.
    start
        Estimate on the same grid to begin at.

    Raises
    ------
    CalibrationError
        The record has too few steady minutes with an outlet reading.
    """
    blocks, of_minute = blocks_of(minutes)
    usable = int(np.isfinite(blocks.outlet).sum())
    if usable < FEWEST_BLOCKS:
        raise CalibrationError(
            f"has {usable} steady blocks of ten minutes with an outlet reading; {FEWEST_BLOCKS} are needed: give a "
            f"longer record"
        )
    return Fitted(
        model, minutes, blocks, of_minute, estimate(model, blocks, priors, labels, openings, edges_s, start=start)
    )


def predict_cell(fitted: Fitted) -> Calibrated:
    """Predict a fitted cell's outlet minute by minute, the readings of each window hidden from it."""
    model, minutes, posterior = fitted.model, fitted.minutes, fitted.posterior
    slow = posterior.slow[posterior.cells_at(minutes.time_s)]
    known = np.flatnonzero(minutes.known)
    predicted, commissioned = np.full(len(slow), np.nan), np.full(len(slow), np.nan)
    predicted[known] = model.outlet(minutes.operation.take(known), slow[known], posterior.constant)
    commissioned[known] = _clean_outlet(model, minutes, known)
    predicted, commissioned = first_order_lag(predicted, minutes.known), first_order_lag(commissioned, minutes.known)
    t_out = predicted + _without_own_window(posterior, fitted.blocks, minutes)
    half = _half_width(minutes, t_out, slow[:, 3], posterior)
    sd = posterior.sd()[posterior.cells_at(minutes.time_s)]
    return Calibrated(
        t_out, t_out - half, t_out + half, commissioned, slow[:, :4].copy(), sd[:, :4].copy(), posterior, fitted.blocks
    )


def _clean_outlet(model: CellModel, minutes: Minutes, rows: NDArray[np.intp]) -> Array:
    """Return the outlet by the clean cell as commissioned, without what a record teaches."""
    from twin.tower.cell import solve_cell

    u = minutes.operation.inputs.take(rows)
    out = solve_cell(u, model.design).t_out
    return np.asarray(out + minutes.operation.bypass[rows] * (u.t_in - out))


def _without_own_window(p: Estimate, blocks: Blocks, minutes: Minutes) -> Array:
    """Return the shift of each minute's prediction when the outlet readings of its window are hidden, K (n,).

    The posterior is Gaussian about its mode, so leaving out rows J with weights W changes the estimate by
    -C J' (W^-1 - J C J')^-1 r. The shift of a minute is taken linearly between those of its own window's blocks: those
    of the next window hide other readings. In a window without blocks it is taken between those about it.
    """
    window = np.floor(blocks.time_s / WINDOW_S).astype(np.int64)
    s, end = len(SLOW), p.slow.size
    shift = np.zeros(len(blocks.time_s))
    constants = np.arange(end, end + p.constant.size)
    order = np.argsort(window, kind="stable")
    edges = np.flatnonzero(np.r_[True, np.diff(window[order]) > 0, True])
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        rows = order[a:b]
        used = p.weights[rows] > 0.0
        if not used.any():
            continue
        cells = np.unique(p.cell[rows])
        index = np.concatenate([*(np.arange(k * s, (k + 1) * s) for k in cells), constants])
        jac = np.zeros((len(rows), len(index)))
        for i, row in enumerate(rows):
            at = int(np.searchsorted(cells, p.cell[row])) * s
            jac[i, at : at + s] = p.jacobian[row, :s]
            jac[i, len(cells) * s :] = p.jacobian[row, s:]
        local = p.covariance[np.ix_(index, index)]
        water = jac.copy()  # of the water's temperature: without the thermometer's bias
        water[:, [k * s + SLOW.index("bias") for k in range(len(cells))]] = 0.0
        inner = np.diag(1.0 / p.weights[rows][used]) - jac[used] @ local @ jac[used].T
        shift[rows] = -(water @ local @ jac[used].T) @ np.linalg.solve(inner, p.residual[rows][used])
    if not len(shift):
        return np.zeros(len(minutes.time_s))
    found = np.interp(minutes.time_s, blocks.time_s, shift)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        rows = order[a:b]
        start = float(window[rows[0]]) * WINDOW_S
        first, last = np.searchsorted(minutes.time_s, (start, start + WINDOW_S))
        found[first:last] = np.interp(minutes.time_s[first:last], blocks.time_s[rows], shift[rows])
    return found


def _half_width(minutes: Minutes, t_out: Array, bias: Array, p: Estimate) -> Array:
    """Return the half width of the outlet's 90 % interval (n,).

    The quantile of the absolute residuals of hidden readings in each class of minutes, less the noise of the
    readings, which the water does not have, and widened by the uncertainty of the thermometer's bias, which no
    residual shows.
    """
    residual = minutes.outlet - bias - t_out
    there = np.isfinite(residual)
    kind = _classes(minutes)
    noise = _noise(residual[there])
    half = np.full(len(t_out), np.nan)
    overall = float(np.quantile(np.abs(residual[there]), QUANTILE)) if there.any() else 1.0
    for one in np.unique(kind):
        rows = kind == one
        seen = rows & there
        half[rows] = np.quantile(np.abs(residual[seen]), QUANTILE) if seen.sum() >= FEWEST_RESIDUALS else 1.5 * overall
    water = np.sqrt(np.maximum(half**2 - (NORMAL * noise) ** 2, (LEAST_SHARE * half) ** 2))
    bias_sd = p.sd()[p.cells_at(minutes.time_s)][:, DEVIATIONS.index("bias")]
    return np.sqrt(np.maximum(water, LEAST_WIDTH_K) ** 2 + (NORMAL * bias_sd) ** 2)


def _classes(minutes: Minutes) -> NDArray[np.intp]:
    """Return the class of each minute: just after a start, else its regime, steady or not, by the weather."""
    index = np.arange(len(minutes.known))
    since = index - np.maximum.accumulate(np.where(minutes.known, -1, index))
    since = np.where(np.maximum.accumulate(~minutes.known), since, START_MIN[-1] + 1)
    weather = np.digitize(np.nan_to_num(minutes.operation.inputs.wet), WET_C)
    usual = len(START_MIN) + (2 * minutes.regime.astype(int) + minutes.steady) * (len(WET_C) + 1) + weather
    return np.where(since <= START_MIN[0], 0, np.where(since <= START_MIN[1], 1, usual))


def _noise(residual: Array) -> float:
    """Return the standard deviation of the readings' noise by the differences of successive residuals, K."""
    if len(residual) < FEWEST_RESIDUALS:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(residual))) / np.sqrt(2.0))
