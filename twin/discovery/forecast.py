"""What a record, or a planned profile, could show: the smallest effect of each kind, and the pairs it cannot separate.

No reading is needed: signatures follow from the inputs and from what the twin does with them. The usual condition
number of the tunables says next to nothing about this; the matrix of pairs does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.contest import Contest
from twin.discovery.grid import Grid
from twin.discovery.laws import Book
from twin.discovery.noise import Noise
from twin.discovery.null import FALSE_ALARMS, null_scores
from twin.discovery.probe import Probe
from twin.elements.base import Candidate
from twin.gauss_newton import Prior
from twin.network import Array

CONFUSED = 0.98


@dataclass(frozen=True)
class Seen:
    """One candidate, present from the beginning: the least size that would be noticed, and how much of its signature
    the tunables cannot take up."""

    candidate: Candidate
    least: float
    kept: float


@dataclass(frozen=True)
class Forecast:
    """Candidates by how well they show, and pairs (a, b, correlation) that look alike."""

    seen: tuple[Seen, ...]
    unseen: tuple[Candidate, ...]
    confused: tuple[tuple[Candidate, Candidate, float], ...]


def planned(probe: Probe, grid: Grid, state: Array | None = None) -> tuple[Grid, Array]:
    """The grid with the twin's own readings in place of measured ones, and its initial state."""
    start = probe.probed_state(grid) if state is None else state
    return replace(grid, measured=probe.run(grid, start).readings), start


def forecast(probe: Probe, book: Book, noise: Noise, prior: Prior, grid: Grid, state: Array | None = None) -> Forecast:
    """What inputs like the grid's could show.

    Args:
        grid: its readings are not looked at. state: initial temperatures (k,); from the grid's readings by default.
    """
    own, start = planned(probe, grid, state)
    run = probe.run(own, start)
    contest = Contest(probe, own, start, run, noise, prior)
    found = book.laws(own, run)
    vectors = np.stack([contest.vector(law) for law in found])
    flat = vectors.reshape(len(found), -1)
    gram = flat @ contest.gram @ flat.T
    norm = np.sqrt(np.maximum(np.diag(gram), 0.0))
    bare = np.sqrt(np.maximum(contest.bare(flat), 1e-30))
    threshold = null_scores(contest, found).quantile(FALSE_ALARMS)
    seen, unseen = [], [c for c in book.candidates if c.id not in {law.candidate.id for law in found}]
    for law, n, b in zip(found, norm, bare, strict=True):
        c = law.candidate
        least = threshold / n if n > 0.0 else np.inf
        if least > max(abs(c.lower), abs(c.upper)):
            unseen.append(c)
        else:
            seen.append(Seen(c, float(least), float(n / b)))
    seen.sort(key=lambda s: s.least / s.candidate.typical)
    confused = []
    for i in range(len(found)):
        for j in range(i + 1, len(found)):
            if norm[i] > 0.0 and norm[j] > 0.0:
                rho = float(gram[i, j] / (norm[i] * norm[j]))
                a, b = found[i].candidate, found[j].candidate
                if abs(rho) > CONFUSED and (a.kind, a.where, a.driver) != (b.kind, b.where, b.driver):
                    confused.append((a, b, rho))
    confused.sort(key=lambda x: -abs(x[2]))
    return Forecast(tuple(seen), tuple(unseen), tuple(confused))
