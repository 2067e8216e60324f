"""Time courses of an effect: at once, growing in proportion to time for a while, or growing towards a final size.

Amplitudes are relative to the effect's size: 1 after a step, 1 where a ramp has ended, 1 in the limit for a saturating
growth. What is put in with a temperature of its own is there at once, and what it does fades.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.network import Array

EARLY_S = 3600.0
"""Onsets up to this are as good as the beginning: little tells them from it."""
GROWTH_H = {"ramp": (2.0, 6.0, 16.0, np.inf), "saturating": (1.0, 4.0, 12.0)}
"""Durations of ramps and time constants of saturating growth that are tried, h; one ramp is still rising when the
record ends."""
BEYOND = 1.5
"""Lengths of a record until which what is still rising at its end is taken to rise: beyond what will be looked at."""


TIMED = ("spell", "periodic", "pulse")
"""Shapes that end, come back or fade: each has a second time, `growth_s`, that is told by the record."""


@dataclass(frozen=True)
class Shape:
    """`name` step, ramp, saturating, put in, or one of `TIMED`; `onset_s` from the record's beginning.

    `growth_s`: the duration of a ramp or a spell, the period of a periodic one, or the time constant with which a
    saturating one nears its size, what was put in nears its place's and a pulse fades. `duty`: share of a period in
    which a periodic one is there, from its onset on.
    """

    name: str
    onset_s: float = 0.0
    growth_s: float = 0.0
    duty: float = 0.5

    def block_means(self, edges_s: Array) -> Array:
        """Mean amplitude (b,) between `edges_s` (b + 1,), s from the record's beginning."""
        low, high = edges_s[:-1], edges_s[1:]
        a = np.maximum(low - self.onset_s, 0.0)
        b = np.maximum(high - self.onset_s, 0.0)
        width = np.maximum(high - low, 1e-9)
        if self.name == "step":
            return (b - a) / width
        growth = max(self.growth_s, 1.0)
        if self.name == "spell":
            there: Array = (np.minimum(b, growth) - np.minimum(a, growth)) / width
            return there
        if self.name == "periodic":
            on = self.duty * growth
            upto = [on * (x // growth) + np.minimum(x % growth, on) for x in (a, b)]
            back: Array = (upto[1] - upto[0]) / width
            return back
        if self.name in ("put in", "pulse"):
            faded: Array = growth * (np.exp(-a / growth) - np.exp(-b / growth)) / width
            return faded
        if self.name == "ramp":
            up = 0.5 * (np.minimum(b, growth) ** 2 - np.minimum(a, growth) ** 2) / growth
            held = np.maximum(b - growth, 0.0) - np.maximum(a - growth, 0.0)
            rising: Array = (up + held) / width
            return rising
        mean: Array = (b - a + growth * (np.exp(-b / growth) - np.exp(-a / growth))) / width
        return mean

    @property
    def grows(self) -> bool:
        return self.name in GROWTH_H

    @property
    def entered(self) -> Shape:
        """How the element itself comes in, whatever becomes of what it does."""
        return Shape("step", self.onset_s) if self.name == "put in" else self

    def mean(self, low_s: float, high_s: float) -> float:
        """Mean amplitude over one span."""
        return float(self.block_means(np.array([low_s, max(high_s, low_s + 1e-3)]))[0])

    def going_on(self, span_s: float) -> Shape:
        """The shape, where it still rises or is still there when a record of `span_s` ends, as one that goes on.

        Until when it does the record does not tell; that it stops then and there would be odd. What a ramp comes to
        then is as many times as large as its growth is longer.
        """
        if self.name == "spell" and not self.free(span_s):
            return Shape("step", self.onset_s)
        if self.name != "ramp" or self.free(span_s):
            return self
        return replace(self, growth_s=BEYOND * span_s - self.onset_s)

    def free(self, span_s: float) -> bool:
        """Whether a record of `span_s` tells the growth apart from the size: a ramp that goes on does not."""
        if self.name == "spell":
            return self.onset_s + self.growth_s < 0.98 * span_s
        return self.name in ("saturating", "periodic", "pulse") or (
            self.name == "ramp" and self.onset_s + self.growth_s < 0.98 * span_s
        )


def family(name: str, span_s: float) -> tuple[float, ...]:
    """Growth times, s, of a named shape that are tried on a record of `span_s`."""
    return tuple(min(3600.0 * h, BEYOND * span_s) for h in GROWTH_H[name])
