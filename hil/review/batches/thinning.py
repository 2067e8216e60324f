"""Thinning of smooth curves in a file: a viewer draws straight lines between the rows that are stored.

Rows are processed in groups of `GROUP` counted from the curve's first, so the result does not depend on the batches. A
group that one line fits keeps its first row. Any other group keeps the first row of each quarter that one line fits,
and all rows of the other quarters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GROUP = 16
"""Rows of a group: the largest factor by which a curve shrinks."""
_QUARTER = GROUP // 4


def needed_rows(time_s: NDArray[np.float64], values: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
    """Return a mask of the rows that a curve needs: straight lines between them miss no other by more than `tolerance`.

    Parameters
    ----------
    time_s
        Times of the rows, s, shape (n,).
    values
        Values of the rows, shape (n, k); NaN in a gap, whose neighbours are kept.
    tolerance
        Largest miss, in the unit of the values.

    Returns
    -------
    NDArray
        True for rows to keep, shape (n,). Rows after the last whole group are kept.
    """
    groups = max(len(time_s) - 1, 0) // GROUP
    found = np.ones(len(time_s), dtype=bool)
    if groups == 0:
        return found
    whole, quarters = (_on_a_line(time_s, values, tolerance, size, groups * GROUP) for size in (GROUP, _QUARTER))
    places = np.arange(groups * GROUP)
    drop = quarters[places // _QUARTER] & (places % _QUARTER > 0)
    drop |= whole[places // GROUP] & (places % GROUP > 0)
    found[: groups * GROUP] = ~drop
    return found


def _on_a_line(
    time_s: NDArray[np.float64], values: NDArray[np.float64], tolerance: float, size: int, rows: int
) -> NDArray[np.bool_]:
    """Return True for each run of `size` rows that the line from its first row to the next run's first row fits."""
    begins, ends = np.arange(0, rows, size), np.arange(size, rows + 1, size)
    own_s, own = time_s[:rows].reshape(-1, size), values[:rows].reshape(len(begins), size, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (own_s - own_s[:, :1]) / (time_s[ends] - time_s[begins])[:, None]
        line = values[begins][:, None] + share[:, :, None] * (values[ends] - values[begins])[:, None]
        return np.asarray((np.abs(own - line) <= tolerance).all(axis=(1, 2)))
