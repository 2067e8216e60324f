"""Heartbeat, arming and watchdog of a served rig, as its rig file declares them. No I/O.

While the rig is not armed, or after its watchdog has tripped, its outputs are the safe values of the rig file. A trip
sets the lowest bit of `watchdog_mask`, and the rig can be armed again after a new beat.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.rig_file import Heartbeat


class Watchdog:
    """Watchdog of a heartbeat section.

    Parameters
    ----------
    beat
        The section.
    default_s
        Time-out where no point holds one, s.
    """

    def __init__(self, beat: Heartbeat, default_s: float) -> None:
        self._beat, self._default_s = beat, default_s
        self.armed = False
        self.tripped = False
        self._alive_s = 0.0
        self._last = 0.0
        self._fresh_needed = False
        self._beating = False

    @property
    def lets_through(self) -> bool:
        """True while set-points reach the plant."""
        return not self.tripped and (self.armed or self._beat.arm is None)

    @property
    def status(self) -> int:
        """Bits that the rig reports."""
        mask = self._beat.watchdog_mask
        return mask & -mask if self.tripped else 0

    def restart(self) -> None:
        """Set the state after a power cut."""
        self.armed = self.tripped = self._fresh_needed = self._beating = False
        self._last = 0.0

    def accepts(self, now_s: float, value: Callable[[str], float]) -> bool:
        """Take up what has just been written; return False where arming is refused for want of a beat.

        Parameters
        ----------
        now_s
            Rig time, s.
        value
            Value that a point holds now, by its name.
        """
        beat = value(self._beat.point)
        fresh = beat != self._last
        if self._beat.arm is not None:
            wanted = value(self._beat.arm) != 0.0
            if wanted and not self.armed:
                if self._fresh_needed and not fresh:
                    return False
                self.armed, self.tripped, self._alive_s = True, False, now_s
            elif not wanted:
                self.armed = False
        if fresh:
            self._last, self._alive_s = beat, now_s
            self._fresh_needed, self._beating = False, True
            if self._beat.arm is None:
                self.tripped = False
        return True

    def trips(self, now_s: float, held_s: float | None) -> bool:
        """Return True at the moment of a trip; `held_s` is the time-out that the rig holds, None without one."""
        timeout_s = self._default_s if held_s is None else held_s
        watched = self.armed if self._beat.arm is not None else self._beating
        if not watched or timeout_s <= 0.0 or now_s - self._alive_s <= timeout_s + 1e-6:
            return False
        self.tripped, self.armed, self._beating, self._fresh_needed = True, False, False, True
        return True
