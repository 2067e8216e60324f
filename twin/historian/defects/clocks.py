"""Tags whose time stamps are local time, or off by hours, though they are said to be UTC.

The hypothesis is tested on the changes of a tag: shifted they must go better with the changes of tags of other
interfaces than as they stand. Candidates are the station's time zone with its changes of clock, and every half hour.
Water follows a fan or a load with a lag, so the changes of two tags are compared within 20 min. Two clocks half an hour
apart then go almost equally well, and the one that does so within 10 min is chosen.
"""

from __future__ import annotations

import datetime
import zoneinfo
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.historian.defects.clock_changes import ByChange, clock_changes, second_pass
from twin.historian.defects.panel import on_grid, upper_quartile
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
LEAST_ALONE, MARGIN_ALONE = 0.5, 0.25
"""Least correlation and rise of a single tag, which no other tag of its interface confirms: a quarter of its variance
is that of another tag, and the rise is five times the spread between chance shifts."""
HOURS = tuple(0.5 * half for half in range(-28, 29) if half)
"""Differences of two clocks that are tried, h: zones differ by whole and half hours. Of the few zones with three
quarters of one the nearest half hour is found."""
MOST_VOTES = 0.6
"""Share of the votes of an interface's tags that its clock must have."""
HALF_HOUR_S = 1800.0
LAGS, SHORT = 2, 1
"""Steps by which the changes of two tags may be apart, and those by which two clocks half an hour apart are told."""


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

    @property
    def needed(self) -> str:
        """The correction in words."""
        if self.zone is not None:
            return f"the zone {self.zone}"
        return f"{abs(self.add_s) / 3600.0:g} h {'more' if self.add_s > 0 else 'less'}"

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
    """Return the series with true times, in their order.

    The hour that local time goes through twice is told by the order of storing; where that does not show it, the two
    hours are a hole.
    """
    time_s = shift.to_utc(series.time_s)
    holes = shift.to_utc(series.holes.ravel()).reshape(-1, 2)
    if shift.zone is None or not len(time_s):
        return replace(series, time_s=time_s, holes=holes).rows(np.argsort(time_s, kind="stable"))
    unknown = []
    for change in clock_changes(shift.zone, float(time_s.min()), float(time_s.max())):
        if not change.back:
            continue
        low, high = change.stamps
        second = second_pass(series.time_s, change)
        if second is None:
            unknown.append((change.time_s - (high - low), change.time_s + (high - low)))
            continue
        stamp = series.time_s[second]
        time_s[second] += np.where((stamp >= low) & (stamp < high), high - low, 0.0)
    moved = replace(series, time_s=time_s, holes=holes).rows(np.argsort(time_s, kind="stable"))
    return moved.without(unknown)


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
    usable = [one for one in series if len(one.time_s) >= 50]
    if len(usable) < 3:
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
    correlations = _Correlations.of(usable, grid, candidates, label)
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
    correlations: _Correlations, known: frozenset[str], zones: int
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
    offset = _offset_s(np.arange(start, end, 86400.0), timezone, local=True)
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
    found: Sequence[tuple[Defect, Shift]], correlations: _Correlations, settled: frozenset[str]
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


@dataclass
class _Correlations:
    """Correlations (candidates, tags, tags) of each tag at each candidate clock with all tags as assumed now: the
    largest at lags of up to `LAGS`, and of up to `SHORT` (`close`)."""

    usable: Sequence[Series]
    grid: Array
    candidates: Sequence[Shift]
    label: NDArray[np.int_]
    lively: NDArray[np.bool_]
    value: Array
    close: Array

    @classmethod
    def of(
        cls, usable: Sequence[Series], grid: Array, candidates: Sequence[Shift], label: NDArray[np.int_]
    ) -> _Correlations:
        """Return the correlations with all tags as they stand."""
        stamped = np.stack([_changes(one, grid) for one in usable])
        # A tag that seldom changes goes with some other tag by chance.
        lively = np.count_nonzero(stamped, axis=1) >= LEAST_CHANGES
        value, close = np.zeros((2, len(candidates), len(usable), len(usable)))
        found = cls(usable, grid, candidates, label, lively, value, close)
        found._set(np.arange(len(usable)), stamped)
        return found

    def assume(self, ks: tuple[int, ...], clock: int) -> None:
        """Take a candidate clock as that of groups from now on."""
        columns = np.flatnonzero(np.isin(self.label, ks))
        stamps = self.candidates[clock].to_stamp(self.grid)
        self._set(columns, np.stack([_changes(self.usable[int(column)], stamps) for column in columns]))

    def _set(self, columns: NDArray[np.int_], reference: Array) -> None:
        courses = [_Course(one, self.grid, self.candidates) for one in self.usable]
        for at, shift in enumerate(self.candidates):
            moved = np.stack([one.changes(shift) for one in courses])
            self.value[at][:, columns], self.close[at][:, columns] = _correlations(moved, reference)

    def together(self) -> list[tuple[int, ...]]:
        """Return the sets of at most half of the tags whose groups go with one another as they stand.

        Groups with one wrong clock confirm each other, so that none of them is found by itself.
        """
        keys = sorted(set(self.label) - {-1})
        root = {key: key for key in keys}
        for k, first in enumerate(keys):
            for second in keys[k + 1 :]:
                rows, columns = (self.label == first) & self.lively, (self.label == second) & self.lively
                best = self.value[:, rows][:, :, columns].max(axis=(1, 2), initial=0.0)
                if best[0] >= LEAST and best.max() < best[0] + MARGIN:
                    old, new = root[second], root[first]
                    root = {key: new if value == old else value for key, value in root.items()}
        sets = [tuple(key for key in keys if root[key] == one) for one in sorted(set(root.values()))]
        return [one for one in sets if np.isin(self.label, one).sum() <= 0.5 * len(self.label)]

    def winner(self, ks: tuple[int, ...], zones: int) -> int:
        """Return the candidate for which most of the groups' tags vote; 0 where they have no clear majority."""
        own = np.isin(self.label, ks)
        rows = np.flatnonzero(own & self.lively)
        cast = [(vote, row) for row in rows.tolist() if (vote := self._vote(row, ~own, zones)) is not None]
        if not cast or len(cast) < LEAST_TAGS:
            return 0
        # A vote counts as the share of the tag's variance that its best partner has: of many clocks one goes by chance.
        weight = np.zeros(len(self.candidates))
        for vote, row in cast:
            weight[vote] += float(self.value[vote, row][~own].max()) ** 2
        most = int(np.argmax(weight))
        alike = self.beside(most)
        if weight[alike].sum() < MOST_VOTES * weight.sum():
            return 0
        close = self.close[:, own & self.lively][:, :, ~own].max(axis=2, initial=0.0).sum(axis=1)
        return max(alike, key=lambda candidate: float(close[candidate]))

    @property
    def near(self) -> list[int]:
        """Candidates half an hour from the clocks as they stand."""
        return [k for k, one in enumerate(self.candidates) if one.zone is None and abs(one.add_s) == HALF_HOUR_S]

    def _vote(self, row: int, others: NDArray[np.bool_], zones: int) -> int | None:
        """Return the candidate of a tag by its best correlation at each; None where it goes with no other tag.

        Lags of 20 min hide half an hour, so that these two candidates are held against short lags.
        """
        best, close = (one[:, row][:, others].max(axis=1, initial=0.0) for one in (self.value, self.close))
        vote = _vote(np.where(np.isin(np.arange(len(best)), self.near), 0.0, best), zones)
        nearest = max(self.near, key=lambda candidate: float(close[candidate]))
        if vote == 0 and close[nearest] >= close[0] + MARGIN:
            return nearest
        return vote

    def beside(self, candidate: int) -> list[int]:
        """Return a candidate and those fixed shifts that are half an hour from it; the station's zone is alone."""
        one = self.candidates[candidate]
        if one.zone is not None or not one.add_s:
            return [candidate]
        return [
            k
            for k, other in enumerate(self.candidates)
            if other.zone is None and other.add_s and abs(other.add_s - one.add_s) <= HALF_HOUR_S
        ]

    def assume_alone(self, row: int, clock: int) -> None:
        """Take a candidate clock as that of one tag from now on."""
        stamps = self.candidates[clock].to_stamp(self.grid)
        self._set(np.array([row]), _changes(self.usable[row], stamps)[None])

    def winner_alone(self, row: int, zones: int) -> int:
        """Return the candidate at which a tag goes clearly better with another one; 0 where there is none."""
        others = np.arange(len(self.usable)) != row
        best = self.value[:, row][:, others].max(axis=1, initial=0.0)
        vote = self._vote(row, others, zones)
        close = self.close[:, row][:, others].max(axis=1, initial=0.0)
        of_lags = close if vote in self.near else best
        if not vote or of_lags[vote] < max(LEAST_ALONE, of_lags[0] + MARGIN_ALONE):
            return 0
        return max(self.beside(vote), key=lambda candidate: float(close[candidate]))

    def partner(self, row: int) -> int:
        """Return the tag with which a tag goes best at any clock but its own."""
        best = self.value[1:, row].max(axis=0)
        best[row] = 0.0
        return int(np.argmax(best))

    def rise_alone(self, row: int, clock: int) -> float:
        """Return by how much a clock of a tag raises its correlations with all others, in sum."""
        others = (np.arange(len(self.usable)) != row) & self.lively
        return float((self.value[clock, row][others] - self.value[0, row][others]).sum())

    def rise(self, ks: tuple[int, ...], clock: int) -> float:
        """Return by how much a clock of groups raises their tags' correlations with the other groups, in sum.

        The best tag of each other group counts, so that going with one group at the expense of the others is no rise.
        Of half an hour lags up to `SHORT` count, as longer ones hide it.
        """
        rows = np.isin(self.label, ks) & self.lively
        rise, of_lags = 0.0, self.close if clock in self.near else self.value
        for other in set(self.label) - set(ks):
            best = of_lags[[clock, 0]][:, rows][:, :, self.label == other].max(axis=2)
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


class _Course:
    """Changes of a tag at the stamps that times `grid` have by some clocks.

    Clocks that differ by whole steps of the grid have most of their stamps in common: the tag is read once at all.
    """

    def __init__(self, series: Series, grid: Array, shifts: Sequence[Shift]) -> None:
        self.series, self.grid = series, grid
        added = [one.add_s for one in shifts if one.zone is None]
        self.first_s, last_s = float(grid[0]) - max(added), float(grid[-1]) - min(added)
        self.values = on_grid(series, np.arange(self.first_s, last_s + 0.5 * STEP_S, STEP_S))

    def changes(self, shift: Shift) -> Array:
        """Return the bounded changes (m,) by one of the clocks."""
        if shift.zone is not None:
            return _changes(self.series, shift.to_stamp(self.grid))
        first = round((float(self.grid[0]) - shift.add_s - self.first_s) / STEP_S)
        return _bounded_changes(self.values[first : first + len(self.grid)])


def _changes(series: Series, stamps: Array) -> Array:
    """Return bounded changes over half an hour (m,), standardised; 0 where unknown."""
    return _bounded_changes(on_grid(series, stamps))


def _bounded_changes(x: Array) -> Array:
    change = np.zeros(len(x))
    change[CHANGE_STEPS:] = x[CHANGE_STEPS:] - x[:-CHANGE_STEPS]
    change[~np.isfinite(change)] = 0.0
    size = np.abs(change[change != 0.0])
    if len(size) == 0:
        return change
    limit = 3.0 * upper_quartile(size)  # so that a start-up does not weigh like a week
    change = np.minimum(np.maximum(change, -limit), limit)
    change -= change.mean()
    scale = float(np.sqrt((change**2).mean()))
    return np.asarray(change / scale if scale > 0.0 else change)


def _correlations(moved: Array, reference: Array) -> tuple[Array, Array]:
    """Return the largest absolute correlations at lags of up to `LAGS` and of up to `SHORT` either way, tags by
    tags."""
    m = reference.shape[1]
    best, close = np.zeros((2, len(moved), len(reference)))
    for lag in range(-LAGS, LAGS + 1):
        x, y = (moved[:, lag:], reference[:, : m - lag]) if lag >= 0 else (moved[:, :lag], reference[:, -lag:])
        found = np.abs(x @ y.T) / m
        best = np.maximum(best, found)
        if abs(lag) <= SHORT:
            close = np.maximum(close, found)
    return best, close
