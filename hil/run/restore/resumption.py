"""A run in segments: where one was cut, and how the next begins."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from hil.run.restore.thermal_restore import SoakRule


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
