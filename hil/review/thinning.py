"""Rows of a smooth curve that a file needs: the others lie on the straight lines that a viewer draws between them.

Rows are looked at in groups of `GROUP` counted from the curve's first, so the answer does not depend on how the rows
were cut into batches. Of a group that one line explains the first row is kept, of any other the first row of each
quarter that one line explains, and everything of the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GROUP = 16
"""Rows of a group: the most by which a curve shrinks."""
_QUARTER = GROUP // 4


def kept(time_s: NDArray[np.float64], values: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
    """Return which of n rows a curve needs so that straight lines between them miss no other by more than `tolerance`.

    Args:
        time_s: (n,) s. values: (n, k), NaN where there is a gap, whose neighbours are kept.

    Rows after the last whole group are kept.
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
    """Return for each run of `size` rows whether the line from its first to the next one's first is near all of it."""
    begins, ends = np.arange(0, rows, size), np.arange(size, rows + 1, size)
    own_s, own = time_s[:rows].reshape(-1, size), values[:rows].reshape(len(begins), size, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (own_s - own_s[:, :1]) / (time_s[ends] - time_s[begins])[:, None]
        line = values[begins][:, None] + share[:, :, None] * (values[ends] - values[begins])[:, None]
        return np.asarray((np.abs(own - line) <= tolerance).all(axis=(1, 2)))
