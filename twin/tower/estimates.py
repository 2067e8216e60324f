"""Priors and posterior of a cell's slow deviations on a grid of half days."""

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
    """

    bounds: Mapping[str, float]
    replaced: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    discrepancy: bool = True
    learned: tuple[Array, Array] | None = None

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
        Global quantities (24,), then the weights of the discrepancy's features.
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
