"""Course of a run in a fixed number of bins, so that a late viewer gets the past of any length at once.

When all bins are used, neighbours are merged and each bin covers twice the time: memory and cost do not grow with the
run. A bin has the mean, least and greatest of its good values.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

BINS = 600
"""Most bins: as many as a tablet's screen shows apart."""
DIGITS = 5
"""Significant digits of a value on its way to a browser."""


class Trends:
    """Course of `series` named series over time.

    Parameters
    ----------
    names
        Names of the series.
    period_s
        Time covered by a bin at first, s.
    bins
        Most bins, an even number.
    """

    def __init__(self, names: list[str], period_s: float, bins: int = BINS) -> None:
        self.names = names
        self.bin_s = period_s
        self._bins = bins
        shape = (bins, len(names))
        self._sum, self._count = np.zeros(shape), np.zeros(shape)
        self._low, self._high = np.full(shape, np.inf), np.full(shape, -np.inf)

    def add(self, time_s: NDArray[np.float64], columns: list[int], values: NDArray[np.float64]) -> None:
        """Add `values (n, len(columns))` at `time_s (n,)`, s; NaN for a value that is not good."""
        inside = np.isfinite(time_s) & (time_s >= 0.0)
        time_s, values = time_s[inside], values[inside]
        if not len(time_s) or not columns:
            return
        last = float(time_s.max())
        while last >= self.bin_s * self._bins:
            self._merge()
        place = np.minimum((time_s / self.bin_s).astype(np.int64), self._bins - 1)
        known = np.isfinite(values)
        at = np.ix_(np.arange(self._bins), np.array(columns))
        for kept, ufunc, part in (
            (self._sum, np.add, np.where(known, values, 0.0)),
            (self._count, np.add, known.astype(np.float64)),
            (self._low, np.minimum, np.where(known, values, np.inf)),
            (self._high, np.maximum, np.where(known, values, -np.inf)),
        ):
            block = kept[at]
            ufunc.at(block, place, part)
            kept[at] = block

    def _merge(self) -> None:
        """Let each bin cover twice the time."""
        half = self._bins // 2
        for kept, ufunc, empty in (
            (self._sum, np.add, 0.0),
            (self._count, np.add, 0.0),
            (self._low, np.minimum, np.inf),
            (self._high, np.maximum, -np.inf),
        ):
            kept[:half] = ufunc(kept[0::2], kept[1::2])
            kept[half:] = empty
        self.bin_s *= 2.0

    def document(self) -> dict[str, Any]:
        """Return the course as JSON has it: middle of each bin with a value, s, and mean, low, high by series."""
        used = np.flatnonzero(self._count.any(axis=1))
        count = self._count[used]
        mean = np.divide(self._sum[used], count, out=np.full(count.shape, np.nan), where=count > 0)
        return {
            "bin_s": self.bin_s,
            "time_s": [round(float(k + 0.5) * self.bin_s, 3) for k in used],
            "series": {
                name: {
                    "mean": _cells(mean[:, k]),
                    "low": _cells(self._low[used, k]),
                    "high": _cells(self._high[used, k]),
                }
                for k, name in enumerate(self.names)
            },
        }


def _cells(values: NDArray[np.float64]) -> list[float | None]:
    return [number(value) for value in values.tolist()]


def number(value: float) -> float | None:
    """Return a number in `DIGITS` digits, None for one that JSON has not."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
