"""Every law in every time course from every onset, by evidence, alone or beside effects that are integrated out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.discovery.effects.laws import Law
from twin.discovery.effects.shapes import TIMED, Shape
from twin.discovery.evidence.marginal import Joint, log_bayes_of_sizes
from twin.discovery.evidence.priors import ALL_ALONG, AT_ONCE
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import LAST_SHARE, Courses, Squares
from twin.elements.base import Candidate
from twin.network import Array

STEADY = ("constant", "temperature_difference")
"""Drivers of laws that are tried with the courses that end, come back or fade."""
NEAREST_S = 15.0
"""Onsets are told no closer by block means, s."""
_TINY = 1e-12


def scan(
    contest: Contest, laws: Sequence[Law], beside: Joint | None = None, *, timed: bool = True
) -> list[Entry]:  # fmt: skip
    """Return the likeliest onset of each law in each of its shapes, by falling evidence.

    `Entry.log_bayes` is averaged over the times of its course by their prior; `Entry.log_occam` is the logarithm of
    that average over its best.

    Parameters:
        beside: effects that are integrated out. timed: with courses that end, come back or fade.
    """
    courses = Courses.of(contest)
    score = contest.score if beside is None else beside.reduced_score(contest.score)
    sites_score = score.reshape(contest.sites, contest.b)
    found: list[Entry] = []
    for law in laws:
        squares = Squares.of(contest, law)
        own = (sites_score * squares.blocks).sum(axis=0)
        share = _taken(contest, squares.blocks, beside)
        found += _of_law(contest, law, own, squares, share, courses, timed and may_end(law.candidate))
    found.sort(key=lambda e: -e.log_bayes)
    return found


def _taken(contest: Contest, blocks: Array, beside: Joint | None) -> Array:
    """Return the part (b, c) of a law's blocks that effects beside it stand for; its square leaves the Gram matrix."""
    if beside is None:
        return np.empty((contest.b, 0))
    sites = np.flatnonzero(blocks.any(axis=1))
    onto = beside.onto.reshape(contest.sites, contest.b, -1)
    shared: Array = sum(onto[s] * blocks[s][:, None] for s in sites) @ beside.root
    return shared


def may_end(candidate: Candidate) -> bool:
    """Return True for a law that may come and go: one of each place and kind is enough, what it follows fits tell."""
    return candidate.shapes != ("step",) and not candidate.begins and candidate.driver in STEADY


def refined(contest: Contest, entry: Entry, beside: Joint | None = None) -> Entry:
    """Return an entry with its onset (and growth) moved to where its evidence is greatest, between the blocks too."""
    edges_s = contest.edges * contest.grid.step_s
    blocks = Squares.of(contest, entry.law).blocks
    gram, _ = contest.small(blocks)
    score = contest.score if beside is None else beside.reduced_score(contest.score)
    own = (score.reshape(contest.sites, contest.b) * blocks).sum(axis=0)
    taken = _taken(contest, blocks, beside)
    gram = gram - taken @ taken.T
    least = _TINY * max(float(np.trace(gram)), _TINY)

    def at(shape: Shape) -> tuple[float, float, float, Array]:
        course = shape.block_means(edges_s)
        bottom = max(float(course @ gram @ course), least)
        odds, size = log_bayes_of_sizes(entry.candidate, np.array(own @ course), np.array(bottom))
        return float(odds), float(size), bottom, course

    shape, (best, size, bottom, course) = entry.shape, at(entry.shape)
    start = best
    reach = contest.step_s if shape.onset_s > 0.0 or shape.name in TIMED else 0.0
    while reach >= NEAREST_S:
        tried = [replace(shape, onset_s=shape.onset_s + d) for d in (-reach, reach)]
        if shape.name == "spell":
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
        elif shape.free(float(edges_s[-1])):
            tried += [replace(s, growth_s=s.growth_s * f) for s in (shape, *tried) for f in (0.7, 1.4)]
        tried = [
            s.going_on(float(edges_s[-1]))
            for s in tried
            if 0.0 <= s.onset_s <= LAST_SHARE * edges_s[-1] and (s.name not in TIMED or s.growth_s > NEAREST_S)
        ]
        found = max(((at(s), s) for s in tried), key=lambda f: f[0][0], default=None)
        if found is not None and found[0][0] > best:
            (best, size, bottom, course), shape = found
        else:
            reach *= 0.5
    return replace(
        entry, shape=shape, vector=blocks * course, size=size, sd=bottom**-0.5, gain=size**2 * bottom,
        log_bayes=entry.log_bayes + best - start,
    )  # fmt: skip


def _of_law(
    contest: Contest, law: Law, score: Array, squares: Squares, share: Array, courses: Courses,
    turns: bool,
) -> list[Entry]:  # fmt: skip
    c = law.candidate
    blocks = squares.blocks
    least = _TINY * max(float(squares.steps.max()), _TINY)
    put_in, grows = bool(c.begins), c.shapes != ("step",) and not c.begins
    rest = math.log((1.0 - AT_ONCE) / (4.0 if may_end(c) else 2.0)) if grows else 0.0
    out: list[Entry] = []

    def add(shapes: Sequence[Shape], columns: Array, bottom: Array, prior: Array) -> None:
        bottom = np.maximum(bottom, least)
        odds, size = log_bayes_of_sizes(c, score @ columns, bottom)
        out.extend(_best(law, blocks, shapes, columns, odds, size, bottom, prior))

    if not put_in:
        steps = np.maximum(
            squares.steps - (share[::-1].cumsum(axis=0)[::-1][: len(squares.steps)] ** 2).sum(axis=1), least
        )
        odds, size = log_bayes_of_sizes(c, score @ courses.steps, steps)
        if c.lumped:
            # A lumped twin leaves as much of it all along: there it is no fault, later it has to beat that.
            usual = abs(size[0]) < c.lumped
            odds = odds - (max(float(odds[0]), 0.0) if usual else 0.0)
            odds[0] = -np.inf if usual else odds[0]
        prior = np.full(len(odds), math.log((1.0 - ALL_ALONG) / max(len(odds) - 1, 1)))
        prior[0] = math.log(ALL_ALONG)
        prior += math.log(AT_ONCE) if grows else 0.0
        out += _best(law, blocks, courses.steps_shapes, courses.steps, odds, size, steps, prior)
    others, shaped = courses.beyond(c)
    if (grows or put_in) and len(others):
        bottom = squares.growths - ((share.T @ shaped) ** 2).sum(axis=0)
        names = np.array([o.name for o in others])
        for name in dict.fromkeys(names.tolist()):
            rows = np.flatnonzero(names == name)
            prior = np.full(len(rows), rest - math.log(len(rows)))
            add([others[i] for i in rows], shaped[:, rows], bottom[rows], prior)
    if turns:
        gram = contest.small(blocks)[0] - share @ share.T
        out += _spells(contest, law, blocks, score, gram, rest)
        names = np.array([o.name for o in courses.timed])
        bottom = (courses.returns * (gram @ courses.returns)).sum(axis=0)
        for name in dict.fromkeys(names.tolist()):
            rows = np.flatnonzero(names == name)
            prior = np.full(len(rows), rest - math.log(2.0 * len(rows)))
            add([courses.timed[i] for i in rows], courses.returns[:, rows], bottom[rows], prior)
    return out


def _spells(
    contest: Contest, law: Law, blocks: Array, score: Array, gram: Array, rest: float
) -> list[Entry]:  # fmt: skip
    """Return the likeliest spell of a law, of two blocks or more, that is over two blocks before the record is."""
    b = contest.b
    sums, tops = np.zeros((b + 1, b + 1)), np.concatenate([[0.0], np.cumsum(score)])
    sums[1:, 1:] = gram.cumsum(axis=0).cumsum(axis=1)
    first, last = np.triu_indices(b - 1, 2)
    if not len(first):
        return []  # so short a record has no room for one
    bottom: Array = sums[last, last] - sums[first, last] - sums[last, first] + sums[first, first]
    bottom = np.maximum(bottom, _TINY * max(float(np.diag(sums).max()), _TINY))
    odds, size = log_bayes_of_sizes(law.candidate, tops[last] - tops[first], bottom)
    k = int(np.argmax(odds))
    prior = rest - math.log(len(odds))
    total = logsumexp(odds) + prior
    block_s = contest.step_s
    shape = Shape("spell", first[k] * block_s, (last[k] - first[k]) * block_s)
    vector = blocks * shape.block_means(contest.edges * contest.grid.step_s)
    gain = float(size[k] ** 2 * bottom[k])
    return [Entry(law, shape, vector, float(size[k]), float(bottom[k]) ** -0.5, gain, log_bayes=total,
                  log_occam=total - float(odds[k]))]  # fmt: skip


def logsumexp(values: Array) -> float:
    """Return the logarithm of a sum of exponentials; scipy's takes ten times as long for a few numbers."""
    most = float(values.max())
    return most + math.log(float(np.exp(values - most).sum())) if math.isfinite(most) else most


def _best(
    law: Law, blocks: Array, shapes: Sequence[Shape], columns: Array, odds: Array, size: Array, bottom: Array,
    prior: Array,
) -> list[Entry]:  # fmt: skip
    weighted = odds + prior
    if not len(weighted) or not np.isfinite(weighted).any():
        return []
    k = int(np.argmax(weighted))
    total = logsumexp(weighted)
    gain = float(size[k] ** 2 * bottom[k])
    return [Entry(law, shapes[k], blocks * columns[:, k], float(size[k]), float(bottom[k]) ** -0.5, gain,
                  log_bayes=total, log_occam=total - float(odds[k]))]  # fmt: skip
