"""What a scan works out once: courses of time, squares of laws along them, what known effects take from them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin.discovery.effects.laws import Law
from twin.discovery.effects.shapes import EARLY_S, Shape, family
from twin.discovery.scoring.contest import Contest
from twin.elements.base import Candidate
from twin.network import Array

LAST_SHARE = 0.95
"""Onsets are looked for up to this share of the record; an effect needs some time to show."""
_KNOWN = 1e-10


@dataclass(frozen=True)
class Courses:
    """Onsets (i,), s, of steps and their courses (b, i); shapes that grow, j of them, and theirs (b, j).

    `edges_s` (b + 1,) bound the blocks.
    """

    onsets: Array
    steps: Array
    grown: list[Shape]
    growths: Array
    edges_s: Array
    _fading: dict[float, tuple[list[Shape], Array]] = field(default_factory=dict)

    @classmethod
    def of(cls, contest: Contest) -> Courses:
        known: Courses | None = contest.memo.get("courses")
        if known is None:
            known = contest.memo["courses"] = _courses(contest)
        return known

    def beyond(self, candidate: Candidate) -> tuple[list[Shape], Array]:
        """The shapes of a candidate other than steps, and their courses (b, j)."""
        if candidate.shapes == ("step",):
            return [], self.growths[:, :0]
        if not candidate.begins:
            return self.grown, self.growths
        if candidate.slow_s not in self._fading:
            # What was put in before the record begins is as warm as its place may be: no reading tells.
            shapes = [Shape("put in", float(t), candidate.slow_s) for t in self.onsets if t > EARLY_S]
            courses = [shape.block_means(self.edges_s) for shape in shapes]
            # A record of an hour has no such moments.
            stacked = np.stack(courses, axis=1) if courses else np.empty((len(self.edges_s) - 1, 0))
            self._fading[candidate.slow_s] = shapes, stacked
        return self._fading[candidate.slow_s]


@dataclass(frozen=True)
class Squares:
    """Of a law at size 1, nothing else known: `blocks` (sites, b), squares of its steps (i,) and other shapes (j,)."""

    blocks: Array
    steps: Array
    growths: Array

    @classmethod
    def of(cls, contest: Contest, law: Law) -> Squares:
        known: Squares | None = contest.memo.get(law)
        if known is None:
            courses, blocks = Courses.of(contest), contest.vector(law)
            gram = contest.small(blocks)[0]
            steps = _late_sums(gram)[: len(courses.onsets)]
            beyond = courses.beyond(law.candidate)[1]
            known = cls(blocks, steps, (beyond * (gram @ beyond)).sum(axis=0))
            contest.memo[law] = known
        return known


class Given:
    """Effects whose sizes are fitted along with each that is tried, `vectors` (e, sites, b)."""

    def __init__(self, contest: Contest, vectors: Array) -> None:
        flat = vectors.reshape(len(vectors), -1)
        onto = contest.gram @ flat.T
        self._onto = onto.reshape(contest.sites, contest.b, -1)
        values, axes = np.linalg.eigh(flat @ onto)
        kept = values > _KNOWN * values.max()
        self._root = axes[:, kept] / np.sqrt(values[kept])
        self._score = self._root.T @ (flat @ contest.score)

    def share(self, p: Array) -> Array:
        """(b, e): the part of a law's blocks that the given effects stand for; its square leaves the Gram matrix."""
        shared: Array = np.einsum("sbe,sb->be", self._onto, p) @ self._root
        return shared

    def score(self, share: Array) -> Array:
        """(b,) of the law's score that goes with it."""
        taken: Array = share @ self._score
        return taken


def _courses(contest: Contest) -> Courses:
    edges_s = contest.edges * contest.grid.step_s
    onsets = edges_s[: max(int(contest.b * LAST_SHARE), 1)]
    steps = np.stack([Shape("step", float(t)).block_means(edges_s) for t in onsets], axis=1)
    # Growth begins so gently that every third block is enough; `refine` looks between them.
    grown = [
        Shape(name, float(t), growth).going_on(float(edges_s[-1]))
        for name in ("ramp", "saturating")
        for growth in family(name, float(edges_s[-1]))
        for t in onsets[::3]
    ]
    growths = np.stack([shape.block_means(edges_s) for shape in grown], axis=1)
    return Courses(onsets, steps, grown, growths, edges_s)


def _late_sums(gram: Array) -> Array:
    """Squares (b,) of steps that begin with each block: sums of the lower right corners of a Gram matrix (b, b)."""
    sums: Array = np.diag(gram[::-1, ::-1].cumsum(axis=0).cumsum(axis=1))[::-1]
    return sums
