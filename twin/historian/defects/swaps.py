"""Pairs of tags whose values were exchanged for a time.

The difference of the two is predicted from the plant's other tags. In a swap the difference has the opposite sign of
its prediction. Two kinds of evidence must agree: over the span the sign is reversed (a sum of log likelihood
ratios), and the changes of the difference within a day go against those of its prediction. The second does not
depend on drifts of the thermometers or of the plant, which look like a swap to the first. A maintenance entry that
names both tags about the time of an edge lowers the thresholds; it is never enough.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.defects.panel import (
    BASIN,
    STEP_S,
    RobustPredictor,
    TagPanel,
    basin_inflows,
    design_matrix,
    largest_sum,
    moving_mean,
    panel,
    stands,
)
from twin.historian.events import Event, naming
from twin.historian.tags import Array, Defect, Mask, Series
from twin.historian.units import unit_of

LEAST_S = 12.0 * 3600.0
CAP = 1.0
"""Largest evidence of a row of a quarter of an hour: an outlier is none for a swap that lasts."""
LEAST_EVIDENCE, LEAST_EVIDENCE_NAMED = 60.0, 15.0
"""Sum of evidence; an hour of clear contradiction gives 4. With a maintenance entry that names both tags the second."""
AGAINST, AGAINST_NAMED = -0.4, -0.15
"""Correlation of changes inside the span; outside it must be as far on the other side."""
BEYOND = 3.0
"""Standard errors by which the changes inside must go against the predicted ones: a thousand to one, as many as there
are pairs and spans of a station."""
DAY_S = 86400.0
ROUNDS = 4
LEAST_ROWS = 8
"""Rows (two hours) of the shortest span that is looked at."""
AROUND_ROWS = 2000
"""Rows (three weeks) on either side of a swap from which its edges are refined."""
JUMP_ROWS = 4
"""Least rows (an hour) between two jumps; the level on either side of one is the mean of a row more."""
NEAR_ROWS = 144
"""Rows (a day and a half) about a jump in which every edge is tried."""
MOST_EDGES = 40
MOST, MOST_PAIRS = 3, 6
"""Swaps of a pair in a record, and pairs that were swapped."""


def swapped(series: Sequence[Series], events: Sequence[Event] = (), before: Sequence[Defect] = ()) -> list[Defect]:
    """Return the pairs of temperatures or flows that carry each other's values, and from when to when.

    A swapped pair reverses the prediction of the pairs beside it, too. So the pair of most evidence, of those that an
    entry names first, is exchanged back before the others are judged.

    Parameters
    ----------
    series
        Samples in which the swaps `before` are undone.
    events
        Entries of maintenance.
    before
        Swaps that were found when the series held more of the witnesses; their pairs are not exchanged again.
    """
    found: list[Defect] = []
    for _ in range(MOST_PAIRS):
        table = panel(series)
        if len(table.series) < 3 or len(table.grid_s) < 200:
            break
        hits = []
        for j, k in itertools.combinations(range(len(table.series)), 2):
            names = {table.series[j].tag.name, table.series[k].tag.name}
            # A pair that was exchanged back once is not exchanged again.
            again = any(names == set(one.tags) for one in (*before, *found))
            if not again and _exchangeable(table.series[j], table.series[k]):
                hits += _pair(table, j, k, events)
        if not hits:
            break
        most = max(hits, key=lambda one: (bool(one.entries), one.evidence))
        of_pair = [one.defect for one in hits if one.defect.tags == most.defect.tags]
        found += of_pair
        for defect in of_pair:
            series = undo_swap(series, defect)
    return found


def undo_swap(series: Sequence[Series], defect: Defect) -> list[Series]:
    """Return the series with the samples of the pair exchanged inside the defect."""
    by_name = {one.tag.name: one for one in series}
    first, second = (by_name[name] for name in defect.tags)
    other = {first.tag.name: second, second.tag.name: first}
    return [_exchanged(one, other[one.tag.name], defect) if one.tag.name in other else one for one in series]


def _exchanged(own: Series, other: Series, defect: Defect) -> Series:
    """Return the own samples outside, and those of the other tag, in the own unit, inside the defect."""
    outside = (own.time_s < defect.start_s) | (own.time_s > defect.end_s)
    inside = (other.time_s >= defect.start_s) & (other.time_s <= defect.end_s)
    theirs, ours = unit_of(other.tag.unit), unit_of(own.tag.unit)
    value = (theirs.scale * other.value[inside] + theirs.offset - ours.offset) / ours.scale
    time_s = np.append(own.time_s[outside], other.time_s[inside])
    order = np.argsort(time_s, kind="stable")
    holes = np.concatenate([_clipped(own.holes, defect, inside=False), _clipped(other.holes, defect, inside=True)])
    return replace(
        own,
        time_s=time_s[order],
        value=np.append(own.value[outside], value)[order],
        quality=np.append(own.quality[outside], other.quality[inside])[order],
        holes=np.concatenate([holes, [[defect.start_s, defect.start_s], [defect.end_s, defect.end_s]]]),
    )


def _clipped(holes: Array, defect: Defect, *, inside: bool) -> Array:
    """Return the holes, each as a whole, that lie (by their middle) inside or outside the defect."""
    middle = holes.mean(axis=1) if len(holes) else np.zeros(0)
    within = (middle >= defect.start_s) & (middle <= defect.end_s)
    return np.asarray(holes[within if inside else ~within])


def _exchangeable(first: Series, second: Series) -> bool:
    """Return whether two tags are of one dimension and at places between which terminals are exchanged."""
    dimension = unit_of(first.tag.unit).dimension
    if dimension not in ("temperature", "mass flow") or unit_of(second.tag.unit).dimension != dimension:
        return False
    if first.tag.cell is None or second.tag.cell is None:
        return False
    return first.tag.role == second.tag.role or first.tag.cell == second.tag.cell


@dataclass(frozen=True)
class _Hit:
    """A swap with its evidence, a log likelihood ratio, the maintenance entries that name it, and its rows of the
    table."""

    defect: Defect
    evidence: float
    entries: tuple[Event, ...]
    low: int
    high: int


def _pair(table: TagPanel, j: int, k: int, events: Sequence[Event]) -> list[_Hit]:
    """Return the swaps of a pair."""
    first, second = table.series[j].tag, table.series[k].tag
    drivers = [
        i
        for i, one in enumerate(table.series)
        if i not in (j, k)
        and one.tag.cell in (None, first.cell, second.cell)
        and unit_of(one.tag.unit).dimension not in ("angle", "state")
    ]
    values = table.values[drivers]
    if BASIN in (first.role, second.role):
        values = np.concatenate([values, basin_inflows(table, (j, k))])
    predict = RobustPredictor(design_matrix(values))
    difference = _in_water(table, j) - _in_water(table, k)
    if np.isfinite(difference).sum() < 200:
        return []
    found: list[_Hit] = []
    sign = np.ones(len(difference))
    for _ in range(MOST):
        hit = _judged(table, (j, k), sign, predict, events)
        if hit is None:
            break
        found.append(hit)
        sign[hit.low : hit.high] *= -1.0
        # An entry is of one exchange: it supports no further one.
        events = [one for one in events if one not in hit.entries]
    return found


def _in_water(table: TagPanel, k: int) -> Array:
    """Return the values of a tag (m,), NaN where its cell stands: no other tag follows a thermometer in standing water,
    which is no evidence of an exchange and shows no edge of one."""
    one = table.series[k]
    return np.where(stands(one, table.series, table.grid_s), np.nan, table.values[k])


def _judged(
    table: TagPanel, pair: tuple[int, int], sign: Array, predict: RobustPredictor, events: Sequence[Event]
) -> _Hit | None:
    """Return the first span of a swap that both kinds of evidence support; None without one.

    Levels are tried first: they give the sharper edges. Changes within a day follow, for pairs that drift against one
    another by more than they differ; alone they need a maintenance entry.
    """
    tags = table.series[pair[0]].tag.name, table.series[pair[1]].tag.name
    values = [_in_water(table, k) for k in pair]
    now, other = (np.where(sign > 0.0, one, two) for one, two in (values, values[::-1]))
    difference = now - other
    for daily in (False, True):
        span = _span(difference, predict, daily=daily)
        if span is None:
            continue
        low, high = span.low, span.high
        if span.correlation(low, high) <= AGAINST_NAMED and span.evidence >= LEAST_EVIDENCE_NAMED:
            for reach in (AROUND_ROWS, NEAR_ROWS):
                low, high = span.moved(low, high, *_refined(difference, predict.matrix, low, high, reach))
        start, end = float(table.grid_s[low]), float(table.grid_s[high - 1])
        entries = (*naming(events, tags, start), *naming(events, tags, end))
        least, against = (LEAST_EVIDENCE_NAMED, AGAINST_NAMED) if entries else (LEAST_EVIDENCE, AGAINST)
        long_enough = LEAST_S <= end - start <= 0.6 * (table.grid_s[-1] - table.grid_s[0])
        inside, outside = span.correlation(low, high), span.correlation(low, high, outside=True)
        if span.evidence < least or inside > against or outside < -against or not long_enough:
            continue
        # Of short spans many pairs have such a correlation by chance, such as two cells that stand.
        if not entries and inside > -_chance(high - low, BEYOND):
            continue
        alone = daily or not (_better(now, other, predict, low, high) and _better(other, now, predict, low, high))
        if alone and not entries:
            continue
        if not entries and _least_without_one(difference, predict.matrix, low, high) < LEAST_EVIDENCE_NAMED:
            continue
        entry = "; a maintenance entry names both" if entries else ""
        says = f"{tags[0]} and {tags[1]} carry each other's values for {(end - start) / DAY_S:.1f} days"
        says += f" (log likelihood ratio {span.evidence:.0f}{entry})"
        return _Hit(Defect("swap", tags, start, end, says, "exchanged"), span.evidence, entries, low, high)
    return None


def _least_without_one(difference: Array, matrix: Array, low: int, high: int) -> float:
    """Return the least evidence of a span that is left without one of the witnesses, columns of `matrix (m, k)`.

    A witness that is faulty itself reverses the prediction of a right pair; the others then do not.
    """
    mask = np.ones(len(difference))
    mask[low:high] = -1.0
    least = np.inf
    for column in range(1, matrix.shape[1]):
        predicted, sigma = RobustPredictor(np.delete(matrix, column, axis=1))(difference * mask)
        gain = np.nan_to_num(-2.0 * difference[low:high] * predicted[low:high] / sigma**2)
        least = min(least, float(np.clip(gain, -CAP, CAP).sum()))
    return least


def _better(own: Array, theirs: Array, predict: RobustPredictor, low: int, high: int) -> bool:
    """Return whether a tag's prediction goes better with the other tag's values inside the span than with its own.

    In a swap it does for both. A single faulty tag reverses the difference too, but its partner keeps its own place.
    """
    exchanged = own.copy()
    exchanged[low:high] = theirs[low:high]
    predicted, _ = predict(exchanged)
    inside = slice(low, high)
    ours, others = (float(np.nansum(np.abs(value[inside] - predicted[inside]))) for value in (own, theirs))
    return ours > others


@dataclass(frozen=True)
class _Span:
    """Most probable span of a swap, its evidence, and the changes within a day beside the predicted ones."""

    low: int
    high: int
    evidence: float
    changes: Array
    wanted: Array

    def correlation(self, low: int, high: int, *, outside: bool = False) -> float:
        """Return the correlation of the changes with the predicted ones inside or outside the rows."""
        inside = np.zeros(len(self.changes), dtype=bool)
        inside[low:high] = True
        known = np.isfinite(self.changes) & np.isfinite(self.wanted)
        return _correlation(self.changes, self.wanted, known & (~inside if outside else inside))

    def moved(self, low: int, high: int, new_low: int, new_high: int) -> tuple[int, int]:
        """Return the new edges, or the old one where the changes of the rows between the two speak against a move."""
        if new_high - new_low < LEAST_ROWS:
            return low, high
        if self._right(new_low, low) if new_low < low else self._exchanged(low, new_low):
            new_low = low
        if self._right(high, new_high) if new_high > high else self._exchanged(new_high, high):
            new_high = high
        # One edge alone may have moved beyond the other.
        return (new_low, new_high) if new_high - new_low >= LEAST_ROWS else (low, high)

    def _right(self, low: int, high: int) -> bool:
        """Return whether the changes between two rows go with the predicted ones, beyond chance."""
        return self.correlation(low, high) > _chance(high - low)

    def _exchanged(self, low: int, high: int) -> bool:
        """Return whether the changes between two rows go against the predicted ones, beyond chance."""
        return self.correlation(low, high) < -_chance(high - low)


def _chance(rows: int, errors: float = 2.0) -> float:
    """Return standard errors of a correlation of hourly values: a fan's or a load's changes last an hour."""
    return errors / float(np.sqrt(max(rows / 4.0, 1.0)))


def _span(difference: Array, predict: RobustPredictor, *, daily: bool) -> _Span | None:
    """Return the most probable swap, by the levels or by the changes within a day."""
    mask = np.ones(len(difference))
    low, high, total, predicted = 0, 0, 0.0, difference
    half = round(0.5 * DAY_S / STEP_S)
    changes = difference - moving_mean(difference, half)
    for _ in range(ROUNDS):
        predicted, sigma = predict(difference * mask)
        wanted = predicted - moving_mean(predicted, half)
        # log p(now | swapped) - log p(now | not) of a normal error
        gain = np.nan_to_num(-2.0 * (changes * wanted if daily else difference * predicted) / sigma**2)
        low, high, total = largest_sum(np.clip(gain, -CAP, CAP))
        again = np.ones(len(difference))
        again[low:high] = -1.0
        if np.array_equal(again, mask):
            break
        mask = again
    if high - low < LEAST_ROWS:
        return None
    return _Span(low, high, total, changes, predicted - moving_mean(predicted, half))


def _refined(difference: Array, matrix: Array, low: int, high: int, most: int) -> tuple[int, int]:
    """Return begin and end of a swap with which the prediction errs least.

    A swap begins and ends with a jump. So the rows of the largest jumps, at most `most` rows from the old
    edges, are tried as edges, one edge at a time.
    """
    first, last = max(low - AROUND_ROWS, 0), min(high + AROUND_ROWS, len(difference))
    x, predict = difference[first:last], RobustPredictor(matrix[first:last])
    filled = np.where(np.isfinite(x), x, 0.0)
    nearby = np.minimum(np.abs(np.arange(first, last) - low), np.abs(np.arange(first, last) - high)) <= most
    before, after = moving_mean(x, JUMP_ROWS // 2)[: -JUMP_ROWS - 1], moving_mean(x, JUMP_ROWS // 2)[JUMP_ROWS + 1 :]
    jump = np.nan_to_num(np.abs(after - before))
    edges = [0, len(x)] if most >= AROUND_ROWS else []
    for row in np.argsort(jump)[::-1]:
        edge = int(row) + JUMP_ROWS // 2 + 1
        if len(edges) >= MOST_EDGES:
            break
        if nearby[min(edge, len(x) - 1)] and all(abs(edge - other) > JUMP_ROWS for other in edges):
            edges.append(edge)
    edges += [low - first, high - first]
    scale = max(float(np.median(np.abs(filled - np.median(filled)))), 1e-3)

    def error(begin: int, end: int) -> float:
        y = x.copy()
        y[begin:end] *= -1.0
        predicted, _ = predict(y)
        return float(np.nansum(np.minimum(np.abs(y - predicted), 2.0 * scale)))

    begin, end = low - first, high - first
    for _ in range(2):
        begin = min((edge for edge in edges if edge < end), key=lambda edge: error(edge, end))
        end = min((edge for edge in edges if edge > begin), key=lambda edge: error(begin, edge))
    for step, reach in ((NEAR_ROWS // 24, NEAR_ROWS), (1, NEAR_ROWS // 24)):
        begin = min(
            range(max(begin - reach, 0), min(begin + reach, end - 1) + 1, step), key=lambda edge: error(edge, end)
        )
        end = min(
            range(max(end - reach, begin + 1), min(end + reach, len(x)) + 1, step), key=lambda edge: error(begin, edge)
        )
    return begin + first, end + first


def _correlation(x: Array, y: Array, rows: Mask) -> float:
    """Return the correlation of bounded values; 0 where there are few."""
    if rows.sum() < 24:
        return 0.0
    u, v = _bounded(x[rows]), _bounded(y[rows])
    if u.std() == 0.0 or v.std() == 0.0:
        return 0.0
    return float(np.corrcoef(u, v)[0, 1])


def _bounded(x: Array) -> Array:
    limit = 3.0 * float(np.median(np.abs(x - np.median(x)))) + 1e-12
    return np.asarray(np.clip(x - np.median(x), -limit, limit))
