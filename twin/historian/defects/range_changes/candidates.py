"""Leaps of a tag to another level, which its samples show or which lie within a rest or a silence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.historian.defects.panel import SMALLEST_WORK, TagPanel, known_median, stands
from twin.historian.defects.range_changes.readings import (
    FANS,
    LEAST,
    LEAST_KPA,
    canonical,
    is_ratio,
    is_witnessed,
    law_ratio,
    least_ratio,
)
from twin.historian.tags import Array, Series
from twin.historian.units import unit_of

LEVEL = 3
"""Samples on either side of a leap whose median is the level."""
HELD = 0.6
"""Share of the leap between two samples by which the levels must differ."""
FAR = 4.0
"""Standard deviations of a tag's usual steps beyond which it leaps; they grow with the root of the time between
samples."""
USUAL = 0.9, 1.645
"""Quantile of the changes by which their standard deviation is known, and that of a normal distribution."""
LAW_S, LAW_APART = 43200.0, 0.3
"""Time on either side of a leap over which the law of a fan gives its factor: short, since other leaps may be near; and
by how much it may differ from that of the other tags, in logarithms."""
FEWEST = 100
"""Samples of a tag below which nothing is judged by them."""
MOST, MOST_HIDDEN = 100, 40
"""Leaps of a tag that are judged, the largest first, those that the samples show and those that they do not; the first
is also the most changes of range of a station."""


def splits_best(series: Series, ratio: Array, at: LeapCandidate, candidates: Sequence[LeapCandidate]) -> bool:
    """Return whether of the candidates nearby a leap of a fan's tag is the one about which its ratio to the law is two
    levels, by least absolute error."""
    time_s = series.time_s
    low, high = np.searchsorted(time_s, (time_s[at.row] - LAW_S, time_s[at.after] + LAW_S)).tolist()

    def error(one: LeapCandidate) -> float:
        sides = ratio[low : one.row + 1], ratio[one.after : high]
        return sum(float(np.nansum(np.abs(side - known_median(side)))) for side in sides)

    near = [one for one in candidates if low <= one.row and one.after < high and not _is_its_start(one, at)]
    return error(at) <= min((error(one) for one in near), default=np.inf)


def _is_its_start(one: LeapCandidate, at: LeapCandidate) -> bool:
    """Return whether a leap lies in the samples about the rest of another one: a fan that starts or stops is off its
    command."""
    return at.hidden and not one.hidden and (abs(one.row - at.after) < LEVEL or abs(at.row - one.after) < LEVEL)


@dataclass(frozen=True)
class LeapCandidate:
    """Rows of the last reading of a tag before a leap and of the first one after it; `hidden` where the tag was at rest
    or silent in between, so that its samples do not show the leap."""

    row: int
    after: int
    hidden: bool

    def sides(self, x: Array) -> tuple[float, float]:
        """Return the levels of values (n,) on either side."""
        return (
            known_median(x[max(self.row + 1 - LEVEL, 0) : self.row + 1]),
            known_median(x[self.after : self.after + LEVEL]),
        )


def leap_candidates(table: TagPanel, k: int) -> list[LeapCandidate]:
    """Return where a tag leaps to another level, the largest leap first."""
    series = table.series[k]
    if not is_witnessed(table, k) or len(series.time_s) < FEWEST:
        return []
    x, least = canonical(series), LEAST.get(unit_of(series.tag.unit).dimension, LEAST_KPA)
    if series.tag.role in FANS:
        x, least = law_ratio(table, k), least_ratio(series)
    elif is_ratio(series):
        rest = max(SMALLEST_WORK * float(np.quantile(np.abs(x), 0.95)), 1e-9)
        x, least = np.where(x > rest, np.log(np.maximum(x, rest)), np.nan), least_ratio(series)
    work = np.flatnonzero(np.isfinite(x) & ~stands(series, table.series, series.time_s))
    if len(work) < FEWEST:
        return []
    ends = np.concatenate([[0], np.cumsum(series.broken())])
    hidden = (np.diff(work) > 1) | (ends[work[1:]] > ends[work[:-1]])
    step = np.diff(x[work])
    apart = np.diff(series.time_s[work])
    usual = float(np.quantile(np.abs(step[~hidden]), USUAL[0])) / USUAL[1] if (~hidden).any() else 0.0
    stretch = np.sqrt(apart / max(float(np.median(apart)), 1e-9))
    far = np.maximum(least, 0.0 if series.tag.role in FANS else FAR * usual * stretch)
    found: list[tuple[float, LeapCandidate]] = []
    for i in np.flatnonzero(hidden | (np.abs(step) >= far)).tolist():
        at = LeapCandidate(int(work[i]), int(work[i + 1]), bool(hidden[i]))
        before, after = at.sides(x)
        if hidden[i] and abs(after - before) >= least:
            found.append((-abs(after - before), at))
        elif not hidden[i] and (after - before) * np.sign(step[i]) >= HELD * abs(step[i]):
            # On the two levels that the step joins: no spike, and no ramp.
            found.append((-abs(float(step[i])), at))
    found.sort(key=lambda one: (one[0], one[1].row))
    seen = [at for _, at in found if not at.hidden][:MOST]
    return seen + [at for _, at in found if at.hidden][:MOST_HIDDEN]
