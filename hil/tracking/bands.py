"""Bands of a twin's prediction errors: from its own past errors, the same rule for every twin.

The band of ten minutes is the interval that held 90 % of the twin's errors in the two hours before. It is known before
the data comes, independent of the calibrator and its own claims. Its coverage is counted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SPAN_S = 600.0
SPANS = 12
CONFIDENCE = 0.90

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Band:
    """Ten minutes of a twin: sensor -> mean of measured minus predicted, and the predicted half width, K; None without
    readings or history.
    """

    twin: str
    start_s: float
    end_s: float
    mean_K: dict[str, float | None]
    half_width_K: dict[str, float | None]


class _Twin:
    """Prediction errors (n, m) K of one twin."""

    def __init__(self, sensors: int) -> None:
        self.open: list[Array] = []
        self.past: deque[Array] = deque(maxlen=SPANS)
        self.half = np.full(sensors, np.nan)
        self.sums = np.zeros((4, sensors))  # Half widths and their number, readings inside and all readings.

    def close(self) -> tuple[Array, Array]:
        """Close a span: return its mean error and its predicted half width, both (m,)."""
        miss = np.concatenate(self.open)
        self.open = []
        half, good = self.half, np.isfinite(miss)
        foretold = np.isfinite(half)
        inside = (np.abs(np.where(good, miss, np.inf)) <= half).sum(axis=0)
        self.sums += [np.where(foretold, half, 0.0), foretold, inside, good.sum(axis=0) * foretold]
        self.past.append(np.abs(miss))
        self.half = _quantile(np.concatenate(self.past))
        count = good.sum(axis=0)
        mean = np.where(count > 0, np.where(good, miss, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
        return mean, half


class Bands:
    """Bands of twins on one stream, whose spans are counted from its first sample."""

    def __init__(self, sensors: tuple[str, ...]) -> None:
        self._sensors = sensors
        self._twins: dict[str, _Twin] = {}
        self._origin: float | None = None
        self._span = 0
        self._last_s = 0.0

    def push(self, time_s: Array, measured: Array, outputs: dict[str, Array]) -> tuple[Band, ...]:
        """Add samples (n,) s, (n, m) degC, and the predictions (n, m) of each twin; return the bands of the spans that
        end.
        """
        if self._origin is None:
            self._origin = self._last_s = float(time_s[0])
        span = np.maximum(np.maximum.accumulate((time_s - self._origin) // SPAN_S), self._span).astype(np.int64)
        ended: list[Band] = []
        for number in np.unique(span).tolist():
            if number != self._span:
                ended += self._close()
                self._span = number
            rows = span == number
            for name, values in outputs.items():
                twin = self._twins.setdefault(name, _Twin(len(self._sensors)))
                twin.open.append(measured[rows] - values[rows])
            self._last_s = float(time_s[rows][-1])
        return tuple(ended)

    def _close(self) -> list[Band]:
        assert self._origin is not None
        found = []
        for name, twin in self._twins.items():
            if twin.open:
                mean, half = (dict(zip(self._sensors, map(_known, a.tolist()), strict=True)) for a in twin.close())
                found.append(Band(name, self._origin + self._span * SPAN_S, self._last_s, mean, half))
        return found

    def table(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Return twin -> sensor -> mean half width, K, and the coverage of the bands, over whole spans."""
        rows = {}
        for name, twin in self._twins.items():
            half, spans, inside, count = twin.sums
            if (count > 0).all():
                pairs = zip((half / spans).tolist(), (inside / count).tolist(), strict=True)
                rows[name] = dict(zip(self._sensors, pairs, strict=True))
        return rows


def _quantile(misses: Array) -> Array:
    """Return the ceil((n + 1) 0.9)-th smallest finite entry of each column; NaN if there are too few."""
    ordered = np.sort(misses, axis=0)  # NaN comes last.
    count = np.isfinite(misses).sum(axis=0)
    rank = np.ceil((count + 1) * CONFIDENCE).astype(np.int64)
    picked = np.take_along_axis(ordered, np.clip(rank - 1, 0, len(misses) - 1)[None, :], axis=0)[0]
    return np.where((count > 0) & (rank <= count), picked, np.nan)


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
