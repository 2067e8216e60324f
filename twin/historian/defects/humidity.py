"""Air instruments that contradict one another: wet bulbs that cannot be, and humidity sensors that latch.

Dry bulb, two humidity sensors and a wet bulb measure two quantities. The one that departs from the others is at fault.
Where that leaves two, it is the one that leaps against its own past where the contradiction begins or ends; where none
does, nothing tells, and both are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.historian.defects.panel import moving_mean, on_grid
from twin.historian.tags import Array, Defect, Mask, Series
from twin.quantiles import NORMAL90
from twin.tower.air import wet_bulb

CLOSURE_K = 0.35
"""Largest difference between the measured wet bulb and that of dry bulb and humidity (the paper)."""
STEP_S = 300.0
SMOOTH = 7
"""Rows over which a difference is averaged: instruments of different lag differ at each gust."""
LEAST_S = 2.0 * 3600.0
JOINED_S = 3.0 * 3600.0
SATURATED = 97.0
"""% at which a humidity sensor latches: condensed water on it."""
APART = 3.0
"""% by which the other sensor must depart from a latched one (each is good to 2 %)."""
SCATTERS = 6.0
"""Robust standard deviations of the closure, by which a wet bulb is off beyond its usual scatter at this site."""
OFFSET_K, OFFSET_PART = 1.0, 0.1
"""Largest usual closure, that of a humidity off by 5 % and thermometers off by 0.3 K, and the part of a record that
has to show it."""
LEAP_ROWS = 3
"""Rows on either side of a leap whose mean is the level: a quarter of an hour."""
LEAP_S = 3600.0
"""Time about the edge of a contradiction in which a leap is looked for: its averaging blurs the edge by half that."""
LEAPT, APART_LEAPS = 4.0, 1.5
"""Usual changes in a quarter of an hour by which an instrument leaps, and how much more than any other."""
STEADIER = 2.0
"""Times by which one difference must be steadier than another to be the constant one."""
POSSIBLE_KPA = (50.0, 110.0)
"""Air pressure on Earth (`columns`); another one is none."""
ROLES = ("relative_humidity", "relative_humidity_redundant")


def latched(series: Sequence[Series], stuck: Sequence[Defect]) -> tuple[list[Defect], list[Defect]]:
    """Return the latched humidities among the stuck values, and the stuck values that remain.

    A humidity that stands at saturation is latched if the other sensor shows dry air meanwhile; if it shows saturation
    too there was fog, and no defect.
    """
    humid = {one.tag.name: one for one in series if one.tag.role in ROLES}
    found, left = [], []
    for defect in stuck:
        one = humid.get(defect.tags[0])
        if one is None:
            left.append(defect)
            continue
        rows = (one.time_s >= defect.start_s) & (one.time_s <= defect.end_s)
        level = float(np.median(on_grid(replace(one, holes=one.holes[:0]), one.time_s[rows])))
        if level < SATURATED:
            left.append(defect)
            continue
        others = [other for other in humid.values() if other is not one]
        if not others or _departs(others[0], defect, level):
            found.append(replace(defect, kind="humidity_latched", says=f"{defect.says}, latched at saturation"))
    return found, left


def _departs(other: Series, defect: Defect, level: float) -> bool:
    """Return whether the other sensor shows drier air within the span; unknown counts as no."""
    grid = np.arange(defect.start_s, defect.end_s, STEP_S)
    off = level - on_grid(other, grid)
    return bool(np.isfinite(off).any() and np.nanquantile(off, 0.9) > APART)


def wet_bulb_defects(series: Sequence[Series], pressure_kPa: float) -> list[Defect]:
    """Return the spans in which wet bulb, dry bulb and humidities contradict one another, of the one at fault.

    Nothing without dry bulb and one of the others.
    """
    by_role: dict[str, Series] = {}
    for one in series:
        if len(one.time_s) > 1:
            by_role.setdefault(one.tag.role, one)
    dry, wet = by_role.get("dry_bulb_temperature"), by_role.get("wet_bulb_temperature")
    if dry is None or wet is None:
        return []
    grid = np.arange(wet.time_s[0], wet.time_s[-1], STEP_S)
    t, measured = on_grid(dry, grid), on_grid(wet, grid)
    pressure = np.full(len(grid), pressure_kPa)
    if "barometric_pressure" in by_role:
        seen = on_grid(by_role["barometric_pressure"], grid)
        pressure = np.where((seen >= POSSIBLE_KPA[0]) & (seen <= POSSIBLE_KPA[1]), seen, pressure)
    humid = [by_role[role] for role in ROLES if role in by_role]
    shares = [on_grid(one, grid) for one in humid]
    offs = [measured - _expected(t, share, pressure) for share in shares]
    offs = [off - _usual(off, t) for off in offs]
    spans = _impossible(grid, measured - t, offs)
    suspects = [(wet, measured), (dry, t)]
    if len(humid) == 1:
        suspects.append((humid[0], shares[0]))
    return [defect for span in spans for defect in _at_fault(grid, span, suspects)]


def named_impossible(
    found: Sequence[Defect], series: Sequence[Series], dry: Sequence[Series], pressure_kPa: float
) -> list[Defect]:
    """Return the defects, and of them a wet bulb that shows the dry bulb or more as impossible.

    It looks like a change of range where the dry bulb itself was left out. A dry wick shows the dry bulb, and a range
    the wet bulb with another zero: the steadier difference decides, as the dry bulb's zero is not known to a degree.

    Parameters
    ----------
    found
        Defects.
    series
        Samples of the tags, with those of the spans of these defects.
    dry
        The same with a dry bulb of another range mapped back.
    pressure_kPa
        Of the site.
    """
    wet = {one.tag.name: one for one in series if one.tag.role == "wet_bulb_temperature"}
    bulb = next((one for one in dry if one.tag.role == "dry_bulb_temperature" and len(one.time_s) > 1), None)
    humid = [one for one in series if one.tag.role in ROLES and len(one.time_s) > 1]
    named = []
    for defect in found:
        one = wet.get(defect.tags[0])
        if defect.kind == "range_change" and one is not None and bulb is not None and humid:
            grid = np.arange(defect.start_s, defect.end_s, STEP_S)
            measured, t = on_grid(one, grid), on_grid(bulb, grid)
            off = measured - _expected(t, on_grid(humid[0], grid), np.full(len(grid), pressure_kPa))
            above = measured - t
            known = np.isfinite(above) & np.isfinite(off)
            if (
                known.any()
                and float(np.median(above[known])) > -OFFSET_K
                and STEADIER * _scatter(above[known]) < _scatter(off[known])
            ):
                says = f"{one.tag.name} shows the dry bulb or more, as with a wick that is dry"
                defect = replace(defect, kind="impossible_wet_bulb", says=says)
        named.append(defect)
    return named


def _at_fault(grid: Array, span: tuple[float, float, float], suspects: Sequence[tuple[Series, Array]]) -> list[Defect]:
    """Return the defect of the instrument that leaps where a contradiction begins and ends; those of all that may be
    at fault if none does."""
    start, end, size = span
    leaps = []
    for _, values in suspects:
        change = _changes(values)
        known = np.abs(change[np.isfinite(change)])
        usual = float(np.quantile(known, 0.9)) / NORMAL90 if len(known) else 0.0
        at_edges = [np.abs(change[np.abs(grid - edge) <= LEAP_S]) for edge in (start, end)]
        leaps.append(max((float(np.nanmax(one)) for one in at_edges if np.isfinite(one).any()), default=0.0))
        leaps[-1] /= max(usual, 1e-9)
    order = np.argsort(leaps)[::-1]
    sure = leaps[order[0]] >= LEAPT and leaps[order[0]] >= APART_LEAPS * leaps[order[1]]
    wet = suspects[0][0]
    found = []
    for k in order[:1] if sure else range(len(suspects)):
        one = suspects[k][0]
        why = "" if sure else "; nothing tells which instrument is at fault, and all are left out"
        if one is wet:
            says = f"{one.tag.name} is up to {size:.1f} K off the wet bulb of dry bulb and humidity{why}"
            found.append(Defect("impossible_wet_bulb", (one.tag.name,), start, end, says, "left out"))
        else:
            leapt = f"; {one.tag.name} leapt and {wet.tag.name} did not" if sure else why
            says = (
                f"with {one.tag.name} the wet bulb of dry bulb and humidity is up to {size:.1f} K off the measured one"
            )
            found.append(Defect("contradicted", (one.tag.name,), start, end, says + leapt, "left out"))
    return found


def _changes(values: Array) -> Array:
    """Return the change of the mean level from before each row to after it."""
    level = moving_mean(values, LEAP_ROWS // 2)
    change = np.full(len(values), np.nan)
    half = LEAP_ROWS // 2 + 1
    change[half : len(values) - half] = level[2 * half :] - level[: -2 * half]
    return change


def _expected(t: Array, share: Array, pressure: Array) -> Array:
    rows = np.isfinite(t) & np.isfinite(share)
    found = np.full(len(t), np.nan)
    if rows.any():
        found[rows] = wet_bulb(t[rows], share[rows] / 100.0, pressure[rows])
    return found


def _usual(off: Array, t: Array) -> Array:
    """Return the usual closure: the offsets of the instruments, linear in the temperature, by a robust line.

    Where a part of the record shows offsets that instruments have, it alone decides: a fault may last for most of a
    record.
    """
    rows = np.isfinite(off) & np.isfinite(t)
    possible = rows & (np.abs(off) <= OFFSET_K)
    if possible.sum() >= OFFSET_PART * rows.sum():
        rows = possible
    if rows.sum() < 50:
        return np.zeros(len(off))
    x, y = t[rows] - np.median(t[rows]), off[rows]
    weight = np.ones(len(x))
    slope = level = 0.0
    for _ in range(4):
        w = weight.sum()
        mx, my = (weight * x).sum() / w, (weight * y).sum() / w
        slope = float((weight * (x - mx) * (y - my)).sum() / max((weight * (x - mx) ** 2).sum(), 1e-9))
        level = float(my - slope * mx)
        off_line = np.abs(y - level - slope * x)
        weight = np.minimum(1.0, max(float(np.median(off_line)), 1e-3) / np.maximum(off_line, 1e-9))
    return np.asarray(level + slope * (t - np.median(t[rows])))


def _impossible(grid: Array, above: Array, offs: list[Array]) -> list[tuple[float, float, float]]:
    """Return the spans with a wet bulb above the dry bulb, or off from every humidity sensor on the same side, each
    with how far in K."""
    wrong = moving_mean(np.nan_to_num(above, nan=-1.0), SMOOTH // 2) > CLOSURE_K
    worst = np.where(wrong, above, 0.0)
    if offs:
        smooth = [moving_mean(off, SMOOTH // 2) for off in offs]
        limits = [max(2.0 * CLOSURE_K, SCATTERS * _scatter(one)) for one in smooth]
        known = np.stack([np.isfinite(one) for one in smooth])
        high = np.stack([one > limit for one, limit in zip(smooth, limits, strict=True)])
        low = np.stack([one < -limit for one, limit in zip(smooth, limits, strict=True)])
        # The one that departs is at fault: a wet bulb must depart from every humidity that is known.
        both = known.any(axis=0) & ((high | ~known).all(axis=0) | (low | ~known).all(axis=0))
        if len(offs) > 1:
            both &= known.all(axis=0)
        wrong |= both
        size = np.where(known, np.abs(np.stack(smooth)), 0.0).max(axis=0)
        worst = np.where(both, size, worst)
    found = []
    for start, end in _spans(grid, wrong):
        rows = (grid >= start) & (grid <= end) & wrong
        found.append((start, end, float(np.nanmax(worst[rows]))))
    return found


def _scatter(x: Array) -> float:
    known = x[np.isfinite(x)]
    return 1.4826 * float(np.median(np.abs(known - np.median(known)))) if len(known) else 0.0


def _spans(grid: Array, wrong: Mask) -> list[tuple[float, float]]:
    """Return the spans of at least two hours of which half is wrong; shorter interruptions join two."""
    rows = np.flatnonzero(wrong)
    if len(rows) == 0:
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(grid[rows]) > JOINED_S) + 1)
    found = []
    for part in parts:
        start, end = float(grid[part[0]]), float(grid[part[-1]])
        if end - start >= LEAST_S and len(part) * STEP_S >= 0.5 * (end - start):
            found.append((start, end))
    return found
