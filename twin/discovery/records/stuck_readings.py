"""Stuck thermometers, detected before their readings are used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.network import Array

STUCK_S = 900.0
"""Time of one exact value from which a reading may be stuck, s."""
STUCK_SAMPLES = 60
"""Equal readings in a row that make a noisy thermometer stuck."""
LEAST_FLICKER = 0.4
"""Reversals per reading from which a thermometer is noisy enough for that. With normal noise of 0.4 resolutions, 40 %
of the readings turn back, and at the middle of a step, 60 equal readings in a row have a probability of 1e-6."""


@dataclass(frozen=True)
class Stuck:
    """Column with one constant value from `first_s` to `last_s`, degC."""

    column: str
    value: float
    first_s: float
    last_s: float
    rows: slice


def stuck(column: str, time_s: Array, values: Array, sigma: float) -> tuple[Stuck, ...]:
    """Return the spans over which `values` (n,), degC, are constant although the thermometer is noisy.

    A thermometer with a resolution far coarser than its noise repeats itself at rest and is left out. The readings
    beside the spans show the noise; if there are too few, `sigma`, K, counts.
    """
    good = np.flatnonzero(np.isfinite(values))
    if len(good) < STUCK_SAMPLES:
        return ()
    v = values[good]
    steps = np.diff(v)
    moving = np.abs(steps) > 1e-9
    if not moving.any():
        return (Stuck(column, float(v[0]), float(time_s[good[0]]), float(time_s[good[-1]]), slice(0, len(values))),)
    borders = np.flatnonzero(np.concatenate([[True], moving, [True]]))
    found, others = [], len(v)
    for k in np.flatnonzero(np.diff(borders) >= STUCK_SAMPLES):
        first, last = borders[k], borders[k + 1]
        a, b = good[first], good[last - 1]
        if time_s[b] - time_s[a] >= STUCK_S:
            found.append(Stuck(column, float(v[first]), float(time_s[a]), float(time_s[b]), slice(int(a), int(b) + 1)))
            others -= last - first
    way = np.sign(steps[moving])
    reversals = int((way[1:] != way[:-1]).sum())
    noisy = reversals >= LEAST_FLICKER * others
    if others < STUCK_SAMPLES:
        noisy = sigma >= LEAST_FLICKER * float(np.abs(steps[moving]).min())
    return tuple(found) if noisy else ()
