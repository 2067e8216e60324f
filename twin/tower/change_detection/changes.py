"""Undeclared changes of a cell: jumps of its deviations that no event announces, by the smoother's auxiliary residuals.

A walk of the deviations takes a jump only where an event opens one. Thermometers step and cells are cleaned without an
entry, often while the cell stands still. Such a jump bends everything about it, and the fit trusts itself too much. The
smoothed increment between two cells of the time grid and its variance give the likelihood of one more jump there,
Gaussian with precision i and mean m:

    i = (v - v_post)/v^2,    m i = (increment - mean)/v,    log B = (J m i)^2/(2 (1 + J^2 i)) - log(1 + J^2 i)/2

v is the increment's prior variance, v_post its posterior one, J the standard deviation of a jump. A jump is opened
where its posterior odds, Bayes factor times prior odds, are above one.

A fill or its nozzles change at once if somebody works on them, which needs a cell that stands. Where readings go on, a
jump is more probably one of the thermometer.

Sources: Harvey & Koopman, J. Bus. Econ. Stat. 10 (1992) 377 (auxiliary residuals); de Jong & Penzer, J. Am. Stat.
Assoc. 93 (1998) 796 (shocks of a state); Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773 (Bayes factor).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.cell_observations import Label
from twin.tower.change_detection.rates import increment_scores
from twin.tower.estimates import (
    DAY_S,
    JUMP,
    RATE_D,
    Blocks,
    Estimate,
    Opening,
    Priors,
    moved_grid,
)
from twin.tower.model import SLOW, CellModel
from twin.tower.smoother import estimate

TOGETHER = {"fill": ("fill", "uniformity"), "uniformity": ("uniformity", "fill")}
"""Deviations that a jump opens beside its own: who washes a fill cleans its nozzles, with an entry or without."""
STOP_S = 2.0 * 3600.0
"""Time without a steady reading in which somebody may have worked in a cell."""
WHILE_RUNNING = {"fill": 0.05, "uniformity": 0.05}
"""Share of the changes of a deviation that come while its cell runs: nozzles that break or are freed from above."""
APART_S = 5.0 * DAY_S
"""Least time between two jumps of one deviation that are opened at once: the second may be the shadow of the first."""
ROUNDS = 4
FEWEST = 3
"""Blocks of half an hour on each side of a jump of the bias that is located between readings."""
LOCATED = 0.9
"""Posterior probability of the times between which a jump is opened: where nothing was read for days, a jump may lie
anywhere in them."""


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
    found: list[tuple[Opening, ...]] = []
    edges = start.edges_s
    for number in range(ROUNDS):
        known = (*openings, *(one for event in found for one in event))
        # The shortest correlation time: residuals about a jump that is not open look like slow ones.
        start = estimate(model, blocks, priors, labels, known, edges, start=start, least_correlation=True)
        kept = [event for event in found if _stands(start, event)]
        # A jump of the last round would not be judged again once it is open.
        more = _likely(start, known, blocks.time_s) if number < ROUNDS - 1 else []
        if not more and len(kept) == len(found):
            break
        more = [tuple(_located(start, blocks.time_s, one) for one in event) for event in more]
        # A jump inside of a cell would look like one at either edge.
        edges = moved_grid(edges, [one.start_s for event in more for one in event if one.parameter == "bias"])
        found = kept + more
    return tuple(sorted((one for event in found for one in event), key=lambda one: one.start_s))


def _likely(posterior: Estimate, known: Sequence[Opening], time_s: Array) -> list[tuple[Opening, ...]]:
    """Return the events with posterior odds above one, the likeliest of those that are close to each other, each with
    the jumps that it opens; `time_s` (n,) are the times of the blocks."""
    edges = posterior.edges_s
    stood = _stood(edges, time_s[np.isfinite(posterior.residual)])
    ranked: list[tuple[float, int, str]] = []
    by_name: dict[str, Array] = {}
    for name in RATE_D:
        score, information = _scores(posterior, known, name)
        prior = np.log(RATE_D[name] * np.diff(0.5 * (edges[:-1] + edges[1:])) / DAY_S)
        prior += np.where(stood, 0.0, np.log(WHILE_RUNNING.get(name, 1.0)))
        # Scores of a fit that trusts itself too much are too large everywhere: their usual size is one.
        usual = max(1.4826 * float(np.median(np.abs(score) / np.sqrt(information))), 1.0)
        odds = prior + _log_bayes_factor(score / usual, information, name)
        by_name[name] = odds
        # Deviations that the same readings show are compared by what they explain of these, whatever is usual of each.
        explained = prior + _log_bayes_factor(score, information, name)
        ranked += [(float(explained[k]), int(k), name) for k in np.flatnonzero(odds > 0.0)]
    taken: list[tuple[int, str]] = []
    for _, k, name in sorted(ranked, reverse=True):
        # One change explains its surroundings; others beside it are judged again once it is open.
        if all(abs(edges[k + 1] - edges[other + 1]) > APART_S for other, _ in taken):
            taken.append((k, name))
    return [
        tuple(Opening(*_window(by_name[name], edges, k), other) for other in TOGETHER.get(name, (name,)))
        for k, name in taken
    ]


def _stood(edges: Array, read_s: Array) -> NDArray[np.bool_]:
    """Return True for each edge between two cells of the grid (k - 1,) in which the tower's cell may have stood: its
    steady readings, at `read_s` (n,), pause there."""
    if not len(read_s):
        return np.ones(len(edges) - 2, dtype=bool)
    ends = np.concatenate([[edges[0]], read_s, [edges[-1]]])
    begin, end = ends[:-1], ends[1:]
    pauses = end - begin > STOP_S
    overlap = (begin[pauses] < edges[2:, None]) & (end[pauses] > edges[:-2, None])
    return np.asarray(overlap.any(axis=1))


def _located(p: Estimate, time_s: Array, jump: Opening) -> Opening:
    """Return a jump of the bias at one edge of the grid at the time between readings where it fits best: the split of
    the readings in the cells about the edge into two levels of least absolute error."""
    at = int(np.abs(p.edges_s - jump.start_s).argmin())
    if jump.parameter != "bias" or jump.end_s > jump.start_s or not 0 < at < len(p.edges_s) - 1:
        return jump
    rows = np.flatnonzero(np.isfinite(p.residual) & ((p.cell == at - 1) | (p.cell == at)))
    level = p.residual[rows] + p.slow[p.cell[rows], SLOW.index("bias")]
    splits = np.arange(FEWEST, len(rows) - FEWEST + 1)
    if not len(splits):
        return jump
    loss = [sum(float(np.abs(part - np.median(part)).sum()) for part in (level[:k], level[k:])) for k in splits]
    k = int(splits[int(np.argmin(loss))])
    middle = 0.5 * float(time_s[rows[k - 1]] + time_s[rows[k]])
    return Opening(middle, middle, jump.parameter)


def _stands(p: Estimate, event: Sequence[Opening]) -> bool:
    """Return True if the jumps of an event, which are open in a posterior, still have odds above one beside the others.

    The density of no jump before and after the data gives their Bayes factor (Dickey, Ann. Math. Stat. 42 (1971) 204).
    A jump of the air stands: it has opened the level of the fan's power too, which may have taken all of it.
    """
    if any(one.parameter == "air" for one in event):
        return True
    rows, excess = [], []
    prior, odds = np.zeros(len(event)), 0.0
    for j, one in enumerate(event):
        inside = np.flatnonzero((p.edges_s[1:-1] >= one.start_s) & (p.edges_s[1:-1] <= one.end_s))
        if not len(inside):
            inside = np.array([np.abs(p.edges_s[1:-1] - one.start_s).argmin()])
        first, last = int(inside.min()), int(inside.max()) + 1
        column = SLOW.index(one.parameter)
        days = float(p.edges_s[last + 1] - p.edges_s[first]) / DAY_S
        rows.append((first * len(SLOW) + column, last * len(SLOW) + column))
        excess.append(float(p.slow[last, column] - p.slow[first, column]))
        prior[j] = JUMP[one.parameter] ** 2
        odds = np.log(RATE_D[one.parameter] * days) if j == 0 else odds
    low, high = np.array(rows).T
    c = p.covariance
    spread = c[np.ix_(high, high)] + c[np.ix_(low, low)] - c[np.ix_(high, low)] - c[np.ix_(low, high)]
    jump = np.array(excess)
    gain = 0.5 * float(jump @ np.linalg.solve(spread, jump)) + 0.5 * float(np.linalg.slogdet(spread)[1])
    return bool(gain - 0.5 * float(np.log(prior).sum()) + odds > 0.0)


def _window(odds: Array, edges: Array, k: int) -> tuple[float, float]:
    """Return the first and the last edge at which a jump near edge `k + 1` lies by its log posterior odds (k - 1,)."""
    near = np.abs(edges[1:-1] - edges[k + 1]) <= APART_S
    weight = np.where(near, np.exp(odds - odds[near].max()), 0.0)
    order = np.argsort(-weight, kind="stable")
    count = int(np.searchsorted(np.cumsum(weight[order]), LOCATED * weight.sum())) + 1
    inside = order[:count]
    return float(edges[inside.min() + 1]), float(edges[inside.max() + 1])


def _scores(p: Estimate, known: Sequence[Opening], name: str) -> tuple[Array, Array]:
    """Return the scores and the information of a jump between each two cells of the grid (k - 1,)."""
    score, information, prior = increment_scores(p, known, name)
    return score, np.maximum(np.diag(information), 1e-6 * np.diag(prior))


def _log_bayes_factor(score: Array, information: Array, name: str) -> Array:
    """Return the logarithm of the Bayes factor of a jump between each two cells of the grid (k - 1,)."""
    jump = JUMP[name] ** 2
    return np.asarray(0.5 * jump * score**2 / (1.0 + jump * information) - 0.5 * np.log1p(jump * information))
