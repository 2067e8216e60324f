"""Calibration of one cell over a record: the posterior, and the outlet's prediction with its own window's readings
hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.calibration.outlet_interval import WINDOW_S, half_width
from twin.tower.cell_observations import Label
from twin.tower.estimates import Blocks, Estimate, Opening, Priors
from twin.tower.minutes import Minutes, blocks_of, first_order_lag
from twin.tower.model import SLOW, CellModel
from twin.tower.smoother import estimate

FEWEST_BLOCKS = 36
"""Steady blocks of ten minutes, six hours in all: below them nothing is fitted."""
LARGE_K = 0.1
"""Shift of a prediction without its own window's readings, K, from which each minute has its own: twice the noise of a
reading."""
SMALL_K = 0.02
"""Part of such a shift, K, over which a slope is taken."""


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
    t_out = predicted + _without_own_window(fitted)
    half = half_width(minutes, fitted.of_minute, t_out, slow[:, 3], posterior)
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


def _without_own_window(fitted: Fitted) -> Array:
    """Return the shift of each minute's prediction when the outlet readings of its window are hidden, K (n,).

    The posterior is Gaussian about its mode, so leaving out rows J with weights W changes the estimate by
    -C J' (W^-1 - J C J')^-1 r. The shift of a minute is taken linearly between those of its own window's blocks: those
    of the next window hide other readings. A window without blocks has nothing to hide. Where the shift is large, the
    window alone shows what the cell does in it, such as with its fan at rest. The slope along the change is then taken
    minute by minute: in minutes with a fan the shift is another one.
    """
    p, blocks, minutes = fitted.posterior, fitted.blocks, fitted.minutes
    window = np.floor(blocks.time_s / WINDOW_S).astype(np.int64)
    order = np.argsort(window, kind="stable")
    edges = np.flatnonzero(np.r_[True, np.diff(window[order]) > 0, True]) if len(window) else np.zeros(0, dtype=int)
    found = np.zeros(len(minutes.time_s))
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        change = _change_without(p, order[a:b])
        start = float(window[change.rows[0]]) * WINDOW_S
        inside = slice(*np.searchsorted(minutes.time_s, (start, start + WINDOW_S)).tolist())
        found[inside] = np.interp(minutes.time_s[inside], blocks.time_s[change.rows], change.shift)
        if np.abs(change.shift).max() > LARGE_K:
            found[inside] = _evaluated(fitted, change, inside, found[inside])
    return found


class _Change(NamedTuple):
    """Change of an estimate without the outlet readings of a window.

    rows (r,) are the window's blocks, `shift` (r,) the change of the water's temperature there, K. `cells` are those of
    the time grid, `slow` (cells, s) and `constant` (g,) the changes of the quantities.
    """

    rows: NDArray[np.intp]
    shift: Array
    cells: NDArray[np.intp]
    slow: Array
    constant: Array


def _change_without(p: Estimate, rows: NDArray[np.intp]) -> _Change:
    """Return the change of an estimate without the outlet readings of blocks `rows`."""
    s, end = len(SLOW), p.slow.size
    cells = np.unique(p.cell[rows])
    used = p.linear_weights[rows] > 0.0
    constants = np.arange(end, end + p.constant.size)
    if not used.any():
        return _Change(rows, np.zeros(len(rows)), cells, np.zeros((len(cells), s)), np.zeros(len(constants)))
    index = np.concatenate([*(np.arange(k * s, (k + 1) * s) for k in cells), constants])
    jac = np.zeros((len(rows), len(index)))
    for i, row in enumerate(rows):
        at = int(np.searchsorted(cells, p.cell[row])) * s
        jac[i, at : at + s] = p.jacobian[row, :s]
        jac[i, len(cells) * s :] = p.jacobian[row, s:]
    local = p.covariance[np.ix_(index, index)]
    water = jac.copy()  # of the water's temperature: without the thermometer's bias
    water[:, [k * s + SLOW.index("bias") for k in range(len(cells))]] = 0.0
    inner = np.diag(1.0 / p.linear_weights[rows][used]) - jac[used] @ local @ jac[used].T
    change = -(local @ jac[used].T) @ np.linalg.solve(inner, p.linear_residual[rows][used])
    of_slow = change[: len(cells) * s].reshape(len(cells), s)
    return _Change(rows, water @ change, cells, of_slow, change[len(cells) * s :])


def _evaluated(fitted: Fitted, change: _Change, inside: slice, otherwise: Array) -> Array:
    """Return the shift of the minutes `inside` (m,) by the slope of the cell along a change; `otherwise` where its
    inputs are not known.

    A slope, since the changes of many quantities cancel where other readings hold the cell, to first order alone.
    """
    p, minutes = fitted.posterior, fitted.minutes
    known = np.flatnonzero(minutes.known[inside]) + inside.start
    if not len(known):
        return otherwise
    o, cell = minutes.operation.take(known), p.cells_at(minutes.time_s[known])
    nearest = np.clip(np.searchsorted(change.cells, cell), 0, len(change.cells) - 1)
    step = SMALL_K / float(np.abs(change.shift).max())
    ends = [
        fitted.model.outlet(o, p.slow[cell] + part * change.slow[nearest], p.constant + part * change.constant)
        for part in (0.0, step)
    ]
    shift = np.full(inside.stop - inside.start, np.nan)
    shift[known - inside.start] = (ends[1] - ends[0]) / step
    followed = first_order_lag(shift, minutes.known[inside])
    return np.where(np.isfinite(followed), followed, otherwise)
