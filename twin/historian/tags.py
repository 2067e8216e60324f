"""Tags of a historian and their raw samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
GOOD = 192
"""OPC quality from which a sample is good (OPC DA 3.0, 6.8)."""


@dataclass(frozen=True)
class Tag:
    """A tag of the dictionary: its unit as written, its role, its cell (None: the whole station), its scan time in
    s."""

    name: str
    unit: str
    role: str
    cell: int | None = None
    scan_s: float = 60.0
    description: str = ""


@dataclass(frozen=True)
class Series:
    """Raw samples of a tag in the order of time: seconds since 1970 (UTC), value, quality code, arrays (n,).

    `holes (k, 2)` are times from and to, between which the value is not known though samples lie around: bad quality, a
    silent interface, a defect that was left out. Nothing is interpolated across them.
    """

    tag: Tag
    time_s: Array
    value: Array
    quality: NDArray[np.int16]
    holes: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def good(self) -> NDArray[np.bool_]:
        """Samples of good quality with a number."""
        return (self.quality >= GOOD) & np.isfinite(self.value)

    def usable(self) -> Series:
        """Return the good samples, one a time: of several with one time stamp the last that was stored.

        Runs of samples that are not good become holes.
        """
        order = np.argsort(self.time_s, kind="stable")
        time_s, good = self.time_s[order], self.good[order]
        holes = self.holes
        if not good.all():
            edge = np.diff(np.concatenate([[0], (~good).astype(np.int8), [0]]))
            first, after = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
            runs = np.stack([time_s[first], time_s[np.minimum(after, len(time_s) - 1)]], axis=1)
            holes = np.concatenate([holes, runs])
        rows = order[good]
        one = self.rows(rows)
        last = np.append(np.diff(one.time_s) > 0.0, True) if len(rows) else np.zeros(0, dtype=bool)
        return replace(one.rows(last), holes=holes)

    def rows(self, chosen: NDArray[Any]) -> Series:
        """Return the samples of these rows, by number or by mask."""
        return replace(self, time_s=self.time_s[chosen], value=self.value[chosen], quality=self.quality[chosen])

    def between(self, start_s: float, end_s: float) -> Series:
        """Return the samples from `start_s` to before `end_s`."""
        return self.rows((self.time_s >= start_s) & (self.time_s < end_s))

    def without(self, spans: Sequence[tuple[float, float]]) -> Series:
        """Return the series without the samples within the spans, which become holes."""
        if not len(spans):
            return self
        keep = np.ones(len(self.time_s), dtype=bool)
        for start, end in spans:
            low, high = np.searchsorted(self.time_s, (start, end), side="left")
            keep[low : np.searchsorted(self.time_s, end, side="right") if end > start else high] = False
        return replace(self.rows(keep), holes=np.concatenate([self.holes, np.asarray(spans, dtype=np.float64)]))

    def broken(self) -> NDArray[np.bool_]:
        """Return the intervals between neighbouring samples that a hole cuts (n - 1,)."""
        n = len(self.time_s) - 1
        cut = np.zeros(max(n, 0) + 1, dtype=np.int64)
        if n <= 0 or len(self.holes) == 0:
            return cut[:-1] > 0
        low = np.searchsorted(self.time_s, self.holes[:, 0], side="right") - 1
        high = np.searchsorted(self.time_s, self.holes[:, 1], side="left") - 1
        np.add.at(cut, np.clip(low, 0, n), 1)
        np.add.at(cut, np.clip(np.maximum(high, low) + 1, 0, n), -1)
        return np.asarray(np.cumsum(cut)[:-1] > 0)

    @cached_property
    def _intervals_s(self) -> Array:
        return np.diff(self.time_s)

    @cached_property
    def _broken(self) -> NDArray[np.bool_]:
        return self.broken()

    @cached_property
    def _longest_s(self) -> float:
        return _longest_of(self._intervals_s, self.tag.scan_s)

    def at(self, grid_s: Array, limit_s: float) -> Array:
        """Return linear interpolation at `grid_s (m,)`; NaN in holes and between samples more than `limit_s` apart."""
        if len(self.time_s) < 2:
            return np.full(len(grid_s), np.nan)
        found = np.interp(grid_s, self.time_s, self.value, left=np.nan, right=np.nan)
        interval = np.clip(np.searchsorted(self.time_s, grid_s, side="right") - 1, 0, len(self.time_s) - 2)
        wide = (self._intervals_s > limit_s) | self._broken
        exact = self.time_s[interval] == grid_s
        return np.asarray(np.where(wide[interval] & ~exact, np.nan, found))


@dataclass(frozen=True)
class Defect:
    """A defect of the record: kind, tags, seconds since 1970 from and to, and what was seen, as a sentence."""

    kind: str
    tags: tuple[str, ...]
    start_s: float
    end_s: float
    says: str
    repair: str = ""
    """Action of the alignment on it."""


def longest_interval_s(series: Series) -> float:
    """Return the longest regular interval between samples, s.

    A historian with exception reporting stores nothing while a value stands still, and a sample at the latest after a
    fixed time. So the intervals pile up there; longer ones are gaps. Without a pile it is the 99.5 % quantile.
    """
    return series._longest_s


def _longest_of(intervals: Array, scan_s: float) -> float:
    intervals = intervals[intervals > 0.0]
    if len(intervals) < 20:
        return 3.0 * scan_s
    far = float(np.quantile(intervals, 0.995))
    tail = intervals[intervals > 0.5 * far]
    # The pile: the scan before the fixed time is the last one that can be stored.
    bins = np.round(tail / max(scan_s, 60.0))
    values, counts = np.unique(bins, return_counts=True)
    pile = float(values[np.argmax(counts)] * max(scan_s, 60.0)) if counts.max() >= 0.3 * len(tail) else far
    return max(pile, far, 3.0 * scan_s) + scan_s
