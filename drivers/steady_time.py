"""Seconds that pass whether or not this machine or this process runs."""

from __future__ import annotations

import time

_CLOCK = getattr(time, "CLOCK_BOOTTIME", None)
"""Linux: CLOCK_MONOTONIC stands still while the machine is suspended, CLOCK_BOOTTIME does not (clock_gettime(2))."""


def steady_s() -> float:
    """Return the time since an arbitrary moment, s; no clock setting moves it, and a suspended machine counts."""
    return time.monotonic() if _CLOCK is None else time.clock_gettime(_CLOCK)
