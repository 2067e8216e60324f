"""Quantities that a scan computes once: time courses, squares of laws along them, and the share of known effects."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.shapes import EARLY_S, Shape, courses_of, family, means_between
from twin.discovery.scoring.course_squares import CourseSquares
from twin.discovery.scoring.score_tests import ScoreTest
from twin.elements.candidates import Candidate
from twin.network import Array

LAST_SHARE = 0.95
"""Share of the record up to which onsets are tried; an effect needs some time to show."""
_KNOWN = 1e-10
"""Share of the largest eigenvalue below which a direction of given effects is rounding."""
FADING_S = (60.0, 600.0, 3600.0)
"""Time constants of pulses that are tried, s: water that is poured in, a wall, a room."""
LEAST_BLOCKS, LEAST_TURNS, PERIODS, PHASES = 3.0, 2.0, 40, 12
"""Blocks in the shortest period and periods in a record, how many periods are tried and how many phases of each."""
DAY_S, DAYS, DAY_PHASES = 86_400.0, 1.25, 24
"""Seconds of a day; days in a record from which a daily course is tried, which then shows six hours of it twice; and
phases of a day, one an hour. Two whole periods are not required, unlike for other periods: rooms, shifts and the sun
follow the day."""
RATES = 3.0
"""Frequencies of periodic courses per inverse record length: with three, the nearest one deviates by a sixth of a
period at the record's end, if it agrees at the beginning."""
DUTIES = (0.25, 0.5, 0.75)
"""Shares of a period in which a periodic effect is present that are tried."""


@dataclass(frozen=True)
class Courses:
    """Onsets (i,), s, of steps and their courses (b, i); j growing shapes, and their courses (b, j).

    `edges_s` (b + 1,) bound the blocks.
    """

    onsets: Array
    steps: Array
    grown: list[Shape]
    growths: Array
    edges_s: Array
    steps_shapes: list[Shape]
    _fading: dict[float, tuple[list[Shape], Array]] = field(default_factory=dict)

    @classmethod
    def of(cls, score_test: ScoreTest) -> Courses:
        known: Courses | None = score_test.memo.get("courses")
        if known is None:
            known = score_test.memo["courses"] = _courses(score_test)
        return known

    @cached_property
    def transients(self) -> list[Shape]:
        """Return periodic shapes and pulses, for the search by evidence alone."""
        return _transients(self.onsets, self.edges_s)

    @cached_property
    def by_name(self) -> tuple[tuple[list[Shape], NDArray[np.intp]], ...]:
        """Return the `transients` shapes of each name, with their columns of `returns`."""
        return rows_by_name(self.transients)

    @cached_property
    def returns(self) -> Array:
        """Return courses (b, k) of the `transients` shapes."""
        return courses_of(self.transients, self.edges_s).T.copy()

    @cached_property
    def turns(self) -> tuple[list[Shape], Array, NDArray[np.intp]]:
        """Return periodic shapes, their courses (b, k), and for each the nearest one among those of `transients`.

        Their frequencies are closer than the resolution of the record.
        """
        coarse = next(shapes for shapes, _ in self.by_name if shapes[0].name == "periodic")
        onset, growth, duty = np.array([(s.onset_s, s.growth_s, s.duty) for s in coarse]).T
        span = float(self.edges_s[-1])
        periods = np.unique(growth)
        period = 1.0 / np.arange(1.0 / periods[-1], 1.0 / periods[0], 1.0 / (RATES * span))
        near = periods[np.argmin(np.abs(np.log(periods / period[:, None])), axis=1)]
        alike = [np.flatnonzero(growth == one) for one in near]
        of = np.concatenate(alike)
        longer = np.repeat(period / near, [len(rows) for rows in alike])
        times = np.stack([onset[of] * longer, growth[of] * longer, duty[of], np.zeros(len(of))])
        shapes = [Shape("periodic", *row) for row in times.T.tolist()]
        return shapes, means_between(self.edges_s, "periodic", times).T.copy(), of

    def beyond(self, candidate: Candidate) -> tuple[list[Shape], Array]:
        """Return the shapes of a candidate other than steps, and their courses (b, j)."""
        if candidate.shapes == ("step",) or candidate.is_event:
            return [], self.growths[:, :0]
        if not candidate.begins:
            return self.grown, self.growths
        if candidate.slow_s not in self._fading:
            # What was put in before the record begins is as warm as its place may be: no reading tells.
            shapes = [Shape("put in", float(t), candidate.slow_s) for t in self.onsets if t > EARLY_S]
            self._fading[candidate.slow_s] = shapes, courses_of(shapes, self.edges_s).T.copy()
        return self._fading[candidate.slow_s]


@dataclass(frozen=True)
class LawSquares:
    """Squares of a law at size 1, alone: `blocks` (sites, b), squares of its steps (i,) and other shapes (j,).

    `sites` (a,) are those at which it acts; `most` is the largest square of a step.
    """

    blocks: Array
    steps: Array
    growths: Array
    sites: NDArray[np.intp]
    most: float

    @classmethod
    def of(cls, score_test: ScoreTest, law: CandidateLaw) -> LawSquares:
        (found,) = cls.of_all(score_test, [law])
        return found

    @classmethod
    def of_all(cls, score_test: ScoreTest, laws: Sequence[CandidateLaw]) -> list[LawSquares]:
        """Return those of several laws; of laws that are steps alone, all that are new at once."""
        new = [law for law in laws if law not in score_test.memo]
        courses = Courses.of(score_test)
        alone = [law for law in new if not len(courses.beyond(law.candidate)[0])]
        count = len(courses.onsets)
        if alone:
            vectors = np.stack([score_test.vector(law) for law in alone])
            for law, blocks, steps in zip(alone, vectors, _steps_of(score_test, vectors)[:, :count], strict=True):
                score_test.memo[law] = cls._of(blocks, steps, np.zeros(0))
        for law in new:
            if law not in score_test.memo:
                blocks = score_test.vector(law)
                gram = score_test.small_gram(blocks)
                shapes, shaped = courses.beyond(law.candidate)
                growths = squares_of(score_test, gram, shaped, shapes)
                score_test.memo[law] = cls._of(blocks, _late_sums(gram)[:count], growths)
        return [score_test.memo[law] for law in laws]

    @classmethod
    def _of(cls, blocks: Array, steps: Array, growths: Array) -> LawSquares:
        return cls(blocks, steps, growths, np.flatnonzero(blocks.any(axis=1)), float(steps.max()))


def returning(score_test: ScoreTest, law: CandidateLaw, gram: Array) -> Array:
    """Return the squares (k,) of a law at size 1, of Gram matrix (b, b), for periodic courses and pulses."""
    known: Array | None = score_test.memo.get(("returning", law))
    if known is None:
        courses = Courses.of(score_test)
        known = score_test.memo["returning", law] = squares_of(score_test, gram, courses.returns, courses.transients)
    return known


def _steps_of(score_test: ScoreTest, vectors: Array) -> Array:
    """Return the squares (l, b) of steps of laws, `vectors` (l, sites, b), that begin with each block."""
    b, active = score_test.b, np.flatnonzero(vectors.any(axis=(0, 2)))
    sites, more = score_test.gram.reshape(score_test.sites, b, score_test.sites, b), np.zeros((len(vectors), b))
    for one in active:
        for other in active:
            there = np.flatnonzero((vectors[:, one].any(axis=1)) & (vectors[:, other].any(axis=1)))
            if len(there):
                pulled = (sites[one, :, other] * _row_and_column(b)) @ vectors[there, other].T
                more[there] += vectors[there, one] * pulled.T
    sums: Array = more[:, ::-1].cumsum(axis=1)[:, ::-1]
    return sums


def squares_of(score_test: ScoreTest, gram: Array, courses: Array, shapes: Sequence[Shape] = ()) -> Array:
    """Return the squares (j,) of courses (b, j), which the score test keeps, in a Gram matrix (b, b).

    `shapes` are those of the courses, if they have some: families of them share most products.
    """
    known: tuple[Array, CourseSquares] | None = score_test.memo.get(("squares", id(courses)))
    if known is None:  # with the courses, whose identity so stays their own
        edges_s = score_test.edges * score_test.grid.step_s if len(shapes) else None
        known = score_test.memo["squares", id(courses)] = courses, CourseSquares.of(courses, shapes, edges_s)
    return known[1](gram)


class Given:
    """Known effects whose sizes are fitted jointly with each candidate, `vectors` (e, sites, b)."""

    def __init__(self, score_test: ScoreTest, vectors: Array) -> None:
        flat = vectors.reshape(len(vectors), -1)
        onto = score_test.gram @ flat.T
        self._onto = onto.reshape(score_test.sites, score_test.b, -1)
        values, axes = np.linalg.eigh(flat @ onto)
        kept = values > _KNOWN * values.max()
        self._root = axes[:, kept] / np.sqrt(values[kept])
        self._score = self._root.T @ (flat @ score_test.score)

    def share(self, p: Array) -> Array:
        """Return the part (b, e) of a law's blocks that the given effects explain; its square leaves the Gram
        matrix.
        """
        shared: Array = np.einsum("sbe,sb->be", self._onto, p) @ self._root
        return shared

    def score(self, share: Array) -> Array:
        """Return the part (b,) of the law's score that goes with it."""
        taken: Array = share @ self._score
        return taken


def rows_by_name(shapes: Sequence[Shape]) -> tuple[tuple[list[Shape], NDArray[np.intp]], ...]:
    """Return the shapes of each name, with their rows."""
    names = np.array([s.name for s in shapes])
    found = []
    for name in dict.fromkeys(names.tolist()):
        rows = np.flatnonzero(names == name)
        found.append(([shapes[int(i)] for i in rows], rows))
    return tuple(found)


def _courses(score_test: ScoreTest) -> Courses:
    edges_s = score_test.edges * score_test.grid.step_s
    onsets = edges_s[: max(int(score_test.b * LAST_SHARE), 1)]
    begins = [Shape("step", float(t)) for t in onsets]
    steps = courses_of(begins, edges_s).T.copy()
    # Growth begins so gently that every third block is enough; `refine` looks between them.
    grown = [
        Shape(name, float(t), growth).going_on(float(edges_s[-1]))
        for name in ("ramp", "saturating")
        for growth in family(name, float(edges_s[-1]))
        for t in onsets[::3]
    ]
    growths = courses_of(grown, edges_s).T.copy()
    return Courses(onsets, steps, grown, growths, edges_s, begins)


def _transients(onsets: Array, edges_s: Array) -> list[Shape]:
    """Return periodic shapes and pulses that a record of these blocks resolves; `refined` searches between them."""
    span, block = float(edges_s[-1]), float(edges_s[1] - edges_s[0])
    found = [
        Shape("pulse", float(t), decay)
        for decay in FADING_S
        if block < 8.0 * decay and decay < 0.5 * span
        for t in onsets
        if t > EARLY_S  # what fades from the beginning on is a state that was not at rest
    ]
    long_enough = span > LEAST_TURNS * LEAST_BLOCKS * block
    periods = np.geomspace(LEAST_BLOCKS * block, span / LEAST_TURNS, PERIODS) if long_enough else np.empty(0)
    for period in periods:
        count = int(np.clip(np.ceil(period / block), 4, PHASES))
        found += [
            Shape("periodic", float(period * k / count), float(period), duty) for duty in DUTIES for k in range(count)
        ]
    if DAYS * DAY_S < span < LEAST_TURNS * DAY_S:
        found += [Shape("periodic", DAY_S * k / DAY_PHASES, DAY_S, duty) for duty in DUTIES for k in range(DAY_PHASES)]
    return found


def _late_sums(gram: Array) -> Array:
    """Return squares (b,) of steps that begin with each block: sums of the lower right corners of a Gram matrix (b, b).

    The corner of a block has one row and one column more than that of the next one, and the matrix is symmetric.
    """
    more = np.einsum("ij,ij->i", gram, _row_and_column(len(gram)))
    sums: Array = more[::-1].cumsum()[::-1]
    return sums


@functools.cache
def _row_and_column(b: int) -> Array:
    """Return weights (b, b) by which a row's sum from the diagonal on is that of the row and the column of its
    block.
    """
    return np.triu(np.full((b, b), 2.0), 1) + np.eye(b)
