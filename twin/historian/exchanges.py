"""Flow meters that read several times as much, or a fraction, from one day on: exchanged, or set to another range.

No pump moves the water of a cell by such a factor, and no unit of a meter has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.historian.tags import Array, Series
from twin.historian.units import alternatives, unit_of

DAY_S = 86400.0
FACTOR = 5.0
"""Factor that no operation of pumps makes: a cell is run between a quarter and one and a half of its design flow."""
STEADY = 2.0
"""Factor within which the days on either side are alike."""
BESIDE, FEWEST = 5, 2
"""Days on either side of the change that are compared, and the fewest of them."""
REST = 0.02
"""Share of the largest flow up to which a day is one of rest: a meter that reads a tenth is at work."""
OF_A_UNIT = 0.15
"""Difference in logarithm from the factor between two units, up to which a change is one of unit."""


@dataclass(frozen=True)
class Exchange:
    """A change of a meter: time, levels before and after as the dictionary's unit has them, and the wrong part."""

    time_s: float
    before: float
    after: float
    late_is_wrong: bool

    def right(self, series: Series) -> Series:
        """Return the samples of the part that is right."""
        return series.rows((series.time_s < self.time_s) == self.late_is_wrong)


def exchanged_meter(series: Series, design_kg_s: float | None) -> Exchange | None:
    """Return the change of a flow meter, None of one without.

    Parameters
    ----------
    series
        Raw samples of a water flow.
    design_kg_s
        Flow of the cell by its datasheet, which tells the wrong part; None: readings before count as right.
    """
    order = np.argsort(series.time_s, kind="stable")
    good = series.good[order]
    time_s, value = series.time_s[order][good], series.value[order][good]
    if not len(time_s):
        return None
    day = np.floor(time_s / DAY_S)
    days = np.unique(day)
    edges = np.append(np.searchsorted(day, days), len(day))
    level = np.array([np.quantile(value[a:b], 0.9) for a, b in zip(edges, edges[1:], strict=False)])
    work = np.flatnonzero(level > REST * level.max())
    if len(work) < 2 * FEWEST or level.max() <= 0.0:
        return None
    logs = np.log(level[work])
    best = min(range(FEWEST, len(work) - FEWEST + 1), key=lambda k: _scatter(logs, k))
    sides = _sides(logs, best)
    step = float(np.median(sides[1]) - np.median(sides[0]))
    alike = all(np.ptp(side[1:] if k else side[:-1]) <= np.log(STEADY) for k, side in enumerate(sides))
    own = unit_of(series.tag.unit)
    units = [np.log(unit.scale / own.scale) for unit in alternatives(series.tag.unit).values()]
    if abs(step) < np.log(FACTOR) or not alike or any(abs(abs(step) - abs(one)) < OF_A_UNIT for one in units):
        return None
    before, after = (float(np.exp(np.median(side))) for side in sides)
    near = (day >= days[work[best - 1]]) & (day <= days[work[best]])
    high = time_s[near & (value > np.sqrt(before * after))]
    at = float(high[0] if after > before else np.nextafter(high[-1], np.inf))
    late = True
    if design_kg_s:
        apart = [abs(np.log(own.scale * one / design_kg_s)) for one in (before, after)]
        late = apart[1] > apart[0]
    return Exchange(at, before, after, late)


def _sides(logs: Array, k: int) -> tuple[Array, Array]:
    """Return the levels of the days before and after one."""
    return logs[max(k - BESIDE, 0) : k], logs[k : k + BESIDE]


def _scatter(logs: Array, k: int) -> float:
    """Return how far the levels are off those of two sides, in sum."""
    return float(sum(np.abs(side - np.median(side)).sum() for side in (logs[:k], logs[k:])))
