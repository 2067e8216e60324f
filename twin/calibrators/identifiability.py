"""Identifiability of parameters in a single window.

The information of the window alone, without earlier windows, is J'J of its residuals with the initial state taken as
unknown (its Schur complement). Parameters are dropped one by one, always the one with the largest standard error
against its range of plausible values, until the rest is identifiable together: backward elimination, as in Brun,
Reichert & Kuensch, Water Resources Research 37 (2001) 1015. The standard errors of a set measure its collinearity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.results import CalibrationReport
from twin.gauss_newton import Scaling
from twin.network import Array

UNIDENTIFIABLE_SHARE = 0.5
"""Standard error, as a share of the plausible width, above which a parameter is not identifiable."""
STATE_SD = 5.0
"""Prior standard deviation of the initial state, K: wide."""


@dataclass(frozen=True)
class WindowInformation:
    """Information of one window about q parameters, in the optimiser's variables z.

    Attributes
    ----------
    spread
        (q,) standard errors with all q unknown; infinite in directions without any information.
    condition
        Condition number of the information's correlation matrix.
    unidentifiable
        (q,) bool, parameters to hold so that the others are identifiable.
    """

    spread: Array
    condition: float
    unidentifiable: np.ndarray

    def report(self, scaling: Scaling, values: Array) -> CalibrationReport:
        """Return a report for a method that moves all parameters: it flags those that are not identifiable."""
        names = [i for i, hit in zip(scaling.ids, self.unidentifiable, strict=True) if hit]
        return CalibrationReport(
            flags=tuple(f"{i} is not identifiable: its value is meaningless" for i in names),
            window_errors=self.window_errors(scaling, values),
            condition=self.condition,
        )

    def window_errors(self, scaling: Scaling, values: Array) -> dict[str, float]:
        """Return the standard error of each parameter from this window alone, in its own unit, at `values` (q,)."""
        return dict(zip(scaling.ids, (self.spread * scaling.slope(values)).tolist(), strict=True))


def window_information(normal: Array, plausible: Array, chi: float = 1.0) -> WindowInformation:
    """Compute the information of a window.

    Parameters
    ----------
    normal
        (q + k, q + k) J'J in [z, initial state K], noise-weighted.
    plausible
        (q,) standard deviation of plausible values, in z (`Scaling.prior_sd`).
    chi
        Reduced chi-square of the residuals; information is divided by it.
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
    unidentifiable = np.ones(q, dtype=bool)
    unidentifiable[kept] = False
    return WindowInformation(spread, condition_number(information), unidentifiable)


def condition_number(information: Array) -> float:
    """Return the condition number of an information matrix scaled to unit diagonal; at most 1e16."""
    if not information.size:
        return 1.0
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values = np.linalg.eigvalsh(information / np.outer(scale, scale))
    return float(values[-1] / max(values[0], 1e-16))


def _spread(information: Array) -> Array:
    """Return square roots of the diagonal of the inverse; a parameter without any information gets 1e6."""
    if not information.size:
        return np.zeros(0)
    inverse = np.linalg.inv(information + 1e-12 * np.eye(len(information)))
    return np.sqrt(np.clip(np.diag(inverse), 0.0, 1e12))
