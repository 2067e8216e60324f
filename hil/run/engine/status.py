"""Status of a run for operators, and the outcome that it ends with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from hil.journal import State


@dataclass(frozen=True, slots=True)
class Status:
    """State of a run as an operator sees it: `time_s` since its first tick, `profile_s` on the profile's clock.

    `values` are measured values by point, NaN where they are not good; `units` are those of set-points and of measured
    values. The rig's own flags and counters have no unit there.
    """

    state: State
    reason: str
    tick: int
    time_s: float
    profile_s: float
    duration_s: float
    values: dict[str, float]
    setpoints: dict[str, float]
    trips: tuple[str, ...]
    warnings: tuple[str, ...]
    units: dict[str, str] = field(default_factory=dict)
    not_safe: str = ""
    """Reading or read-back that contradicts safe outputs, in a run whose outputs are to be safe; else empty."""


@dataclass(slots=True)
class Outcome:
    """End of a run. `ticks` counts from the run's beginning, gaps included; `restore_s` is the time of thermal restore
    after a gap, `restarts` the number of restarts of the rig's program. `safe` is True where the safe values were read
    back from the rig and no heater's meter contradicts them, `away` the measured value that did not get there. A run
    that ended `untouched` has written nothing to the rig."""

    status: Literal["done", "aborted", "faulted"]
    reason: str
    ticks: int = 0
    overruns: int = 0
    safe: bool = False
    away: str = ""
    untouched: bool = False
    problems: list[str] = field(default_factory=list)
    trips: tuple[str, ...] = ()
    restore_s: float = 0.0
    restarts: int = 0
    guardian: str = ""
    """Action of the guardian, where it acted."""
    deviations: list[str] = field(default_factory=list)
    """Set-points of a run to the end whose meters did not show what was asked, a sentence each."""
    disobeyed: str = ""
    """Heater that stayed on when it was switched off, until the heartbeat was withheld, as a sentence; among the
    deviations."""

    @property
    def in_order(self) -> bool:
        """Return whether the profile was run to its end as it asks, and the rig left safe."""
        return self.status == "done" and self.safe and not self.away and not self.deviations

    @property
    def verdict(self) -> str:
        """Return the status as people read it."""
        return "done with deviations" if self.status == "done" and self.deviations else self.status
