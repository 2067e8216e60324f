"""Tags that read on another scale from one sample to the next: a transmitter that was given another range.

Such a jump has no factor of a unit. It is told from a step of the plant by three kinds of evidence, which must agree:

* the tag leaps between two samples, and the other tags show nothing unusual within an hour (a step of the plant moves
  its redundant measurements, a command or a state);
* over days, one map (times a factor, or plus a constant) makes the readings after the leap go with the prediction by
  the other tags, and as they stand they do not;
* the prediction without the leap, in which the other tags may explain it, is worse by a large share of it.

Plants start and stop at any hour. So the first is not needed where the other two are decisive: by one map the readings
of days go several times better with the tags that moved, too. Nor is it where no sample shows the leap, since the tag
was at rest or silent: the last reading at work before and the first one after are then its sides.

A leap by the factor between two units is a change of unit, whatever hid it from the search for these.

Sizes that the plant's own faults have are no change of range: the bias of a thermometer, the pitch of a fan's blades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.defects.panel import SMALLEST_WORK, TagPanel, on_grid, panel
from twin.historian.defects.range_changes.candidates import MOST, leap_candidates, splits_best
from twin.historian.defects.range_changes.judgement import judged_leap, others_moved, return_map, unusual_changes
from twin.historian.defects.range_changes.maps import Leap
from twin.historian.defects.range_changes.readings import FANS, WITNESSED, is_ratio, law_ratio, related
from twin.historian.defects.range_changes.spans import defect_of, scale_spans, unit_of_span
from twin.historian.defects.unit_switch import Switch
from twin.historian.tags import Array, Defect, Series
from twin.historian.units import unit_of


@dataclass(frozen=True)
class RangeChanges:
    """Spans in which tags read on another scale: of the kind `range_change`, and those whose scale is of a unit.

    `mapped`: all series, with the readings of these spans on the scale that they had before.
    """

    ranges: tuple[Defect, ...]
    units: tuple[Switch, ...]
    mapped: tuple[Series, ...]

    @property
    def defects(self) -> list[Defect]:
        """Both."""
        return [*self.ranges, *(one.defect for one in self.units)]


def range_changes(
    series: Sequence[Series], roles: frozenset[str] = WITNESSED | {*FANS}, full_speed: str = "60 Hz"
) -> RangeChanges:
    """Return the spans in which tags read on another scale than before.

    The readings before the first leap of a tag are taken as right.

    Parameters
    ----------
    series
        Good samples of the tags in the units of the dictionary, without changes of unit and stuck values.
    roles
        Of the tags that are judged; all of them are witnesses.
    full_speed
        Speed of a fan at 100 %, with its unit: a share and a frequency are units of one quantity.
    """
    table = panel(series)
    leaps: dict[int, list[Leap]] = {k: [] for k, one in enumerate(table.series) if one.tag.role in roles}
    judged: dict[int, list[Leap]] = {}
    anew = [k for k in leaps if leap_candidates(table, k)]
    for _ in range(MOST):
        unusual = unusual_changes(table)
        judged |= {k: _borne_out(table, k, leaps[k], unusual) for k in anew}
        surest = min(
            ((leap.hidden, leap.doubt, k, leap) for k, found in judged.items() for leap in found),
            key=lambda one: one[:3],
            default=None,
        )
        if surest is None:
            break
        # Leaps that the samples show, and of them the surest, come first: with its readings mapped, the leaps of the
        # tags that they predict are judged anew.
        _, _, k, leap = surest
        leaps[k].append(leap)
        table = _mapped(table, k, leap)
        anew = [j for j in judged if related(table, j, k)]
    spans = [(k, one) for k, found in leaps.items() for one in scale_spans(table.series[k], found)]
    units = {id(span): unit_of_span(table, k, span, full_speed) for k, span in spans}
    return RangeChanges(
        tuple(defect_of(table.series[k], span) for k, span in spans if units[id(span)] is None),
        tuple(switch for switch in units.values() if switch is not None),
        table.series,
    )


def _borne_out(table: TagPanel, k: int, before: Sequence[Leap], unusual: Array) -> list[Leap]:
    """Return the leaps of a tag that the other tags bear out, beside those that were found before."""
    found = []
    candidates = leap_candidates(table, k)
    if not candidates:
        return []
    rest = SMALLEST_WORK * float(np.nanquantile(np.abs(table.values[k]), 0.95)) if is_ratio(table.series[k]) else None
    ratio = law_ratio(table, k) if table.series[k].tag.role in FANS else np.zeros(0)
    for at in candidates:
        if any(leap.before_s == table.series[k].time_s[at.row] for leap in before):
            continue
        if len(ratio) and not splits_best(table.series[k], ratio, at, candidates):
            continue
        back = return_map(table, k, at, before)
        alone = not at.hidden and not others_moved(table, k, float(table.series[k].time_s[at.after]), unusual)
        leap = judged_leap(table, k, at, before, back, rest, alone=alone or back is not None)
        if leap is not None:
            found.append(leap)
    return found


def _mapped(table: TagPanel, k: int, leap: Leap) -> TagPanel:
    """Return the table with a tag's readings after a leap mapped to those before it."""
    one = table.series[k]
    unit = unit_of(one.tag.unit)
    again = ((unit.scale * one.value + unit.offset - leap.constant) / leap.factor - unit.offset) / unit.scale
    mapped = replace(
        one,
        value=np.where(one.time_s >= leap.after_s, again, one.value),
        holes=np.concatenate([one.holes, [[leap.after_s, leap.after_s]]]),
    )
    values = table.values.copy()
    values[k] = on_grid(mapped, table.grid_s)
    return TagPanel((*table.series[:k], mapped, *table.series[k + 1 :]), table.grid_s, values)
