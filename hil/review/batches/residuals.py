"""Residuals of twins that answer at different times, joined tick by tick.

Each row of an entity costs a review more than the value in it (its id, time and place), so the twins' residuals of a
sensor share rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_Part = tuple[NDArray[np.int64], Floats, Floats]

LATE_TICKS = 3600
"""Largest delay in ticks between twins; a twin that is later is not waited for."""


class Residuals:
    """Residuals of `twins` at `sensors` sensors that have been added and not taken yet. Not thread-safe."""

    def __init__(self, twins: tuple[str, ...], sensors: int) -> None:
        self._sensors = sensors
        self._waiting: dict[str, list[_Part]] = {twin: [] for twin in twins}
        self._last = dict.fromkeys(twins, -1)
        self._taken = -1

    def add(self, twin: str, tick: NDArray[np.int64], time_s: Floats, residual: Floats) -> None:
        """Append the result of a twin: `tick (n,)`, `time_s (n,)`, `residual (n, m)`, K."""
        self._waiting[twin].append((tick, time_s, residual))
        self._last[twin] = int(tick[-1])

    def take(self, *, last: bool) -> tuple[Floats, Floats]:
        """Return the ticks that all twins have answered, `time_s (n,)` and `residual (n, twins, m)`, NaN for a missing
        twin.

        Parameters
        ----------
        last
            Nothing more comes, so nothing is waited for.
        """
        newest = max(self._last.values(), default=-1)
        waited = [tick for tick in self._last.values() if tick >= newest - LATE_TICKS]
        until = newest if last else min(waited, default=-1)
        parts = [self._up_to(twin, until) for twin in self._waiting]
        if not parts:
            return np.zeros(0), np.zeros((0, 0, self._sensors))
        ticks, first = np.unique(np.concatenate([tick for tick, _, _ in parts]), return_index=True)
        residual = np.full((len(ticks), len(parts), self._sensors), np.nan)
        for k, (tick, _, values) in enumerate(parts):
            residual[np.searchsorted(ticks, tick), k] = values
        self._taken = max(self._taken, until)
        return np.concatenate([time_s for _, time_s, _ in parts])[first], residual

    def _up_to(self, twin: str, tick: int) -> _Part:
        """Remove and return the pending rows of a twin up to a tick; later rows of taken ticks are dropped."""
        waiting = self._waiting[twin]
        if not waiting:
            return np.zeros(0, np.int64), np.zeros(0), np.zeros((0, self._sensors))
        ticks, time_s, residual = (np.concatenate(each) for each in zip(*waiting, strict=True))
        begin, end = np.searchsorted(ticks, (self._taken, tick), side="right")
        self._waiting[twin] = [(ticks[end:], time_s[end:], residual[end:])] if end < len(ticks) else []
        return ticks[begin:end], time_s[begin:end], residual[begin:end]
