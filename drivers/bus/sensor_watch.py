"""Sensor faults that show only over time: stuck sensors and jumps.

A single reading is judged by `drivers.bus.contract`. The rig file enables these two checks for each point.
`stuck_after_s` is the time after which an instrument with noise is stuck if it repeats its value to the last bit.
`max_change_per_s` is the fastest change that the quantity can make.

A reading that jumped is accepted again when it is back, or when the quantity could have got there since the last
accepted one. After a silence longer than `stale_after_s` a watched instrument is STALE until a reading differs from the
first one: it may have got stuck meanwhile, and the count would begin anew.
"""

from __future__ import annotations

import math

from drivers.rig_file import Point
from drivers.signals import Quality

_GOOD = int(Quality.GOOD)
LONGER = 3.0
"""A silence is so many times as long as the readings were apart before."""
SHORTEST_S = 1.0
"""Readings may come fast, and noise does not shrink with their distance: a change is allowed that of a second."""


class SensorWatch:
    """Stuck and jump check of one point; values in its unit, times in s of rig time."""

    def __init__(self, point: Point) -> None:
        self._stuck_after_s = math.inf if point.stuck_after_s is None else point.stuck_after_s
        self._max_change_per_s = math.inf if point.max_change_per_s is None else point.max_change_per_s
        self._may_jump = point.max_change_per_s is not None
        self._stale_after_s = point.stale_after_s if point.stuck_after_s is not None else math.inf
        self._heard_s = math.nan
        self._apart_s = math.inf
        self._lives = True
        self._value = math.nan
        self._since_s = 0.0
        self._believed = math.nan
        self._believed_s = 0.0

    def judge(self, value: float, quality: int, now_s: float) -> int:
        """Return the quality of `value` (in the point's unit), read at `now_s`, whose own quality is `quality`.

        SENSOR_FAULT where it is stuck or has jumped, STALE while no change after a silence shows that it works.
        """
        apart_s = now_s - self._heard_s  # NaN of the first reading
        silent = apart_s > self._stale_after_s and apart_s > LONGER * self._apart_s
        if not silent and apart_s == apart_s:
            self._apart_s = apart_s
        if value != self._value or silent:
            self._lives = not silent
            self._value, self._since_s = value, now_s
        self._heard_s = now_s
        if quality != _GOOD:
            return quality
        if now_s - self._since_s >= self._stuck_after_s:
            return Quality.SENSOR_FAULT
        if not self._lives:
            return Quality.STALE
        if self._may_jump:
            reach = self._max_change_per_s * max(now_s - self._believed_s, SHORTEST_S)
            if abs(value - self._believed) > reach:  # False of the first reading, when nothing is believed yet
                return Quality.SENSOR_FAULT
            self._believed, self._believed_s = value, now_s
        return _GOOD


def watches(points: tuple[Point, ...]) -> list[SensorWatch | None]:
    """Return a watch for each point that asks for one, else None, in the order of `points`."""
    return [
        None if point.stuck_after_s is None and point.max_change_per_s is None else SensorWatch(point)
        for point in points
    ]
