"""Collection of a rig's points into a historian."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drivers.historian import BAD, GOOD, UNCERTAIN, HistorianAwayError, HistorianStore, Samples
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
"""Time after which collected samples are stored, and a store that was away is asked again: at most these are lost in a
crash."""
CALENDAR_S = 1.0e9
"""Source time from which a device's clock shows the calendar, s since 1970: no device runs for thirty years."""
SET_S = 86400.0
"""Change of a device's calendar, s, that is taken at once: a clock that is set, or summer time. A larger one may be a
register that was read wrongly, and counts when the clock goes on from it."""
MOST_WAITING = 1_000_000
"""Samples that wait for a store that is away (some 30 MB); beyond, the collection ends with the store's error."""


@dataclass
class Collected:
    """Count of what was collected: polls, samples, how often the store stayed away, and failures of the link, with the
    last one's sentence."""

    polls: int = 0
    samples: int = 0
    away: int = 0
    failures: int = 0
    last_failure: str = ""


@dataclass
class _Calendar:
    """Calendar of the devices beside the clock of this machine; it may run faster, as that of a replay does."""

    last: tuple[float, float] | None = None
    """Time of this machine and of the calendar at the last poll that counted, s since 1970."""
    rate: float = 1.0
    doubtful: float | None = None
    """Calendar far off its course."""

    def expected_s(self, now_s: float) -> float:
        """Return the calendar at a time of this machine by its course; that time where none was read yet."""
        return now_s if self.last is None else self.last[1] + self.rate * (now_s - self.last[0])

    def at(self, now_s: float, read_s: float) -> float:
        """Return the time of a poll whose calendar was read as `read_s`; its course goes on from there if it counts."""
        expected = self.expected_s(now_s)
        passed = 0.0 if self.last is None else now_s - self.last[0]
        usual = self.last is None or abs(read_s - expected) <= SET_S + abs(self.rate) * passed
        if not usual and (self.doubtful is None or not 0.0 < read_s - self.doubtful <= abs(read_s - expected)):
            self.doubtful = read_s if self.doubtful is None or read_s < self.doubtful else self.doubtful
            return expected
        if usual and self.last is not None and passed > 0.0:
            self.rate = max((read_s - self.last[1]) / passed, 0.0)
        self.last, self.doubtful = (now_s, read_s), None
        return read_s


@dataclass
class _Waiting:
    """Samples that are not stored yet."""

    rows: dict[str, list[tuple[float, float, int]]] = field(default_factory=dict)
    since_s: float = 0.0
    count: int = 0
    calendar: _Calendar = field(default_factory=lambda: _Calendar())

    def add(self, name: str, time_s: float, value: float, quality: int) -> None:
        self.rows.setdefault(name, []).append((time_s, value, quality))
        self.count += 1

    def taken(self) -> _Waiting:
        """Return all samples so far, which wait here no longer."""
        batch = _Waiting(self.rows, self.since_s, self.count)
        self.rows, self.count = {}, 0
        return batch

    def put_back(self, batch: _Waiting) -> None:
        """Let the samples of a batch wait again, before the others."""
        for name, rows in self.rows.items():
            batch.rows.setdefault(name, []).extend(rows)
        self.rows, self.count = batch.rows, batch.count + self.count

    def store(self, into: HistorianStore) -> int:
        """Append all samples to the store and return their number."""
        samples = {}
        for name, rows in self.rows.items():
            columns = np.asarray(rows, dtype=np.float64)
            samples[name] = Samples(columns[:, 0], columns[:, 1], columns[:, 2].astype(np.int16))
        into.append(samples)
        return self.count


class _Storing:
    """Storage of what was collected, beside the polls: a store that is slow or away delays none of them."""

    def __init__(self, into: HistorianStore, waiting: _Waiting, done: Collected) -> None:
        self.into, self.waiting, self.done = into, waiting, done
        self._batch: _Waiting | None = None
        self._task: asyncio.Task[int] | None = None

    async def go_on(self) -> None:
        """Begin to store what waits when its time has come, and take the result of what is done.

        Raises
        ------
        HistorianError
            The store fails, or is away while `MOST_WAITING` samples wait.
        """
        waits = self.waiting.count + (self._batch.count if self._batch else 0)
        if self._task is not None and (self._task.done() or waits >= MOST_WAITING):
            await self._result(final=waits >= MOST_WAITING)
        if self._task is None and (
            time.monotonic() - self.waiting.since_s >= FLUSH_S or self.waiting.count >= MOST_WAITING
        ):
            self.waiting.since_s = time.monotonic()
            self._batch = self.waiting.taken()
            self._task = asyncio.create_task(asyncio.to_thread(self._batch.store, self.into))

    async def finish(self) -> None:
        """Store all that waits; raises `HistorianError` as `go_on`."""
        if self._task is not None:
            await self._result(final=False)
        if self.waiting.count:
            self.done.samples += self.waiting.taken().store(self.into)

    async def _result(self, *, final: bool) -> None:
        task, batch = self._task, self._batch
        assert task is not None and batch is not None
        self._task = self._batch = None
        try:
            self.done.samples += await task
        except HistorianAwayError:
            self.waiting.put_back(batch)
            self.done.away += 1
            if final:
                raise


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
        The store fails. A store that is away (`HistorianAwayError`) is asked again until `MOST_WAITING` samples wait.
    """
    connection = RigConnection(rig, time.monotonic)
    await connection.connect()
    done, waiting = Collected(), _Waiting(since_s=time.monotonic())
    end = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    due = time.monotonic()
    storing = _Storing(into, waiting, done)
    try:
        while due < end:
            await asyncio.sleep(max(due - time.monotonic(), 0.0))
            await _poll(connection, waiting, done, now)
            await storing.go_on()
            progress(done)
            due = max(due + every_s, time.monotonic())
    finally:
        # Samples first: a connection that fails to close loses none of them.
        try:
            await storing.finish()
        finally:
            await connection.close()
    return done


async def _poll(connection: RigConnection, waiting: _Waiting, done: Collected, now: Callable[[], float]) -> None:
    """Read all points once and keep them."""
    began = now()
    stamp = waiting.calendar.expected_s(began)
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
        stamp = waiting.calendar.at(began, max(calendar))
    rows = zip(connection.points, snapshot.values, snapshot.quality, snapshot.source_time_s, strict=True)
    for point, value, quality, source in rows:
        own = source if source >= CALENDAR_S and abs(source - stamp) <= SET_S else stamp
        waiting.add(point.name, own, value, CODES[Quality(quality)])
