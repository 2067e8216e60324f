"""Tags whose time stamps are local time, or off by hours, though they are said to be UTC.

The hypothesis is tested on the changes of a tag: shifted they must go better with the changes of tags of other
interfaces than as they stand. Candidates are the station's time zone with its changes of clock, and every half hour.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.defects.clocks.changes import ByChange
from twin.historian.defects.clocks.correlations import MARGIN, MARGIN_ALONE, STEP_S, Correlations
from twin.historian.defects.clocks.shift import Shift, offset_s
from twin.historian.defects.silence import LEAST_TAGS, Group
from twin.historian.tags import Defect, Series

LEAST_ROWS = 300
"""Steps of the grid in a record that is judged: two days."""
LEAST_SAMPLES, FEWEST_USABLE = 50, 3
"""Samples of a tag that is judged, and tags of a record: with two nobody knows which is right."""
HOURS = tuple(0.5 * half for half in range(-28, 29) if half)
"""Differences of two clocks that are tried, h: zones differ by whole and half hours. Of the few zones with three
quarters of one the nearest half hour is found."""


@dataclass(frozen=True)
class Clocks:
    """Wrong clocks: a defect for each with its correction, and sentences on what could not be decided."""

    found: tuple[tuple[Defect, Shift], ...] = ()
    remarks: tuple[str, ...] = ()


def shifted_clocks(
    series: Sequence[Series], groups: Sequence[Group], timezone: str | None, settled: frozenset[str] = frozenset()
) -> Clocks:
    """Return the groups of tags, and then the single tags, whose clock is wrong by their changes.

    The clock that most tags have is taken as right, unless the others lead by the offset of the station's zone: then
    the many are in local time. Clocks are corrected one after the other, and each is tested against the tags as
    corrected so far: a right clock that goes with a wrong one must not be moved to it.

    Parameters
    ----------
    series
        Usable samples.
    groups
        Tags by interface.
    timezone
        Of the station, IANA.
    settled
        Tags whose clock is known from its changes.
    """
    usable = [one for one in series if len(one.time_s) >= LEAST_SAMPLES]
    if len(usable) < FEWEST_USABLE:
        return Clocks()
    start, end = min(one.time_s[0] for one in usable), max(one.time_s[-1] for one in usable)
    grid = np.arange(np.ceil(start / STEP_S) * STEP_S, end, STEP_S)
    if len(grid) < LEAST_ROWS:
        return Clocks()
    zone = [Shift(timezone)] if timezone is not None else []
    candidates = [Shift(), *zone, *(Shift(add_s=3600.0 * hour) for hour in HOURS)]
    # What is known of some tags of an interface holds for these: the others of it are compared with them.
    parts = [Group(tuple(n for n in one.tags if (n in settled) == known)) for one in groups for known in (False, True)]
    groups = [one for one in parts if one.tags]
    group_of = {name: k for k, group in enumerate(groups) for name in group.tags}
    label = np.array([group_of.get(one.tag.name, -1) for one in usable])
    correlations = Correlations.of(usable, grid, candidates, label)
    open_groups = [
        k
        for k, group in enumerate(groups)
        if LEAST_TAGS <= len(group.tags) <= 0.5 * len(usable) and not set(group.tags) <= settled
    ]
    found = []
    while open_groups:
        sets: list[tuple[int, ...]] = [(k,) for k in open_groups]
        sets += [one for one in correlations.together() if len(one) > 1 and set(one) <= set(open_groups)]
        wrong = [(ks, winner) for ks in sets if (winner := correlations.winner(ks, len(zone)))]
        rise, chosen, winner = max(
            ((correlations.rise(ks, winner), ks, winner) for ks, winner in wrong), default=(0.0, (), 0)
        )
        if rise <= 0.0:
            break
        correlations.assume(chosen, winner)
        open_groups = [k for k in open_groups if k not in chosen]
        names = Group(tuple(name for k in chosen for name in groups[k].tags))
        members = [one for one in usable if one.tag.name in names.tags]
        found.append((_defect(names, members, candidates[winner]), candidates[winner]))
    known = settled | {name for defect, _ in found for name in defect.tags}
    single, remarks = _single_tags(correlations, known, len(zone))
    found += [(_defect(Group((one.tag.name,)), [one], candidates[c]), candidates[c]) for one, c in single]
    found = _many_in_local_time(found, usable, timezone, settled)
    return Clocks(tuple(found), (*remarks, *_no_majority(found, correlations, settled)))


def _single_tags(
    correlations: Correlations, known: frozenset[str], zones: int
) -> tuple[list[tuple[Series, int]], list[str]]:
    """Return the single tags whose clock is wrong with their candidate, and a sentence for pairs that may be either.

    The clock of a tag whose correction raises its correlations with all other groups most is corrected first. Where
    the correction of another tag, by as many hours the other way, raises them as much, it may be either of the two.
    """
    usable, candidates = correlations.usable, correlations.candidates
    open_tags = [k for k, one in enumerate(usable) if one.tag.name not in known and correlations.lively[k]]
    chosen: list[tuple[Series, int]] = []
    remarks: list[str] = []
    while open_tags:
        wrong = [(correlations.rise_alone(k, c), k, c) for k in open_tags if (c := correlations.winner_alone(k, zones))]
        rise, k, c = max(wrong, default=(0.0, 0, 0))
        if rise < MARGIN_ALONE:
            break
        rival = next((j for other, j, _ in wrong if j != k and other > rise - MARGIN), None)
        open_tags.remove(k)
        if rival is not None and correlations.partner(rival) == k:
            open_tags.remove(rival)
            remarks.append(
                f"the clocks of {usable[k].tag.name} and {usable[rival].tag.name} differ: one needs "
                f"{candidates[c].needed}; no other tag shows which is right, and both are left as they are"
            )
            continue
        correlations.assume_alone(k, c)
        chosen.append((usable[k], c))
    return chosen, remarks


def _many_in_local_time(
    found: list[tuple[Defect, Shift]], usable: Sequence[Series], timezone: str | None, settled: frozenset[str]
) -> list[tuple[Defect, Shift]]:
    """Return the corrections with the many in local time where the few lead them by the offset of the zone.

    A logger that is fast by just the zone's offset is less usual than a plant that records in local time beside a
    service that records in UTC.
    """
    if timezone is None or settled or any(shift.zone is not None for _, shift in found):
        return found
    start, end = min(one.time_s[0] for one in usable), max(one.time_s[-1] for one in usable)
    offset = offset_s(np.arange(start, end, 86400.0), timezone, local=True)
    ahead = [shift.add_s for _, shift in found if shift.add_s and (offset == shift.add_s).all()]
    if not ahead:
        return found
    moved = {name for defect, _ in found for name in defect.tags}
    rest = [one for one in usable if one.tag.name not in moved]
    turned = [
        (replace(defect, says=f"{len(defect.tags)} tags have time stamps {shift}"), shift)
        for defect, old in found
        if (shift := Shift(add_s=old.add_s - ahead[0])).add_s
    ]
    local = Shift(timezone)
    return [(_defect(Group(tuple(one.tag.name for one in rest)), rest, local), local), *turned]


def _no_majority(
    found: Sequence[tuple[Defect, Shift]], correlations: Correlations, settled: frozenset[str]
) -> list[str]:
    """Return a sentence where fewer than half of the tags have the clock that was taken as right."""
    moved = {name for defect, _ in found for name in defect.tags}
    judged = [one.tag.name for one, alive in zip(correlations.usable, correlations.lively, strict=True) if alive]
    agree = [name for name in judged if name not in moved]
    if not moved or settled or 2 * len(agree) > len(judged):
        return []
    return [
        f"only {len(agree)} of {len(judged)} tags have the clock that was taken as UTC ({', '.join(agree[:3])}); no "
        f"majority has one clock: check these tags against an event of known time"
    ]


def _defect(group: Group, members: Sequence[Series], shift: Shift) -> Defect:
    """Return the defect of a group whose stamps need a shift, over its samples' true times."""
    low = min(float(shift.to_utc(one.time_s[:1])[0]) for one in members)
    high = max(float(shift.to_utc(one.time_s[-1:])[0]) for one in members)
    kind = "local_time" if shift.zone is not None else "clock_offset"
    count = f"{len(group.tags)} tags have" if len(group.tags) > 1 else f"{group.tags[0]} has"
    says = f"{count} time stamps {'in ' if shift.zone else ''}{shift}"
    return Defect(kind, group.tags, low, high, says, "shifted to UTC")


def changed_clocks(by_change: ByChange, series: Sequence[Series], timezone: str) -> list[tuple[Defect, Shift]]:
    """Return the defect of the tags in local time by its changes of clock, and their correction."""
    members = [one for one in series if one.tag.name in by_change.local and len(one.time_s)]
    if not members:
        return []
    shift = Shift(timezone)
    defect = _defect(Group(tuple(one.tag.name for one in members)), members, shift)
    days = [datetime.datetime.fromtimestamp(c.time_s, datetime.UTC).strftime("%Y-%m-%d") for c in by_change.changes]
    shown = ", ".join(days[:2]) + (f" and {len(days) - 2} more" if len(days) > 2 else "")
    return [(replace(defect, says=f"{defect.says}, as its change of clock shows ({shown})"), shift)]
