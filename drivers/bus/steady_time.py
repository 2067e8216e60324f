"""Seconds that pass whether or not this machine or this process runs."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable

_BOOT_TIME: int | None = getattr(time, "CLOCK_BOOTTIME", None)
"""Linux: CLOCK_MONOTONIC stands still while the machine is suspended, CLOCK_BOOTTIME does not (clock_gettime(2))."""

steady_s: Callable[[], float] = (
    time.monotonic if _BOOT_TIME is None else functools.partial(time.clock_gettime, _BOOT_TIME)
)
"""Return the time since an arbitrary moment, s; no clock setting moves it, and a suspended machine counts."""
