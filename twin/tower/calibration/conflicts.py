"""Labels that contradict what is known of a cell without them.

The posterior is Gaussian, so what is known without a label follows from it by taking the label's own Gaussian off again
(its cavity). A label contradicts where its value, or the nearest bound of its interval, is off the cavity's mean by
more than happens in 1 % of records with as many labels. Two values of one quantity that contradict each other leave one
of them wrong, and nothing says which. The standard deviation is then multiplied by Birge's ratio, the root mean square
of the labels' distances in standard deviations. A single label gives its distance, so that the interval reaches both;
many labels that agree with the record show that it is the label that is wrong.

Values that all lie off by somewhat more than they should show an error of the twin itself that lasts, as one of its law
in cold weather does: a fit takes it for a deviation and leaves nothing of it in any residual. Its variance is what the
squared distances exceed their expectation by, as between the results of different laboratories.

Sources: Birge, Phys. Rev. 40 (1932) 207 (scale of inconsistent values); Opper & Winther, Neural Comput. 12 (2000) 2655
(cavity); DerSimonian & Laird, Control. Clin. Trials 7 (1986) 177 (variance between results).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from twin.tower.air import Array
from twin.tower.cell_observations import Label
from twin.tower.estimates import DAY_S, Estimate
from twin.tower.model import SLOW

CHANCE = 0.01
"""Share of records without a wrong label in which one contradicts."""
BEYOND = 2.576
"""Standard deviations beyond which 1 % of a normal distribution lies: from there two values contradict each other."""
LEAST = 0.05
"""Least precision of a cavity, as a share of the posterior's: below it the label alone decides."""
MEDIAN = 0.4549
"""Median of the squared distances, in variances: that of a chi-square distribution of one degree of freedom."""
AS_STATED = 2.0
"""Values as good as stated that count beside those of a record. A judgement."""
FEWEST = 4
"""Values below which no lasting error is told from chance. A judgement: a wrong one among three moves their median."""


@dataclass(frozen=True)
class LabelConflict:
    """A label, mean and standard deviation of its deviation without it, the distance in standard deviations, and
    another label of the deviation that it contradicts, None where it contradicts the record."""

    label: Label
    mean: float
    sd: float
    distance: float
    other: Label | None = None


class _Cavity(NamedTuple):
    """A label, mean and standard deviation of its deviation without it, and that of an error of it that lasts."""

    label: Label
    mean: float
    sd: float
    lasting: float

    @property
    def off(self) -> float:
        """Return the distance of the mean from the label's value or interval."""
        return max(self.label.low - self.mean, self.mean - self.label.high, 0.0)

    @property
    def expected(self) -> float:
        """Return the standard deviation of that distance."""
        return float(np.linalg.norm([self.sd, self.label.sd or 0.0, self.lasting]))

    @property
    def distance(self) -> float:
        """Return the distance of the mean from the label in standard deviations."""
        return self.off / self.expected


def _cavities(p: Estimate) -> list[_Cavity]:
    lasting = p.lasting if p.lasting.size else np.zeros(len(SLOW))
    variance, found = replace(p, lasting=np.zeros(0)).sd() ** 2, []
    for label, value, sd in p.label_sites:
        k, j = int(p.cells_at(np.array([label.time_s]))[0]), SLOW.index(label.parameter)
        mean, own = float(p.slow[k, j]), float(variance[k, j])
        precision = max(1.0 / own - 1.0 / sd**2, LEAST / own)
        found.append(_Cavity(label, (mean / own - value / sd**2) / precision, precision**-0.5, float(lasting[j])))
    return found


def with_lasting_errors(p: Estimate) -> Estimate:
    """Return the posterior with the errors that last for the record, as the values of its labels show them.

    Values that contradict the record beside such an error count as wrong, and are left out.
    """
    cavities, lasting = [one for one in _cavities(p) if one.label.sd], np.zeros(len(SLOW))
    for j, name in enumerate(SLOW):
        own = [one for one in cavities if one.label.parameter == name]
        if len(own) >= FEWEST:
            lasting[j] = _lasting_error(np.array([one.off for one in own]), np.array([one.expected for one in own]))
    return replace(p, lasting=lasting) if lasting.any() else p


def _lasting_error(off: Array, expected: Array) -> float:
    """Return the standard deviation beyond what distances `off` (n,) of values are `expected` to have (n,)."""
    # The median tells what is wrong, as long as less than half of the values are.
    excess = float(np.median(off**2 / MEDIAN - expected**2))
    sound = off <= BEYOND * np.sqrt(expected**2 + max(excess, 0.0))
    found = float((off[sound] ** 2 - expected[sound] ** 2).sum()) / (sound.sum() + AS_STATED)
    return float(np.sqrt(max(found, 0.0)))


def label_conflicts(p: Estimate, walk: Mapping[str, float]) -> tuple[LabelConflict, ...]:
    """Return the labels that contradict a posterior without them, in the order of time.

    Parameters
    ----------
    p
        Posterior with the Gaussians of its labels.
    walk
        Standard deviation of a day's change by deviation, for two labels of different times.
    """
    cavities = _cavities(p)
    limit = float(ndtri(1.0 - CHANCE / (2.0 * max(len(cavities), 1))))
    found = [
        LabelConflict(one.label, one.mean, float(np.hypot(one.sd, one.lasting)), one.distance)
        for one in cavities
        if one.distance > limit
    ]
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
    """Return the posterior with the standard deviations of contradicted deviations multiplied by Birge's ratio."""
    scale, cavities = np.ones(len(SLOW)), _cavities(p) if conflicts else []
    for name in {one.label.parameter for one in conflicts}:
        squares = [one.distance**2 for one in cavities if one.label.parameter == name]
        scale[SLOW.index(name)] = max(float(np.sqrt(np.mean(squares))), 1.0)
    return replace(p, widening=scale) if conflicts else p
