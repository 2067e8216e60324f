"""Windows of a calibrated cell: the day before each target interval, what it tells and what is missing in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from twin.tower.air import Array
from twin.tower.calibration import WINDOW_S, Calibrated
from twin.tower.cell import Inputs
from twin.tower.identifiability.identify import (
    TOLERANCE,
    Identifiability,
    excited,
    identifiability,
    weighed_sensitivities,
)
from twin.tower.minutes import Minutes
from twin.tower.model import DEVIATIONS, NAMES, CellModel
from twin.tower.shared_observations import GAIN
from twin.tower.twin_file import BOUNDS

CONTEXT_S = 86400.0
BLOCK_MIN = 10.0
ENVELOPE = 0.995
"""Share of further operating points of the same kind that are usual."""
FEWEST = 8
"""Windows before, twice as many as there are features, from which more is told than their mean."""


@dataclass(frozen=True)
class TargetWindow:
    """A target interval and the day up to its end.

    Attributes
    ----------
    start_s, end_s
        Of the target interval.
    told
        What the day tells.
    excited
        It passes the excitation thresholds.
    features
        Mean operating point of the target interval: wet bulb degC, inlet over wet bulb K, speed, flow as shares.
    share_known
        Of its minutes with all inputs.
    half
        Mean half width of the outlet's interval, K.
    """

    start_s: float
    end_s: float
    told: Identifiability
    excited: bool
    features: Array
    share_known: float
    half: float


def windows_of(
    model: CellModel, minutes: Minutes, calibrated: Calibrated, hidden: Array, second: bool, makeup: bool = False
) -> list[TargetWindow]:
    """Return the windows of a record in the order of time.

    Parameters
    ----------
    hidden
        Share of hidden required channels by minute (n,).
    second
        A basin thermometer is in use.
    makeup
        The station's evaporation is.
    """
    blocks, posterior = calibrated.blocks, calibrated.posterior
    slopes = _scaled(calibrated, second, makeup)
    first, last = float(minutes.time_s[0]), float(minutes.time_s[-1])
    starts = np.arange(np.floor(first / WINDOW_S) * WINDOW_S, last + 1.0, WINDOW_S)
    running = np.isfinite(blocks.outlet) & (posterior.weights > 0.0)
    found = []
    for start in starts:
        end = start + WINDOW_S
        rows = np.flatnonzero((blocks.time_s >= end - CONTEXT_S) & (blocks.time_s < end) & running)
        within = slice(int(np.searchsorted(minutes.time_s, start)), int(np.searchsorted(minutes.time_s, end)))
        u = blocks.operation.inputs.take(rows)
        told = identifiability(slopes[:, rows].reshape(-1, len(DEVIATIONS)), BLOCK_MIN, float(np.mean(hidden[within])))
        half = 0.5 * (calibrated.high[within] - calibrated.low[within])
        found.append(
            TargetWindow(
                float(start),
                float(end),
                told,
                excited(u, model.design),
                _features(minutes, within, model.design.m_w0),
                float(minutes.known[within].mean()),
                float(np.nanmean(half)) if np.isfinite(half).any() else float("nan"),
            )
        )
    return found


def _scaled(calibrated: Calibrated, second: bool, makeup: bool) -> Array:
    """Return the scaled sensitivities of each block by sensor (sensors, n, 4)."""
    jac = calibrated.posterior.jacobian[:, : len(DEVIATIONS)]
    kappa = float(calibrated.posterior.constant[NAMES.index("kappa")])
    rows = weighed_sensitivities(jac, np.isfinite(calibrated.blocks.log_power), kappa, second)
    if makeup:
        water = jac.copy()
        water[:, DEVIATIONS.index("bias")] = 0.0
        u = calibrated.blocks.operation.inputs
        fall = np.maximum(u.t_in - calibrated.blocks.outlet, 1.0)[:, None]
        # A cell's own share of the station's evaporation is known as well as the sum: the others' errors are its own.
        rows.append(np.where(np.isfinite(fall), -water / fall, 0.0) / np.hypot(TOLERANCE["evaporation"], GAIN))
    return np.stack(rows) * np.array([BOUNDS[name] for name in DEVIATIONS])


def _features(minutes: Minutes, within: slice, m_w0: float) -> Array:
    u: Inputs = minutes.operation.inputs
    known = minutes.known[within]
    if not known.any():
        return np.full(4, np.nan)
    values = (u.wet[within], u.t_in[within] - u.wet[within], u.speed[within], u.m_w[within] / m_w0)
    return np.array([float(np.mean(v[known])) for v in values])


def novelty(features: Sequence[Array], usable: Sequence[bool]) -> Array:
    """Return how far each operating point is from those before it, as a share of the usual distance.

    Distances are Hotelling's T with a shrunk covariance (Ledoit & Wolf, J. Multivariate Anal. 88 (2004) 365, with the
    fixed weight of a tenth). The limit holds `ENVELOPE` of further points of the same normal distribution (Hotelling,
    Ann. Math. Stat. 2 (1931) 360).

    Parameters
    ----------
    features
        (4,) of each window in order of time.
    usable
        Windows that later ones are compared with.

    Returns
    -------
    ndarray
        (n,), above 1 outside; NaN without features, or with fewer than `FEWEST` usable windows before.
    """
    x = np.array(features, dtype=float).reshape(-1, 4)
    kept = np.isfinite(x).all(axis=1) & np.asarray(usable, dtype=bool)
    p = x.shape[1]
    # Sums of the rows before each; about the middle of all, so that squares do not cancel.
    middle = x[kept].mean(axis=0) if kept.any() else np.zeros(p)
    y = np.where(kept[:, None], x - middle, 0.0)
    count = np.cumsum(kept) - kept
    total = np.cumsum(y, axis=0) - y
    squares = np.einsum("ij,ik->ijk", y, y)
    squares = np.cumsum(squares, axis=0) - squares
    found = np.full(len(x), np.nan)
    for k in np.flatnonzero(np.isfinite(x).all(axis=1) & (count >= FEWEST)):
        n = int(count[k])
        mean = total[k] / n
        covariance = (squares[k] - n * np.outer(mean, mean)) / (n - 1)
        spread = 0.9 * covariance + 0.1 * np.diag(np.diag(covariance)) + 1e-6 * np.eye(p)
        offset = x[k] - middle - mean
        limit = p * (n * n - 1.0) / (n * (n - p)) * fdtri(p, n - p, ENVELOPE)
        found[k] = np.sqrt(offset @ np.linalg.solve(spread, offset) / limit)
    return found
