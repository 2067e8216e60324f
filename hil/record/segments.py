"""Segments of a record that a twin can be asked about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.segments import LONG_GAP_S


@dataclass(frozen=True)
class Parts:
    """What a twin can be asked about of a run that was cut: `rows` of it, and those (n,) among them to be left `aside`,
    so that it begins anew after each gap; nobody knows what heated meanwhile, and the rig came back colder."""

    rows: slice
    aside: NDArray[np.bool_]

    @classmethod
    def of(cls, time_s: NDArray[np.float64], segment: NDArray[np.generic]) -> Parts:
        """Of rows at `time_s (n,)`, with `segment (n,)` never falling: all segments, or the one that has most where the
        gaps are longer than what there is beside them."""
        _, first, counts = np.unique(segment, return_index=True, return_counts=True)
        ends = first + counts - 1
        gaps = time_s[first[1:]] - time_s[ends[:-1]]
        if gaps.sum() > (time_s[ends] - time_s[first]).sum():
            k = int(np.argmax(counts))
            rows = slice(int(first[k]), int(ends[k]) + 1)
            return cls(rows, np.zeros(int(counts[k]), dtype=np.bool_))
        aside = np.zeros(len(time_s), dtype=np.bool_)
        for begin, before in zip(first[1:], ends[:-1], strict=True):
            # However short a gap was: one of this length is one to every twin.
            aside[begin:] |= time_s[begin:] <= time_s[before] + LONG_GAP_S
        return cls(slice(0, len(time_s)), aside)
