"""Priors and posterior of a cell's slow deviations on a grid of half days."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
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

    def sd(self) -> Array:
        """Return the standard deviations of the slow deviations (k, 5)."""
        return np.sqrt(np.diag(self.covariance)[: self.slow.size]).reshape(self.slow.shape)

    def cells_at(self, time_s: Array) -> NDArray[np.intp]:
        """Return the grid cell of each time."""
        found = np.searchsorted(self.edges_s, time_s, side="right") - 1
        return np.clip(found, 0, len(self.slow) - 1)


def time_grid(start_s: float, end_s: float) -> Array:
    """Return the edges (k + 1,) of the grid, s: half days, or as many as `MOST_CELLS` allow."""
    count = int(np.clip(np.ceil((end_s - start_s) / (0.5 * DAY_S)), 1, MOST_CELLS))
    return np.linspace(start_s, max(end_s, start_s + 1.0), count + 1)
