"""Stuck thermometers, detected before their readings are used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.network import Array

STUCK_S = 900.0
STUCK_SAMPLES = 60
"""Equal readings in a row that make a noisy thermometer stuck."""


@dataclass(frozen=True)
class Stuck:
    """Column with one constant value from `first_s` to `last_s`, degC."""

    column: str
    value: float
    first_s: float
    last_s: float
    rows: slice


def stuck(column: str, time_s: Array, values: Array, sigma: float) -> tuple[Stuck, ...]:
    """Return the spans over which `values` (n,), degC, are constant although the thermometer has a noise of `sigma` K.

    A thermometer with a resolution far coarser than its noise repeats itself normally and is left out.
    """
    good = np.flatnonzero(np.isfinite(values))
    if len(good) < STUCK_SAMPLES:
        return ()
    v = values[good]
    steps = np.abs(np.diff(v))
    moving = steps[steps > 1e-9]
    if not moving.size:
        return (Stuck(column, float(v[0]), float(time_s[good[0]]), float(time_s[good[-1]]), slice(0, len(values))),)
    if sigma < 0.3 * float(moving.min()):
        return ()
    borders = np.flatnonzero(np.concatenate([[True], steps > 1e-9, [True]]))
    found = []
    long = np.flatnonzero(np.diff(borders) >= STUCK_SAMPLES)
    for first, last in zip(borders[long], borders[long + 1], strict=True):
        a, b = good[first], good[last - 1]
        if time_s[b] - time_s[a] >= STUCK_S:
            found.append(Stuck(column, float(v[first]), float(time_s[a]), float(time_s[b]), slice(int(a), int(b) + 1)))
    return tuple(found)
