"""Correction of a clock that is wrong all along: local time of a zone, or off by a fixed number of seconds."""

from __future__ import annotations

import datetime
import zoneinfo
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.defects.clocks.changes import clock_changes, second_pass
from twin.historian.tags import Array, Series


@dataclass(frozen=True)
class Shift:
    """Correction of a clock: from local time of a zone, or by a fixed number of seconds to add."""

    zone: str | None = None
    add_s: float = 0.0

    def to_utc(self, stamp_s: Array) -> Array:
        """Return true times of stamps (n,). The hour that comes twice is taken as its first."""
        return stamp_s + self.add_s if self.zone is None else stamp_s - offset_s(stamp_s, self.zone, local=True)

    def to_stamp(self, utc_s: Array) -> Array:
        """Return the stamps that true times have (n,)."""
        return utc_s - self.add_s if self.zone is None else utc_s + offset_s(utc_s, self.zone, local=False)

    @property
    def needed(self) -> str:
        """The correction in words."""
        if self.zone is not None:
            return f"the zone {self.zone}"
        return f"{abs(self.add_s) / 3600.0:g} h {'more' if self.add_s > 0 else 'less'}"

    def __str__(self) -> str:
        if self.zone is not None:
            return f"local time of {self.zone}"
        return f"{abs(self.add_s) / 3600.0:g} h {'behind' if self.add_s > 0 else 'ahead of'} the other tags"


def offset_s(times_s: Array, zone: str, *, local: bool) -> Array:
    """Return local time minus UTC at times that are local or UTC, by the hour, s."""
    info = zoneinfo.ZoneInfo(zone)
    hours, inverse = np.unique(np.floor(times_s / 3600.0), return_inverse=True)
    offsets = np.empty(len(hours))
    for k, hour in enumerate(hours):
        moment = datetime.datetime.fromtimestamp(float(hour) * 3600.0, datetime.UTC)
        moment = moment.replace(tzinfo=info) if local else moment.astimezone(info)
        offset = moment.utcoffset()
        offsets[k] = offset.total_seconds() if offset is not None else 0.0
    return np.asarray(offsets[inverse])


def repeated_hours(start_s: float, end_s: float, zone: str) -> list[tuple[float, float]]:
    """Return the spans (UTC) of two hours in which local time goes through one hour twice."""
    hours = np.arange(np.floor(start_s / 3600.0), np.ceil(end_s / 3600.0) + 1.0) * 3600.0
    offset = offset_s(hours, zone, local=False)
    back = np.flatnonzero(np.diff(offset) < 0.0)
    return [(float(hours[k + 1] + np.diff(offset)[k]), float(hours[k + 1] - np.diff(offset)[k])) for k in back]


def corrected(series: Series, shift: Shift) -> Series:
    """Return the series with true times, in their order.

    The hour that local time goes through twice is told by the order of storing; where that does not show it, the two
    hours are a hole.
    """
    time_s = shift.to_utc(series.time_s)
    holes = shift.to_utc(series.holes.ravel()).reshape(-1, 2)
    if shift.zone is None or not len(time_s):
        return replace(series, time_s=time_s, holes=holes).rows(np.argsort(time_s, kind="stable"))
    unknown = []
    for change in clock_changes(shift.zone, float(time_s.min()), float(time_s.max())):
        if not change.back:
            continue
        low, high = change.stamps
        second = second_pass(series.time_s, change)
        if second is None:
            unknown.append((change.time_s - (high - low), change.time_s + (high - low)))
            continue
        stamp = series.time_s[second]
        time_s[second] += np.where((stamp >= low) & (stamp < high), high - low, 0.0)
    moved = replace(series, time_s=time_s, holes=holes).rows(np.argsort(time_s, kind="stable"))
    return moved.without(unknown)
