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
from dataclasses import replace

import numpy as np

from twin.historian.defects.panel import Mask, Panel, design_matrix, largest_sum, moving_mean, robust_prediction
from twin.historian.events import Event, naming
from twin.historian.tags import Array, Defect, Series
from twin.historian.units import unit_of

LEAST_S = 12.0 * 3600.0
CAP = 1.0
"""Largest evidence of a row of a quarter of an hour: an outlier is none for a swap that lasts."""
LEAST_EVIDENCE, LEAST_EVIDENCE_NAMED = 60.0, 15.0
"""Sum of evidence; an hour of clear contradiction gives 4. With a maintenance entry that names both tags the second."""
AGAINST, AGAINST_NAMED = -0.4, -0.15
"""Correlation of changes inside the span; outside it must be as far on the other side."""
DAY_S = 86400.0
ROUNDS = 4
AROUND_ROWS = 2000
"""Rows (three weeks) on either side of a swap from which its edges are refined."""
JUMP_ROWS = 4
NEAR_ROWS = 144
"""Rows (a day and a half) about a jump in which every edge is tried."""
MOST_EDGES = 40
MOST = 3
"""Swaps of a pair in a record."""


def swapped(panel: Panel, events: Sequence[Event] = ()) -> list[Defect]:
    """Return the pairs of temperatures or flows that carry each other's values, and from when to when."""
    if len(panel.series) < 3 or len(panel.grid_s) < 200:
        return []
    found: list[Defect] = []
    for j, k in itertools.combinations(range(len(panel.series)), 2):
        if _exchangeable(panel.series[j], panel.series[k]):
            found += _pair(panel, j, k, events)
    return _strongest(found)


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


def _pair(panel: Panel, j: int, k: int, events: Sequence[Event]) -> list[Defect]:
    """Return the swaps of a pair."""
    first, second = panel.series[j].tag, panel.series[k].tag
    drivers = [
        i for i, one in enumerate(panel.series)
        if i not in (j, k) and one.tag.cell in (None, first.cell, second.cell)
        and unit_of(one.tag.unit).dimension not in ("angle", "state")
    ]  # fmt: skip
    matrix = design_matrix(panel.values[drivers])
    difference = panel.values[j] - panel.values[k]
    if np.isfinite(difference).sum() < 200:
        return []
    found: list[Defect] = []
    sign = np.ones(len(difference))
    for _ in range(MOST):
        span = _span(difference, sign, matrix)
        if span is None:
            break
        low, high, evidence, inside, outside = span
        if inside <= AGAINST_NAMED and evidence >= LEAST_EVIDENCE_NAMED:
            low, high = _refined(difference * sign, matrix, low, high)
        start, end = float(panel.grid_s[low]), float(panel.grid_s[high - 1])
        tags = (first.name, second.name)
        named = bool(naming(events, tags, start) or naming(events, tags, end))
        least, against = (LEAST_EVIDENCE_NAMED, AGAINST_NAMED) if named else (LEAST_EVIDENCE, AGAINST)
        long_enough = LEAST_S <= end - start <= 0.6 * (panel.grid_s[-1] - panel.grid_s[0])
        if evidence < least or inside > against or outside < -against or not long_enough:
            break
        entry = "; a maintenance entry names both" if named else ""
        says = f"{first.name} and {second.name} carry each other's values for {(end - start) / DAY_S:.1f} days"
        repair = "exchanged"
        found.append(Defect("swap", tags, start, end, f"{says} (log likelihood ratio {evidence:.0f}{entry})", repair))
        sign[low:high] *= -1.0
    return found


def _span(difference: Array, sign: Array, matrix: Array) -> tuple[int, int, float, float, float] | None:
    """Return begin, end, evidence of the most probable swap, and the correlation of changes inside and outside."""
    mask = np.ones(len(difference))
    low, high, total, predicted = 0, 0, 0.0, difference
    width = round(DAY_S / 900.0)
    for _ in range(ROUNDS):
        predicted, sigma = robust_prediction(difference * sign * mask, matrix)
        now = difference * sign
        # log p(now | swapped) - log p(now | not) of a normal error
        gain = np.nan_to_num(-2.0 * now * predicted / sigma**2)
        low, high, total = largest_sum(np.clip(gain, -CAP, CAP))
        again = np.ones(len(difference))
        again[low:high] = -1.0
        if np.array_equal(again, mask):
            break
        mask = again
    if high - low < 8:
        return None
    now = difference * sign
    changes, wanted = now - moving_mean(now, width), predicted - moving_mean(predicted, width)
    rows = np.isfinite(changes) & np.isfinite(wanted)
    inside = np.zeros(len(now), dtype=bool)
    inside[low:high] = True
    return low, high, total, _correlation(changes, wanted, rows & inside), _correlation(changes, wanted, rows & ~inside)


def _refined(difference: Array, matrix: Array, low: int, high: int) -> tuple[int, int]:
    """Return begin and end of a swap with which the prediction errs least.

    A swap begins and ends with a jump. So the rows of the largest jumps are tried as edges, one edge at a time.
    """
    first, last = max(low - AROUND_ROWS, 0), min(high + AROUND_ROWS, len(difference))
    x, a = difference[first:last], matrix[first:last]
    filled = np.where(np.isfinite(x), x, 0.0)
    before, after = moving_mean(x, JUMP_ROWS)[: -JUMP_ROWS - 1], moving_mean(x, JUMP_ROWS)[JUMP_ROWS + 1 :]
    jump = np.nan_to_num(np.abs(after - before))
    edges = [0, len(x)]
    for row in np.argsort(jump)[::-1]:
        edge = int(row) + JUMP_ROWS // 2 + 1
        if len(edges) >= MOST_EDGES:
            break
        if all(abs(edge - other) > JUMP_ROWS for other in edges):
            edges.append(edge)
    edges += [low - first, high - first]
    scale = max(float(np.median(np.abs(filled - np.median(filled)))), 1e-3)

    def error(begin: int, end: int) -> float:
        y = x.copy()
        y[begin:end] *= -1.0
        predicted, _ = robust_prediction(y, a)
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


def _strongest(found: list[Defect]) -> list[Defect]:
    """Return the swaps without those that share a tag and time with a longer one."""
    left: list[Defect] = []
    for one in sorted(found, key=lambda d: -(d.end_s - d.start_s)):
        clash = any(
            set(one.tags) & set(other.tags) and one.start_s < other.end_s and other.start_s < one.end_s
            for other in left
        )
        if not clash:
            left.append(one)
    return left
