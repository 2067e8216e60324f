"""Clocks of twelve hours that lack AM and PM: after 12:59 they step back to 1:00."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_HALF_DAY = 43_200_000_000
"""Microseconds."""
_NEXT_STEPS = 5
"""Typical steps within which a twelve-hour clock goes on after 12:59; a later time is another record."""


class TimeTextError(ValueError):
    """Error of an ambiguous time column; the message lacks file and column."""


def require_full_clock(micros: NDArray[np.int64], hours: NDArray[np.int64], shown: Callable[[int], str]) -> None:
    """Check that the times are not of a twelve-hour clock without AM and PM.

    Parameters
    ----------
    micros
        Microseconds (n,) in the order of the file.
    hours
        Hours (n,) as the clock shows them.
    shown
        Names the time of a row for the message.

    Raises
    ------
    TimeTextError
        Hours are 1 to 12 alone, and a time steps back by twelve hours and goes on from there.
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
