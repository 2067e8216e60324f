"""Time courses of an effect: at once, growing in proportion to time for a while, or growing towards a final size.

Amplitudes are relative to the effect's size: 1 after a step, 1 where a ramp has ended, 1 in the limit for a saturating
growth. What is put in with a temperature of its own is there at once, and what it does fades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.elements.candidates import PASSING
from twin.network import Array

EARLY_S = 3600.0
"""Onsets up to this are as good as the beginning: little tells them from it."""
GROWTH_H = {"ramp": (2.0, 6.0, 16.0, np.inf), "saturating": (1.0, 4.0, 12.0)}
"""Durations of ramps and time constants of saturating growth that are tried, h; one ramp is still rising when the
record ends."""
BEYOND = 1.5
"""Lengths of a record until which what is still rising at its end is taken to rise: beyond what will be looked at."""


TIMED = PASSING
"""Shapes that end, come back or fade: each has a second time, `growth_s`, that is told by the record."""


@dataclass(frozen=True)
class Shape:
    """`name` step, ramp, saturating, put in, or one of `TIMED`; `onset_s` from the record's beginning.

    `growth_s`: the duration of a ramp or a spell, the period of a periodic one, or the time constant with which a
    saturating one nears its size, what was put in nears its place's and a pulse fades. `duty`: share of a period in
    which a periodic one is there, from its onset on; its first turn began `into_s` before that.
    """

    name: str
    onset_s: float = 0.0
    growth_s: float = 0.0
    duty: float = 0.5
    into_s: float = 0.0

    def block_means(self, edges_s: Array) -> Array:
        """Mean amplitude (b,) between `edges_s` (b + 1,), s from the record's beginning."""
        means: Array = courses_of([self], edges_s)[0]
        return means

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


def courses_of(shapes: Sequence[Shape], edges_s: Array) -> Array:
    """Mean amplitudes (n, b) of n shapes between `edges_s` (b + 1,), s from the record's beginning."""
    rows: dict[str, list[int]] = {}
    for row, shape in enumerate(shapes):
        rows.setdefault(shape.name, []).append(row)
    found = np.empty((len(shapes), len(edges_s) - 1))
    for name, those in rows.items():
        times = [(shapes[i].onset_s, shapes[i].growth_s, shapes[i].duty, shapes[i].into_s) for i in those]
        found[those] = means_between(edges_s, name, np.array(times).T)
    return found


def means_between(edges_s: Array, name: str, times: Array) -> Array:
    """Mean amplitudes (n, b) between `edges_s` (b + 1,) of n shapes of one name.

    Args:
        times: (4, n) their onsets, growths, duties and times into a turn, as those of a `Shape`.
    """
    onset, growth, duty, into = times[..., None]
    upto = _integrals(name, np.maximum(edges_s - onset, 0.0) + into, np.maximum(growth, 1.0), duty)
    means: Array = np.diff(upto, axis=1) / np.maximum(np.diff(edges_s), 1e-9)
    return means


def _integrals(name: str, t: Array, growth: Array, duty: Array) -> Array:
    """Integrals (n, t) of the amplitude of shapes of one name from their onsets to `t`, s since then."""
    if name == "step":
        return t
    if name == "spell":
        return np.asarray(np.minimum(t, growth))
    if name == "periodic":
        on, turns = duty * growth, np.floor(t / growth)
        return np.asarray(on * turns + np.minimum(t - growth * turns, on))
    if name in ("put in", "pulse"):
        return np.asarray(-growth * np.expm1(-t / growth))
    if name == "ramp":
        return np.asarray(0.5 * np.minimum(t, growth) ** 2 / growth + np.maximum(t - growth, 0.0))
    return np.asarray(t + growth * np.expm1(-t / growth))


def family(name: str, span_s: float) -> tuple[float, ...]:
    """Growth times, s, of a named shape that are tried on a record of `span_s`."""
    return tuple(min(3600.0 * h, BEYOND * span_s) for h in GROWTH_H[name])
