"""Tags of a historian and their raw samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GOOD = 192
"""OPC quality from which a sample is good (OPC DA 3.0, 6.8)."""


@dataclass(frozen=True)
class Tag:
    """A tag of the dictionary: its unit as written, its role, its cell (None: the whole station), its scan time in s."""

    name: str
    unit: str
    role: str
    cell: int | None = None
    scan_s: float = 60.0
    description: str = ""


@dataclass(frozen=True)
class Series:
    """Raw samples of a tag in the order of time: seconds since 1970 (UTC), value, quality code, arrays (n,)."""

    tag: Tag
    time_s: Array
    value: Array
    quality: NDArray[np.int16]

    @property
    def good(self) -> NDArray[np.bool_]:
        """Samples of good quality with a number."""
        return (self.quality >= GOOD) & np.isfinite(self.value)

    def usable(self) -> Series:
        """Return the good samples, one a time: of several with one time stamp the last that was stored."""
        keep = self.good
        time_s, value, quality = self.time_s[keep], self.value[keep], self.quality[keep]
        order = np.argsort(time_s, kind="stable")
        time_s, value, quality = time_s[order], value[order], quality[order]
        last = np.append(np.diff(time_s) > 0.0, True) if len(time_s) else np.zeros(0, dtype=bool)
        return replace(self, time_s=time_s[last], value=value[last], quality=quality[last])

    def between(self, start_s: float, end_s: float) -> Series:
        """Return the samples from `start_s` to before `end_s`."""
        rows = (self.time_s >= start_s) & (self.time_s < end_s)
        return replace(self, time_s=self.time_s[rows], value=self.value[rows], quality=self.quality[rows])

    def at(self, grid_s: Array, limit_s: float) -> Array:
        """Return linear interpolation at `grid_s (m,)`; NaN where the samples around are more than `limit_s` apart."""
        if len(self.time_s) == 0:
            return np.full(len(grid_s), np.nan)
        after = np.searchsorted(self.time_s, grid_s, side="left")
        before = np.maximum(after - 1, 0)
        after = np.minimum(after, len(self.time_s) - 1)
        exact = self.time_s[after] == grid_s
        wide = (self.time_s[after] - self.time_s[before] > limit_s) & ~exact
        outside = (grid_s < self.time_s[0]) | (grid_s > self.time_s[-1])
        found = np.interp(grid_s, self.time_s, self.value)
        return np.asarray(np.where(wide | outside, np.nan, found))


@dataclass(frozen=True)
class Defect:
    """A defect of the record: kind, tags, seconds since 1970 from and to, and what was seen, as a sentence."""

    kind: str
    tags: tuple[str, ...]
    start_s: float
    end_s: float
    says: str
    repair: str = ""
    """What the alignment does about it."""


def longest_interval_s(series: Series) -> float:
    """Return the longest regular interval between samples, s.

    A historian with exception reporting stores nothing while a value stands still, and a sample at the latest after a
    fixed time. So the intervals pile up there; longer ones are gaps. Without a pile it is the 99.5 % quantile.
    """
    intervals = np.diff(series.time_s)
    intervals = intervals[intervals > 0.0]
    if len(intervals) < 20:
        return 3.0 * series.tag.scan_s
    far = float(np.quantile(intervals, 0.995))
    tail = intervals[intervals > 0.5 * far]
    # The pile: the scan before the fixed time is the last one that can be stored.
    bins = np.round(tail / max(series.tag.scan_s, 60.0))
    values, counts = np.unique(bins, return_counts=True)
    pile = float(values[np.argmax(counts)] * max(series.tag.scan_s, 60.0)) if counts.max() >= 0.3 * len(tail) else far
    return max(pile, far, 3.0 * series.tag.scan_s) + series.tag.scan_s
