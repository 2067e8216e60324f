"""Contradictions of a record: steps of an outlet thermometer that no thermometer makes.

A thermometer steps or is exchanged some three times a year (`twin.tower.change_detection.changes.RATE_D`), within the
bounds of its bias. A larger step, or more steps than a Poisson process of this rate gives in one record of a hundred,
comes from something else, such as an input in another unit. Its readings are left out of the fit, since a bias would
explain them with a wrong value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from twin.tower.air import Array
from twin.tower.change_detection.changes import RATE_D
from twin.tower.change_detection.steps import Step
from twin.tower.estimates import DAY_S

LEVEL = 0.01
"""Probability of as many steps as in the record, below which they are not the thermometer's."""
WITNESS_S, BESIDE_S = 1800.0, 300.0
"""Time on each side of a jump over which a column's median is taken, and the time next to it that is left out."""
AROUND_S = 0.5 * DAY_S
"""Time about a contradiction in which the cause may have begun or ended: a cell that stands shows nothing of it."""
BEYOND = 1.5
"""Ratio of a column's largest jump there to its largest jump elsewhere above which it is named."""
EVERY_MIN = 15
"""Step of the times at which jumps are looked for: half of `WITNESS_S`."""


@dataclass(frozen=True)
class Contradiction:
    """A span of a record, s, that contradicts the rest: number of lasting steps in it, the largest one K, and the
    column that jumps there, "" where none is known."""

    start_s: float
    end_s: float
    steps: int
    size: float
    column: str = ""


def most_steps(days: float) -> int:
    """Return the largest plausible number of a thermometer's steps in a record of so many days."""
    steps = 0
    while pdtrc(steps, RATE_D["bias"] * days) > LEVEL:
        steps += 1
    return steps


def contradictory_steps(steps: Sequence[Step], days: float, bound: float) -> tuple[Contradiction, ...]:
    """Return the spans in which an outlet thermometer steps as no thermometer does.

    Parameters
    ----------
    steps
        Of the thermometer, in the order of time; those that did not last tell how far a span reaches.
    days
        Length of the record.
    bound
        Largest bias, K.
    """
    # A basin thermometer that an input contradicts as well makes such steps the water's.
    mine = [one for one in steps if one.kind in ("thermometer", "water")]
    many = sum(one.lasting for one in mine) > most_steps(days)
    groups: list[list[Step]] = []
    for one in mine:
        if groups and one.start_s - groups[-1][-1].start_s <= DAY_S:
            groups[-1].append(one)
        else:
            groups.append([one])
    found = []
    for group in groups:
        lasting = [one for one in group if one.lasting]
        sizes = [one.size for one in lasting]
        large = any(abs(one.size) > bound for one in lasting if one.kind == "thermometer")
        if large or (many and len(sizes) > 1):
            found.append(Contradiction(group[0].start_s, group[-1].alarm_s, len(sizes), max(sizes, key=abs)))
    return tuple(found)


def spans_beyond(edges_s: Array, bias: Array, bound: float) -> tuple[Contradiction, ...]:
    """Return the spans in which a bias that was fitted leaves its bounds.

    Parameters
    ----------
    edges_s
        (k + 1,) s, of the time grid.
    bias
        (k,) K.
    bound
        Largest bias, K.
    """
    beyond = np.r_[False, np.abs(bias) > bound, False]
    starts, ends = (np.flatnonzero(np.diff(beyond.astype(int)) == sign) for sign in (1, -1))
    return tuple(
        Contradiction(float(edges_s[a]), float(edges_s[b]), 0, float(max(bias[a:b], key=abs)))
        for a, b in zip(starts, ends, strict=True)
    )


def merged(found: Sequence[Contradiction]) -> tuple[Contradiction, ...]:
    """Return contradictions in the order of time, those that overlap or lie within a day of each other as one."""
    joined: list[Contradiction] = []
    for one in sorted(found, key=lambda c: c.start_s):
        if joined and one.start_s <= joined[-1].end_s + DAY_S:
            last = joined.pop()
            size = max((last.size, one.size), key=abs)
            one = Contradiction(last.start_s, max(last.end_s, one.end_s), last.steps + one.steps, size)
        joined.append(one)
    return tuple(joined)


def jumping_column(
    time_s: Array, running: NDArray[np.bool_], columns: Mapping[str, Array], spans: Sequence[Contradiction]
) -> list[str]:
    """Return for each span the column whose jump there exceeds its jumps elsewhere most, "" where none does.

    Parameters
    ----------
    time_s, running
        Minutes (n,), and those in which the cell runs.
    columns
        Candidates by name (n,).
    spans
        Contradictions of the record.
    """
    at = time_s[::EVERY_MIN]
    near = [(at >= one.start_s - AROUND_S) & (at <= one.end_s + AROUND_S) for one in spans]
    outside = ~np.any(near, axis=0) if near else np.ones(len(at), dtype=bool)
    best = [("", BEYOND)] * len(spans)
    for name, values in columns.items():
        jumps = _jumps(time_s, np.where(running, values, np.nan), at)
        usual = float(np.nanmax(jumps[outside], initial=0.0)) if np.isfinite(jumps[outside]).any() else 0.0
        for k, inside in enumerate(near):
            there = jumps[inside]
            if usual > 0.0 and np.isfinite(there).any():
                ratio = float(np.nanmax(there)) / usual
                best[k] = max(best[k], (name, ratio), key=lambda pair: pair[1])
    return [name for name, _ in best]


def _jumps(time_s: Array, values: Array, at: Array) -> Array:
    """Return the size of the jump of a column at each time, NaN where it is not known on both sides (m,)."""
    found = np.full(len(at), np.nan)
    for k, moment in enumerate(at):
        a, b, c, d = np.searchsorted(
            time_s, (moment - WITNESS_S, moment - BESIDE_S, moment + BESIDE_S, moment + WITNESS_S)
        )
        before, after = values[a:b], values[c:d]
        before, after = before[np.isfinite(before)], after[np.isfinite(after)]
        if min(len(before), len(after)) >= 3:
            found[k] = abs(float(np.median(after)) - float(np.median(before)))
    return found
