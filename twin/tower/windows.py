"""Windows of a calibrated cell: the day before each target interval, what it tells and what is missing in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.tower.air import Array
from twin.tower.calibration import WINDOW_S, Calibrated
from twin.tower.cell import Inputs
from twin.tower.identify import TOLERANCE, Identifiability, excited, identifiability
from twin.tower.minutes import Minutes
from twin.tower.model import DEVIATIONS, GLOBALS, NAMES, CellModel
from twin.tower.shared_observations import GAIN
from twin.tower.twin_file import BOUNDS

CONTEXT_S = 86400.0
BLOCK_MIN = 10.0


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
    bounds = np.array([BOUNDS[name] for name in DEVIATIONS])
    fan = np.zeros_like(jac)
    kappa = calibrated.posterior.constant[NAMES.index("kappa")]
    fan[:, 1] = np.where(np.isfinite(calibrated.blocks.log_power), kappa, 0.0)
    # The level of the fan's power is open by as much as its prior: a window learns little of the air from it.
    level = next(one.sd for one in GLOBALS if one.name == "power_gain")
    rows = [jac / TOLERANCE["outlet"], fan / np.hypot(TOLERANCE["fan"], level)]
    water = jac.copy()
    water[:, DEVIATIONS.index("bias")] = 0.0
    if second:
        rows.append(water / TOLERANCE["basin"])
    if makeup:
        u = calibrated.blocks.operation.inputs
        fall = np.maximum(u.t_in - calibrated.blocks.outlet, 1.0)[:, None]
        # A cell's own share of the station's evaporation is known as well as the sum: the others' errors are its own.
        rows.append(np.where(np.isfinite(fall), -water / fall, 0.0) / np.hypot(TOLERANCE["evaporation"], GAIN))
    return np.stack(rows) * bounds


def _features(minutes: Minutes, within: slice, m_w0: float) -> Array:
    u: Inputs = minutes.operation.inputs
    known = minutes.known[within]
    if not known.any():
        return np.full(4, np.nan)
    values = (u.wet[within], u.t_in[within] - u.wet[within], u.speed[within], u.m_w[within] / m_w0)
    return np.array([float(np.mean(v[known])) for v in values])


def distances(features: Sequence[Array], reference: Sequence[int]) -> Array:
    """Return the Mahalanobis distance of each operating point from those of the reference windows, with shrunk
    covariance.

    Source: Ledoit & Wolf, J. Multivariate Anal. 88 (2004) 365, with the fixed weight of a tenth.
    """
    x = np.array(features, dtype=float).reshape(-1, 4)
    base = x[np.asarray(reference, dtype=int)] if len(reference) else x
    base = base[np.isfinite(base).all(axis=1)]
    if len(base) < 8:
        return np.full(len(x), np.nan)
    covariance = np.cov(base.T)
    spread = 0.9 * covariance + 0.1 * np.diag(np.diag(covariance)) + 1e-6 * np.eye(4)
    offset = x - base.mean(axis=0)
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", offset, np.linalg.inv(spread), offset)))
