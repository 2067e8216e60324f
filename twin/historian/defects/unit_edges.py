"""Jumps of a tag that are those of a change of unit, sample by sample.

At such a jump the values, converted, go on as the tag usually does, while as they stand they leap. The odds of it are
those of the usual step against a leap of that size, less for a tag that leaps often: a fan that is switched, a valve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from twin.historian.tags import Array, Series
from twin.historian.units import Unit
from twin.quantiles import NORMAL90

WIDTHS = (1, 7, 31)
"""Samples whose median is the level beside a jump: one tells most, many where a tag is noisy, such as the wind."""
FAR = 4.0
"""Standard deviations of the usual steps within which the converted step lies, and beyond which the raw one lies."""
NEAR = 0.35
"""Share of the jump within which the converted step may lie besides: operation may step in the same minute."""
ROUNDED = 0.005
"""Share of the jump to which it is known at best: converted values are stored with two or three digits."""
REST = 5.0
"""Usual steps below which a value is at rest: its ratio to the next one says nothing."""
AROUND = 101
"""Samples by which the usual step about a time is known."""
USUAL = 0.9
"""Quantile of the absolute steps by which their standard deviation is known."""
MOST = 12
"""Edges of each direction that are kept, the most probable first."""


@dataclass(frozen=True)
class Edge:
    """A jump into a unit, or back from it: times of the samples before and after it (s since 1970) and log odds."""

    before_s: float
    after_s: float
    odds: float
    into: bool


class TagLevels:
    """Levels of a tag on either side of each of its steps, which all of its units share."""

    def __init__(self, series: Series) -> None:
        self.series = series
        self._found: dict[bool, _Levels | None] = {}

    def of(self, *, ratio: bool) -> _Levels | None:
        """Return the levels, or of a `ratio` those of logarithms of values at work; None of few samples."""
        if ratio not in self._found:
            self._found[ratio] = _Levels.of(self.series, ratio=ratio)
        return self._found[ratio]


@dataclass(frozen=True)
class _Levels:
    """Samples `x (n,)`, and by the width of the medians the levels before and after each step (n - 1,).

    Of each width also the size of the steps, the deviation of the usual ones, and `stretch`, by which a step across a
    longer interval may be larger.
    """

    time_s: Array
    x: Array
    stretch: Array
    tried: tuple[tuple[int, Array, Array, Array, float], ...]

    @classmethod
    def of(cls, series: Series, *, ratio: bool) -> _Levels | None:
        time_s, x = series.time_s, series.value
        if ratio:
            rows = _not_at_rest(x)
            time_s, x = time_s[rows], np.log(x[rows])
        if len(x) < AROUND:
            return None
        apart = np.diff(time_s)
        stretch = np.sqrt(np.maximum(apart / max(float(np.median(apart)), 1e-9), 1.0))
        tried = []
        for width in WIDTHS:
            level = median_filter(x, size=width, mode="nearest")
            before = level[np.maximum(np.arange(len(x) - 1) - width // 2, 0)]
            after = level[np.minimum(np.arange(1, len(x)) + width // 2, len(x) - 1)]
            size = np.abs(after - before)
            tried.append((width, before, after, size, max(float(np.quantile(size, USUAL)) / NORMAL90, 0.0)))
        return cls(time_s, x, stretch, tuple(tried))


def unit_edges(levels: TagLevels, own: Unit, unit: Unit) -> list[Edge]:
    """Return the jumps of a tag from the unit `own` to `unit`, and back.

    Parameters
    ----------
    levels
        Of the good samples of the tag, in the unit `own`.
    own, unit
        Unit of the dictionary and the one that the tag may change to.
    """
    ratio = own.offset == 0.0 and unit.offset == 0.0
    known = levels.of(ratio=ratio)
    if known is None:
        return []
    x, ways = known.x, [_both_ways(before, after, own, unit, ratio) for _, before, after, _, _ in known.tried]
    found: list[Edge] = []
    for way in (0, 1):
        best = np.full(len(x) - 1, -np.inf)
        where = np.arange(len(x) - 1)
        for (width, _, _, size, usual), both in zip(known.tried, ways, strict=True):
            off, jump = both[way]
            scale = np.maximum(usual * known.stretch, ROUNDED * np.maximum(jump, 1e-12))
            near = (np.abs(off) < np.maximum(FAR * scale, NEAR * jump)) & (jump > FAR * scale)
            if not near.any():
                continue
            often = float((size >= 0.5 * np.median(jump)).sum()) / width - 2.0
            rows = np.flatnonzero(near)
            wide, leap = scale[rows] ** 2, jump[rows] ** 2
            # Steps have heavy tails, as Cauchy's distribution has.
            odds = np.full(len(x) - 1, -np.inf)
            odds[rows] = 0.5 * np.log((wide + leap) / (wide + off[rows] ** 2)) - np.log(max(often, 1.0))
            if width > 1:
                where = np.where(odds > best, _at_the_leap(odds, x, width), where)
            best = np.maximum(best, odds)
        found += _highest(best, where, known.time_s, into=way == 0)
    return found


def _not_at_rest(x: Array) -> NDArray[np.intp]:
    """Return the rows with values far above their own scatter."""
    step = np.abs(np.diff(x, prepend=x[:1]))
    scatter = median_filter(step, size=AROUND, mode="nearest")
    level = median_filter(np.abs(x), size=WIDTHS[1], mode="nearest")
    return np.asarray(np.flatnonzero((x > 0.0) & (level > REST * scatter)))


def _both_ways(
    before: Array, after: Array, own: Unit, unit: Unit, ratio: bool
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return how far a jump into the unit, and one back, is off the converted level, and its size as it stands."""
    if ratio:
        jump = float(np.log(own.scale / unit.scale))
        size = np.full(len(before), abs(jump))
        return (after - before - jump, size), (after - before + jump, size)
    converted_after = (unit.scale * after + unit.offset - own.offset) / own.scale
    converted_before = (unit.scale * before + unit.offset - own.offset) / own.scale
    into = converted_after - before, np.abs(converted_after - after)
    back = after - converted_before, np.abs(converted_before - before)
    return into, back


def _at_the_leap(odds: Array, x: Array, width: int) -> NDArray[np.intp]:
    """Return of each row that has odds the one of the largest step within `width` samples."""
    at = np.arange(len(odds))
    step = np.abs(np.diff(x))
    for row in np.flatnonzero(np.isfinite(odds)).tolist():
        low = max(row - width, 0)
        at[row] = low + int(np.argmax(step[low : row + width + 1]))
    return at


def _highest(odds: Array, where: NDArray[np.intp], time_s: Array, *, into: bool) -> list[Edge]:
    """Return the most probable edges, of neighbouring ones the best."""
    found: list[Edge] = []
    taken: list[int] = []
    for row in np.argsort(-odds, kind="stable").tolist():
        if not np.isfinite(odds[row]) or len(found) >= MOST:
            break
        if any(abs(row - other) <= WIDTHS[-1] for other in taken):
            continue
        taken.append(int(row))
        at = int(where[row])
        found.append(Edge(float(time_s[at]), float(time_s[at + 1]), float(odds[row]), into))
    return found
