"""Tags that change their unit in the middle of the record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.historian.tags import Array, Defect, Series
from twin.historian.units import Unit, alternatives, unit_of

WINDOW_S = 6.0 * 3600.0
LEAST_S = 12.0 * 3600.0
NEAR = 0.06
"""Relative distance of the step from the ratio of two units."""
LEAST_RATIO = 1.5
"""Smaller ratios are not told from a change of operation."""
SHARE_AT_REST = 0.1
"""Of the 90 % quantile: below it the quantity is at rest, and has no unit to be seen by."""
SEVERAL = 8


def unit_switches(series: Series) -> list[tuple[Defect, Unit]]:
    """Return spans in which the values are in another unit than the dictionary's, each with that unit.

    A switch is a step by the ratio of two units that lasts for half a day, and after which the converted values lie
    where those before it lay, the others nowhere near.
    """
    own = unit_of(series.tag.unit)
    if own.dimension in ("state", "angle", "share"):
        return []
    rows = _at_work(series.value)
    time_s, value = series.time_s[rows], series.value[rows]
    if len(value) < 4 * SEVERAL:
        return []
    steps = [
        (distance, at, name, unit)
        for name, unit in alternatives(series.tag.unit).items()
        if (step := _step(time_s, value, own, unit)) is not None
        for distance, at in (step,)
    ]
    if not steps:
        return []
    _, at, name, unit = min(steps, key=lambda step: step[0])
    end = _back(time_s, value, at, own, unit)
    says = f"{series.tag.name} is in {name} instead of {series.tag.unit}"
    end_s = float(series.time_s[-1]) if end is None else float(time_s[end])
    defect = Defect("unit_switch", (series.tag.name,), float(time_s[at]), end_s, says, "converted")
    return [(defect, unit)]


def converted(series: Series, defect: Defect, unit: Unit) -> Series:
    """Return the series with the values inside the defect in the dictionary's unit."""
    own = unit_of(series.tag.unit)
    inside = (series.time_s >= defect.start_s) & (series.time_s <= defect.end_s)
    again = (unit.scale * series.value + unit.offset - own.offset) / own.scale
    return replace(series, value=np.where(inside, again, series.value))


def _at_work(value: Array) -> Array:
    """Return the samples that are not at rest, whichever unit they are in."""
    top = float(np.quantile(value, 0.9))
    return np.asarray(np.abs(value) > SHARE_AT_REST * abs(top))


def _step(time_s: Array, value: Array, own: Unit, unit: Unit) -> tuple[float, int] | None:
    """Return how far the best step is from the switch to `unit` and where it is, or None."""
    as_if = (own.scale * value + own.offset - unit.offset) / unit.scale  # what the values would be in the other unit
    typical = float(np.median(np.abs(value)))
    ratio = float(np.median(np.abs(as_if))) / max(typical, 1e-12)
    if max(ratio, 1.0 / max(ratio, 1e-12)) < LEAST_RATIO:
        return None
    best: tuple[float, int] | None = None
    # A switch is between two samples: candidates are the largest relative changes.
    change = np.abs(np.diff(np.log(np.maximum(np.abs(value), 1e-9))))
    for at in np.argsort(change)[::-1][:200] + 1:
        before = (time_s >= time_s[at] - WINDOW_S) & (np.arange(len(value)) < at)
        after = (time_s < time_s[at] + WINDOW_S) & (np.arange(len(value)) >= at)
        if before.sum() < SEVERAL or after.sum() < SEVERAL or time_s[-1] - time_s[at] < LEAST_S:
            continue
        wanted, seen = float(np.median(as_if[before])), float(np.median(value[after]))
        distance = abs(seen / wanted - 1.0) if wanted else np.inf
        level = float(np.median(value[before]))
        if distance < 3.0 * NEAR and _holds(time_s, value, as_if, at, level) and (best is None or distance < best[0]):
            best = distance, int(at)
    return best


def _holds(time_s: Array, value: Array, as_if: Array, at: int, level: float) -> bool:
    """Return whether, for half a day, the values lie where the converted ones of before lie, and not where those lay."""
    later = (time_s >= time_s[at]) & (time_s < time_s[at] + LEAST_S)
    earlier = time_s < time_s[at]
    low, high = np.quantile(as_if[earlier], (0.02, 0.98))
    margin = NEAR * max(abs(float(low)), abs(float(high)))
    inside = (value[later] >= low - margin) & (value[later] <= high + margin)
    old_low, old_high = np.quantile(value[earlier], (0.02, 0.98))
    stays = (value[later] >= old_low) & (value[later] <= old_high)
    return bool(inside.mean() > 0.8 and stays.mean() < 0.3 and level != 0.0)


def _back(time_s: Array, value: Array, at: int, own: Unit, unit: Unit) -> int | None:
    """Return the first sample after the switch that is in the dictionary's unit again, or None."""
    early = value[:at]
    as_if = (own.scale * early + own.offset - unit.offset) / unit.scale
    middle_own, middle_other = np.log(np.median(np.abs(early))), np.log(np.median(np.abs(as_if)))
    nearer_own = np.abs(np.log(np.abs(value[at:])) - middle_own) < np.abs(np.log(np.abs(value[at:])) - middle_other)
    if len(nearer_own) < SEVERAL:
        return None
    run = np.convolve(nearer_own, np.ones(SEVERAL), mode="valid")
    back = np.flatnonzero(run == SEVERAL)
    return at + int(back[0]) if len(back) else None
