"""Values that stand still for longer than the tag ever does.

With exception reporting a still value is normal for hours, for a valve as for a steady flow. So a run is judged by the
tag's other runs, and a value at which the tag often rests (a limit, a usual command, zero) is never called stuck.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.historian.tags import Array, Defect, Series
from twin.historian.units import unit_of

LEAST_S = 2.0 * 3600.0
FAR = 4.0
"""Times the longest of the tag's other runs."""
MEASURED = frozenset({"temperature", "mass flow", "power", "pressure", "speed", "angle", "frequency"})
USUAL = 0.02
"""Share of the time at one value, from which the tag is said to rest there."""


def stuck_values(series: Series, gaps: Sequence[Defect]) -> list[Defect]:
    """Return the spans in which a measured quantity stood still for longer than it ever does otherwise.

    Parameters:
        series: good samples of a tag.
        gaps: silences of its interface, across which nothing is known.
    """
    measured = unit_of(series.tag.unit).dimension in MEASURED or "humidity" in series.tag.role
    if not measured or "command" in series.tag.role or len(series.time_s) < 50:
        return []
    start, end, value = _runs(series, [gap for gap in gaps if series.tag.name in gap.tags])
    length = end - start
    found = []
    for k in np.flatnonzero(length >= LEAST_S):
        if _rests(value, length, k):
            continue
        others = np.delete(length, np.flatnonzero(np.abs(length) >= LEAST_S)) if len(length) > 1 else length[:0]
        longest = float(np.quantile(others, 0.999)) if len(others) > 20 else 0.0
        if length[k] >= FAR * max(longest, series.tag.scan_s):
            hours = length[k] / 3600.0
            says = f"{series.tag.name} stood at {value[k]:g} {series.tag.unit} for {hours:.1f} h"
            found.append(Defect("stuck", (series.tag.name,), float(start[k]), float(end[k]), says, "left out"))
    return found


def _rests(value: Array, length: Array, k: int) -> bool:
    """Return whether the tag often stands at this value: in other runs, for a good share of the time."""
    near = np.abs(value - value[k]) <= 0.005 * max(float(np.abs(value).max()), 1e-9)
    near[k] = False
    if abs(value[k]) <= 0.01 * float(np.abs(value).max()):
        return True
    return bool(length[near].sum() >= USUAL * length.sum() and near.sum() >= 2)


def _runs(series: Series, gaps: Sequence[Defect]) -> tuple[Array, Array, Array]:
    """Return begin, end and value of each run of equal samples; a run ends at the sample that differs, or at a gap."""
    time_s, value = series.time_s, series.value
    new = np.append(True, value[1:] != value[:-1])
    for gap in gaps:
        at = int(np.searchsorted(time_s, gap.end_s, side="left"))
        if at < len(new):
            new[at] = True
    first = np.flatnonzero(new)
    last = np.append(first[1:] - 1, len(value) - 1)
    following = np.minimum(last + 1, len(value) - 1)
    end = time_s[following].copy()
    for gap in gaps:
        crossing = (time_s[first] <= gap.start_s) & (end > gap.start_s)
        end[crossing] = gap.start_s
    return time_s[first], end, value[first]
