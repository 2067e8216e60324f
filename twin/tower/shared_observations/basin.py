"""Basin thermometers as second thermometers of the cells that drain into one compartment of a basin.

A compartment of volume V is well mixed. With the outlet readings y_c = t_c + bias_c of its cells alone it would read

    V rho dT/dt = sum of m_c (y_c - T),     T - T_own = sum of h_c bias_c

where h_c is the share of its water that came from cell c, by the same filter. Water of the other compartments comes in
by eddies, and where fewer cells drain into this one than the pumps take from it. The supply is a mixture of all
compartments, so that the thermometer lies between the own water and the supply:

    T_basin = T_own + r (T_supply - T_own) + offset,     0 <= r <= 1

r is unknown: it depends on which cells of the other compartments run. Where the supply is as warm as the own water, r
does not matter, and that is what the bias is learned from. The offset of a basin thermometer is unknown too, so a
single cell learns as much as two thermometers of one class agree; two cells that run by turns learn their difference.
Minutes with cold makeup water in the basin are left out.

Source of the update: batch Kalman (Bayesian linear) update of the cells' joint posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.estimates import Estimate
from twin.tower.model import DEVIATIONS, SLOW
from twin.tower.shared_observations.joint import joint_update

OFFSET_K = 0.25
"""Standard deviation of a basin thermometer's offset: a thermometer, stratification and the basin's own loss of
heat."""
PATTERN_K = 0.1
"""Standard deviation of the error of perfect mixing in one pattern of running cells."""
EXCHANGE = 0.5
"""Mean of r, uniform between 0 and 1."""
EXCHANGE_SD = 1.0 / 6.0
"""Standard deviation of each of the three parts of r: of the basin, of a pattern of running cells, and of half a day.
The variances of the three add up to that of a uniform distribution, 1/12."""
PASSES = 3
"""Linearisations of the product of r and the biases; a further one moves a bias by less than 1 mK."""
ROW_K = 0.15
"""Standard deviation of the mean of half a day."""
DILUTED = 0.003
"""Share of makeup water in the compartment from which a minute is left out: 15 K colder, it moves the mean by 0.05
K."""
MIXED = 3.0
"""Residence times after a gap until the mixture is that of the model."""
FEWEST_MINUTES = 5
DENSITY = 1000.0
BIAS = DEVIATIONS.index("bias")


@dataclass(frozen=True)
class Drain:
    """Water that a cell drains into the compartment, by minute (n,): flow kg/s (0 when off), outlet reading and basin
    reading degC.

    `sampled`: the basin reading has a raw sample there.
    """

    flow: Array
    outlet: Array
    basin: Array
    sampled: NDArray[np.bool_]


@dataclass(frozen=True)
class _BasinRows:
    """Rows of mean differences (r,): time s, shares (r, cells), value K, sensor, pattern and epoch of each.

    `beyond` is the supply less the own water by the outlet readings, K.
    """

    time_s: Array
    shares: Array
    value: Array
    beyond: Array
    group: list[tuple[int, int, int]]


class _Exchange(NamedTuple):
    """Mean (r,) and covariance (r, r) of the supply's share in what a thermometer reads."""

    mean: Array
    covariance: Array


class _LinearRows(NamedTuple):
    """Rows linear in the biases: slopes (r, cells), slopes by the supply's share with their sign changed, K (r,), and
    innovation, K (r,)."""

    slopes: Array
    beyond: Array
    innovation: Array


def with_basin(
    posteriors: Sequence[Estimate],
    drains: Sequence[Drain],
    time_s: Array,
    makeup: Array,
    volume_m3: float,
    changes_s: Sequence[float] = (),
    supply: Array | None = None,
) -> list[Estimate]:
    """Return the posteriors of a compartment's cells updated by its basin thermometers.

    Parameters
    ----------
    posteriors
        Of all cells that drain into the compartment.
    drains, time_s, makeup
        By minute (n,); makeup kg/s, of the whole basin.
    volume_m3
        Of the compartment.
    changes_s
        Times at which a basin thermometer may have been exchanged.
    supply
        Temperature of the common supply by minute (n,), degC; None where the basin is one compartment.
    """
    rows = _rows(posteriors[0], drains, time_s, (makeup, supply), volume_m3, changes_s)
    if rows is None:
        return list(posteriors)
    at = [posterior.cells_at(rows.time_s) * len(SLOW) + BIAS for posterior in posteriors]
    prior = [p.slow.ravel()[k] for p, k in zip(posteriors, at, strict=True)]
    spread = [p.covariance[np.ix_(k, k)] for p, k in zip(posteriors, at, strict=True)]
    noise, exchange = _thermometer_noise(rows), _exchange(rows, at[0], supply is not None)
    bias, share = prior, exchange.mean
    for _ in range(PASSES):
        linear = _linear(rows, prior, bias, exchange, share)
        total = noise + exchange.covariance * np.outer(linear.beyond, linear.beyond)
        for slope, one in zip(linear.slopes.T, spread, strict=True):
            total += np.outer(slope, slope) * one
        if supply is None:
            break  # it is linear
        gain = np.linalg.solve(total, linear.innovation)
        bias = [b + one @ (h * gain) for b, one, h in zip(prior, spread, linear.slopes.T, strict=True)]
        share = np.clip(exchange.mean - exchange.covariance @ (linear.beyond * gain), 0.0, 1.0)
    crosses = [p.covariance[:, k] * h for p, k, h in zip(posteriors, at, linear.slopes.T, strict=True)]
    return joint_update(posteriors, crosses, total, linear.innovation)


def _linear(
    rows: _BasinRows, prior: Sequence[Array], bias: Sequence[Array], exchange: _Exchange, share: Array
) -> _LinearRows:
    """Return the rows about the biases (r,) of each cell and the supply's shares (r,)."""
    now, before = (np.sum([h * b for h, b in zip(rows.shares.T, of, strict=True)], axis=0) for of in (bias, prior))
    beyond = rows.beyond + now
    expected = now - share * beyond + (1.0 - share) * (before - now) - beyond * (exchange.mean - share)
    return _LinearRows((1.0 - share)[:, None] * rows.shares, beyond, rows.value - expected)


def _thermometer_noise(rows: _BasinRows) -> Array:
    """Return the covariance (r, r) of the rows by the thermometers and their places, K^2."""
    noise = np.diag(np.full(len(rows.value), ROW_K**2))
    by_sensor = [(sensor, -1, epoch) for sensor, _, epoch in rows.group]
    for keys, scale in ((by_sensor, OFFSET_K), (rows.group, PATTERN_K)):
        for key in set(keys):
            member = np.array([k == key for k in keys], dtype=float)
            noise += scale**2 * np.outer(member, member)
    return noise


def _exchange(rows: _BasinRows, time: NDArray[np.intp], exists: bool) -> _Exchange:
    """Return mean (r,) and covariance (r, r) of the supply's share in each row; none unless it `exists`.

    Thermometers of one compartment see the same water, so they have it in common.
    """
    count = len(rows.value)
    if not exists:
        return _Exchange(np.zeros(count), np.zeros((count, count)))
    pattern = np.array([of for _, of, _ in rows.group])
    alike = pattern[:, None] == pattern[None, :]
    at_once = alike & (time[:, None] == time[None, :])
    return _Exchange(np.full(count, EXCHANGE), EXCHANGE_SD**2 * (1.0 + alike + at_once))


def _rows(
    posterior: Estimate,
    drains: Sequence[Drain],
    time_s: Array,
    others: tuple[Array, Array | None],
    volume_m3: float,
    changes_s: Sequence[float],
) -> _BasinRows | None:
    """Return the mean differences by cell of the first grid, thermometer and pattern; None where there are none.

    `others` are makeup and supply by minute.
    """
    mixed, shares, beyond, ready = _mixture(drains, *others, volume_m3)
    grid = posterior.cells_at(time_s)
    epoch = np.searchsorted(np.sort(np.asarray(changes_s, dtype=float)), time_s)
    pattern = np.zeros(len(time_s), dtype=int)
    for share in shares.T:
        pattern = 3 * pattern + np.digitize(share, (0.2, 0.8))
    found: dict[tuple[int, int, int, int], tuple[Array, float, float, float]] = {}
    for sensor, drain in enumerate(drains):
        rows = np.flatnonzero(ready & drain.sampled & np.isfinite(drain.basin))
        if not len(rows):
            continue
        code = (grid[rows] * 1000 + pattern[rows]) * 100 + epoch[rows]
        for one in np.unique(code):
            there = rows[code == one]
            if len(there) >= FEWEST_MINUTES:
                key = (int(grid[there[0]]), sensor, int(pattern[there[0]]), int(epoch[there[0]]))
                value = float(np.median(mixed[there] - drain.basin[there]))
                found[key] = (
                    shares[there].mean(axis=0),
                    value,
                    float(np.median(time_s[there])),
                    float(np.median(beyond[there])),
                )
    if not found:
        return None
    keys = list(found)
    return _BasinRows(
        np.array([found[k][2] for k in keys]),
        np.array([found[k][0] for k in keys]),
        np.array([found[k][1] for k in keys]),
        np.array([found[k][3] for k in keys]),
        [(k[1], k[2], k[3]) for k in keys],
    )


def _mixture(
    drains: Sequence[Drain], makeup: Array, supply: Array | None, volume_m3: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return the compartment's temperature by the outlet readings, the cells' shares of its water, by how much the
    supply was warmer, by the same filter (0 without one), and usable minutes."""
    flow = np.stack([np.nan_to_num(d.flow) for d in drains], axis=1)
    outlet = np.stack([d.outlet for d in drains], axis=1)
    known: NDArray[np.bool_] = np.asarray(~((flow > 0.0) & ~np.isfinite(outlet)).any(axis=1))
    for d in drains:
        known &= np.isfinite(d.flow)
    if supply is not None:
        known &= np.isfinite(supply)
    mass = volume_m3 * DENSITY
    total = flow.sum(axis=1)
    keep = np.exp(-60.0 * total / mass)
    fresh = np.nan_to_num(makeup)
    cells = len(drains)
    into = np.zeros((len(total), cells + 3))
    running = np.maximum(total, 1e-9)[:, None]
    into[:, :cells] = flow / running
    into[:, cells] = (flow * np.nan_to_num(outlet)).sum(axis=1) / running[:, 0]
    into[:, cells + 1] = np.minimum(fresh / running[:, 0], 1.0)
    into[:, cells + 2] = into[:, cells] if supply is None else np.nan_to_num(supply)
    state, age = np.zeros(cells + 3), 0.0
    out, ready = np.full((len(total), cells + 3), np.nan), np.zeros(len(total), dtype=bool)
    for i in range(len(total)):
        if not known[i]:
            age = 0.0
            continue
        if age == 0.0:
            state = into[i].copy()
        # Without flow the makeup stays; it leaves with the water that comes.
        state = keep[i] * state + (1.0 - keep[i]) * into[i]
        if total[i] <= 0.0 and fresh[i] > 0.0:
            state[cells + 1] = min(state[cells + 1] + 60.0 * fresh[i] / mass, 1.0)
        age += 60.0 * total[i] / mass + 1e-12
        out[i] = state
        ready[i] = age > MIXED and total[i] > 0.0 and state[cells + 1] < DILUTED
    return out[:, cells], out[:, :cells], out[:, cells + 2] - out[:, cells], ready
