"""Values that stand still for longer than the tag ever does.

With exception reporting a still value is normal for hours, for a valve as for a steady flow: nothing is stored but a
sample after the fixed time. These samples show the instrument's noise, in which a healthy instrument nearly never repeats
a number several times, and a stuck one always does. So a run of equal samples is called stuck if its repeats are
improbable by the tag's share of repeats, and if it is set off from the tag's other runs: sorted by length, there is a
step by a factor of two below it. Values at which the tag often rests (a limit, zero) are never called stuck.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array, Defect, Series
from twin.historian.units import unit_of

LEAST_S = 2.0 * 3600.0
STEP = 2.0
"""Factor by which a stuck run is longer than the longest healthy one."""
MOST = 8
"""Stuck runs of a tag in a record; more are its habit."""
MEASURED = frozenset({"temperature", "mass flow", "power", "pressure", "speed", "angle", "frequency"})
CHANCE = 0.02
"""Largest expected number of such runs in the tag's record by chance."""
AT_REST = 0.02
"""Of the 98 % quantile: at rest below it."""
REST_RUNS = 2
"""Other runs of half the length at the same value, from which the tag is said to rest there."""


def stuck_values(series: Series) -> list[Defect]:
    """Return the spans in which a measured quantity stood still for longer than it ever does otherwise.

    Parameters:
        series: good samples of a tag, in its own unit; a hole ends a run.
    """
    measured = unit_of(series.tag.unit).dimension in MEASURED or "humidity" in series.tag.role or series.tag.role == "fan_speed"
    if not measured or "command" in series.tag.role or len(series.time_s) < 50:
        return []
    first, last, end = _runs(series)
    value, start = series.value[first], series.time_s[first]
    held = series.time_s[last] - start
    top = float(np.quantile(np.abs(series.value), 0.98))
    at_work = np.abs(value) > AT_REST * top
    chosen = _set_off(held, at_work)
    repeats = last - first
    share = (repeats[at_work].sum() + 1.0) / (repeats[at_work].sum() + at_work.sum() + 2.0)
    found = []
    for k in chosen:
        by_chance = share ** repeats[k] * at_work.sum()
        if by_chance > CHANCE or _rests(value, held, k, top):
            continue
        hours = (end[k] - start[k]) / 3600.0
        says = f"{series.tag.name} stood at {value[k]:g} {series.tag.unit} for {hours:.1f} h"
        found.append(Defect("stuck", (series.tag.name,), float(start[k]), float(end[k]), says, "left out"))
    return found


def _set_off(held: Array, at_work: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the runs that a step in the sorted lengths sets off from the others."""
    order = np.flatnonzero(at_work)
    order = order[np.argsort(held[order])[::-1]][: MOST + 1]
    lengths = np.append(held[order], 0.0)
    steps = [k for k in range(min(MOST, len(order))) if lengths[k] >= max(STEP * lengths[k + 1], LEAST_S)]
    return order[: steps[-1] + 1] if steps else order[:0]


def _runs(series: Series) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the first and the last row of each run of equal samples, and the time of the sample that ends it.

    A hole ends a run too, at its beginning.
    """
    time_s, value = series.time_s, series.value
    new = np.append(True, (np.diff(value) != 0.0) | series.broken())
    first = np.flatnonzero(new)
    last = np.append(first[1:] - 1, len(value) - 1)
    following = np.minimum(last + 1, len(value) - 1)
    cut = np.append(series.broken(), True)[last]
    return first, last, np.where(cut, time_s[last], time_s[following])


def _rests(value: Array, held: Array, k: int, top: float) -> bool:
    """Return whether the tag often stands at this value: in other long runs."""
    near = np.abs(value - value[k]) <= 0.002 * top
    near[k] = False
    return bool((held[near] >= 0.5 * LEAST_S).sum() >= REST_RUNS)
