"""Clocks of twelve hours that lack AM and PM: after 12:59 they step back to 1:00."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_HALF_DAY = 43_200_000_000
"""Microseconds."""
_NEXT_STEPS = 5
"""A clock of twelve hours goes on after 12:59 within that many typical steps; later it is another record."""


class TimeTextError(ValueError):
    """A column of times may be read in two ways; the message lacks file and column."""


def require_full_clock(micros: NDArray[np.int64], hours: NDArray[np.int64], shown: Callable[[int], str]) -> None:
    """Check that no clock of twelve hours without AM and PM wrote the times.

    Args:
        micros: microseconds (n,) in the order of the file. hours: hours (n,) as the clock shows them.
        shown: names the time of a row for the message.

    Raises:
        TimeTextError: hours are 1 to 12 alone, and a time steps back by twelve hours and goes on from there.
    """
    steps = np.diff(micros)
    if not (steps < 0).any() or not (steps > 0).any() or hours.min() < 1 or hours.max() > 12:
        return
    after = steps + _HALF_DAY
    passes = (steps < 0) & (after > 0) & (after <= _NEXT_STEPS * np.median(steps[steps > 0]))
    if passes.any():
        raise TimeTextError(
            f"after '{shown(int(np.argmax(passes)))}' the clock steps back by twelve hours, as one of twelve hours "
            "without AM and PM does; write hours from 00 to 23, or AM and PM"
        )
