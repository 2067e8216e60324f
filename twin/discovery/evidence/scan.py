"""Scan by evidence: every law in every time course from every onset, alone or with other effects integrated out."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.shapes import EARLY_S, Shape, courses_of
from twin.discovery.evidence.marginal import (
    LEAD,
    NEGLIGIBLE,
    Joint,
    free_log_bayes,
    likeliest,
    log_bayes_of_sizes,
)
from twin.discovery.evidence.priors import ALL_ALONG, AT_ONCE, SPREAD
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import LAST_SHARE, Courses, LawSquares, returning, rows_by_name
from twin.elements.candidates import INTERMITTENT, Candidate
from twin.network import Array

STEADY = ("constant", "temperature_difference")
"""Drivers of laws that are tried with transient courses."""
NEAREST_S = 15.0
"""Resolution of onsets by block means, s."""
ENDED = (0.95, 0.85, 0.7, 0.5)
"""Shares of the time from its onset to the record's end at which a ramp may end."""
TOGETHER = 32
"""Laws in one batch, which bounds the memory."""
LEADING_TURNS, STARTS = 8, 8
"""Periodic courses of a law whose squares are computed exactly, and onsets from which it may return."""
_TINY = 1e-12
"""Share of the largest squares below which squares are rounding."""


def scan(
    score_test: ScoreTest, laws: Sequence[CandidateLaw], beside: Joint | None = None, *, transient: bool = True
) -> list[Entry]:
    """Return the likeliest onset of each law in each of its shapes, by falling evidence.

    `Entry.log_bayes` is averaged over the times of its course by their prior; `Entry.log_occam` is the logarithm of
    that average over its maximum.

    Parameters:
        beside: effects that are integrated out. transient: with transient courses, too.
    """
    courses = Courses.of(score_test)
    scanned = _Scanned(score_test, courses, beside)
    alike: dict[tuple[str, float, bool], list[CandidateLaw]] = {}
    for law in laws:
        c = law.candidate
        alike.setdefault((family_of(c), c.slow_s if c.begins else 0.0, may_end(c)), []).append(law)
    found: list[Entry] = []
    for (family, _, ends), those in alike.items():
        for k in range(0, len(those), TOGETHER):
            found += _of_laws(scanned, those[k : k + TOGETHER], family, transient and ends)
    found.sort(key=lambda e: -e.log_bayes)
    return found


class _Scanned:
    """Score of a record for a scan, with other effects integrated out."""

    def __init__(self, score_test: ScoreTest, courses: Courses, beside: Joint | None) -> None:
        self.score_test, self.courses = score_test, courses
        score = score_test.score if beside is None else beside.reduced_score(score_test)
        self._score = score.reshape(score_test.sites, score_test.b)
        onto = np.empty((score_test.sites * score_test.b, 0)) if beside is None else beside.onto
        self._onto = onto.reshape(score_test.sites, score_test.b, -1).transpose(0, 2, 1).copy()

    def score(self, squares: LawSquares) -> Array:
        """Return the score (b,) of a law's blocks."""
        if len(squares.sites) == 1:
            (site,) = squares.sites
            return np.asarray(self._score[site] * squares.blocks[site])
        found: Array = (self._score[squares.sites] * squares.blocks[squares.sites]).sum(axis=0)
        return found

    def taken(self, squares: Sequence[LawSquares]) -> Array:
        """Return the parts (l, c, b) of laws' blocks that the other effects explain; their squares leave the Gram
        matrices.
        """
        found = np.zeros((len(squares), *self._onto.shape[1:]))
        for one, of_law in zip(squares, found, strict=True):
            for k, site in enumerate(one.sites):
                if k:
                    of_law += self._onto[site] * one.blocks[site]
                else:
                    np.multiply(self._onto[site], one.blocks[site], out=of_law)
        return found


def family_of(candidate: Candidate) -> str:
    """Return the family of courses that a law is tried with: "put in", "event", "step" alone, or "any"."""
    if candidate.begins:
        return "put in"
    if candidate.is_event:
        return "event"
    return "step" if candidate.shapes == ("step",) else "any"


def may_end(candidate: Candidate) -> bool:
    """Return True for a law that may be transient.

    One of each place and kind suffices, as its driver is determined by fits. A sticking thermometer is no form of
    another.
    """
    tried = candidate.driver in STEADY or candidate.sticks
    return not set(INTERMITTENT).isdisjoint(candidate.shapes) and not candidate.begins and tried


def refined(score_test: ScoreTest, entry: Entry, beside: Joint | None = None) -> Entry:
    """Return an entry with onset and growth time at the maximum of its evidence, also between block edges."""
    edges_s = score_test.edges * score_test.grid.step_s
    squares = LawSquares.of(score_test, entry.law)
    blocks, scanned = squares.blocks, _Scanned(score_test, Courses.of(score_test), beside)
    own, (taken,) = scanned.score(squares), scanned.taken([squares])
    gram = score_test.small_gram(blocks) - taken.T @ taken
    least = _TINY * max(float(np.trace(gram)), _TINY)

    def at(shapes: Sequence[Shape]) -> tuple[float, float, float, Shape, Array]:
        """Return log B, size and squares of the best of these shapes, that shape and its course."""
        tried = courses_of(shapes, edges_s)
        bottoms = np.maximum(((tried @ gram) * tried).sum(axis=1), least)
        odds, sizes = log_bayes_of_sizes(entry.candidate, tried @ own, bottoms)
        odds = odds - [_later_turns(s, float(edges_s[-1])) for s in shapes]
        k = int(np.argmax(odds))
        return float(odds[k]), float(sizes[k]), float(bottoms[k]), shapes[k], tried[k]

    best, size, bottom, shape, course = at([entry.shape])
    start = best
    if shape.name == "periodic":
        # A scan knows the turn with which it began within an eighth of the record.
        turns_s = np.arange(shape.onset_s % shape.growth_s, LAST_SHARE * edges_s[-1], shape.growth_s)
        best, size, bottom, shape, course = at([replace(shape, onset_s=float(t)) for t in turns_s])
    reach = score_test.step_s if shape.onset_s > 0.0 or shape.name in INTERMITTENT else 0.0
    while reach >= NEAREST_S:
        tried = [replace(shape, onset_s=shape.onset_s + d) for d in (-reach, reach)]
        if shape.name == "transient":
            tried += [replace(s, growth_s=s.growth_s + d) for s in (shape, *tried) for d in (-reach, reach)]
        elif shape.name == "periodic":
            turns = max(edges_s[-1] / shape.growth_s, 1.0)
            tried += [replace(s, growth_s=s.growth_s + d / turns) for s in (shape, *tried) for d in (-reach, reach)]
            tried += [
                replace(s, duty=d)
                for s in (shape, *tried)
                for by in (-reach, reach)
                if 0.02 < (d := shape.duty + by / shape.growth_s) < 0.98
            ]
            # It may have come in amid a turn.
            tried += [
                replace(s, onset_s=s.onset_s + d, into_s=s.into_s + d) for s in (shape, *tried) for d in (-reach, reach)
            ]
        elif shape.name == "ramp" and not shape.free(float(edges_s[-1])):
            # It may have come to its end before the record does.
            left_s = float(edges_s[-1]) - shape.onset_s
            tried += [replace(s, growth_s=f * left_s) for s in (shape, *tried) for f in ENDED]
        elif shape.free(float(edges_s[-1])):
            tried += [replace(s, growth_s=s.growth_s * f) for s in (shape, *tried) for f in (0.7, 1.4)]
        tried = [
            s.going_on(float(edges_s[-1]))
            for s in tried
            if 0.0 <= s.onset_s <= LAST_SHARE * edges_s[-1]
            and 0.0 <= s.into_s <= s.duty * s.growth_s
            and (s.name not in INTERMITTENT or s.growth_s > NEAREST_S)
            and (s.name != "pulse" or s.onset_s > EARLY_S)
            and (s.name != "transient" or s.onset_s >= score_test.step_s or s.onset_s + s.growth_s > EARLY_S)
        ]
        found = at(tried) if tried else None
        if found is not None and found[0] > best:
            best, size, bottom, shape, course = found
        else:
            reach *= 0.5
    return replace(
        entry,
        shape=shape,
        vector=blocks * course,
        size=size,
        sd=bottom**-0.5,
        gain=size**2 * bottom,
        log_bayes=entry.log_bayes + best - start,
    )


def _later_turns(shape: Shape, span_s: float) -> float:
    """Return the negative log prior of the first period of a periodic effect: the record's first, or any later one."""
    if shape.name != "periodic" or shape.onset_s < shape.growth_s:
        return 0.0
    return math.log(max(span_s / shape.growth_s - 1.0, 1.0) * ALL_ALONG / (1.0 - ALL_ALONG))


def step_prior(score_test: ScoreTest, candidate: Candidate, onset_s: float) -> float:
    """Return the log prior of a step of a law from an onset on, which the record tells to a block."""
    onsets = Courses.of(score_test).steps.shape[1]
    begun = ALL_ALONG if onset_s == 0.0 else (1.0 - ALL_ALONG) / max(onsets - 1, 1)
    return math.log(begun * (AT_ONCE if family_of(candidate) == "any" else 1.0))


def _of_laws(scanned: _Scanned, laws: Sequence[CandidateLaw], family: str, turns: bool) -> list[Entry]:
    """Return the likeliest course of each shape of laws of one family."""
    score_test, courses = scanned.score_test, scanned.courses
    candidates = [law.candidate for law in laws]
    squares = LawSquares.of_all(score_test, laws)
    scores = np.stack([scanned.score(q) for q in squares])
    taken = scanned.taken(squares)
    least = _TINY * np.maximum([[q.most] for q in squares], _TINY)
    grows = family == "any"
    rest = math.log((1.0 - AT_ONCE) / (4.0 if may_end(candidates[0]) else 2.0)) if grows else -math.log(2.0)
    out: list[Entry] = []

    def add(shapes: Sequence[Shape], columns: Array, bottom: Array, prior: float) -> None:
        odds, size = log_bayes_of_sizes(candidates, scores @ columns, bottom)
        out.extend(_best(laws, squares, shapes, columns, odds + prior, odds, size, bottom))

    if family not in ("put in", "event"):
        late = taken[..., ::-1].cumsum(axis=2)[..., ::-1][..., : courses.steps.shape[1]]
        bottom = np.maximum(np.stack([q.steps for q in squares]) - np.einsum("lcb,lcb->lb", late, late), least)
        odds, size = log_bayes_of_sizes(candidates, scores @ courses.steps, bottom)
        # A lumped twin leaves as much of it all along: there it is no fault, later it has to beat that.
        usual = np.abs(size[:, 0]) < [c.lumped for c in candidates]
        odds[usual] -= np.maximum(odds[usual, :1], 0.0)
        odds[usual, 0] = -np.inf
        prior = np.full(odds.shape[1], math.log((1.0 - ALL_ALONG) / max(odds.shape[1] - 1, 1)))
        prior[0] = math.log(ALL_ALONG)
        prior += math.log(AT_ONCE) if grows else 0.0
        out += _best(laws, squares, courses.steps_shapes, courses.steps, odds + prior, odds, size, bottom)
    others, shaped = courses.beyond(candidates[0])
    if family != "step" and len(others):
        bottom = np.maximum(np.stack([q.growths for q in squares]) - _squares(taken, shaped), least)
        for shapes, rows in rows_by_name(others):
            add(shapes, shaped[:, rows], bottom[:, rows], rest - math.log(len(rows)))
    if turns:
        own = [score_test.small_gram(q.blocks) for q in squares]
        returns = [returning(score_test, law, gram) for law, gram in zip(laws, own, strict=True)]
        bottom = np.stack(returns) - _squares(taken, courses.returns)
        grams = [gram - t.T @ t for gram, t in zip(own, taken, strict=True)]
        for law, q, score, gram in zip(laws, squares, scores, grams, strict=True):
            out += _transients(score_test, law, q.blocks, score, gram, rest)
        for shapes, rows in courses.by_name:
            least_rows = np.maximum(bottom[:, rows], least)
            if shapes[0].name != "periodic":
                add(shapes, courses.returns[:, rows], least_rows, rest - math.log(2.0 * len(rows)))
                continue
            # One that sticks now and then is told by its first time.
            them = [i for i, law in enumerate(laws) if not law.candidate.sticks]
            tops = _tops_of_turns(scores[them], courses)
            out += [
                _turn(laws[i], squares[i], scores[i], grams[i], courses, tops[:, n], least_rows[i], rest)
                for n, i in enumerate(them)
            ]
    return out


def _squares(taken: Array, courses: Array) -> Array:
    """Return the squares (l, j) of courses (b, j) of l laws that other effects explain; they have `taken` (l, c, b) of
    each.
    """
    if not taken.shape[1]:
        return np.zeros((len(taken), courses.shape[1]))
    shared = taken @ courses
    return np.asarray(np.einsum("lcj,lcj->lj", shared, shared))


def _tops_of_turns(scores: Array, courses: Courses) -> Array:
    """Return the scores (s, l, n) of n periodic courses from each of s onsets, of laws with block scores (l, b)."""
    _, columns, _ = courses.turns
    cuts = np.linspace(0, scores.shape[1], STARTS + 1).astype(int)
    tops = np.stack([scores[:, i:j] @ columns[i:j] for i, j in itertools.pairwise(cuts)])
    for i in range(len(tops) - 1, 0, -1):
        tops[i - 1] += tops[i]
    return tops


def _turn(
    law: CandidateLaw,
    squares: LawSquares,
    score: Array,
    gram: Array,
    courses: Courses,
    tops: Array,
    bottoms: Array,
    rest: float,
) -> Entry:
    """Return the likeliest periodic course of a law, from the beginning or from one of some onsets.

    The score resolves the period to the inverse of the record's length; `tops` (s, n) has it from each of s onsets. The
    squares hardly change between the few periods for which `bottoms` (k,) are known, and those of a later onset are
    about its share of them; the leading courses get exact ones.
    """
    shapes, _, of = courses.turns
    cuts = np.linspace(0, len(score), STARTS + 1).astype(int)[:-1]
    weighted, prior, which = _likeliest_turns(law.candidate, tops, bottoms[of], 1.0 - cuts / len(score))
    total = logsumexp(weighted) + rest - math.log(2.0 * len(shapes))
    since, alike = weighted.argmax(axis=0), weighted.max(axis=0)
    lead = np.argpartition(alike, -min(LEADING_TURNS, len(alike)))[-LEADING_TURNS:]
    begun = [_begun(shapes[which[i]], float(courses.edges_s[cuts[since[i]]])) for i in lead]
    those = courses_of(begun, courses.edges_s).T
    own = np.maximum(np.einsum("bj,bj->j", those, gram @ those), _TINY * max(float(bottoms.max()), _TINY))
    exact, size = log_bayes_of_sizes(law.candidate, score @ those, own)
    k = int(np.argmax(exact))
    occam = total - float((weighted - prior[:, None])[since[lead], lead].max())
    return Entry(
        law,
        begun[k],
        squares.blocks * those[:, k],
        float(size[k]),
        float(own[k]) ** -0.5,
        float(size[k] ** 2 * own[k]),
        log_bayes=float(exact[k]) + occam,
        log_occam=occam,
    )


def _likeliest_turns(
    candidate: Candidate, tops: Array, bottoms: Array, left: Array
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return log B with its prior (s, j) of the courses that are not negligible, the prior (s,), and their indices.

    `tops` (s, n) are the scores from s onsets with shares `left` (s,) of the record, `bottoms` (n,) the squares from
    the record's beginning. A course is negligible if its bound (`most_log_bayes`) is below rounding of the likeliest
    one, and below each of the `LEADING_TURNS` courses that get exact squares. Of some courses with large bounds, the
    likeliest and the last of the leading ones are no likelier than those of all courses, so both limits are safe.
    """
    prior = np.full(len(left), math.log((1.0 - ALL_ALONG) / (len(left) - 1)))
    prior[0] = math.log(ALL_ALONG)

    def weighted(those: NDArray[np.intp]) -> Array:
        return _roughly(candidate, tops[:, those], left[:, None] * bottoms[those]) + prior[:, None]

    usual = SPREAD * candidate.typical
    most = ((0.5 * tops**2) * (1.0 / left)[:, None]) / bottoms
    bound = (most + (prior - 0.5 * np.log1p(usual**2 * left * float(bottoms.min())))[:, None]).max(axis=0)
    some = np.argpartition(bound, -min(LEAD, len(bound)))[-LEAD:]
    reached = np.sort(weighted(some).max(axis=0))
    least = min(reached[-min(LEADING_TURNS, len(reached))], reached[-1] - NEGLIGIBLE - math.log(tops.size))
    kept = np.flatnonzero(bound >= least)
    return weighted(kept), prior, kept


def _roughly(candidate: Candidate, top: Array, bottom: Array) -> Array:
    """Return log B of sizes without the factor of their bounds; minus infinity for an excluded sign."""
    impossible = ((top > 0.0) & (candidate.upper <= 0.0)) | ((top < 0.0) & (candidate.lower >= 0.0))
    return np.where(impossible, -math.inf, free_log_bayes(candidate, top, bottom))


def _begun(shape: Shape, since_s: float) -> Shape:
    """Return a periodic shape whose first period begins at or after a time, s."""
    turns = max(math.ceil((since_s - shape.onset_s) / shape.growth_s), 0)
    return replace(shape, onset_s=shape.onset_s + turns * shape.growth_s)


def _transients(
    score_test: ScoreTest, law: CandidateLaw, blocks: Array, score: Array, gram: Array, rest: float
) -> list[Entry]:
    """Return the likeliest transient of a law, of two blocks or more, that ends two blocks before the record."""
    b = score_test.b
    sums, tops = np.zeros((b + 1, b + 1)), np.concatenate([[0.0], np.cumsum(score)])
    sums[1:, 1:] = gram.cumsum(axis=0).cumsum(axis=1)
    first, last = _spans(b, score_test.step_s)
    if not len(first):
        return []  # so short a record has no room for one
    upto = np.diag(sums)
    bottom: Array = upto[last] + upto[first] - 2.0 * sums.ravel()[first * (b + 1) + last]
    bottom = np.maximum(bottom, _TINY * max(float(upto.max()), _TINY))
    top, count = tops[last] - tops[first], len(first)
    leading = likeliest(law.candidate, top, bottom)
    first, last, bottom = first[leading], last[leading], bottom[leading]
    odds, size = log_bayes_of_sizes(law.candidate, top[leading], bottom)
    k = int(np.argmax(odds))
    total = logsumexp(odds) + rest - math.log(count)
    block_s = score_test.step_s
    shape = Shape("transient", first[k] * block_s, (last[k] - first[k]) * block_s)
    vector = blocks * shape.block_means(score_test.edges * score_test.grid.step_s)
    gain = float(size[k] ** 2 * bottom[k])
    return [
        Entry(
            law,
            shape,
            vector,
            float(size[k]),
            float(bottom[k]) ** -0.5,
            gain,
            log_bayes=total,
            log_occam=total - float(odds[k]),
        )
    ]


@functools.lru_cache(maxsize=16)
def _spans(b: int, step_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first blocks of transients in a record of b blocks, and the blocks before which they end.

    What is there from the beginning and ends within `EARLY_S` is a state that was not at rest, and no transient.
    """
    first, last = np.triu_indices(b - 1, 2)
    later = (first > 0) | (last * step_s > EARLY_S)
    return first[later], last[later]


def logsumexp(values: Array) -> float:
    """Return the logarithm of a sum of exponentials; scipy's takes ten times as long for a few numbers."""
    most = float(values.max())
    return most + math.log(float(np.exp(values - most).sum())) if math.isfinite(most) else most


def _best(
    laws: Sequence[CandidateLaw],
    squares: Sequence[LawSquares],
    shapes: Sequence[Shape],
    columns: Array,
    weighted: Array,
    odds: Array,
    size: Array,
    bottom: Array,
) -> list[Entry]:
    """Return each law's likeliest course of those in `columns` (b, i); the other arrays are (laws, i)."""
    rows, best = np.arange(len(laws)), np.argmax(weighted, axis=1)
    most, sizes, squared = (values[rows, best] for values in (weighted, size, bottom))
    with np.errstate(invalid="ignore"):
        total = most + np.log(np.exp(weighted - most[:, None]).sum(axis=1))
    return [
        Entry(
            law,
            shapes[k],
            q.blocks * columns[:, k],
            float(s),
            float(square) ** -0.5,
            float(s**2 * square),
            log_bayes=float(mean),
            log_occam=float(mean - alone),
        )
        for law, q, k, s, square, mean, alone in zip(
            laws, squares, best, sizes, squared, total, odds[rows, best], strict=True
        )
        if math.isfinite(mean)
    ]
