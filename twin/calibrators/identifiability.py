"""Which parameters a single window can tell.

The information of the window alone, without what earlier windows said, is J'J of its residuals with the initial
state taken as unknown (its Schur complement). Parameters are dropped one by one, always the one with the largest
standard error against its range of plausible values, until the rest can be told together: backward elimination,
as in Brun, Reichert & Kuensch, Water Resources Research 37 (2001) 1015, with the collinearity of a set judged by
its standard errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.results import CalibrationReport
from twin.gauss_newton import Scaling
from twin.network import Array

UNIDENTIFIABLE_SHARE = 0.5
"""Standard error, as a share of the plausible width, above which a number says nothing."""
STATE_SD = 5.0
"""K, how little is taken for granted about the initial state."""


@dataclass(frozen=True)
class WindowInformation:
    """What one window says about q parameters, in the optimiser's variables z.

    Attributes:
        spread: (q,) standard errors with all q unknown; infinite in directions without any information.
        condition: condition number of the information's correlation matrix.
        untold: (q,) bool, parameters to hold so that the others can be told.
    """

    spread: Array
    condition: float
    untold: np.ndarray

    def warning(self, scaling: Scaling, values: Array) -> CalibrationReport:
        """For a method that moves all parameters all the same: which of its numbers say nothing."""
        names = [i for i, hit in zip(scaling.ids, self.untold, strict=True) if hit]
        return CalibrationReport(
            flags=tuple(f"cannot tell {i}: its number says nothing" for i in names),
            alone=self.alone(scaling, values),
            condition=self.condition,
        )

    def alone(self, scaling: Scaling, values: Array) -> dict[str, float]:
        """Standard error of each parameter from this window alone, in its own unit, at `values` (q,)."""
        return dict(zip(scaling.ids, (self.spread * scaling.slope(values)).tolist(), strict=True))


def window_information(normal: Array, plausible: Array, chi: float = 1.0) -> WindowInformation:
    """Judge a window.

    Args:
        normal: (q + k, q + k) J'J in [z, initial state K], noise-weighted.
        plausible: (q,) standard deviation of what is plausible, in z (`Scaling.prior_sd`).
        chi: reduced chi-square of the residuals; information is divided by it.
    """
    q = plausible.size
    state = normal[q:, q:] / chi + np.eye(normal.shape[0] - q) * STATE_SD**-2
    cross = normal[:q, q:] / chi
    information = (normal[:q, :q] / chi - cross @ np.linalg.solve(state, cross.T)) * np.outer(plausible, plausible)
    kept = list(range(q))
    share = _spread(information)
    spread = share * plausible
    while kept and share.max() > UNIDENTIFIABLE_SHARE:
        del kept[int(np.argmax(share))]
        share = _spread(information[np.ix_(kept, kept)])
    untold = np.ones(q, dtype=bool)
    untold[kept] = False
    return WindowInformation(spread, condition_number(information), untold)


def condition_number(information: Array) -> float:
    """Condition number of an information matrix scaled to unit diagonal; at most 1e16."""
    if not information.size:
        return 1.0
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values = np.linalg.eigvalsh(information / np.outer(scale, scale))
    return float(values[-1] / max(values[0], 1e-16))


def _spread(information: Array) -> Array:
    """Square roots of the diagonal of the inverse; what has no information at all gets 1e6."""
    if not information.size:
        return np.zeros(0)
    inverse = np.linalg.inv(information + 1e-12 * np.eye(len(information)))
    return np.sqrt(np.clip(np.diag(inverse), 0.0, 1e12))
