"""Search by score: every law in every time course from every onset, then one, two or three of them jointly."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.shapes import Shape
from twin.discovery.scoring.score_tests import JointEstimate, ScoreTest
from twin.discovery.scoring.sweep import LAST_SHARE, Courses, Given, LawSquares
from twin.elements.candidates import Candidate
from twin.network import Array
from twin.quantiles import NORMAL90

WORTH_GROWING = 4.0
"""Gain of a law's best step below which its growing courses are not scored: the two never differ much."""
CAME_IN = 25.0
"""Gain over the presence from the beginning from which an effect has an onset, and is no model error of a lumped twin.
"""
CAME_IN_SHARE = 0.1
"""The same as a share of its gain, if the model error is unknown: the beginning of a record has transients of its own.
"""
ACTUATED = ("heater_power", "pump_speed", "fan_speed")
"""Drivers that an effect follows even if it grows too: an input explains more than time does."""
_TINY = 1e-12
"""Share of the largest squares below which squares are rounding."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One hypothesis with its size estimated alone: `vector` (sites, b) at size 1.

    `sd` of a growing effect is that of its size at the record's end. `log_bayes` is its log Bayes factor over no
    effect, averaged over onsets by their prior, and `log_occam` the logarithm of that average over its maximum.
    `on_bound` is True for a size that a fit left on a bound of what its place can have.
    """

    law: CandidateLaw
    shape: Shape
    vector: Array
    size: float
    sd: float
    gain: float
    onset_sd_s: float = 0.0
    log_bayes: float = 0.0
    log_occam: float = 0.0
    on_bound: bool = False

    @property
    def candidate(self) -> Candidate:
        return self.law.candidate

    @property
    def z(self) -> float:
        return float(np.sqrt(max(self.gain, 0.0)))

    def placed(self, score_test: ScoreTest) -> Array:
        """Return the vector for the entry's present shape."""
        placed: Array = score_test.vector(self.law) * self.shape.block_means(score_test.edges * score_test.grid.step_s)
        return placed

    def refreshed(self, score_test: ScoreTest) -> Entry:
        """Return the entry with the vector of its present shape in another score test."""
        return replace(self, vector=self.placed(score_test))

    def going_on(self, part_s: float, record_s: float) -> Entry:
        """Return an effect of the first `part_s` of a record, s, that still grew at their end, as growing on.

        A fit may end a ramp within rounding of its data's end, and whether it ended there is not identifiable.
        """
        shape = self.shape
        if shape.name != "ramp" or shape.free(part_s):
            return self
        longer = replace(shape, growth_s=record_s).going_on(record_s)
        more = longer.growth_s / shape.growth_s
        return replace(self, shape=longer, vector=self.vector / more, size=self.size * more, sd=self.sd * more)

    @property
    def driver(self) -> str:
        """Return the driver of the effect: the input of its law, else time if it grows, else that of the law."""
        if self.shape.name == "periodic":
            return "periodic"
        time = self.shape.grows and self.candidate.driver not in ACTUATED
        return "elapsed_time" if time else self.candidate.driver

    @property
    def change(self) -> str:
        """Return the type of change: a drifting parameter is a missing law of time, one that stepped a moved
        parameter.
        """
        return "new" if self.shape.grows else self.candidate.change

    @property
    def label(self) -> tuple[str, str, str]:
        return self.candidate.kind, self.candidate.where, self.driver


def allowed(candidate: Candidate, size: float) -> bool:
    return candidate.lower <= size <= candidate.upper


def scan(score_test: ScoreTest, laws: list[CandidateLaw], given: Array | None = None) -> list[Entry]:
    """Return the best onset of each law in each of its shapes, by falling gain.

    Args:
        given: vectors (e, sites, b) of effects that are already known; their sizes are fitted jointly.
    """
    known = Courses.of(score_test)
    onsets, steps = known.onsets, known.steps
    beside = Given(score_test, given) if given is not None and len(given) else None
    found: list[Entry] = []
    for law in laws:
        others, courses = known.beyond(law.candidate)
        p, score, bottom, growing = _beside(score_test, law, beside)
        size, gain = _gains(law, score @ steps, bottom)
        if law.candidate.lumped and not _came_in(law, gain):
            gain[np.abs(size) < law.candidate.lumped] = 0.0
        best = int(np.argmax(gain))
        put_in = bool(law.candidate.begins)
        if gain[best] > 0.0 and not put_in:
            vector = p * steps[:, best]
            shape = Shape("step", float(onsets[best]))
            found.append(_entry(law, shape, vector, size[best], bottom[best], gain[best]))
        if law.candidate.shapes == ("step",) or (gain[best] < WORTH_GROWING and not put_in):
            continue
        bottom = growing
        size, gain = _gains(law, score @ courses, bottom)
        each = max(len(others), 1) if put_in else len(onsets[::3])
        for first in range(0, len(others), each):
            best = first + int(np.argmax(gain[first : first + each]))
            if gain[best] > 0.0:
                found.append(_entry(law, others[best], p * courses[:, best], size[best], bottom[best], gain[best]))
    found.sort(key=lambda e: -e.gain)
    return found


def _came_in(law: CandidateLaw, gain: Array) -> bool:
    """Return True if gains (i,) by onset indicate an onset after the beginning; the limit is higher if the size is
    uncertain.
    """
    more = gain.max() - gain[0]
    return bool(more >= CAME_IN and (law.candidate.lumped < np.inf or more >= CAME_IN_SHARE * gain.max()))


def able_to_begin(score_test: ScoreTest, entry: Entry, given: Array) -> tuple[float, float]:
    """Return the earliest and the latest onset, s, with a gain equal to the best within the 90 % interval.

    Args:
        given: vectors (e, sites, b) of the effects beside it.
    """
    known = Courses.of(score_test)
    beside = Given(score_test, given) if len(given) else None
    _, score, bottom, growing = _beside(score_test, entry.law, beside)
    if entry.shape.name == "step":
        onsets, gain = known.onsets, _gains(entry.law, score @ known.steps, bottom)[1]
    else:
        shapes, courses = known.beyond(entry.candidate)
        of_it = np.array([shape.name == entry.shape.name for shape in shapes], dtype=bool)
        onsets = np.array([shape.onset_s for shape in shapes])[of_it]
        gain = _gains(entry.law, score @ courses, growing)[1][of_it]
    able = onsets[gain > gain.max(initial=0.0) - NORMAL90**2]
    return (float(able.min()), float(able.max())) if len(able) else (entry.shape.onset_s, entry.shape.onset_s)


def _beside(score_test: ScoreTest, law: CandidateLaw, beside: Given | None) -> tuple[Array, Array, Array, Array]:
    """Return a law's blocks (sites, b) and score (b,), and the squares of its steps and of its other shapes.

    The part that the given effects explain is subtracted.
    """
    squares = LawSquares.of(score_test, law)
    p, score, bottom, growing = squares.blocks, score_test.scored(squares.blocks), squares.steps, squares.growths
    if beside is not None:
        share = beside.share(p)
        score = score - beside.score(share)
        bottom = bottom - (share[::-1].cumsum(axis=0)[::-1][: len(bottom)] ** 2).sum(axis=1)
        growing = growing - ((share.T @ Courses.of(score_test).beyond(law.candidate)[1]) ** 2).sum(axis=0)
    least = _TINY * max(float(squares.steps.max()), _TINY)
    return p, score, np.maximum(bottom, least), np.maximum(growing, least)


def _gains(law: CandidateLaw, top: Array, bottom: Array) -> tuple[Array, Array]:
    """Return sizes and gains of courses with scores `top` and squares `bottom`; no gain if the size is impossible."""
    size = top / bottom
    inside = (size >= law.candidate.lower) & (size <= law.candidate.upper)
    gain: Array = np.where(inside, top * size, 0.0)
    return size, gain


def _entry(law: CandidateLaw, shape: Shape, vector: Array, size: float, bottom: float, gain: float) -> Entry:
    return Entry(law, shape, vector, float(size), float(bottom) ** -0.5, float(gain))


def refine(score_test: ScoreTest, entry: Entry) -> Entry:
    """Return the entry with onset and growth time at the maximum of its gain."""
    edges_s = score_test.edges * score_test.grid.step_s
    p = score_test.vector(entry.law)
    gram, score = score_test.small(p)
    best = entry
    reach = score_test.step_s
    while reach >= 30.0:
        for shift, factor in itertools.product((-reach, 0.0, reach), (0.7, 1.0, 1.4)):
            growth = best.shape.growth_s * factor
            if factor != 1.0 and not best.shape.free(float(edges_s[-1])):
                continue
            onset = best.shape.onset_s + shift
            if onset < 0.0 or onset > edges_s[-1] * LAST_SHARE:
                continue
            shape = Shape(best.shape.name, onset, growth).going_on(float(edges_s[-1]))
            best = _better(score_test, best, shape, p, gram, score)
        reach *= 0.5
    return best


def _better(score_test: ScoreTest, entry: Entry, shape: Shape, p: Array, gram: Array, score: Array) -> Entry:
    course = shape.block_means(score_test.edges * score_test.grid.step_s)
    bottom = max(float(course @ gram @ course), _TINY)
    top = float(score @ course)
    if top**2 / bottom <= entry.gain or not allowed(entry.candidate, top / bottom):
        return entry
    return Entry(entry.law, shape, p * course, top / bottom, bottom**-0.5, top**2 / bottom)


def together(score_test: ScoreTest, entries: tuple[Entry, ...]) -> tuple[tuple[Entry, ...], JointEstimate]:
    """Return the entries with jointly fitted sizes, and that fit."""
    if not entries:
        return entries, score_test.estimate(np.empty((0, score_test.sites, score_test.b)))
    fit = score_test.estimate(np.stack([e.vector for e in entries]))
    sizes, sd = fit.sizes.tolist(), np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)).tolist()
    return tuple(replace(e, size=s, sd=d) for e, s, d in zip(entries, sizes, sd, strict=True)), fit


def possible(entries: tuple[Entry, ...]) -> bool:
    """Return True if all sizes have a possible sign and magnitude."""
    return all(allowed(e.candidate, e.size) for e in entries)
