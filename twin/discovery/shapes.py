"""How an effect comes in: at once, growing with time, or growing towards a final size.

Amplitudes are relative to the effect's size: 1 after a step, 1 at the end of the record for a ramp, 1 in the limit for
a saturating growth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.network import Array

GROWTH_H = (1.0, 4.0, 12.0)
"""Time constants of saturating growth that are tried, h."""


@dataclass(frozen=True)
class Shape:
    """`name` step, ramp or saturating; `onset_s` from the record's beginning; `growth_s` of the last of them."""

    name: str
    onset_s: float = 0.0
    growth_s: float = 0.0

    def block_means(self, edges_s: Array, end_s: float | None = None) -> Array:
        """Mean amplitude (b,) between `edges_s` (b + 1,), s from the record's beginning; a ramp is full at `end_s`."""
        end = float(edges_s[-1]) if end_s is None else end_s
        low, high = edges_s[:-1], edges_s[1:]
        a = np.maximum(low - self.onset_s, 0.0)
        b = np.maximum(high - self.onset_s, 0.0)
        width = np.maximum(high - low, 1e-9)
        if self.name == "step":
            return (b - a) / width
        if self.name == "ramp":
            return 0.5 * (b**2 - a**2) / width / max(end - self.onset_s, 1.0)
        tau = max(self.growth_s, 1.0)
        mean: Array = (b - a + tau * (np.exp(-b / tau) - np.exp(-a / tau))) / width
        return mean

    def mean(self, low_s: float, high_s: float, end_s: float) -> float:
        """Mean amplitude over one span."""
        if high_s <= low_s:
            high_s = low_s + 1e-3
        return float(self.block_means(np.array([low_s, high_s]), end_s)[0])


def family(name: str) -> tuple[float, ...]:
    """Growth times, s, of a named shape that are tried."""
    return tuple(3600.0 * h for h in GROWTH_H) if name == "saturating" else (0.0,)
