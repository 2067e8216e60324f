"""Air instruments that contradict one another: wet bulbs that cannot be, and humidity sensors that latch.

Dry bulb, two humidity sensors and a wet bulb measure two quantities. The one that departs from the others is at fault.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.historian.tags import Array, Defect, Series, longest_interval_s
from twin.historian.units import unit_of
from twin.tower.air import wet_bulb

CLOSURE_K = 0.35
"""Largest difference between the measured wet bulb and that of dry bulb and humidity."""
STEP_S = 300.0
LEAST_S = 3600.0
LATCHED_S = 3.0 * 3600.0
LATCHED_APART = 4.0
"""% of relative humidity, by which a latched sensor differs from the other one."""


def humidity_defects(series: Sequence[Series], pressure_kPa: float) -> list[Defect]:
    """Return spans with a wet bulb or a humidity that cannot be; nothing without dry bulb and one of the others."""
    by_role: dict[str, Series] = {}
    for one in series:
        by_role.setdefault(one.tag.role, one)
    dry = by_role.get("dry_bulb_temperature")
    if dry is None or len(dry.time_s) < 2:
        return []
    grid = np.arange(dry.time_s[0], dry.time_s[-1], STEP_S)
    t = _canonical(dry, grid)
    found: list[Defect] = []
    humid = {role: by_role[role] for role in ("relative_humidity", "relative_humidity_redundant") if role in by_role}
    shares = {role: _canonical(one, grid) for role, one in humid.items()}
    if len(shares) == 2:
        found += _latched(grid, humid, shares)
        for defect in found:
            for role, one in humid.items():
                if one.tag.name in defect.tags:
                    shares[role] = np.where((grid >= defect.start_s) & (grid <= defect.end_s), np.nan, shares[role])
    wet = by_role.get("wet_bulb_temperature")
    if wet is None:
        return found
    barometer = by_role.get("barometric_pressure")
    pressure = np.full(len(grid), pressure_kPa)
    if barometer is not None:
        seen = _canonical(barometer, grid)
        pressure = np.where(np.isfinite(seen), seen, pressure)
    expected = _mean([wet_bulb(t, share / 100.0, pressure) for share in shares.values()])
    measured = _canonical(wet, grid)
    return found + _impossible(grid, wet, measured - t, measured - expected)


def _canonical(series: Series, grid: Array) -> Array:
    unit = unit_of(series.tag.unit)
    return np.asarray(unit.scale * series.at(grid, 1.2 * longest_interval_s(series)) + unit.offset)


def _mean(rows: list[Array]) -> Array:
    """Return the mean of those that are there."""
    if not rows:
        return np.asarray(np.nan)
    stack = np.stack(rows)
    known = np.isfinite(stack)
    return np.asarray(np.where(known.any(axis=0), np.where(known, stack, 0.0).sum(axis=0), np.nan)
                      / np.maximum(known.sum(axis=0), 1))  # fmt: skip


def _impossible(grid: Array, wet: Series, above: Array, off: Array) -> list[Defect]:
    """Return the spans with a wet bulb above the dry bulb, or too far from that of the humidity."""
    usual = float(np.nanmedian(off)) if np.isfinite(off).any() else 0.0
    wrong = (np.nan_to_num(above, nan=-1.0) > CLOSURE_K) | (np.nan_to_num(np.abs(off - usual)) > 2.0 * CLOSURE_K)
    found = []
    for start, end in _spans(grid, wrong):
        rows = (grid >= start) & (grid <= end)
        worst = float(np.nanmax(np.abs(np.where(np.isfinite(off[rows]), off[rows] - usual, above[rows]))))
        if np.nanmax(above[rows]) > CLOSURE_K or end - start >= 3.0 * LEAST_S:
            says = f"{wet.tag.name} is up to {worst:.1f} K off the wet bulb of dry bulb and humidity"
            found.append(Defect("impossible_wet_bulb", (wet.tag.name,), start, end, says, "left out"))
    return found


def _latched(grid: Array, humid: dict[str, Series], shares: dict[str, Array]) -> list[Defect]:
    """Return the spans in which one humidity stands still while the other, apart from it, moves."""
    found = []
    roles = list(humid)
    for role, other in (roles, roles[::-1]):
        one = shares[role]
        width = round(LATCHED_S / STEP_S)
        still = _spread(one, width) < 0.3
        moving = (_spread(shares[other], width) > 3.0) | (np.abs(one - shares[other]) > LATCHED_APART)
        for start, end in _spans(grid, still & moving):
            name = humid[role].tag.name
            level = float(np.nanmedian(one[(grid >= start) & (grid <= end)]))
            says = f"{name} stands at {level:.1f} % while {humid[other].tag.name} moves"
            found.append(
                Defect("humidity_latched", (name,), start, min(end + LATCHED_S, float(grid[-1])), says, "left out")
            )
    return found


def _spread(x: Array, width: int) -> Array:
    """Return the range of the next `width` values at each row."""
    padded = np.append(x, np.full(width - 1, np.nan))
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    known = np.isfinite(windows)
    top = np.where(known, windows, -np.inf).max(axis=1)
    bottom = np.where(known, windows, np.inf).min(axis=1)
    return np.asarray(np.where(known.sum(axis=1) >= width // 2, top - bottom, np.nan))


def _spans(grid: Array, wrong: Array) -> list[tuple[float, float]]:
    """Return the spans of at least an hour; shorter interruptions join two."""
    rows = np.flatnonzero(wrong)
    if len(rows) == 0:
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(grid[rows]) > LEAST_S) + 1)
    spans = [(float(grid[part[0]]), float(grid[part[-1]])) for part in parts if len(part) > 2]
    return [(start, end) for start, end in spans if end - start >= LEAST_S]
