"""Values that stand still for longer than the tag ever does.

With exception reporting a still value is normal for hours, for a valve as for a steady flow: nothing is stored but a
sample after the fixed time. These samples show the instrument's noise, in which a healthy instrument nearly never
repeats a number several times, and a stuck one always does. So a run of equal samples is called stuck if its repeats
are improbable by the tag's share of repeats, and if it is set off from the tag's other runs: sorted by length, there
is a step by a factor of two below it. Values at which the tag often rests (a limit, zero) are never called stuck.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array, Defect, Series, longest_interval_s
from twin.historian.units import unit_of

LEAST_S = 2.0 * 3600.0
STEP = 2.0
"""Factor by which a stuck run is longer than the longest healthy one."""
MOST = 8
"""Stuck runs of a tag in a season; more are its habit."""
MEASURED = frozenset({"temperature", "mass flow", "power", "pressure", "speed", "angle", "frequency"})
CHANCE = 0.005
"""Largest expected number of such runs in the tag's record by chance."""
AROUND_S = 2.0 * 3600.0
LIVELY = 20.0
"""Expected samples, by the rates on either side, from which standing still is improbable: exp(-20) for a Poisson
process, and samples of one tag come more evenly than those."""
AT_REST = 0.02
"""Share of the 98 % quantile: at rest below it."""
REST_RUNS = 2
"""Other long runs, of a quarter of the length, at the same value, from which the tag is said to rest there."""


def stuck_values(series: Series) -> list[Defect]:
    """Return the spans in which a measured quantity stood still for longer than it ever does otherwise.

    Parameters
    ----------
    series
        Good samples of a tag, in its own unit; a hole ends a run.
    """
    measured = (
        unit_of(series.tag.unit).dimension in MEASURED
        or "humidity" in series.tag.role
        or series.tag.role == "fan_speed"
    )
    if not measured or "command" in series.tag.role or len(series.time_s) < 50:
        return []
    first, last, end = _runs(series)
    value, start = series.value[first], series.time_s[first]
    held = series.time_s[last] - start
    top = float(np.quantile(np.abs(series.value), 0.98))
    at_work = np.abs(value) > AT_REST * top
    chosen = _set_off(held, at_work)
    saturates = "humidity" not in series.tag.role  # a latched humidity stands at its end; the other sensor decides
    found = []
    for k in chosen:
        lively = _expected(series.time_s, float(start[k]), float(end[k])) > LIVELY
        if not lively and _by_chance(series, first, last, at_work, k) > CHANCE:
            continue
        if _rests(value, held, k, top):
            continue
        if saturates and _at_end(value, k):
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


def _expected(time_s: Array, start: float, end: float) -> float:
    """Return the samples that the rates before and after a run let expect within it, by the smaller of the two."""
    edges = np.array([start - AROUND_S, start, end, end + AROUND_S])
    rows = np.searchsorted(time_s, edges, side="left")
    return float(min(rows[1] - rows[0], rows[3] - rows[2]) / AROUND_S * (end - start))


def _by_chance(
    series: Series, first: NDArray[np.int64], last: NDArray[np.int64], at_work: NDArray[np.bool_], k: int
) -> float:
    """Return the expected number of runs like run `k` in a healthy record.

    Samples that an exception brought differ by nature. So the share of repeats is that of samples which came late,
    after most of the longest interval; where there are few such, a fifth: noise of twice the resolution.
    """
    interval = np.diff(series.time_s)
    run = np.repeat(np.arange(len(first)), last - first + 1)
    late = (interval > 0.5 * longest_interval_s(series)) & at_work[run[1:]] & ~series.broken() & (run[1:] != k)
    same = run[1:] == run[:-1]
    repeats = last - first
    other = at_work & (np.arange(len(first)) != k)
    overall = (repeats[other].sum() + 1.0) / (repeats[other].sum() + other.sum() + 2.0)
    share = max(float(overall), float(((same & late).sum() + 0.6) / (late.sum() + 3.0)))
    return float(share ** repeats[k] * max(late.sum(), 5))


def _at_end(value: Array, k: int) -> bool:
    """Return whether the run is at the upper end of the tag's range, where it is seen in other runs too."""
    near = value >= 0.999 * value.max()
    return bool(near[k] and near.sum() > REST_RUNS + 1)


def _rests(value: Array, held: Array, k: int, top: float) -> bool:
    """Return whether the tag often stands at this value: in other long runs."""
    near = np.abs(value - value[k]) <= 0.002 * top
    near[k] = False
    return bool((held[near] >= max(0.5 * LEAST_S, 0.25 * held[k])).sum() >= REST_RUNS)
