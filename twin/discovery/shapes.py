"""How an effect comes in: at once, growing with time, or growing towards a final size.

Amplitudes are relative to the effect's size: 1 after a step, 1 at the end of the record for a ramp, 1 in the limit for
a saturating growth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.network import Array

GROWTH_H = (1.0, 4.0, 12.0)
"""Time constants of saturating growth that are tried, h."""


@dataclass(frozen=True)
class Shape:
    """`name` step, ramp or saturating; `onset_s` from the record's beginning; `growth_s` of the last of them."""

    name: str
    onset_s: float = 0.0
    growth_s: float = 0.0

    def amplitude(self, time_s: ArrayLike, end_s: float) -> Array:
        """At times (n,) from the record's beginning, which ends at `end_s`."""
        since = np.asarray(time_s, dtype=np.float64) - self.onset_s
        if self.name == "step":
            return (since >= 0.0).astype(np.float64)
        if self.name == "ramp":
            return np.maximum(since, 0.0) / max(end_s - self.onset_s, 1.0)
        return 1.0 - np.exp(-np.maximum(since, 0.0) / self.growth_s)

    def block_means(self, edges_s: Array) -> Array:
        """Means (b,) over blocks with borders `edges_s` (b + 1,), s."""
        low, high = edges_s[:-1], edges_s[1:]
        a = np.maximum(low - self.onset_s, 0.0)
        b = np.maximum(high - self.onset_s, 0.0)
        width = high - low
        if self.name == "step":
            return (b - a) / width
        if self.name == "ramp":
            return 0.5 * (b**2 - a**2) / width / max(edges_s[-1] - self.onset_s, 1.0)
        tau = self.growth_s
        mean: Array = (b - a + tau * (np.exp(-b / tau) - np.exp(-a / tau))) / width
        return mean


def family(name: str) -> tuple[float, ...]:
    """Growth times, s, of a named shape that are tried."""
    return tuple(3600.0 * h for h in GROWTH_H) if name == "saturating" else (0.0,)
