"""Times at which inputs change: a record tells each only to within one interval between its samples.

A heater that is switched between two samples heats for a part of the interval that nobody knows. Held from sample to
sample, its power is wrong by the whole step for that time, which warms a small volume by tenths of a kelvin: as much as
a fault that lasts for half a minute. A healthy record whose steps lie on its samples has no such error.
"""

from __future__ import annotations

import numpy as np

from twin.discovery.effects.laws import Book
from twin.discovery.effects.probe import FreeRun
from twin.discovery.records.grid import Grid
from twin.network import Array
from twin.segments import CLOCK_PREFIX

SHARE = 1.0 / np.sqrt(3.0)
"""Root mean square of a time that is equally likely anywhere in an interval, in intervals from its end."""


def heat_by_input_times(book: Book, grid: Grid, run: FreeRun, period_s: float) -> Array:
    """Return the heat (c, n, k), W, in a bin whose input changes, by one standard deviation of the time of the change.

    Parameters
    ----------
    period_s
        Interval between the samples of the record, s.
    """
    columns = [j for j, c in enumerate(book.network.input_columns) if not c.startswith(CLOCK_PREFIX)]
    share = SHARE * period_s / grid.step_s
    found = np.zeros((len(columns), *run.temperatures.shape))
    for of_input, j in zip(found, columns, strict=True):
        of_input[:] = share * book.heat_of_earlier_input(grid, run, j)
    # What changes at the first bin of a segment has changed before it.
    found[:, [b - 1 for b in grid.begins if b > 0]] = 0.0
    return found
