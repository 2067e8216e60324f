"""Undeclared changes of a cell: jumps of its deviations that no event announces, by the smoother's auxiliary residuals.

A walk of the deviations takes a jump only where an event opens one. Thermometers step and cells are cleaned without an
entry, often while the cell stands still. Such a jump bends everything about it, and the fit trusts itself too much. The
smoothed increment between two cells of the time grid and its variance give the likelihood of one more jump there,
Gaussian with precision i and mean m:

    i = (v - v_post)/v^2,    m i = increment/v,    log B = (J m i)^2/(2 (1 + J^2 i)) - log(1 + J^2 i)/2

v is the increment's prior variance, v_post its posterior one, J the standard deviation of a jump. A jump is opened
where its posterior odds, Bayes factor times prior odds, are above one.

Sources: Harvey & Koopman, J. Bus. Econ. Stat. 10 (1992) 377 (auxiliary residuals); de Jong & Penzer, J. Am. Stat.
Assoc. 93 (1998) 796 (shocks of a state); Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773 (Bayes factor).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.tower.air import Array
from twin.tower.cell_observations import Label
from twin.tower.estimates import DAY_S, Blocks, Estimate, Opening, Priors
from twin.tower.model import SLOW, CellModel
from twin.tower.smoother import JUMP, estimate, walk_variance

RATE_D = {"fill": 1.0 / 1200.0, "air": 1.0 / 1200.0, "uniformity": 1.0 / 1200.0, "bias": 1.0 / 120.0}
"""Undeclared changes a day. One thermometer in a plant steps or is exchanged some three times a year; a cell is cleaned
two or three times, and one entry in eight is missing."""
APART_S = 5.0 * DAY_S
"""Least time between two jumps of one deviation that are opened at once: the second may be the shadow of the first."""
ROUNDS = 4


def undeclared_changes(
    model: CellModel,
    blocks: Blocks,
    priors: Priors,
    labels: Sequence[Label],
    openings: Sequence[Opening],
    start: Estimate,
) -> tuple[Opening, ...]:
    """Return the jumps that the record shows and no event announces, in the order of time.

    Parameters
    ----------
    openings
        Jumps that are known.
    start
        An estimate of the record without the others.
    """
    found: list[Opening] = []
    for _ in range(ROUNDS):
        known = (*openings, *found)
        # The shortest correlation time: residuals about a jump that is not open look like slow ones.
        start = estimate(model, blocks, priors, labels, known, start.edges_s, start=start, least_correlation=True)
        more = _likely(start, known)
        if not more:
            break
        found += more
    return tuple(sorted(found, key=lambda one: one.start_s))


def _likely(posterior: Estimate, known: Sequence[Opening]) -> list[Opening]:
    """Return the jumps with posterior odds above one, the likeliest of those that are close to each other."""
    edges = posterior.edges_s
    ranked: list[tuple[float, int, str]] = []
    for name in JUMP:
        if name not in RATE_D:
            continue
        odds = _log_bayes_factor(posterior, known, name)
        odds += np.log(RATE_D[name] * np.diff(0.5 * (edges[:-1] + edges[1:])) / DAY_S)
        ranked += [(float(odds[k]), int(k), name) for k in np.flatnonzero(odds > 0.0)]
    taken: list[tuple[int, str]] = []
    for _, k, name in sorted(ranked, reverse=True):
        # One change explains its surroundings; others beside it are judged again once it is open.
        if all(abs(edges[k + 1] - edges[other + 1]) > APART_S for other, _ in taken):
            taken.append((k, name))
    return [Opening(float(edges[k + 1]), float(edges[k + 1]), name) for k, name in taken]


def _log_bayes_factor(p: Estimate, known: Sequence[Opening], name: str) -> Array:
    """Return the logarithm of the Bayes factor of a jump between each two cells of the grid (k - 1,)."""
    variance, drift = walk_variance(p.edges_s, name, known)
    rows = np.arange(len(p.slow)) * len(SLOW) + SLOW.index(name)
    own = np.diag(p.covariance)[rows]
    left = own[1:] + own[:-1] - 2.0 * p.covariance[rows[1:], rows[:-1]]
    information = np.maximum(variance - left, 1e-6 * variance) / variance**2
    score = (np.diff(p.slow[:, SLOW.index(name)]) - drift) / variance
    # Scores of a fit that trusts itself too much are too large everywhere: their usual size is one.
    usual = 1.4826 * float(np.median(np.abs(score) / np.sqrt(information)))
    score = score / max(usual, 1.0)
    jump = JUMP[name] ** 2
    return np.asarray(0.5 * jump * score**2 / (1.0 + jump * information) - 0.5 * np.log1p(jump * information))
