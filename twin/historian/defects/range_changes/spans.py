"""Spans of a tag on another scale between its leaps, as defects or as changes of unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.historian.defects.panel import TagPanel
from twin.historian.defects.range_changes.maps import BACK, Leap
from twin.historian.defects.range_changes.readings import canonical
from twin.historian.defects.unit_evidence import is_of_the_unit
from twin.historian.defects.unit_switch import Switch, other_units, witnesses_of
from twin.historian.tags import Defect, Series
from twin.historian.units import unit_of

OF_A_UNIT = 0.04
"""Difference of a factor's logarithm from that between two units, up to which it is a unit's: what the laws of fans and
pumps leave open over days."""


@dataclass(frozen=True)
class OtherScale:
    """A span of a tag on another scale: times, and the map from its readings before."""

    start_s: float
    end_s: float
    factor: float
    constant: float


def scale_spans(series: Series, leaps: Sequence[Leap]) -> list[OtherScale]:
    """Return the spans between leaps in which the readings are on another scale than before the first."""
    found: list[OtherScale] = []
    factor, constant, since = 1.0, 0.0, 0.0
    in_order = sorted(leaps, key=lambda one: one.after_s)
    usual = float(np.median(canonical(series)[series.time_s < in_order[0].after_s])) if in_order else 0.0
    for leap in in_order:
        if (factor, constant) != (1.0, 0.0) and leap.before_s >= since:
            found.append(OtherScale(since, leap.before_s, factor, constant))
        total = factor * leap.factor, constant * leap.factor + leap.constant
        off, left = ((f - 1.0) * usual + c for f, c in ((factor, constant), total))
        back = off != 0.0 and abs(left) < BACK * abs(off)
        factor, constant = (1.0, 0.0) if back else total
        since = leap.after_s
    if (factor, constant) != (1.0, 0.0) and len(series.time_s):
        found.append(OtherScale(since, float(series.time_s[-1]), factor, constant))
    return found


def unit_of_span(table: TagPanel, k: int, span: OtherScale, full_speed: str) -> Switch | None:
    """Return a span as a change of unit if its factor is that between two units, of some the nearest.

    The table holds the readings of the tag mapped to those before its leaps.
    """
    series = table.series[k]
    own = unit_of(series.tag.unit)
    if span.constant != 0.0 or own.offset != 0.0:
        return None
    near = [
        (abs(float(np.log(span.factor * unit.scale / own.scale))), name, unit)
        for name, unit in other_units(series, full_speed).items()
        if unit.offset == 0.0
    ]
    # Of units that are alike, as L/s and kg/s, the first is of the tag's own kind.
    apart, name, unit = min(near, key=lambda one: round(one[0], 2), default=(np.inf, "", own))
    if apart > OF_A_UNIT:
        return None
    inside = (table.grid_s >= span.start_s) & (table.grid_s <= span.end_s)
    x = np.where(inside, span.factor * table.values[k], table.values[k])
    witnesses = witnesses_of(table, k, [j for j in range(len(table.series)) if j != k])
    if not is_of_the_unit(x, unit.scale / own.scale * x, inside, witnesses):
        return None
    says = f"{series.tag.name} is in {name} instead of {series.tag.unit}"
    return Switch(Defect("unit_switch", (series.tag.name,), span.start_s, span.end_s, says, "converted"), unit)


def defect_of(series: Series, span: OtherScale) -> Defect:
    unit = unit_of(series.tag.unit)
    # The map is of the record's unit; the store is corrected in the tag's own, whose zero may be another.
    own = (span.constant + (span.factor - 1.0) * unit.offset) / unit.scale
    times = f"{span.factor:.3g} times what it did" if span.factor != 1.0 else ""
    more = f"{abs(own):.3g} {series.tag.unit} {'more' if own > 0.0 else 'less'}" if own != 0.0 else ""
    says = f"{series.tag.name} reads "
    says += f"{times} and {more}" if times and more else times or f"{more} than it did"
    says += ", and no other tag shows it: its range was changed; correct the readings in the store"
    return Defect("range_change", (series.tag.name,), span.start_s, span.end_s, says, "left out")
