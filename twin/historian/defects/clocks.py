"""Tags whose time stamps are local time, or off by hours, though they are said to be UTC.

The hypothesis is tested on the changes of a tag: shifted they must go better with the changes of tags of other
interfaces than as they stand. Candidates are the station's time zone with its changes of clock, and every whole hour.
"""

from __future__ import annotations

import datetime
import zoneinfo
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.historian.defects.panel import on_grid
from twin.historian.defects.silence import LEAST_TAGS, Group
from twin.historian.tags import Array, Defect, Series

STEP_S = 600.0
CHANGE_STEPS = 3
LEAST_ROWS = 300
LEAST_CHANGES = 100
MARGIN = 0.1
"""Least rise of the correlation; the spread between chance shifts is below 0.05 for a week of samples."""
LEAST = 0.25
"""Least correlation at the best shift: below it the tag goes with no other."""
HOURS = tuple(hour for hour in range(-14, 15) if hour)


@dataclass(frozen=True)
class Shift:
    """Correction of a clock: from local time of a zone, or by a fixed number of seconds to add."""

    zone: str | None = None
    add_s: float = 0.0

    def to_utc(self, stamp_s: Array) -> Array:
        """Return true times of stamps (n,). The hour that comes twice is taken as its first."""
        return stamp_s + self.add_s if self.zone is None else stamp_s - _offset_s(stamp_s, self.zone, local=True)

    def to_stamp(self, utc_s: Array) -> Array:
        """Return the stamps that true times have (n,)."""
        return utc_s - self.add_s if self.zone is None else utc_s + _offset_s(utc_s, self.zone, local=False)

    def __str__(self) -> str:
        if self.zone is not None:
            return f"local time of {self.zone}"
        return f"{abs(self.add_s) / 3600.0:g} h {'behind' if self.add_s > 0 else 'ahead of'} the other tags"


def _offset_s(times_s: Array, zone: str, *, local: bool) -> Array:
    """Return local time minus UTC at times that are local or UTC, by the hour, s."""
    info = zoneinfo.ZoneInfo(zone)
    hours, inverse = np.unique(np.floor(times_s / 3600.0), return_inverse=True)
    offsets = np.empty(len(hours))
    for k, hour in enumerate(hours):
        moment = datetime.datetime.fromtimestamp(float(hour) * 3600.0, datetime.UTC)
        moment = moment.replace(tzinfo=info) if local else moment.astimezone(info)
        offset = moment.utcoffset()
        offsets[k] = offset.total_seconds() if offset is not None else 0.0
    return np.asarray(offsets[inverse])


def repeated_hours(start_s: float, end_s: float, zone: str) -> list[tuple[float, float]]:
    """Return the spans (UTC) of two hours in which local time goes through one hour twice."""
    hours = np.arange(np.floor(start_s / 3600.0), np.ceil(end_s / 3600.0) + 1.0) * 3600.0
    offset = _offset_s(hours, zone, local=False)
    back = np.flatnonzero(np.diff(offset) < 0.0)
    return [(float(hours[k + 1] + np.diff(offset)[k]), float(hours[k + 1] - np.diff(offset)[k])) for k in back]


def corrected(series: Series, shift: Shift) -> Series:
    """Return the series with true times, in their order; the hours that local time cannot name are holes."""
    time_s = shift.to_utc(series.time_s)
    order = np.argsort(time_s, kind="stable")
    moved = replace(series, time_s=time_s, holes=shift.to_utc(series.holes.ravel()).reshape(-1, 2)).rows(order)
    if shift.zone is None or not len(time_s):
        return moved
    return moved.without(repeated_hours(float(time_s.min()), float(time_s.max()), shift.zone))


def shifted_clocks(
    series: Sequence[Series], groups: Sequence[Group], timezone: str | None
) -> list[tuple[Defect, Shift]]:
    """Return a defect for each group of tags whose clock is wrong, and its correction.

    The clock that most tags have is taken as right. Where that is the local one, the others lead by the offset.
    Clocks are corrected one after the other, and each is tested against the tags as corrected so far: a right clock
    that goes with a wrong one must not be moved to it.
    """
    usable = [one for one in series if len(one.time_s) >= 50]
    if len(usable) < 3:
        return []
    start, end = min(one.time_s[0] for one in usable), max(one.time_s[-1] for one in usable)
    grid = np.arange(np.ceil(start / STEP_S) * STEP_S, end, STEP_S)
    if len(grid) < LEAST_ROWS:
        return []
    zone = [Shift(timezone)] if timezone is not None else []
    candidates = [Shift(), *zone, *(Shift(add_s=3600.0 * hour) for hour in HOURS)]
    group_of = {name: k for k, group in enumerate(groups) for name in group.tags}
    label = np.array([group_of.get(one.tag.name, -1) for one in usable])
    correlations = _Correlations.of(usable, grid, candidates, label)
    open_groups = [
        k for k, group in enumerate(groups) if len(group.tags) >= LEAST_TAGS and len(group.tags) <= 0.5 * len(usable)
    ]
    found = []
    while open_groups:
        wrong = [(k, winner) for k in open_groups if (winner := correlations.winner(k, groups[k], len(zone)))]
        rise, k, winner = max(((correlations.rise(k, winner), k, winner) for k, winner in wrong), default=(0.0, 0, 0))
        if rise <= 0.0:
            break
        correlations.assume(k, winner)
        open_groups.remove(k)
        members = [one for one in usable if group_of.get(one.tag.name) == k]
        found.append((_defect(groups[k], members, candidates[winner]), candidates[winner]))
    return found


def _defect(group: Group, members: Sequence[Series], shift: Shift) -> Defect:
    """Return the defect of a group whose stamps need a shift, over its samples' true times."""
    low = min(float(shift.to_utc(one.time_s[:1])[0]) for one in members)
    high = max(float(shift.to_utc(one.time_s[-1:])[0]) for one in members)
    kind = "local_time" if shift.zone is not None else "clock_offset"
    says = f"{len(group.tags)} tags have time stamps {'in ' if shift.zone else ''}{shift}"
    return Defect(kind, group.tags, low, high, says, "shifted to UTC")


@dataclass
class _Correlations:
    """Correlations (candidates, tags, tags) of each tag at each candidate clock with all tags as assumed now."""

    usable: Sequence[Series]
    grid: Array
    candidates: Sequence[Shift]
    label: NDArray[np.int_]
    lively: NDArray[np.bool_]
    value: Array

    @classmethod
    def of(
        cls, usable: Sequence[Series], grid: Array, candidates: Sequence[Shift], label: NDArray[np.int_]
    ) -> _Correlations:
        """Return the correlations with all tags as they stand."""
        stamped = np.stack([_changes(one, grid) for one in usable])
        # A tag that seldom changes goes with some other tag by chance.
        lively = np.count_nonzero(stamped, axis=1) >= LEAST_CHANGES
        found = cls(usable, grid, candidates, label, lively, np.zeros((len(candidates), len(usable), len(usable))))
        found._set(np.arange(len(usable)), stamped)
        return found

    def assume(self, k: int, clock: int) -> None:
        """Take a candidate clock as that of a group from now on."""
        columns = np.flatnonzero(self.label == k)
        stamps = self.candidates[clock].to_stamp(self.grid)
        self._set(columns, np.stack([_changes(self.usable[int(column)], stamps) for column in columns]))

    def _set(self, columns: NDArray[np.int_], reference: Array) -> None:
        for at, shift in enumerate(self.candidates):
            stamps = shift.to_stamp(self.grid)
            moved = np.stack([_changes(one, stamps) for one in self.usable])
            self.value[at][:, columns] = _correlations(moved, reference)

    def winner(self, k: int, group: Group, zones: int) -> int:
        """Return the candidate for which most of the group's tags vote; 0 where they have no clear majority."""
        best = self.value[:, (self.label == k) & self.lively][:, :, self.label != k].max(axis=2, initial=0.0)
        cast = [vote for vote in (_vote(best[:, row], zones) for row in range(best.shape[1])) if vote is not None]
        if not cast or len(cast) < min(2, len(group.tags)):
            return 0
        most = max(set(cast), key=cast.count)
        return most if cast.count(most) >= max(1.0, 0.6 * len(cast)) else 0

    def rise(self, k: int, clock: int) -> float:
        """Return by how much a clock of a group raises its tags' correlations with the other groups, in sum.

        The best tag of each other group counts, so that going with one group at the expense of the others is no rise.
        """
        rows = (self.label == k) & self.lively
        rise = 0.0
        for other in set(self.label) - {k}:
            best = self.value[[clock, 0]][:, rows][:, :, self.label == other].max(axis=2)
            rise += float((best[0] - best[1]).sum())
        return rise


def _vote(best: Array, zones: int) -> int | None:
    """Return the candidate of a tag by its best correlation at each; None where it goes with no other tag."""
    if best.max() < LEAST:
        return None
    order = int(np.argmax(best))
    if best[order] < best[0] + MARGIN:
        return 0
    # A fixed offset that equals the zone's of the season fits as well as the zone: the zone is the usual cause.
    return 1 if zones and best[1] > best[order] - 0.5 * MARGIN else order


def _changes(series: Series, stamps: Array) -> Array:
    """Return bounded changes over half an hour (m,), standardised; 0 where unknown."""
    x = on_grid(series, stamps)
    change = np.zeros(len(x))
    change[CHANGE_STEPS:] = x[CHANGE_STEPS:] - x[:-CHANGE_STEPS]
    change = np.where(np.isfinite(change), change, 0.0)
    size = np.abs(change[change != 0.0])
    if len(size) == 0:
        return change
    limit = 3.0 * float(np.quantile(size, 0.75))  # so that a start-up does not weigh like a week
    change = np.clip(change, -limit, limit)
    change -= change.mean()
    scale = float(np.sqrt((change**2).mean()))
    return np.asarray(change / scale if scale > 0.0 else change)


def _correlations(moved: Array, reference: Array) -> Array:
    """Return the largest absolute correlation at lags of up to 20 minutes either way, tags by tags."""
    m = reference.shape[1]
    best = np.zeros((len(moved), len(reference)))
    for lag in (-2, -1, 0, 1, 2):
        x, y = (moved[:, lag:], reference[:, : m - lag]) if lag >= 0 else (moved[:, :lag], reference[:, -lag:])
        best = np.maximum(best, np.abs(x @ y.T) / m)
    return best
