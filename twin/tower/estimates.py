"""Priors and posterior of a cell's slow deviations on a grid of half days.

Each deviation walks with a variance in proportion to time, about a mean change that is known, or unknown and lasting
(the fill). A documented event opens a jump at its date. Where nothing was read for days, a jump that nobody announced
is not detectable, so the walk takes its variance there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.cell_observations.evidence import Label
from twin.tower.clean_cell import discrepancy
from twin.tower.model import GLOBALS, Operation

DAY_S = 86400.0
MOST_CELLS = 450
"""Cells of the time grid: the equations are solved densely in their number times five."""
FLOW_METER = 0.015
"""Standard deviation of a flow meter's gain."""
WALK = {"fill": 0.002, "air": 0.0015, "uniformity": 0.002, "bias": 0.01, "flow_meter": 0.0005}
"""Standard deviation of a day's change. Fills lose 0.2 to 0.6 % a week, so a month is known to some 1 %; thermometers
drift by some 0.05 K a month, flow meters by some 0.3 %."""
TREND = {"fill": -0.0006, "air": -0.0001, "uniformity": -0.0003, "bias": 0.0, "flow_meter": 0.0}
"""Mean change of a day."""
CLEANED_D = 120.0
"""Days between two cleanings of a cell: some three a year."""
LOST = {"fill": 0.25, "uniformity": 0.15}
"""Bounds of what scale and plugged nozzles take."""
RATE_SD = {"fill": LOST["fill"] / (2.0 * CLEANED_D)}
"""Standard deviation of the mean change of a day, a constant of the record: water that scales fast takes the fill's
bound of 25 % between two cleanings, as two of them. A walk alone has no lasting rate, so it would follow such a fill
late, and give the rest to the other deviations."""
CHANGED_D = 30.0
"""Mean time between two changes of a rate that changes (`change_detection.rates`): water is tested and its treatment
set anew month by month."""
JUMP = {"fill": 0.08, "air": 0.06, "uniformity": 0.05, "bias": 0.4, "flow_meter": 0.0}
"""Standard deviation of a jump that an event opens: a cleaning gives back what was lost, a new thermometer is another
one."""
RATE_D = {"fill": 1.0 / 1200.0, "air": 1.0 / 1200.0, "uniformity": 1.0 / 1200.0, "bias": 1.0 / 120.0}
"""Undeclared changes a day. One thermometer in a plant steps or is exchanged some three times a year; a cell is cleaned
two or three times, and one entry in eight is missing."""
UNREAD_S = 5.0 * DAY_S
"""Days without a reading from which a jump in them is not detectable: the least time between two that a search tells
apart (`change_detection`)."""
_LEAST_VARIANCE = 1e-14
"""Variance of an increment at least: a deviation that does not walk keeps a finite precision."""


@dataclass(frozen=True)
class Blocks:
    """Steady blocks of a cell (n,): middle in s since 1970, operating point, outlet reading degC, log of fan power;
    NaN is missing."""

    time_s: Array
    operation: Operation
    outlet: Array
    log_power: Array


@dataclass(frozen=True)
class Opening:
    """A jump that an event opens: the times between which it happened, and the deviation."""

    start_s: float
    end_s: float
    parameter: str


@dataclass(frozen=True)
class Priors:
    """Bounds of the deviations, and priors of global quantities that replace those of `GLOBALS`: name -> (mean, sd).

    `discrepancy`: marginalise its weights. `learned`: mean and covariance of all constants, of a healthy record.
    `rates`: standard deviations, a day, of rates that change within the record, by deviation.
    """

    bounds: Mapping[str, float]
    replaced: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    discrepancy: bool = True
    learned: tuple[Array, Array] | None = None
    rates: Mapping[str, float] = field(default_factory=dict)

    def slow(self, name: str) -> tuple[float, float]:
        """Return mean and standard deviation of a slow deviation."""
        if name == "flow_meter":
            return 0.0, FLOW_METER
        bound = self.bounds[name]
        return (0.0, bound / 2.0) if name == "bias" else (-bound / 3.0, bound / 3.0)

    def constant(self) -> tuple[Array, Array]:
        """Return means and standard deviations of the constants: global quantities, then weights of the discrepancy."""
        if self.learned is not None:
            return self.learned[0], np.sqrt(np.diag(self.learned[1]))
        pairs = [self.replaced.get(one.name, (one.mean, one.sd)) for one in GLOBALS]
        pairs += [(0.0, discrepancy.prior_sd())] * discrepancy.FEATURES if self.discrepancy else []
        return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


@dataclass(frozen=True)
class Estimate:
    """Posterior of a record.

    Attributes
    ----------
    edges_s
        Of the time grid (k + 1,).
    slow
        Deviations (k, 5).
    constant
        Global quantities (27,), then the weights of the discrepancy's features.
    covariance
        Of [slow row by row, constant].
    sigma
        Of a block's outlet K, and of its log power, as weighed.
    residual
        Outlet of each block K, NaN where it was not used.
    weights
        Of each block.
    cell
        Grid cell of each block.
    jacobian
        Outlet of each block by slow and constant quantities (n, 5 + constants).
    time_correlation
        In blocks.
    linear_residual
        Of the last linear problem, whose mode this is exactly, and `linear_weights`, its weights.
    considered
        Changes of all quantities by one standard deviation of each considered constant (unknowns, m). The covariance
        is that for these constants at their means.
    label_sites
        Labels, each with value and standard deviation of the Gaussian that stands for it.
    widening
        Factors of the standard deviations of the slow deviations (5,), () for none.
    lasting
        Standard deviations of errors of the slow deviations that last for the record and of which no residual tells
        (5,), () for none.
    amplitude
        Standard deviation of the discrepancy's weights over that of their prior.
    """

    edges_s: Array
    slow: Array
    constant: Array
    covariance: Array
    sigma: tuple[float, float]
    residual: Array
    weights: Array
    cell: NDArray[np.intp]
    jacobian: Array
    time_correlation: float
    linear_residual: Array
    linear_weights: Array
    considered: Array = field(default_factory=lambda: np.zeros((0, 0)))
    label_sites: tuple[tuple[Label, float, float], ...] = ()
    widening: Array = field(default_factory=lambda: np.zeros(0))
    lasting: Array = field(default_factory=lambda: np.zeros(0))
    amplitude: float = 1.0

    def sd(self) -> Array:
        """Return the standard deviations of the slow deviations (k, 5), those by the considered constants included."""
        count = self.slow.size
        variance = np.diag(self.covariance)[:count] + self.considered_variance(np.arange(count))
        sd = np.sqrt(variance).reshape(self.slow.shape)
        sd = sd * self.widening if self.widening.size else sd
        return np.asarray(np.hypot(sd, self.lasting) if self.lasting.size else sd)

    def considered_variance(self, rows: NDArray[np.intp]) -> Array:
        """Return the variance of quantities by the considered constants (rows,)."""
        return (self.considered[rows] ** 2).sum(axis=1) if self.considered.size else np.zeros(len(rows))

    def constant_covariance(self) -> Array:
        """Return the covariance of the constants, the considered ones included (constants, constants)."""
        at = self.slow.size
        spread = self.considered[at:] if self.considered.size else np.zeros((len(self.constant), 0))
        return np.asarray(self.covariance[at:, at:] + spread @ spread.T)

    def cells_at(self, time_s: Array) -> NDArray[np.intp]:
        """Return the grid cell of each time."""
        found = np.searchsorted(self.edges_s, time_s, side="right") - 1
        return np.clip(found, 0, len(self.slow) - 1)


def time_grid(start_s: float, end_s: float) -> Array:
    """Return the edges (k + 1,) of the grid, s: half days, or as many as `MOST_CELLS` allow."""
    count = int(np.clip(np.ceil((end_s - start_s) / (0.5 * DAY_S)), 1, MOST_CELLS))
    return np.linspace(start_s, max(end_s, start_s + 1.0), count + 1)


def moved_grid(edges_s: Array, jumps_s: Sequence[float]) -> Array:
    """Return the edges (k + 1,) with the nearest inner one moved to each jump of known time.

    A deviation is constant within a cell of the grid, so that a jump inside of one is wrong on both sides.
    """
    edges, free = edges_s.copy(), np.ones(len(edges_s), dtype=bool)
    free[[0, -1]] = False
    for time_s in sorted(jumps_s):
        nearest = int(np.abs(edges_s - time_s).argmin())
        if free[nearest] and edges[nearest - 1] < time_s < edges[nearest + 1]:
            edges[nearest], free[nearest] = time_s, False
    return edges


def unread_days(edges_s: Array, read: NDArray[np.bool_]) -> Array:
    """Return the days of each increment of a time grid that lie in spans of `UNREAD_S` without a reading (k - 1,).

    Parameters
    ----------
    edges_s
        (k + 1,) s.
    read
        Cells of the grid with a reading (k,).
    """
    ends = np.flatnonzero(np.diff(np.concatenate([[False], ~read, [False]]).astype(np.int8)))
    days = np.zeros(len(read))
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        if edges_s[last] - edges_s[first] >= UNREAD_S:
            days[first:last] = np.diff(edges_s[first : last + 1]) / DAY_S
    return np.asarray(0.5 * (days[:-1] + days[1:]))


def walk_variance(
    edges_s: Array, name: str, openings: Sequence[Opening], unread_d: Array | float = 0.0
) -> tuple[Array, Array]:
    """Return variance and mean of a deviation's increments between the cells of a time grid (k - 1,).

    Parameters
    ----------
    edges_s
        (k + 1,) s.
    name
        Of the deviation.
    openings
        Times at which it may jump.
    unread_d
        Days of each increment of which nothing is known (k - 1,): a compound Poisson process of undeclared jumps adds
        its variance there.
    """
    middle = 0.5 * (edges_s[:-1] + edges_s[1:])
    days = np.diff(middle) / DAY_S
    variance = WALK[name] ** 2 * days + RATE_D.get(name, 0.0) * JUMP[name] ** 2 * unread_d + _LEAST_VARIANCE
    for opening in openings:
        if opening.parameter != name:
            continue
        inside = (edges_s[1:-1] >= opening.start_s - 0.5 * DAY_S) & (edges_s[1:-1] <= opening.end_s + 0.5 * DAY_S)
        exact = (edges_s[1:-1] >= opening.start_s) & (edges_s[1:-1] <= opening.end_s)
        if exact.any() and opening.end_s - opening.start_s < 0.5 * DAY_S:
            inside = exact  # the grid has an edge at a jump of known time
        if inside.any():
            variance[inside] += JUMP[name] ** 2 / inside.sum()
    return variance, TREND[name] * days


def walk_precision(
    edges_s: Array, name: str, openings: Sequence[Opening], unread_d: Array | float = 0.0, changing: float = 0.0
) -> tuple[Array, Array]:
    """Return the precision (k - 1, k - 1) of a deviation's increments between the cells of a time grid, and their mean.

    Unknown rates are marginalised: one that lasts adds a variance that is common to all increments, one that changes
    with the standard deviation `changing` a covariance that `rate_covariance` gives.
    """
    variance, drift = walk_variance(edges_s, name, openings, unread_d)
    variance = variance + _LEAST_VARIANCE
    precision = np.diag(1.0 / variance)
    if name in RATE_SD or changing > 0.0:
        days = np.diff(0.5 * (edges_s[:-1] + edges_s[1:])) / DAY_S
        lasting = RATE_SD.get(name, 0.0) ** 2 * np.outer(days, days)
        found = np.linalg.inv(np.diag(variance) + lasting + rate_covariance(edges_s, changing))
        precision = np.asarray(0.5 * (found + found.T))
    return precision, drift


def rate_covariance(edges_s: Array, sd: float) -> Array:
    """Return the covariance of the increments between the cells of a time grid by a rate that is drawn anew at random
    times, `CHANGED_D` apart on average (k - 1, k - 1).

    Parameters
    ----------
    edges_s
        (k + 1,) s.
    sd
        Of the rate, a day.
    """
    middle = 0.5 * (edges_s[:-1] + edges_s[1:]) / DAY_S
    days, at = np.diff(middle), 0.5 * (middle[:-1] + middle[1:])
    return np.asarray(sd**2 * np.outer(days, days) * np.exp(-np.abs(at[:, None] - at) / CHANGED_D))
