"""Time courses of an effect: step, ramp, saturating growth, and transient ones.

Amplitudes are relative to the effect's size: 1 after a step, 1 at the end of a ramp, 1 in the limit of saturating
growth. A mass that is put in with its own temperature is there at once, and its heat decays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.network import Array

EARLY_S = 3600.0
"""Onsets up to this, s, count as the beginning, from which they are hardly distinguishable."""
GROWTH_H = {"ramp": (2.0, 6.0, 16.0, np.inf), "saturating": (1.0, 4.0, 12.0)}
"""Durations of ramps and time constants of saturating growth that are tried, h; an infinite one still rises at the
record's end."""
BEYOND = 1.5
"""Multiple of a record's length for which a ramp that still rises at its end is taken to rise."""


@dataclass(frozen=True)
class Shape:
    """Time course: `name` step, ramp, saturating, put in, or an intermittent one (`twin.elements.candidates`).

    `onset_s` is from the record's beginning, s.

    `growth_s`: duration of a ramp or of a single transient, period of a periodic course, or time constant of a
    saturating one, of the heat of a mass put in, and of a pulse. `duty`: share of a period in which a periodic effect
    is present, from its onset on; its first period began `into_s` before the onset.
    """

    name: str
    onset_s: float = 0.0
    growth_s: float = 0.0
    duty: float = 0.5
    into_s: float = 0.0

    def block_means(self, edges_s: Array) -> Array:
        """Return the mean amplitudes (b,) between `edges_s` (b + 1,), s from the record's beginning."""
        means: Array = courses_of([self], edges_s)[0]
        return means

    @property
    def grows(self) -> bool:
        return self.name in GROWTH_H

    @property
    def entered(self) -> Shape:
        """Return the time course of the element itself, without the decay of its consequence."""
        return Shape("step", self.onset_s) if self.name == "put in" else self

    def mean(self, low_s: float, high_s: float) -> float:
        """Return the mean amplitude between two times, s."""
        return float(self.block_means(np.array([low_s, max(high_s, low_s + 1e-3)]))[0])

    def reached(self, span_s: float) -> float:
        """Return the amplitude at the end of a record of `span_s`."""
        return self.mean(span_s - 1.0, span_s)

    def going_on(self, span_s: float) -> Shape:
        """Return the shape without an end if it still rises or is still present when a record of `span_s` ends.

        Its later end is not identifiable from the record, and one exactly at the record's end is improbable. The size
        of a ramp then grows in proportion to its duration.
        """
        if self.name == "transient" and not self.free(span_s):
            return Shape("step", self.onset_s)
        if self.name != "ramp" or self.free(span_s):
            return self
        return replace(self, growth_s=BEYOND * span_s - self.onset_s)

    def free(self, span_s: float) -> bool:
        """Return True if growth time and size are separately identifiable from a record of `span_s`: not those of an
        unended ramp.
        """
        if self.name == "transient":
            return self.onset_s + self.growth_s < 0.98 * span_s
        return self.name in ("saturating", "periodic", "pulse") or (
            self.name == "ramp" and self.onset_s + self.growth_s < 0.98 * span_s
        )


def courses_of(shapes: Sequence[Shape], edges_s: Array) -> Array:
    """Return the mean amplitudes (n, b) of n shapes between `edges_s` (b + 1,), s from the record's beginning."""
    rows: dict[str, list[int]] = {}
    for row, shape in enumerate(shapes):
        rows.setdefault(shape.name, []).append(row)
    found = np.empty((len(shapes), len(edges_s) - 1))
    for name, those in rows.items():
        times = [(shapes[i].onset_s, shapes[i].growth_s, shapes[i].duty, shapes[i].into_s) for i in those]
        found[those] = means_between(edges_s, name, np.array(times).T)
    return found


def means_between(edges_s: Array, name: str, times: Array) -> Array:
    """Return the mean amplitudes (n, b) between `edges_s` (b + 1,), s, of n shapes of one name.

    Args:
        times: (4, n) their onsets, growth times, duties and times into a period, as those of a `Shape`.
    """
    onset, growth, duty, into = times[..., None]
    upto = _integrals(name, np.maximum(edges_s - onset, 0.0) + into, np.maximum(growth, 1.0), duty)
    means: Array = np.diff(upto, axis=1) / np.maximum(np.diff(edges_s), 1e-9)
    return means


def _integrals(name: str, t: Array, growth: Array, duty: Array) -> Array:
    """Return the integrals (n, t) of the amplitude of shapes of one name from their onsets to `t`, s since then."""
    if name == "step":
        return t
    if name == "transient":
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
    """Return the growth times, s, of a named shape that are tried on a record of `span_s`."""
    return tuple(min(3600.0 * h, BEYOND * span_s) for h in GROWTH_H[name])
