"""Profile time of the ticks of a run, from its transitions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.journal.rows import StateRow
from hil.journal.states import State


def profile_times(states: Sequence[StateRow], tick: NDArray[np.int64], period_s: float) -> NDArray[np.float64]:
    """Return the profile time (n,), s, at `tick (n,)`: its clock runs in state `running` alone.

    Parameters
    ----------
    states
        Transitions of the run, at least one.
    tick
        Ticks.
    period_s
        Length of a tick, s.
    """
    at = np.searchsorted(np.array([row.tick for row in states]), tick, side="right") - 1
    row_tick, row_s, goes = (
        np.array([value(row) for row in states])[np.maximum(at, 0)]
        for value in (lambda r: r.tick, lambda r: r.profile_s, lambda r: r.target == State.RUNNING)
    )
    return np.asarray(row_s + np.where(goes, (tick - row_tick) * period_s, 0.0), dtype=np.float64)
