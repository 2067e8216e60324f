"""Linear scores of candidates for a residual after re-tuning, from the response to a finite size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from twin.discovery.growing.growth_problem import GrowthFit, GrowthProblem, readings_of
from twin.discovery.growing.likelihood import Spectrum
from twin.discovery.growing.superset.candidate_superset import CandidateSuperset, unsized
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.network import Array

KEPT = 1.0e-4
"""Share of a signature's squares that must remain after re-tuning; with less a candidate has no signature of its own.
"""
MOST = 3.0
"""Largest ratio of a size to the one that was simulated for which the linear score counts."""
SHARES = (0.1, 0.3, 0.6, 0.95)
"""Shares of the largest possible size at which an effect that is nonlinear in its size is simulated."""
ASKED = 5
"""Rounds in which a size is sought that changes the readings by as much as the residual."""


@dataclass(frozen=True)
class Scored:
    """Candidate at its best size, to first order; `asked` is the size that was simulated.

    Attributes:
        squares: fall of the squares in units of noise. likely: squares that remain, weighted by their spectrum.
    """

    entry: Entry
    asked: float
    squares: float
    likely: float


def scores(superset: CandidateSuperset, problem: GrowthProblem, fit: GrowthFit) -> list[Scored]:
    """Return the scores of all candidates with a signature that re-tuning does not explain."""
    white = Spectrum.white(problem.samples.sigma, len(problem.samples.time))
    metrics = [_Metric(problem, fit, spectrum) for spectrum in (white, fit.spectrum)]
    rms = float(np.sqrt(np.nanmean(fit.residual**2)))
    known = {name for e in fit.entries for name in e.candidate.changes}
    elements = {e.name for e in superset.original.elements} | {n for e in fit.entries for n in e.candidate.adds}
    candidates = []
    for candidate in superset.candidates:
        stands_on = {name.rsplit(".", 1)[0] for name in candidate.changes} - set(candidate.adds)
        stands_on |= {superset.after[name] for name in candidate.adds if name in superset.after}
        if not known & set(candidate.changes) and stands_on <= elements:
            candidates.append(candidate)
    answers = _Answers(problem, fit, candidates)
    sizes = [_sizes(c, size) for c, size in zip(candidates, _asked(candidates, answers, rms), strict=True)]
    changes = iter(answers([(i, size) for i, some in enumerate(sizes) for size in some]))
    each = zip(candidates, sizes, strict=True)
    every = [_best(c, some, list(islice(changes, len(some))), metrics) for c, some in each]
    return [scored for scored in every if scored is not None]


def answer_of(problem: GrowthProblem, fit: GrowthFit, entry: Entry) -> Array:
    """Return the change of the readings (n, m), K, if an effect of its size joins a fit."""
    return _Answers(problem, fit, [entry.candidate])([(0, entry.size)])[0]


class _Answers:
    """Changes of the readings (n, m) if effects of some sizes join a fit, one effect at a time."""

    def __init__(self, problem: GrowthProblem, fit: GrowthFit, candidates: Sequence[Candidate]) -> None:
        self._ones = [problem.with_entries((*fit.entries, unsized(c, 1.0))) for c in candidates]
        self._starts = [one.start(fit) for one in self._ones]
        # At size 0 all candidates of one kernel are the fit itself.
        first = {one.kinds: i for i, one in reversed(list(enumerate(self._ones)))}
        nothing = self._readings([(i, 0.0) for i in first.values()])
        self._none = dict(zip(first, nothing, strict=True))

    def __call__(self, asked: Sequence[tuple[int, float]]) -> list[Array]:
        """Return the changes for candidates, by their number, at sizes."""
        readings = self._readings(asked)
        return [there - self._none[self._ones[i].kinds] for (i, _), there in zip(asked, readings, strict=True)]

    def _readings(self, asked: Sequence[tuple[int, float]]) -> Array:
        return readings_of([(self._ones[i], np.append(self._starts[i][:-1], size)[None, :]) for i, size in asked])


def _best(candidate: Candidate, sizes: list[float], answers: list[Array], metrics: list[_Metric]) -> Scored | None:
    best: Scored | None = None
    for size, s in zip(sizes, answers, strict=True):
        if not np.isfinite(s).all():
            continue
        (share, gain), (other, likely) = (metric.taken(s, size, candidate) for metric in metrics)
        if gain > 0.0 and (best is None or gain > best.squares):
            best = Scored(unsized(candidate, share * size), sizes[0], gain, likely)
        elif likely > 0.0 and best is None:
            best = Scored(unsized(candidate, other * size), sizes[0], 0.0, likely)
    if best is None and candidate.driver == "history" and np.abs(answers[0]).max() > 0.0:
        # What delays shows nothing to first order where something else delays too much already.
        best = Scored(unsized(candidate, sizes[0]), sizes[0], 0.0, 0.0)
    return best


def _asked(candidates: Sequence[Candidate], answers: _Answers, rms: float) -> list[float]:
    """Return the sizes at which each candidate changes the readings by as much as the residual."""
    found = [min(c.typical, c.upper) for c in candidates]
    open_ = list(range(len(candidates)))
    for _ in range(ASKED):
        if not open_:
            break
        changes = answers([(i, found[i]) for i in open_])
        off = [float(np.sqrt(np.mean(s**2))) if np.isfinite(s).all() else math.inf for s in changes]
        still = [(i, x) for i, x in zip(open_, off, strict=True) if not 0.3 * rms < x < 2.0 * rms]
        for i, x in still:
            factor = 1e-3 if x == math.inf else rms / max(x, 1e-12)
            found[i] = min(found[i] * min(max(factor, 1e-3), 1e3), candidates[i].upper)
        open_ = [i for i, _ in still]
    return found


def _sizes(candidate: Candidate, size: float) -> list[float]:
    """Return the sizes to simulate: the one that changes the readings by as much as the residual, and shares of the
    largest.
    """
    found = [size]
    if candidate.driver in ("history", "rate_of_change"):
        found += [0.3 * size, 3.0 * size]
    if candidate.kind == "delay":
        found += [share * candidate.upper for share in SHARES]
    found = [x for x in found if x <= candidate.upper]
    return found + [-x for x in found if -x >= candidate.lower]


class _Metric:
    """Squares in units of a spectrum, with tunables, state and the effects so far projected out."""

    def __init__(self, problem: GrowthProblem, fit: GrowthFit, spectrum: Spectrum) -> None:
        self._problem, self._spectrum = problem, spectrum
        self._j = problem.whitened(fit.slopes, spectrum)
        self._inverse = np.linalg.pinv(self._j.T @ self._j + fit.precision, rcond=1e-13, hermitian=True)
        self._residual = self._less(problem.whitened(fit.residual, spectrum))

    def _less(self, white: Array) -> Array:
        out: Array = white - self._j @ (self._inverse @ (self._j.T @ white))
        return out

    def taken(self, answer: Array, size: float, candidate: Candidate) -> tuple[float, float]:
        """Return the best multiple of `answer` within the possible sizes, and the fall of the squares by it."""
        white = self._problem.whitened(answer, self._spectrum)
        whole, s = float(white @ white), self._less(white)
        bottom = float(s @ s)
        if bottom <= KEPT * whole or bottom <= 0.0:
            return 0.0, 0.0
        most = min(MOST, (candidate.upper if size > 0.0 else candidate.lower) / size)
        share = min(max(float(s @ self._residual) / bottom, 0.0), most)
        return share, (2.0 * float(s @ self._residual) - share * bottom) * share
