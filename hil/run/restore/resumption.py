"""Position of a run at its interruption, and the data with which its next segment begins."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from hil.run.restore.thermal_restore import RestoreRule


@dataclass(frozen=True, slots=True)
class RunPosition:
    """Position of a run at its last acknowledged row.

    `tick`, `time_s` and `wall_s` are of that row, `profile_s` is the profile's clock then. `aim` holds the temperatures
    for the thermal restore, degC by signal, those of `aim_tick`. `number` is that of the next segment. `cut_boot_s` is
    the time of the row on this machine's boot clock, s, None where that is not known.
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
        """Return the rig time since the row, s, at `speed` times real time: by the boot clock, else by the wall clock.

        The result is 0 where the wall clock was set back.
        """
        if self.cut_boot_s is not None:
            return max(0.0, (time.clock_gettime(time.CLOCK_BOOTTIME) - self.cut_boot_s) * speed)
        return max(0.0, (time.time() - self.wall_s) * speed)


@dataclass(frozen=True, slots=True)
class Resumption:
    """Data of a resumed run: position, rule of the thermal restore, reason of the interruption.

    The rig's clock runs at `speed` times real time.
    """

    position: RunPosition
    rule: RestoreRule
    reason: str
    speed: float = 1.0

    def first_tick(self, period_s: float) -> int:
        """Return the tick that would begin now: the gap is as long in the journal as it was on the clock."""
        return self.position.tick + max(1, math.ceil(self.position.gap_s(self.speed) / period_s))
