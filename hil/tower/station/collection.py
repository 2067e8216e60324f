"""Collection of a rig's points into a historian."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drivers.historian import BAD, GOOD, UNCERTAIN, HistorianStore, Samples
from drivers.rig import RigConnection
from drivers.rig_file import Rig
from drivers.signals import LinkError, Quality

CODES = {
    Quality.GOOD: GOOD,
    Quality.STALE: UNCERTAIN,
    Quality.OUT_OF_RANGE: UNCERTAIN,
    Quality.SENSOR_FAULT: BAD,
    Quality.LINK_FAULT: BAD,
}
"""OPC quality code of each quality of a reading."""
FLUSH_S = 60.0
"""Time after which collected samples are stored: at most these are lost in a crash."""
CALENDAR_S = 1.0e9
"""Source time from which a device's clock shows the calendar, s since 1970: no device runs for thirty years."""
MOST_WAITING = 1_000_000
"""Samples that wait for a store that is away (some 30 MB); beyond, the collection ends with the store's error."""


@dataclass
class Collected:
    """Count of what was collected: polls, samples, and failures of the link, with the last one's sentence."""

    polls: int = 0
    samples: int = 0
    failures: int = 0
    last_failure: str = ""


@dataclass
class _Waiting:
    """Samples that are not stored yet."""

    rows: dict[str, list[tuple[float, float, int]]] = field(default_factory=dict)
    since_s: float = 0.0
    count: int = 0
    ahead_s: float = 0.0
    """Calendar of the devices ahead of that of this machine."""

    def add(self, name: str, time_s: float, value: float, quality: int) -> None:
        self.rows.setdefault(name, []).append((time_s, value, quality))
        self.count += 1

    def store(self, into: HistorianStore) -> int:
        """Append all to the store and forget them; on an error nothing is forgotten."""
        samples = {}
        for name, rows in self.rows.items():
            columns = np.asarray(rows, dtype=np.float64)
            samples[name] = Samples(columns[:, 0], columns[:, 1], columns[:, 2].astype(np.int16))
        into.append(samples)
        stored, self.rows, self.count = self.count, {}, 0
        return stored


async def collect(
    rig: Rig,
    into: HistorianStore,
    *,
    every_s: float,
    minutes: float | None,
    now: Callable[[], float] = time.time,
    progress: Callable[[Collected], None] = lambda _: None,
) -> Collected:
    """Poll the rig's points every `every_s` into the store until cancelled or `minutes` have passed.

    Every reading is stored with its quality and the time of its poll in UTC, or the time of its device where the
    device's clock (`uptime` of its bus) shows the calendar. A reading that failed is stored as a bad sample without a
    number, so that a gap of the link is not taken for a value that stands still. What was collected is stored when the
    collection ends, however it ends.

    Parameters
    ----------
    rig
        Rig of the station.
    into
        Store of a historian.
    every_s
        Interval of the polls, s.
    minutes
        Duration, or None for no end.
    now
        Clock, s since 1970.
    progress
        Function that gets the state after each poll.

    Raises
    ------
    LinkError
        The rig cannot be reached at the beginning; later failures are counted.
    HistorianError
        The store fails.
    """
    connection = RigConnection(rig, time.monotonic)
    await connection.connect()
    done, waiting = Collected(), _Waiting(since_s=time.monotonic())
    end = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    due = time.monotonic()
    try:
        while due < end:
            await asyncio.sleep(max(due - time.monotonic(), 0.0))
            await _poll(connection, waiting, done, now)
            if time.monotonic() - waiting.since_s >= FLUSH_S or waiting.count >= MOST_WAITING:
                done.samples += waiting.store(into)
                waiting.since_s = time.monotonic()
            progress(done)
            due = max(due + every_s, time.monotonic())
    finally:
        await connection.close()
        if waiting.count:
            done.samples += waiting.store(into)
    return done


async def _poll(connection: RigConnection, waiting: _Waiting, done: Collected, now: Callable[[], float]) -> None:
    """Read all points once and keep them."""
    stamp = now() + waiting.ahead_s
    done.polls += 1
    try:
        snapshot = await connection.read()
    except LinkError as error:
        done.failures += 1
        done.last_failure = str(error)
        for point in connection.points:
            waiting.add(point.name, stamp, math.nan, BAD)
        return
    if snapshot.faults:
        done.failures += 1
        done.last_failure = snapshot.faults[-1]
    calendar = [moment for moment in snapshot.source_time_s if moment >= CALENDAR_S]
    if calendar:
        waiting.ahead_s += max(calendar) - stamp
        stamp = max(calendar)
    rows = zip(connection.points, snapshot.values, snapshot.quality, snapshot.source_time_s, strict=True)
    for point, value, quality, source in rows:
        waiting.add(point.name, source if source >= CALENDAR_S else stamp, value, CODES[Quality(quality)])
