"""Basin thermometers as second thermometers of the cells that drain into one compartment of a basin.

A compartment of volume V is well mixed. With the outlet readings y_c = t_c + bias_c of its cells it would read

    V rho dT/dt = sum of m_c (y_c - T),     T - T_basin = sum of h_c bias_c - offset

where h_c is the share of its water that came from cell c, by the same filter. The offset of a basin thermometer is
unknown, so a single cell learns as much as two thermometers of one class agree; two cells that run by turns learn
their difference. Minutes with cold makeup water in the basin are left out.

Source of the update: batch Kalman (Bayesian linear) update of the cells' joint posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    """Rows of mean differences (r,): time s, shares (r, cells), value K, sensor, pattern and epoch of each."""

    time_s: Array
    shares: Array
    value: Array
    group: list[tuple[int, int, int]]


def with_basin(
    posteriors: Sequence[Estimate],
    drains: Sequence[Drain],
    time_s: Array,
    makeup: Array,
    volume_m3: float,
    changes_s: Sequence[float] = (),
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
    """
    rows = _rows(posteriors[0], drains, time_s, makeup, volume_m3, changes_s)
    if rows is None:
        return list(posteriors)
    count = len(rows.value)
    noise = np.diag(np.full(count, ROW_K**2))
    by_sensor = [(sensor, -1, epoch) for sensor, _, epoch in rows.group]
    for keys, scale in ((by_sensor, OFFSET_K), (rows.group, PATTERN_K)):
        for key in set(keys):
            member = np.array([k == key for k in keys], dtype=float)
            noise += scale**2 * np.outer(member, member)
    stacked, crosses = np.zeros((count, count)), []
    innovation = rows.value.copy()
    for c, posterior in enumerate(posteriors):
        grid = posterior.cells_at(rows.time_s)
        at = grid * len(SLOW) + BIAS
        cross = posterior.covariance[:, at] * rows.shares[:, c]
        stacked += rows.shares[:, c][:, None] * cross[at]
        innovation -= rows.shares[:, c] * posterior.slow[grid, BIAS]
        crosses.append(cross)
    return joint_update(posteriors, crosses, stacked + noise, innovation)


def _rows(
    posterior: Estimate,
    drains: Sequence[Drain],
    time_s: Array,
    makeup: Array,
    volume_m3: float,
    changes_s: Sequence[float],
) -> _BasinRows | None:
    """Return the mean differences by cell of the first grid, thermometer and pattern; None where there are none."""
    mixed, shares, ready = _mixture(drains, makeup, volume_m3)
    grid = posterior.cells_at(time_s)
    epoch = np.searchsorted(np.sort(np.asarray(changes_s, dtype=float)), time_s)
    pattern = np.zeros(len(time_s), dtype=int)
    for share in shares.T:
        pattern = 3 * pattern + np.digitize(share, (0.2, 0.8))
    found: dict[tuple[int, int, int, int], tuple[Array, float, float]] = {}
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
                found[key] = (shares[there].mean(axis=0), value, float(np.median(time_s[there])))
    if not found:
        return None
    keys = list(found)
    return _BasinRows(
        np.array([found[k][2] for k in keys]),
        np.array([found[k][0] for k in keys]),
        np.array([found[k][1] for k in keys]),
        [(k[1], k[2], k[3]) for k in keys],
    )


def _mixture(drains: Sequence[Drain], makeup: Array, volume_m3: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the compartment's temperature by the outlet readings, the cells' shares of its water, and usable
    minutes."""
    flow = np.stack([np.nan_to_num(d.flow) for d in drains], axis=1)
    outlet = np.stack([d.outlet for d in drains], axis=1)
    known: NDArray[np.bool_] = np.asarray(~((flow > 0.0) & ~np.isfinite(outlet)).any(axis=1))
    for d in drains:
        known &= np.isfinite(d.flow)
    mass = volume_m3 * DENSITY
    total = flow.sum(axis=1)
    keep = np.exp(-60.0 * total / mass)
    fresh = np.nan_to_num(makeup)
    cells = len(drains)
    into = np.zeros((len(total), cells + 2))
    running = np.maximum(total, 1e-9)[:, None]
    into[:, :cells] = flow / running
    into[:, cells] = (flow * np.nan_to_num(outlet)).sum(axis=1) / running[:, 0]
    into[:, cells + 1] = np.minimum(fresh / running[:, 0], 1.0)
    state, age = np.zeros(cells + 2), 0.0
    out, ready = np.full((len(total), cells + 2), np.nan), np.zeros(len(total), dtype=bool)
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
    return out[:, cells], out[:, :cells], ready
