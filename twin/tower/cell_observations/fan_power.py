"""Fan power as an observation of changes of the air: what else changes the power is marginalised in the fit of a cell.

    log P = log P_clean - kappa log(1 + air) + s (gain + Phi w + l_k) + noise
    w ~ N(0, S),   l_(k+1) - l_k ~ N(0, v_k)

Phi are the features of the discrepancy at the operating point: motor, inverter and gear lose a share that depends on
the load, and the pressure of the fan depends on water load, wind and density. s is the share of the shaft in the power.

kappa, the power of the air in the shaft's power, stays at its prior mean. Pitch, slip, fouling and wear of the blades
change air and power in different ratios, so its spread is that of a level l_k: v_k is the variance of kappa times that
of an increment of the air. Estimated as a constant by the joint mode, kappa has no bound but its prior. The product of
kappa and a walk fits the same powers with a larger kappa and a smaller walk, and the determinant that would pay for it
in the marginal likelihood is absent from a mode (Neyman & Scott 1948). The walk of the air then shrinks, and its level
follows the prior instead of the traverses.

w and l enter linearly. They are eliminated from the normal equations by their Schur complement, which is exact.

Sources: Neyman & Scott, Econometrica 16 (1948) 1 (modes of many incidental parameters); Rasmussen & Williams, Gaussian
Processes for Machine Learning, 2006, section 2.7 (marginalised linear terms).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from twin.tower.air import Array

AMPLITUDE = 0.03
"""Standard deviation of the law's error far from design, of the logarithm: motor and inverter lose 2 to 4 % more of
their load at half of it, and the load of water changes a fan's pressure by as much."""
ANCHOR = 1e-4
"""Standard deviation of the level in the first cell of the grid, whose own gain is a constant of the record."""


@dataclass(frozen=True)
class PowerRows:
    """Linear equations of the power's logarithm (n,): slopes by air, shares of the shaft, which are the slopes by gain
    and level, and weights."""

    air: Array
    shaft: Array
    weights: Array


class PowerErrors:
    """Errors of the power at blocks in cells of the time grid.

    Parameters: `features` (n, f) of the discrepancy, `cell` (n,) of the time grid, `variance` (k - 1,) of the level's
    increments.
    """

    def __init__(self, features: Array, cell: NDArray[np.intp], variance: Array) -> None:
        n, f, k = len(features), features.shape[1], len(variance) + 1
        self.features, self.cell, self.cells = features, cell, k
        self._sum = csr_array((np.ones(n), (cell, np.arange(n))), shape=(k, n))
        self.precision = np.zeros((f + k, f + k))
        self.precision[np.arange(f), np.arange(f)] = f / AMPLITUDE**2
        level = self.precision[f:, f:]
        level[0, 0] = 1.0 / ANCHOR**2
        for i, v in enumerate(variance):
            level[i : i + 2, i : i + 2] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / v

    def normal(self, rows: PowerRows, target: Array) -> tuple[Array, Array]:
        """Return normal matrix (k + 1, k + 1) and right side of [air of each cell, gain], errors marginalised.

        Parameters
        ----------
        target
            Of the linear equations (n,), 0 where the weight is 0.
        """
        w, k, f = rows.weights, self.cells, self.features.shape[1]
        seen, level = rows.shaft[:, None] * self.features, rows.shaft
        matrix, cross = np.zeros((k + 1, k + 1)), np.zeros((k + 1, f + k))
        diagonal = np.arange(k)
        mixed = self._sum @ (w * rows.air * level)
        matrix[diagonal, diagonal] = self._sum @ (w * rows.air**2)
        matrix[:k, k] = matrix[k, :k] = mixed
        matrix[k, k] = w @ level**2
        cross[:k, :f] = self._sum @ ((w * rows.air)[:, None] * seen)
        cross[diagonal, f + diagonal] = mixed
        cross[k, :f] = (w * level) @ seen
        cross[k, f:] = self._sum @ (w * level**2)
        right = np.append(self._sum @ (w * rows.air * target), (w * level) @ target)
        factor, own = self._factor(rows, target)
        solved = cho_solve(factor, np.column_stack([cross.T, own]))
        return matrix - cross @ solved[:, :-1], right - cross @ solved[:, -1]

    def remaining(self, rows: PowerRows, residual: Array) -> tuple[Array, float]:
        """Return the residuals (n,) less the likeliest errors, and the least weighted sum of squares with the errors'
        prior."""
        f = self.features.shape[1]
        clean = np.nan_to_num(residual)
        factor, own = self._factor(rows, clean)
        z = cho_solve(factor, own)
        left = residual - rows.shaft * (self.features @ z[:f] + z[f:][self.cell])
        return left, float(rows.weights @ clean**2 - own @ z)

    def _factor(self, rows: PowerRows, target: Array) -> tuple[tuple[Array, bool], Array]:
        """Return the Cholesky factor of the errors' own normal matrix and its right side."""
        w, k, f = rows.weights, self.cells, self.features.shape[1]
        seen, level = rows.shaft[:, None] * self.features, rows.shaft
        matrix = self.precision.copy()
        matrix[:f, :f] += seen.T @ (w[:, None] * seen)
        joint = self._sum @ ((w * level)[:, None] * seen)
        matrix[f:, :f] += joint
        matrix[:f, f:] += joint.T
        at = f + np.arange(k)
        matrix[at, at] += self._sum @ (w * level**2)
        return cho_factor(matrix), np.concatenate([seen.T @ (w * target), self._sum @ (w * level * target)])
