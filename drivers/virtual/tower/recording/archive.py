"""The historian of the virtual plant: scans with jitter, exception reporting, then swinging-door compression.

A scan is sent when it leaves the last value sent by more than the exception deviation, or after the longest time; the
scan before goes with it, so that a slope is not invented. The archive keeps what a door from the last kept sample
cannot hold. Source: Bristol, Swinging door trending, ISA National Conference (1990), 749.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.virtual.plant import may_cache

Array = NDArray[np.float64]


def scan_times(start_s: float, end_s: float, every_s: float, rng: np.random.Generator) -> Array:
    """Return times of scans, s (n,): a phase of the tag's own, jitter of some seconds, now and then a late one."""
    nominal = np.arange(start_s + rng.uniform(0.0, every_s), end_s, every_s)
    jitter = rng.normal(0.0, 3.0, len(nominal)) + np.where(
        rng.random(len(nominal)) < 0.01, rng.uniform(5.0, 40.0, len(nominal)), 0.0
    )
    return np.clip(nominal + np.clip(jitter, -12.0, 0.4 * every_s), start_s, end_s - 1e-3)


@njit(cache=may_cache())
def exceptions(time_s: Array, value: Array, deviation: float, longest_s: float) -> NDArray[np.bool_]:
    """Return the scans that are sent (n,)."""
    sent = np.zeros(len(value), dtype=np.bool_)
    if len(value) == 0:
        return sent
    sent[0] = True
    last = 0
    for k in range(1, len(value)):
        moved = abs(value[k] - value[last]) > deviation
        if moved or time_s[k] - time_s[last] >= longest_s:
            if moved and k - 1 > last:
                sent[k - 1] = True
            sent[k] = True
            last = k
    return sent


@njit(cache=may_cache())
def swinging_door(time_s: Array, value: Array, deviation: float, longest_s: float) -> NDArray[np.bool_]:
    """Return the samples that are kept (n,): lines between them stay within `deviation` of those that are not."""
    n = len(value)
    kept = np.zeros(n, dtype=np.bool_)
    if n == 0:
        return kept
    kept[0], kept[n - 1] = True, True
    last, low, high = 0, -np.inf, np.inf
    for k in range(1, n):
        dt = max(time_s[k] - time_s[last], 1e-3)
        slope = (value[k] - value[last]) / dt
        if k > last + 1 and (slope < low or slope > high or dt > longest_s):
            last = k - 1
            kept[last] = True
            dt = max(time_s[k] - time_s[last], 1e-3)
            low, high = (value[k] - deviation - value[last]) / dt, (value[k] + deviation - value[last]) / dt
        else:
            low = max(low, (value[k] - deviation - value[last]) / dt)
            high = min(high, (value[k] + deviation - value[last]) / dt)
    return kept


def archived(time_s: Array, value: Array, deviation: float, longest_s: float) -> NDArray[np.int64]:
    """Return the rows (k,) of scans that end in the archive: exceptions at half the deviation, then the door.

    `time_s` (n,) is in s; `value` (n,) and `deviation` have the unit of the tag.
    """
    sent = np.flatnonzero(exceptions(time_s, value, 0.5 * deviation, 0.5 * longest_s))
    return np.asarray(sent[swinging_door(time_s[sent], value[sent], deviation, longest_s)])
