"""Pairs of tags whose values were exchanged for a time.

Each tag is predicted from the others of its cell and station. In a swap each of the two follows the prediction of the
other one. The span with the largest sum of evidence is the swap; the evidence of an hour counts once, since errors of
minutes are correlated.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.historian.tags import Array, Defect, Series, longest_interval_s
from twin.historian.units import unit_of

STEP_S = 600.0
BLOCK = 6
LEAST_S = 12.0 * 3600.0
LEAST_EVIDENCE = 60.0
"""Sum of log likelihood ratios by the hour; a quiet record of a year reaches about 15."""
CAP = 12.0
"""Largest evidence of an hour: an outlier is none for a swap that lasts."""
ROUNDS = 4


def swapped(series: Sequence[Series]) -> list[Defect]:
    """Return the pairs of temperatures or flows that carry each other's values, and from when to when."""
    usable = [one for one in series if len(one.time_s) > 100]
    if len(usable) < 3:
        return []
    grid = np.arange(max(one.time_s[0] for one in usable), min(one.time_s[-1] for one in usable), STEP_S)
    if len(grid) < 10 * BLOCK:
        return []
    values = {one.tag.name: _on(one, grid) for one in usable}
    found: list[Defect] = []
    for first, second in itertools.combinations(usable, 2):
        if not _exchangeable(first, second):
            continue
        span = _span(first, second, usable, values, grid)
        if span is not None:
            start, end, evidence = span
            names = (first.tag.name, second.tag.name)
            days = (end - start) / 86400.0
            says = f"{names[0]} and {names[1]} carry each other's values for {days:.1f} days"
            found.append(
                Defect("swap", names, start, end, f"{says} (log likelihood ratio {evidence:.0f})", "exchanged")
            )
    return _strongest(found)


def undo_swap(series: Sequence[Series], defect: Defect) -> list[Series]:
    """Return the series with the samples of the pair exchanged inside the defect."""
    by_name = {one.tag.name: one for one in series}
    first, second = (by_name[name] for name in defect.tags)
    return [
        _exchanged(first, second, defect)
        if one is first
        else _exchanged(second, first, defect)
        if one is second
        else one
        for one in series
    ]


def _exchanged(own: Series, other: Series, defect: Defect) -> Series:
    """Return the own samples outside, and those of the other tag, in the own unit, inside the defect."""
    outside = (own.time_s < defect.start_s) | (own.time_s > defect.end_s)
    inside = (other.time_s >= defect.start_s) & (other.time_s <= defect.end_s)
    theirs, ours = unit_of(other.tag.unit), unit_of(own.tag.unit)
    value = (theirs.scale * other.value[inside] + theirs.offset - ours.offset) / ours.scale
    time_s = np.append(own.time_s[outside], other.time_s[inside])
    order = np.argsort(time_s, kind="stable")
    return replace(
        own,
        time_s=time_s[order],
        value=np.append(own.value[outside], value)[order],
        quality=np.append(own.quality[outside], other.quality[inside])[order],
    )


def _exchangeable(first: Series, second: Series) -> bool:
    """Return whether two tags are of one dimension and at places between which terminals are exchanged."""
    dimension = unit_of(first.tag.unit).dimension
    if dimension not in ("temperature", "mass flow") or unit_of(second.tag.unit).dimension != dimension:
        return False
    if first.tag.cell is None or second.tag.cell is None:
        return False
    return first.tag.role == second.tag.role or first.tag.cell == second.tag.cell


def _on(series: Series, grid: Array) -> Array:
    unit = unit_of(series.tag.unit)
    return np.asarray(unit.scale * series.at(grid, 1.2 * longest_interval_s(series)) + unit.offset)


def _span(
    first: Series, second: Series, usable: Sequence[Series], values: dict[str, Array], grid: Array
) -> tuple[float, float, float] | None:
    """Return begin, end and evidence of the swap of a pair, or None."""
    x, y = values[first.tag.name], values[second.tag.name]
    drivers_x, drivers_y = (_drivers(one, first, second, usable, values) for one in (first, second))
    exchanged = np.zeros(len(grid), dtype=bool)
    best: tuple[int, int, float] | None = None
    for _ in range(ROUNDS):
        u, v = np.where(exchanged, y, x), np.where(exchanged, x, y)
        predicted_x, sigma_x = _predicted(u, drivers_x)
        predicted_y, sigma_y = _predicted(v, drivers_y)
        as_is = ((x - predicted_x) / sigma_x) ** 2 + ((y - predicted_y) / sigma_y) ** 2
        other = ((y - predicted_x) / sigma_x) ** 2 + ((x - predicted_y) / sigma_y) ** 2
        gain = np.clip(np.nan_to_num(0.5 * (as_is - other)), -CAP, CAP) / BLOCK
        low, high, total = _largest_sum(gain)
        now = np.zeros(len(grid), dtype=bool)
        now[low:high] = True
        best = low, high, total
        if np.array_equal(now, exchanged):
            break
        exchanged = now
    assert best is not None
    low, high, total = best
    start, end = float(grid[low]), float(grid[high - 1])
    long_enough = LEAST_S <= end - start <= 0.6 * (grid[-1] - grid[0])
    return (start, end, total) if total >= LEAST_EVIDENCE and long_enough else None


def _drivers(of: Series, first: Series, second: Series, usable: Sequence[Series], values: dict[str, Array]) -> Array:
    """Return what predicts a tag (m, k): the measured tags of its cell and of the station, but for the pair."""
    chosen = [
        values[one.tag.name]
        for one in usable
        if one is not first
        and one is not second
        and one.tag.cell in (None, of.tag.cell)
        and unit_of(one.tag.unit).dimension not in ("angle", "state")
    ]
    stack = np.stack([np.ones(len(values[of.tag.name])), *chosen], axis=1)
    return stack


def _predicted(target: Array, drivers: Array) -> tuple[Array, float]:
    """Return the ridge regression of the target on its drivers, robust to outliers, and its scatter."""
    scale = np.nanstd(drivers, axis=0)
    scale[0] = 1.0
    use = np.isfinite(scale) & (scale > 0.0) & (np.isfinite(drivers).mean(axis=0) > 0.7)
    use[0] = True
    centre = np.nanmean(drivers[:, use], axis=0)
    centre[0] = 0.0
    a = np.nan_to_num((drivers[:, use] - centre) / scale[use])
    rows = np.isfinite(target)
    weight = rows.astype(float)
    predicted, sigma = np.zeros(len(target)), 1.0
    for _ in range(4):
        w = weight[rows]
        left = (a[rows] * w[:, None]).T @ a[rows] + 1e-3 * len(w) * np.eye(a.shape[1])
        predicted = a @ np.linalg.solve(left, (a[rows] * w[:, None]).T @ target[rows])
        off = np.abs(target - predicted)
        sigma = max(1.4826 * float(np.nanmedian(off)), 1e-3)
        weight = np.where(rows, np.minimum(1.0, 2.0 * sigma / np.maximum(off, 1e-9)), 0.0)
    return predicted, sigma


def _largest_sum(gain: Array) -> tuple[int, int, float]:
    """Return begin, end and value of the run with the largest sum (Kadane's algorithm)."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    low = int(np.argmin(total[: end + 1]))
    return low, max(end, low + 1), float(total[end] - total[low])


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
