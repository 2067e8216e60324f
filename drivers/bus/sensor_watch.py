"""Sensor faults that show only over time: stuck sensors and jumps.

A single reading is judged by `drivers.bus.contract`. For these two the rig file says for each point how:
`stuck_after_s`, after which an instrument with noise that repeats its value to the last bit is stuck, and
`max_change_per_s`, beyond which the quantity cannot have gone. A reading that jumped is believed again when it is back,
or when the quantity could have got there since the last one that was believed. After a silence longer than
`stale_after_s` an instrument that is watched for being stuck has to show that it is not, by a reading that differs from
the first: it may have got stuck meanwhile, and counting would begin anew.
"""

from __future__ import annotations

import math

from drivers.rig_file.model import Point
from drivers.signals.points import Quality

_GOOD = int(Quality.GOOD)
LONGER = 3.0
"""A silence is so many times as long as the readings were apart before."""
SHORTEST_S = 1.0
"""Readings may come fast, and noise does not shrink with their distance: a change is allowed that of a second."""


class SensorWatch:
    """Memory of one point; values in its unit, times in s of rig time."""

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
        """Quality of `value`, read at `now_s` and good as such or not.

        SENSOR_FAULT where it is stuck or has jumped, STALE where nothing shows yet that it lives.
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
    """A watch for each point that asks for one, in the order of `points`."""
    return [
        None if point.stuck_after_s is None and point.max_change_per_s is None else SensorWatch(point)
        for point in points
    ]
