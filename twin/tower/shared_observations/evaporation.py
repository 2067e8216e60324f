"""Makeup water as an observation of what the cells of a station evaporate together, in sums over six hours.

    makeup - blowdown - V rho d(level)/dt = (1 + gain) * sum of E_c
    E_c = lambda_c m_w cp (T_in - t_out,c),     lambda = evaporation over heat of the clean cell there

Evaporation measures the water's fall of temperature without the outlet thermometer, so it separates a bias of that from
fill and air. Makeup is intermittent: the basin fills between two levels, hence the long sums and the change of the
level. The gain is common to all sums; it holds the errors of the meters and of Merkel's evaporation, which bound what
is learned of the bias: 3 % of a range of 7 K are 0.2 K.

Source: Kloppers & Kroeger, J. Eng. Gas Turbines Power 127 (2005) 1 (error of Merkel's evaporation against Poppe's);
the update is that of `twin.tower.shared_observations.joint`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.calibration import Fitted
from twin.tower.cell import CP_WATER, CellDeviations, Inputs, solve_cell
from twin.tower.estimates import Estimate
from twin.tower.model import NAMES, SLOW
from twin.tower.shared_observations.joint import joint_update

SUM_S = 6 * 3600.0
GAIN = 0.03
"""Standard deviation of the common gain: 2 % of a makeup and a blowdown meter, 2 % of a commissioned evaporation."""
ROW = 0.03
"""Standard deviation of one sum as a share of it: wind, humidity and supersaturation move evaporation at equal heat."""
STORED = 0.05
"""Share of the basin by which its contents differ between the ends of a sum where no level is measured: the usual
hysteresis of a makeup valve."""
LEVEL = 0.002
"""Standard deviation of a level's difference, share of the basin: waves and the transmitter."""
KNOWN = 0.95
"""Share of the minutes of a sum in which every flow must be known."""
ODD = 4.0
"""Standard deviations beyond which a sum is left out, as with an overflow or a hose."""
FEWEST_BLOCKS = 6
"""Steady blocks of a running cell in six hours: an hour in all."""
DENSITY = 1000.0
INLET = NAMES.index("inlet_bias")


@dataclass(frozen=True)
class Balance:
    """Water balance of a station by minute (n,): makeup and blowdown kg/s, level as a share of the basin or NaN
    throughout; volume m3."""

    time_s: Array
    makeup: Array
    blowdown: Array
    level: Array
    volume_m3: float


@dataclass(frozen=True)
class _EvaporationSums:
    """Evaporation of a cell by sum (r,), kg/s, NaN where unknown; its slopes in the cell's unknowns (r, unknowns)."""

    expected: Array
    slopes: Array


def with_evaporation(
    fitted: Sequence[Fitted], off: Sequence[NDArray[np.bool_]], water: Balance
) -> tuple[list[Estimate], str]:
    """Return the posteriors of all cells of a station updated by its makeup, and why it is not used, "" where it is.

    It is not used without a whole sum (`NO_WHOLE_SUM`), nor where most sums contradict the cells (`NOT_CLOSED`), as
    with a meter that stands still or a basin that overflows.

    Parameters
    ----------
    off
        Of each cell, by minute (n,)
    bool
        It has no water.
    """
    number = np.floor(water.time_s / SUM_S).astype(np.int64)
    number -= number[0]
    count = int(number[-1]) + 1
    observed, noise = _observed(water, number, count)
    cells = [_sums(one, gone, number, count) for one, gone in zip(fitted, off, strict=True)]
    total = np.sum([c.expected for c in cells], axis=0)
    rows = np.flatnonzero(np.isfinite(observed) & np.isfinite(total) & (total > 0.0))
    posteriors = [one.posterior for one in fitted]
    if not len(rows):
        return posteriors, "NO_WHOLE_SUM"
    whole = len(rows)
    while True:
        crosses = [p.covariance @ c.slopes[rows].T for p, c in zip(posteriors, cells, strict=True)]
        covariance = np.diag(noise[rows] ** 2 + (ROW * total[rows]) ** 2)
        covariance += GAIN**2 * np.outer(total[rows], total[rows])
        covariance += np.sum([c.slopes[rows] @ cross for c, cross in zip(cells, crosses, strict=True)], axis=0)
        innovation = observed[rows] - total[rows]
        fits = np.abs(innovation) <= ODD * np.sqrt(np.diag(covariance))
        if fits.all():
            return joint_update(posteriors, crosses, covariance, innovation), ""
        rows = rows[fits]
        if len(rows) < 0.5 * whole:
            return posteriors, "NOT_CLOSED"


def _observed(water: Balance, number: NDArray[np.int64], count: int) -> tuple[Array, Array]:
    """Return what evaporated by the water balance in each sum, kg/s, NaN where unknown, and its noise."""
    net = water.makeup - water.blowdown
    mean = _mean(net, number, count)
    per_sum = water.volume_m3 * DENSITY / SUM_S
    if not np.isfinite(water.level).any():
        return mean, np.full(count, STORED * per_sum)
    # The level at the ends of a sum is that of the quarter of an hour about them.
    edges = (np.arange(count + 1) + np.floor(water.time_s[0] / SUM_S)) * SUM_S
    at = np.full(count + 1, np.nan)
    for k, edge in enumerate(edges):
        near = water.level[np.searchsorted(water.time_s, edge - 450.0) : np.searchsorted(water.time_s, edge + 450.0)]
        near = near[np.isfinite(near)]
        at[k] = np.median(near) if len(near) else np.nan
    return mean - per_sum * np.diff(at), np.full(count, LEVEL * per_sum)


def _mean(values: Array, number: NDArray[np.int64], count: int) -> Array:
    """Return means by sum, NaN where too few minutes are known or the sum is not whole."""
    there = np.isfinite(values)
    known = np.bincount(number, there, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(number, np.where(there, values, 0.0), count) / known
    return np.where(known >= KNOWN * SUM_S / 60.0, mean, np.nan)


def _sums(one: Fitted, off: NDArray[np.bool_], number: NDArray[np.int64], count: int) -> _EvaporationSums:
    model, posterior, minutes, blocks = one.model, one.posterior, one.minutes, one.blocks
    slow = posterior.slow[posterior.cells_at(minutes.time_s)]
    rows = np.flatnonzero(minutes.known)
    o = minutes.operation.take(rows)
    t_out = model.outlet(o, slow[rows], posterior.constant)
    per_kelvin = _per_kelvin(one, o.inputs, slow[rows])
    evaporated = np.where(off, 0.0, np.nan)
    evaporated[rows] = per_kelvin * (o.inputs.t_in + posterior.constant[INLET] - t_out)
    running = np.zeros(len(off))
    running[rows] = 1.0
    share = np.bincount(number, running, count) / np.maximum(np.bincount(number, minlength=count), 1)
    s, unknowns = len(SLOW), posterior.covariance.shape[0]
    water = posterior.jacobian.copy()
    water[:, SLOW.index("bias")] = 0.0
    at = posterior.slow[posterior.cell]
    steep = _per_kelvin(one, blocks.operation.inputs, at)[:, None]
    slope = -steep * water
    slope[:, s + INLET] += steep[:, 0]
    of_sum = np.floor(blocks.time_s / SUM_S).astype(np.int64) - int(np.floor(minutes.time_s[0] / SUM_S))
    slopes, few = np.zeros((count, unknowns)), np.zeros(count, dtype=bool)
    for k in range(count):
        there = np.flatnonzero(of_sum == k)
        few[k] = share[k] > 0.0 and len(there) < FEWEST_BLOCKS
        if len(there):
            mean = share[k] * slope[there].mean(axis=0)
            cell = int(np.median(posterior.cell[there]))
            slopes[k, cell * s : (cell + 1) * s] = mean[:s]
            slopes[k, posterior.slow.size :] = mean[s:]
    return _EvaporationSums(np.where(few, np.nan, _mean(evaporated, number, count)), slopes)


def _per_kelvin(one: Fitted, u: Inputs, slow: Array) -> Array:
    """Return what evaporates for a kelvin of the water's fall, kg/(s K) (n,)."""
    out = solve_cell(u, one.model.design, CellDeviations(1.0 + slow[:, 0], 1.0 + slow[:, 1], 1.0 + slow[:, 2]))
    return np.asarray(out.evaporation / np.maximum(out.heat, 1.0) * u.m_w * CP_WATER)
