"""Segments of a record for predictions of a twin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin import LONG_GAP_S


@dataclass(frozen=True)
class Parts:
    """Segments of an interrupted run for predictions: `rows` of it, and a mask (n,) of rows to be left `aside`, so that
    a twin restarts after each gap; heat input during a gap is unknown.
    """

    rows: slice
    aside: NDArray[np.bool_]

    @classmethod
    def of(cls, time_s: NDArray[np.float64], segment: NDArray[np.generic]) -> Parts:
        """Return the segments of rows at `time_s (n,)`, with `segment (n,)` never falling: all of them, or the longest
        if the gaps are longer than the rest.
        """
        _, first, counts = np.unique(segment, return_index=True, return_counts=True)
        ends = first + counts - 1
        gaps = time_s[first[1:]] - time_s[ends[:-1]]
        if gaps.sum() > (time_s[ends] - time_s[first]).sum():
            k = int(np.argmax(counts))
            rows = slice(int(first[k]), int(ends[k]) + 1)
            return cls(rows, np.zeros(int(counts[k]), dtype=np.bool_))
        aside = np.zeros(len(time_s), dtype=np.bool_)
        for begin, before in zip(first[1:], ends[:-1], strict=True):
            # A gap of this length is one to every twin, however short it was.
            aside[begin:] |= time_s[begin:] <= time_s[before] + LONG_GAP_S
        return cls(slice(0, len(time_s)), aside)
