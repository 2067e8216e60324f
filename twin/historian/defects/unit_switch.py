"""Tags that change their unit in the middle of the record.

Two things must come together. At the switch the level steps by the ratio of two units (or to the value that the other
unit has), and stays. Over the whole span the converted values go with the other tags of the plant, and the values as
they stand do not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from twin.historian.defects.panel import Mask, TagPanel, design_matrix, largest_sum, robust_prediction
from twin.historian.tags import Array, Defect, Series
from twin.historian.units import Unit, alternatives, unit_of

WINDOW_S = 12.0 * 3600.0
LEAST_S = 12.0 * 3600.0
NEAR = 0.15
"""Distance of a step from that of two units, as a share of the step of the units: operation moves the level besides."""
LEAST_RATIO = 1.25
"""Smaller ratios are not told from a change of operation."""
AT_REST = 0.1
"""Share of the largest value within days: below it the quantity is at rest, and has no unit to be seen by."""
AROUND_ROWS = 288
"""Rows (three days) in which that is looked for."""
CLEAR = 0.25
"""Largest median distance from the prediction, of the right unit, as a share of the distance of the wrong one."""
CAP = 3.0
"""Largest evidence of a quarter of an hour, a log likelihood ratio; neighbours are correlated, see `LEAST_EVIDENCE`."""
LEAST_EVIDENCE = 60.0
"""Half a day of samples that each speak for the switch."""
VOLUME = frozenset({"L/s", "l/s", "m3/h", "m³/h", "m3/s", "L/min", "gpm"})
BETTER = 0.7
"""Share to which a switch must bring the error of the prediction that knows of none."""
ROUNDS = 3


@dataclass(frozen=True)
class Switch:
    """A span in another unit: the defect, and the unit that the values have in it."""

    defect: Defect
    unit: Unit


def unit_switches(panel: TagPanel) -> list[Switch]:
    """Return the tags that are in another unit for a time, one switch a tag."""
    found = []
    for k, one in enumerate(panel.series):
        own = unit_of(one.tag.unit)
        if own.dimension in ("state", "angle") or one.tag.role.endswith("valve_position"):
            continue
        candidates = list(_candidates(one, panel.values[k], own, panel.grid_s))
        if candidates:
            switch = _best(panel, k, one, own, candidates)
            if switch is not None:
                found.append(switch)
    return found


def converted(series: Series, switch: Switch) -> Series:
    """Return the series with the values inside the switch in the dictionary's unit."""
    own, unit = unit_of(series.tag.unit), switch.unit
    inside = (series.time_s >= switch.defect.start_s) & (series.time_s <= switch.defect.end_s)
    again = (unit.scale * series.value + unit.offset - own.offset) / own.scale
    return replace(series, value=np.where(inside, again, series.value))


def _other_units(series: Series) -> dict[str, Unit]:
    """Return the units that the tag might switch to, of the same kind first; a fan's share and frequency are one."""
    others = dict(alternatives(series.tag.unit))
    dimension = unit_of(series.tag.unit).dimension
    if series.tag.role.startswith("fan_speed"):  # 60 Hz are 100 %, nearly everywhere
        others |= {"Hz": Unit(dimension, 100.0 / 60.0)} if dimension == "share" else {"%": Unit(dimension, 0.6)}
    volume = series.tag.unit in VOLUME
    return dict(sorted(others.items(), key=lambda item: (item[0] in VOLUME) != volume))


def _as_if(x: Array, own: Unit, unit: Unit) -> Array:
    """Return the record's values if the raw ones are in `unit` instead."""
    return np.asarray(unit.scale * (x - own.offset) / own.scale + unit.offset)


def _candidates(series: Series, x: Array, own: Unit, grid: Array) -> Iterable[tuple[str, Unit, int]]:
    """Yield units with the row of a step that would be a switch to them."""
    at_work = np.flatnonzero(_at_work((x - own.offset) / own.scale))
    if len(at_work) < 100:
        return
    before, after = _levels(x[at_work], round(WINDOW_S / (grid[1] - grid[0])))
    seen: set[tuple[float, float]] = set()
    for name, unit in _other_units(series).items():
        key = (round(np.log(unit.scale), 2), round(unit.offset, 1))
        if key in seen:
            continue
        wanted = _as_if(after, own, unit)
        if unit.offset == own.offset:
            ratio = abs(np.log(unit.scale / own.scale))
            if ratio < np.log(LEAST_RATIO):
                continue
            with np.errstate(divide="ignore", invalid="ignore"):
                off = np.abs(np.log(wanted / before)) / ratio
        else:
            off = np.abs(wanted - before) / np.maximum(np.abs(after - before), 1e-9)
        off = np.where(np.isfinite(off), off, np.inf)
        # Back from a unit is the same step the other way.
        row = int(np.argmin(off))
        if off[row] < 2.0 * NEAR:
            seen.add(key)
            yield name, unit, int(at_work[row])


def _at_work(raw: Array) -> Mask:
    """Return the rows that are not at rest, whichever unit they are in: by the largest value within days."""
    size = np.where(np.isfinite(raw), np.abs(raw), 0.0)
    largest = maximum_filter1d(size, size=AROUND_ROWS, mode="nearest")
    return np.asarray(np.isfinite(raw) & (size > AT_REST * largest))


def _levels(x: Array, width: int) -> tuple[Array, Array]:
    """Return the medians of the `width` values before and from each row on; NaN where few are known."""
    padded = np.concatenate([np.full(width, np.nan), x, np.full(width, np.nan)])
    thin = max(width // 12, 1)
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)[:, ::thin]
    known = np.isfinite(windows)
    count = known.sum(axis=1)
    ordered = np.sort(np.where(known, windows, np.inf), axis=1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    level = np.where(count >= 3, middle, np.nan)
    return level[: len(x)], level[width : width + len(x)]


def _best(panel: TagPanel, k: int, series: Series, own: Unit, candidates: list[tuple[str, Unit, int]]) -> Switch | None:
    """Return the most probable switch of a tag, or None."""
    drivers = [
        j
        for j, one in enumerate(panel.series)
        if j != k and one.tag.cell in (None, series.tag.cell) and unit_of(one.tag.unit).dimension != "angle"
    ]
    matrix = design_matrix(panel.values[drivers])
    x = panel.values[k]
    best: tuple[float, float, str, Unit, int, int] | None = None
    for name, unit, row in candidates:
        other = _as_if(x, own, unit)
        mask = np.arange(len(x)) >= row
        low, high, total, sigma, clear = _span(x, other, mask, matrix)
        score = total / max(sigma, 1e-9)
        if clear and total >= LEAST_EVIDENCE and (best is None or score > 1.05 * best[0]):
            best = score, total, name, unit, low, high
    if best is None:
        return None
    _, _, name, unit, low, high = best
    grid = panel.grid_s
    start, end = _edges(series, own, unit, grid, low, high)
    if end - start < LEAST_S or (low == 0 and high == len(grid)):
        return None
    says = f"{series.tag.name} is in {name} instead of {series.tag.unit}"
    return Switch(Defect("unit_switch", (series.tag.name,), start, end, says, "converted"), unit)


def _span(x: Array, other: Array, mask: Mask, matrix: Array) -> tuple[int, int, float, float, bool]:
    """Return begin, end, evidence and scatter of the span in which `other` goes with the plant and `x` does not.

    The last says that on either side one of the two goes clearly with the plant, and the other does not.
    """
    low, high, total, sigma = 0, len(x), 0.0, np.inf
    predicted = x
    for _ in range(ROUNDS):
        predicted, sigma = robust_prediction(np.where(mask, other, x), matrix)
        gain = 0.5 * (((x - predicted) / sigma) ** 2 - ((other - predicted) / sigma) ** 2)
        low, high, total = largest_sum(np.clip(np.nan_to_num(gain), -CAP, CAP))
        now = np.zeros(len(x), dtype=bool)
        now[low:high] = True
        if np.array_equal(now, mask):
            break
        mask = now
    inside = np.zeros(len(x), dtype=bool)
    inside[low:high] = True
    work = _at_work(np.where(inside, other, x))
    right, wrong = np.where(inside, other, x) - predicted, np.where(inside, x, other) - predicted
    clear = all(_clear(right[rows], wrong[rows]) for rows in (inside & work, ~inside & work))
    plain, _ = robust_prediction(x, matrix)
    clear &= _share_of_error(np.where(inside, other, x), predicted) < BETTER * _share_of_error(x, plain)
    return low, high, total, sigma, clear


def _share_of_error(x: Array, predicted: Array) -> float:
    """Return the mean error of a prediction as a share of the mean size of the quantity."""
    return float(np.nanmean(np.abs(x - predicted))) / max(float(np.nanmean(np.abs(x))), 1e-12)


def _clear(right: Array, wrong: Array) -> bool:
    """Return whether the values in the right unit lie near the prediction, those in the wrong one far off."""
    if len(right) < 12:
        return False
    near, far = float(np.nanmedian(np.abs(right))), float(np.nanmedian(np.abs(wrong)))
    return near < CLEAR * far and float(np.mean(np.abs(right) < np.abs(wrong))) > 0.8


def _edges(series: Series, own: Unit, unit: Unit, grid: Array, low: int, high: int) -> tuple[float, float]:
    """Return the times of the first and the last sample inside the span, by the samples around its edges."""
    time_s = series.time_s
    step = grid[1] - grid[0]
    start = float(time_s[0]) if low == 0 else _edge(series, own, unit, grid[low], 4.0 * step, rising=True)
    end = float(time_s[-1]) if high >= len(grid) else _edge(series, own, unit, grid[high - 1], 4.0 * step, rising=False)
    return start, end


def _edge(series: Series, own: Unit, unit: Unit, near_s: float, around_s: float, *, rising: bool) -> float:
    """Return the time of the sample at which the largest step towards the other unit (or back) lies near a time."""
    rows = np.flatnonzero(np.abs(series.time_s - near_s) <= around_s)
    if len(rows) < 2:
        return near_s
    value = np.maximum(np.abs(series.value[rows]), 1e-9)
    wanted = np.sign(np.log(own.scale / unit.scale)) if unit.offset == own.offset else 1.0
    step = np.diff(np.log(value)) * wanted * (1.0 if rising else -1.0)
    at = int(np.argmax(step))
    return float(series.time_s[rows[at + 1] if rising else rows[at]])
