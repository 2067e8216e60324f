"""Squares p'Gp of many time courses p (b,) of one law, with the Gram matrix G (b, b) of its blocks.

Courses of one family share most of their products with G.

Heat that fades with one time constant T is in a later block the same from each onset, but for a factor. With the course
q_t from the beginning of block t, its mean d_t in that block, and r_t = exp(-l_t / T) of the length l_t of the block,
q_tu = r_t q_{t+1,u} for u > t, and so

    s_t = d_t^2 G_tt + 2 d_t sum_{u > t} G_tu q_tu + r_t^2 s_{t+1}

All squares s_t together take as many products as G has elements, instead of as many for each.

Periodic courses of one period are sums of a few windows of it, each repeated in every period, less those of the first
period in which a course had not begun. Their squares are quadratic forms in the products of these windows.

Other courses are multiplied as they are, from the block on with which they begin.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.discovery.effects.shapes import Shape, courses_of
from twin.network import Array

PANEL = 32
"""Rows of a Gram matrix that are multiplied at once: with eight panels in 240 rows, nine sixteenths of all products are
left."""
BEGINNINGS = 8
"""Groups of courses by their first block: with eight, a fifth more is multiplied than with one for each block."""
FADING = ("pulse", "put in")
"""Shapes that decay from their onsets on."""
_WINDOWS = (1, 2, 4)
"""Windows in a phase of a period: duties are quarters of it."""
_ROUNDING = 1e-9
"""Distance from a block edge, in blocks, within which an onset is on it."""


@dataclass(frozen=True)
class CourseSquares:
    """Squares of `count` courses, as the sum of their parts; each part has the courses of one family."""

    count: int
    parts: tuple[_Fading | _Periodic | _Any, ...]

    @classmethod
    def of(cls, courses: Array, shapes: Sequence[Shape] = (), edges_s: Array | None = None) -> CourseSquares:
        """Return the squares of courses (b, j).

        Parameters:
            shapes: those of the courses, by which families are known; without them all are multiplied as they are.
            edges_s: (b + 1,) s, bounds of the blocks.
        """
        parts: list[_Fading | _Periodic | _Any] = []
        left = np.ones(courses.shape[1], dtype=bool)
        if edges_s is not None and len(shapes):
            parts = [*_fading(shapes, edges_s), *_periodic(shapes, edges_s)]
            for part in parts:
                left[part.columns.ravel()] = False
        parts += _by_beginning(courses, np.flatnonzero(left))
        return cls(courses.shape[1], tuple(parts))

    def __call__(self, gram: Array) -> Array:
        """Return the squares (j,) in a Gram matrix (b, b)."""
        found = np.zeros(self.count)
        if not self.count:
            return found
        once = gram * _twice_beyond(len(gram))
        for part in self.parts:
            found[part.columns] = part.squares(gram, once)
        return found


@dataclass(frozen=True)
class _Fading:
    """Courses (j,) that fade from the beginnings of blocks on.

    `own` (b, b) are the weights of G in the first two terms of s, `reach` (j, b) the factors by which these terms of
    each later block are in the square of a course.
    """

    columns: NDArray[np.intp]
    own: Array
    reach: Array

    def squares(self, gram: Array, _: Array) -> Array:
        """Return the squares (j,) of the courses."""
        found: Array = self.reach @ np.einsum("tu,tu->t", gram, self.own)
        return found


def _fading(shapes: Sequence[Shape], edges_s: Array) -> list[_Fading]:
    """Return the parts of fading courses that begin with a block, one for each time constant."""
    begins, starts = {float(t): i for i, t in enumerate(edges_s[:-1])}, edges_s[:-1]
    families: dict[float, list[int]] = {}
    for i, shape in enumerate(shapes):
        if shape.name in FADING and shape.onset_s in begins:
            families.setdefault(shape.growth_s, []).append(i)
    found = []
    for growth_s, those in families.items():
        courses = courses_of([Shape(FADING[0], float(t), growth_s) for t in starts], edges_s)
        first = np.diag(courses)
        own = 2.0 * first[:, None] * np.triu(courses, 1) + np.diag(first**2)
        since = starts - np.array([shapes[i].onset_s for i in those])[:, None]
        reach = np.where(since >= 0.0, np.exp(-2.0 * np.maximum(since, 0.0) / max(growth_s, 1.0)), 0.0)
        found.append(_Fading(np.array(those), own, reach))
    return found


@dataclass(frozen=True)
class _Periodic:
    """Courses of p periods (p, j), each of the same windows: `columns` (p, j).

    `windows` (b, p, n) recur in every period; `first` (h, p, f) are those of the first period alone, which end before
    row h. `sums` (n + f, j) has the windows of each course.
    """

    columns: NDArray[np.intp]
    windows: Array
    first: Array
    sums: Array

    def squares(self, _: Array, once: Array) -> Array:
        """Return the squares (p, j) of the courses."""
        w, f = self.windows, self.first
        (b, p, n), high = w.shape, len(f)
        flat, begun = w.reshape(b, p * n), f.reshape(high, -1)
        pulled, pulled_first = np.empty((b, p * n)), np.empty((high, begun.shape[1]))
        for low in range(0, b, PANEL):
            pulled[low : low + PANEL] = once[low : low + PANEL, low:] @ flat[low:]
        for low in range(0, high, PANEL):
            pulled_first[low : low + PANEL] = once[low : min(low + PANEL, high), low:high] @ begun[low:]
        own, early = pulled.reshape(w.shape).swapaxes(0, 1), pulled_first.reshape(f.shape).swapaxes(0, 1)
        left, left_first = w.transpose(1, 2, 0), f.transpose(1, 2, 0)
        products = np.empty((p, len(self.sums), len(self.sums)))
        products[:, :n, :n] = left @ own
        products[:, :n, n:] = left[:, :, :high] @ early
        products[:, n:, :n] = left_first @ own[:, :high]
        products[:, n:, n:] = left_first @ early
        found: Array = np.einsum("mj,pmj->pj", self.sums, products @ self.sums)
        return found


def _periodic(shapes: Sequence[Shape], edges_s: Array) -> list[_Periodic]:
    """Return the parts of periodic courses whose windows are fewer than they are."""
    periods: dict[float, list[int]] = {}
    for i, shape in enumerate(shapes):
        if shape.name == "periodic" and shape.into_s == 0.0:
            periods.setdefault(shape.growth_s, []).append(i)
    alike: dict[tuple[int, tuple[tuple[int, int], ...]], list[list[int]]] = {}
    for period_s, those in periods.items():
        onset, duty = np.array([(shapes[i].onset_s / period_s, shapes[i].duty) for i in those]).T
        phases = len(np.unique(onset.round(9)))
        for count in (phases * more for more in _WINDOWS):
            begins, lasts = onset * count, duty * count
            whole = (
                np.abs(begins - begins.round()).max() < _ROUNDING and np.abs(lasts - lasts.round()).max() < _ROUNDING
            )
            if whole and count < len(those) and begins.max() < count:
                spans = tuple(zip(begins.round().astype(int).tolist(), lasts.round().astype(int).tolist(), strict=True))
                alike.setdefault((count, spans), []).append(those)
                break
    return [_windows(shapes, edges_s, count, spans, groups) for (count, spans), groups in alike.items()]


def _windows(
    shapes: Sequence[Shape], edges_s: Array, count: int, spans: tuple[tuple[int, int], ...], groups: list[list[int]]
) -> _Periodic:
    """Return the part of the courses of some periods, each of `count` windows: `spans` are the first window of each
    course and the number of its windows.
    """
    early = max(max(begin + last for begin, last in spans) - count, 0)
    sums = np.zeros((count + early, len(spans)))
    for j, (begin, last) in enumerate(spans):
        for window in range(begin, begin + last):
            sums[window % count, j] += 1.0
            if window >= count:  # in the first period the course had not begun yet
                sums[window, j] -= 1.0
    widths = [shapes[those[0]].growth_s / count for those in groups]
    recurring = [Shape("periodic", k * w, count * w, 1.0 / count) for w in widths for k in range(count)]
    single = [Shape("transient", k * w, w) for w in widths for k in range(early)]
    b, p = len(edges_s) - 1, len(groups)
    windows = np.ascontiguousarray(courses_of(recurring, edges_s).T).reshape(b, p, count)
    first = np.ascontiguousarray(courses_of(single, edges_s).T).reshape(b, p, early)
    # Whole panels, as what is above a panel's rows is multiplied twice.
    high = int(np.flatnonzero(first.any(axis=(1, 2))).max(initial=-1)) + 1
    return _Periodic(np.array(groups), windows, first[: min(-(-high // PANEL) * PANEL, b)], sums)


@dataclass(frozen=True)
class _Any:
    """Courses of any form, `begun` (b - low, j), that begin with the block `low` or later."""

    columns: NDArray[np.intp]
    low: int
    begun: Array

    def squares(self, _: Array, once: Array) -> Array:
        """Return the squares (j,) of the courses."""
        first, squares = self.low, np.zeros(len(self.columns))
        # Squares on the diagonal stand where those of the whole matrix do, whatever row the courses begin with.
        for row in range(first - first % PANEL, len(once), PANEL):
            low, high = max(row, first), row + PANEL
            squares += np.einsum(
                "bj,bj->j", self.begun[low - first : high - first], once[low:high, low:] @ self.begun[low - first :]
            )
        return squares


def _by_beginning(courses: Array, which: NDArray[np.intp]) -> list[_Any]:
    """Return some of the courses (b, j) by the eighth of the blocks with which they begin."""
    b, those = len(courses), courses[:, which]
    begins = np.where(those.any(axis=0), (those != 0.0).argmax(axis=0), b)
    eighth = begins * BEGINNINGS // b
    found = []
    for one in range(BEGINNINGS):
        columns = np.flatnonzero(eighth == one)
        if len(columns):
            first = int(begins[columns].min())
            found.append(_Any(which[columns], first, np.ascontiguousarray(those[first:, columns])))
    return found


@functools.cache
def _twice_beyond(b: int) -> Array:
    """Return weights (b, b) of a symmetric matrix: 2 to the right of its diagonal panels, 0 to the left, 1 on them."""
    panel = np.arange(b) // PANEL
    weights: Array = 1.0 + np.sign(panel - panel[:, None])
    return weights
