"""Correlations of the changes of tags at candidate clocks, and the votes of tags for a clock.

Water follows a fan or a load with a lag, so the changes of two tags are compared within 20 min. Two clocks half an hour
apart then go almost equally well, and the one that does so within 10 min is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.historian.defects.clocks.shift import Shift
from twin.historian.defects.panel import on_grid, upper_quartile
from twin.historian.defects.silence import LEAST_TAGS
from twin.historian.tags import Array, Series

STEP_S = 600.0
"""Step of the grid on which tags are compared, s."""
CHANGE_STEPS = 3
"""Steps over which a change counts: half an hour."""
LEAST_CHANGES = 100
"""Steps in which a tag must change: one that seldom does goes with some other tag by chance."""
MARGIN = 0.1
"""Least rise of the correlation; the spread between chance shifts is below 0.05 for a week of samples."""
LEAST = 0.25
"""Least correlation at the best shift: below it the tag goes with no other."""
LEAST_ALONE, MARGIN_ALONE = 0.5, 0.25
"""Least correlation and rise of a single tag, which no other tag of its interface confirms: a quarter of its variance
is that of another tag, and the rise is five times the spread between chance shifts."""
MOST_VOTES = 0.6
"""Share of the votes of an interface's tags that its clock must have."""
HALF_HOUR_S = 1800.0
LAGS, SHORT = 2, 1
"""Steps by which the changes of two tags may be apart, and those by which two clocks half an hour apart are judged."""


@dataclass
class Correlations:
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
    ) -> Correlations:
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
