"""Rates of a loss that change within a record, by the smoother's auxiliary residuals.

Scale and plugged nozzles follow the water's treatment. Most records have one rate, which lasts. Where a treatment
fails, a fit with one rate spreads the loss over all of the record, and gives the rest to other deviations. The size of
a rate that changes therefore comes from the record, by the marginal likelihood. With the smoothed increments' scores q
and their information I, a covariance M of the increments by such a rate has

    log B = q' (I + M^-1)^-1 q / 2 - log det(1 + M I) / 2

Fill and nozzles act on the same readings. With both rates free, a gain of one would pay for a loss of the other, so the
one that explains the readings better changes alone.

Sources: Harvey & Koopman, J. Bus. Econ. Stat. 10 (1992) 377 (auxiliary residuals); MacKay, Neural Computation 4 (1992)
415 (marginal likelihood of a scale).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.tower.air import Array
from twin.tower.estimates import (
    CHANGED_D,
    LOST,
    Estimate,
    Opening,
    rate_covariance,
    unread_days,
    walk_precision,
)
from twin.tower.model import SLOW

SIZES = (1.0, 0.5, 0.25, 0.125)
"""Standard deviations of a rate, in bounds of the deviation over the time between two changes: below an eighth, a rate
that changes is less than one that lasts."""


def changing_rate(p: Estimate, openings: Sequence[Opening]) -> dict[str, float]:
    """Return the standard deviation, a day, of the rate that changes in a record, by its deviation; {} where none has
    odds above one.

    Parameters
    ----------
    p
        Posterior with the jumps `openings`, and rates that last.
    """
    found: dict[str, float] = {}
    best = 0.0
    for name, bound in LOST.items():
        score, information, _ = increment_scores(p, openings, name)
        for size in SIZES:
            sd = size * bound / CHANGED_D
            gain = _log_bayes_factor(score, information, rate_covariance(p.edges_s, sd))
            if gain > best:
                best, found = gain, {name: sd}
    return found


def increment_scores(p: Estimate, known: Sequence[Opening], name: str) -> tuple[Array, Array, Array]:
    """Return scores (k - 1,), information and prior precision (k - 1, k - 1) of a deviation's increments between the
    cells of the time grid.

    Parameters
    ----------
    p, known
        Posterior, and the jumps that are open in it.
    name
        Of the deviation, without a changing rate.
    """
    read = np.bincount(p.cell[np.isfinite(p.residual)], minlength=len(p.slow)) > 0
    inner, drift = walk_precision(p.edges_s, name, known, unread_days(p.edges_s, read))
    rows = np.arange(len(p.slow)) * len(SLOW) + SLOW.index(name)
    own = p.covariance[np.ix_(rows, rows)]
    left = own[1:, 1:] + own[:-1, :-1] - own[1:, :-1] - own[:-1, 1:]
    information = inner - inner @ left @ inner
    return inner @ (np.diff(p.slow[:, SLOW.index(name)]) - drift), 0.5 * (information + information.T), inner


def _log_bayes_factor(score: Array, information: Array, covariance: Array) -> float:
    """Return the logarithm of the Bayes factor of a further covariance of the increments."""
    of_both = np.eye(len(score)) + covariance @ information
    fit = float(score @ np.linalg.solve(of_both, covariance @ score))
    return 0.5 * fit - 0.5 * float(np.linalg.slogdet(of_both)[1])
