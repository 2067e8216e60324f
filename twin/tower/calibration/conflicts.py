"""Labels that contradict what is known of a cell without them.

The posterior is Gaussian, so what is known without a label follows from it by taking the label's own Gaussian off again
(its cavity). A label contradicts where its value, or the nearest bound of its interval, is off the cavity's mean by
more than 1 % of such labels are. Two values of one quantity that contradict each other leave one of them wrong, and
nothing says which. The standard deviation is then multiplied by their distance in standard deviations, so that the
interval reaches both.

Sources: Birge, Phys. Rev. 40 (1932) 207 (scale of inconsistent values); Opper & Winther, Neural Comput. 12 (2000) 2655
(cavity).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from twin.tower.cell_observations import Label
from twin.tower.estimates import DAY_S, Estimate
from twin.tower.model import SLOW

BEYOND = 2.576
"""Standard deviations beyond which 1 % of a normal distribution lies."""
LEAST = 0.05
"""Least precision of a cavity, as a share of the posterior's: below it the label alone decides."""


@dataclass(frozen=True)
class LabelConflict:
    """A label, mean and standard deviation of its deviation without it, the distance in standard deviations, and
    another label of the deviation that it contradicts, None where it contradicts the record."""

    label: Label
    mean: float
    sd: float
    distance: float
    other: Label | None = None


def label_conflicts(p: Estimate, walk: Mapping[str, float]) -> tuple[LabelConflict, ...]:
    """Return the labels that contradict a posterior without them, in the order of time.

    Parameters
    ----------
    p
        Posterior with the Gaussians of its labels.
    walk
        Standard deviation of a day's change by deviation, for two labels of different times.
    """
    variance, found = p.sd() ** 2, []
    for label, value, sd in p.label_sites:
        k, j = int(p.cells_at(np.array([label.time_s]))[0]), SLOW.index(label.parameter)
        mean, own = float(p.slow[k, j]), float(variance[k, j])
        precision = max(1.0 / own - 1.0 / sd**2, LEAST / own)
        without, spread = (mean / own - value / sd**2) / precision, precision**-0.5
        off = max(label.low - without, without - label.high, 0.0)
        distance = off / float(np.hypot(spread, label.sd or 0.0))
        if distance > BEYOND:
            found.append(LabelConflict(label, without, spread, distance))
    found.sort(key=lambda one: one.label.time_s)
    return tuple(replace(one, other=_contradicted(one, found, walk)) for one in found)


def _contradicted(one: LabelConflict, found: list[LabelConflict], walk: Mapping[str, float]) -> Label | None:
    """Return the nearest label in time that contradicts another one by itself."""
    a = one.label
    others = [o.label for o in found if o is not one and o.label.parameter == a.parameter]
    for b in sorted(others, key=lambda o: abs(o.time_s - a.time_s)):
        apart = max(a.low - b.high, b.low - a.high, 0.0)
        moved = walk[a.parameter] ** 2 * abs(a.time_s - b.time_s) / DAY_S
        if apart > BEYOND * float(np.sqrt((a.sd or 0.0) ** 2 + (b.sd or 0.0) ** 2 + moved)):
            return b
    return None


def widened(p: Estimate, conflicts: tuple[LabelConflict, ...]) -> Estimate:
    """Return the posterior with the standard deviations of contradicted deviations multiplied by the distance."""
    scale = np.ones(len(SLOW))
    for one in conflicts:
        j = SLOW.index(one.label.parameter)
        scale[j] = max(scale[j], one.distance)
    return replace(p, widening=scale) if conflicts else p
