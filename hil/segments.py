"""A run in segments: where one was cut, and how the next begins."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.journal_rows import StateRow
from hil.soaking import SoakRule
from hil.states import State
from twin.segments import LONG_GAP_S


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a run stood at its last acknowledged row.

    `tick`, `time_s` and `wall_s` are of that row, `profile_s` is the profile's clock then. `aim` are the temperatures,
    degC by signal, that a soak leads back to, those of `aim_tick`. `number` is that of the segment that would follow.
    `cut_boot_s` is when the row was on this machine's boot clock, s, None where that is not known.
    """

    tick: int
    time_s: float
    wall_s: float
    profile_s: float
    state: str
    number: int
    aim_tick: int
    aim: dict[str, float]
    cut_boot_s: float | None = None

    def gap_s(self, speed: float) -> float:
        """Return the rig time since then, s: by the boot clock, else by the wall clock; 0 where that was set back."""
        if self.cut_boot_s is not None:
            return max(0.0, (time.clock_gettime(time.CLOCK_BOOTTIME) - self.cut_boot_s) * speed)
        return max(0.0, (time.time() - self.wall_s) * speed)


@dataclass(frozen=True, slots=True)
class Resumption:
    """How a run goes on: from where it stood, by what rule it is led back, why it stopped; `speed` times real time."""

    standing: Standing
    rule: SoakRule
    reason: str
    speed: float = 1.0

    def first_tick(self, period_s: float) -> int:
        """Tick that would begin now: the gap is as long in the journal as it was on the clock."""
        return self.standing.tick + max(1, math.ceil(self.standing.gap_s(self.speed) / period_s))


def profile_times(states: Sequence[StateRow], tick: NDArray[np.int64], period_s: float) -> NDArray[np.float64]:
    """Profile time (n,) s at `tick (n,)`, from its transitions, at least one: it goes in `running` alone."""
    at = np.searchsorted(np.array([row.tick for row in states]), tick, side="right") - 1
    row_tick, row_s, goes = (
        np.array([value(row) for row in states])[np.maximum(at, 0)]
        for value in (lambda r: r.tick, lambda r: r.profile_s, lambda r: r.target == State.RUNNING)
    )
    return np.asarray(row_s + np.where(goes, (tick - row_tick) * period_s, 0.0), dtype=np.float64)


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
