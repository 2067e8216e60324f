"""What ends a run, judged in the tick on this tick's values: alarm limits, faulty sensors, lost links, the rig's trip.

A sensor that cannot be trusted counts as high: it does not hide an over-temperature for longer than the rig file's
`abort_after_s`.
"""

from __future__ import annotations

import math

from drivers.points import Quality, Snapshot
from drivers.rigfile import Point, Rig


class Interlocks:
    """State of the interlocks of one run over the rig's polled `points`."""

    def __init__(self, rig: Rig, points: tuple[Point, ...]) -> None:
        self._rig = rig
        self._points = points
        self._bad_since: dict[str, float] = {}
        index = {point.name: position for position, point in enumerate(points)}
        heartbeat = rig.heartbeat
        self._status = index.get(heartbeat.status) if heartbeat and heartbeat.status else None
        self._counter = index.get(heartbeat.counter) if heartbeat and heartbeat.counter else None
        self._trip_mask = heartbeat.trip_mask if heartbeat else 0
        self._counter_value = math.nan
        self._counter_since = -math.inf

    def alarms(self, snapshot: Snapshot) -> list[str]:
        """Alarm limits that are exceeded now, one sentence each; used before the start as well."""
        found = []
        for point, value, quality in zip(self._points, snapshot.values, snapshot.quality, strict=True):
            if point.alarm is None or quality not in (Quality.GOOD, Quality.OUT_OF_RANGE):
                continue
            low, high = point.alarm
            if not low <= value <= high:
                found.append(f"{point.name} is {value:.2f} {point.unit}, its alarm limits are {low:g} to {high:g}")
        return found

    def check(self, snapshot: Snapshot, now_s: float) -> str | None:
        """Why the run must end on this tick, or None. Call once a tick, with rig time."""
        alarms = self.alarms(snapshot)
        if alarms:
            return alarms[0]
        tripped = self.tripped(snapshot)
        if tripped is not None:
            return tripped
        return self._untrusted(snapshot, now_s) or self._frozen(snapshot, now_s)

    def tripped(self, snapshot: Snapshot) -> str | None:
        """What the rig says of its own watchdog and thermostat, where it has tripped."""
        if self._status is None or snapshot.quality[self._status] != Quality.GOOD:
            return None
        bits = int(snapshot.values[self._status]) & self._trip_mask
        if bits:
            name = self._points[self._status].name
            return f"the rig tripped by itself ({name} has bits {bits:#06b} set); look for the cause, then arm it again"
        return None

    def _untrusted(self, snapshot: Snapshot, now_s: float) -> str | None:
        limit = self._rig.abort_after_s
        for point, quality in zip(self._points, snapshot.quality, strict=True):
            if quality == Quality.GOOD or (quality == Quality.OUT_OF_RANGE and point.alarm is None):
                self._bad_since.pop(point.name, None)
                continue
            if point.alarm is None and quality == Quality.SENSOR_FAULT:
                continue
            since = self._bad_since.setdefault(point.name, now_s)
            if now_s - since >= limit:
                why = Quality(quality).name.lower().replace("_", " ")
                cause = f" ({snapshot.faults[0]})" if snapshot.faults else ""
                return f"{point.name} has been without a good value for {limit:g} s: {why}{cause}"
        return None

    def _frozen(self, snapshot: Snapshot, now_s: float) -> str | None:
        if self._counter is None or self._rig.heartbeat is None or snapshot.quality[self._counter] != Quality.GOOD:
            return None
        value = snapshot.values[self._counter]
        if value != self._counter_value:
            self._counter_value, self._counter_since = value, now_s
        elif now_s - self._counter_since > self._rig.heartbeat.timeout_s:
            name = self._points[self._counter].name
            return f"the rig has stopped: {name} has not advanced for {self._rig.heartbeat.timeout_s:g} s"
        return None
