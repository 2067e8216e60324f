"""Crash-safe journal of a run: one SQLite file in WAL mode, append-only, readable while it grows.

A thread writes it. Whoever appends only queues a row, which takes a microsecond: a lock of another program, a slow disk
or a full one never delays a tick. Rows are committed together at least every `COMMIT_INTERVAL_S` of wall time, events
and transitions at once, with synchronous=FULL: a crash or a power cut loses at most that much. Everything else (record,
review, report) is derived from the journal, live or afterwards, through `JournalReader`.

Tables: `meta` (key, JSON), `samples` (a row a tick, a column a signal), `twins` (a row a tick and twin, a column a
twin sensor), `calibrations`, `proposals`, `bands`, `writes`, `events`, `states` (a row a transition), `segments` (a row
a resumption).
"""

from __future__ import annotations

import contextlib
import json
import struct
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from hil.files import plain
from hil.journal.reader import SCHEMA_VERSION, JournalReader
from hil.journal.rows import Header, JournalError, SegmentRow
from hil.journal.store import EVENT, JournalEntry, JournalStore, LockedError, Row

__all__ = ["SCHEMA_VERSION", "Header", "JournalError", "JournalReader", "JournalWriter"]

COMMIT_INTERVAL_S = 0.5
COMMIT_WITHIN_S = 30.0
"""So long `commit` and `close` wait for the thread, s."""
LOCKED_AT_MOST_S = 30.0
"""A journal that another program holds for longer ends the run, s: a crash would lose all of that."""
LONGEST_QUEUE = 36_000
"""Rows that wait at most: an hour at 10 Hz, some 40 MB."""


class JournalWriter:
    """Writer of a journal at `path`: a new one, or with `again` one of a run that was cut, whose header must be the
    same. Appending never blocks and never raises; `failure` says what keeps rows from the disk.
    """

    def __init__(self, path: Path, header: Header, *, again: bool = False) -> None:
        self._store = JournalStore(path, header, again=again)
        self._path = path
        self._queue: deque[JournalEntry] = deque()
        self._changed = threading.Condition()
        self._put_count = self._done_count = 0
        self._urgent = self._ending = False
        self._failure: str | None = None
        self._behind_since: float | None = None
        self._thread = threading.Thread(target=self._work, name="journal", daemon=True)
        self._thread.start()

    @property
    def failure(self) -> str | None:
        """Return why rows are not written: a full disk, a lost file, a lock that stays; None while they are."""
        return self._failure

    @property
    def backlog(self) -> int:
        """Return the number of rows that wait to be written."""
        return self._put_count - self._done_count

    @property
    def behind_s(self) -> float:
        """Return how long rows have been waiting for another program's lock, s."""
        since = self._behind_since
        return 0.0 if since is None else time.monotonic() - since

    def sample(
        self,
        tick: int,
        time_s: float,
        wall_s: float,
        latency_s: float,
        values: Sequence[float],
        quality: Sequence[int],
        source_time_s: Sequence[float],
    ) -> None:
        """Append one tick; a NaN value is stored as NULL."""
        source = struct.pack(f"<{len(source_time_s)}d", *source_time_s)
        self._put("sample", (tick, time_s, wall_s, latency_s, *values, bytes(quality), source))

    def twin_outputs(self, twin: str, ticks: Sequence[int], time_s: Sequence[float], values: NDArray[Any]) -> None:
        """Append predictions of `twin`, `values (n, m)`."""
        for tick, t, row in zip(ticks, time_s, values.tolist(), strict=True):
            self._put("twin", (twin, int(tick), float(t), *row))

    def calibration(self, calibrator: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """Append a finished window."""
        self._put(
            "INSERT INTO calibrations (calibrator, start_s, end_s, document) VALUES (?, ?, ?, ?)",
            (calibrator, start_s, end_s, json.dumps(document)),
        )

    def proposal(self, calibrator: str, time_s: float, document: dict[str, Any]) -> None:
        """Append a proposal."""
        self._put(
            "INSERT INTO proposals (calibrator, time_s, document) VALUES (?, ?, ?)",
            (calibrator, time_s, json.dumps(document)),
        )

    def band(self, twin: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """Append a twin's band."""
        self._put(
            "INSERT INTO bands (twin, start_s, end_s, document) VALUES (?, ?, ?, ?)",
            (twin, start_s, end_s, json.dumps(document)),
        )

    def write(self, tick: int, time_s: float, signal: str, value: float, reason: str) -> None:
        """Append a set-point change."""
        self._put(
            "INSERT INTO writes (tick, time_s, signal, value, reason) VALUES (?, ?, ?, ?, ?)",
            (tick, time_s, signal, value, reason),
        )

    def event(self, tick: int, time_s: float, level: str, text: str) -> None:
        """Append an event and have it committed at once: what an operator must know outlives a crash."""
        self._put(EVENT, (tick, time_s, time.time(), level, plain(text)), urgent=True)

    def state(
        self, tick: int, time_s: float, profile_s: float, source: str, event: str, target: str, reason: str
    ) -> None:
        """Append a transition; `profile_s` is where the profile's clock stands. Committed with the event about it."""
        self._put(
            "INSERT INTO states (tick, time_s, wall_s, profile_s, source, event, target, reason) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (tick, time_s, time.time(), profile_s, source, event, target, plain(reason)),
        )

    def segment(self, row: SegmentRow) -> None:
        """Append where the run goes on after a gap, and have it committed at once."""
        self._put("INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?, ?, ?)", astuple(row), urgent=True)

    def put_meta(self, key: str, value: Any) -> None:
        """Set one entry of the header table."""
        self._put("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, json.dumps(value)))

    def check(self) -> None:
        """Raise JournalError where rows do not reach the disk any more. Never waits."""
        if self._failure is not None:
            raise JournalError(self._failure)

    def commit(self) -> None:
        """Wait until everything appended so far is durable; raises JournalError where that cannot be."""
        with self._changed:
            wanted = self._put_count
            self._urgent = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._done_count >= wanted or self._failure is not None, COMMIT_WITHIN_S)
        if self._done_count >= wanted:
            return
        self.check()
        raise JournalError(f"{self._path} was not written within {COMMIT_WITHIN_S:g} s; free it from other programs")

    def close(self) -> None:
        """Commit, fold the write-ahead log back into the file and close; raises JournalError as `commit` does."""
        try:
            self.commit()
        finally:
            with self._changed:
                self._ending = True
                self._changed.notify_all()
            self._thread.join(COMMIT_WITHIN_S)
            if not self._thread.is_alive():
                self._store.close(tidy=self._failure is None)

    def _put(self, statement: str, row: Row, *, urgent: bool = False) -> None:
        with self._changed:
            if len(self._queue) >= LONGEST_QUEUE:
                self._failure = self._failure or f"{self._path} is {LONGEST_QUEUE} rows behind; free it or its disk"
                return
            self._queue.append((statement, row))
            self._put_count += 1
            if urgent:
                self._urgent = True
                self._changed.notify_all()

    def _work(self) -> None:
        batch: list[JournalEntry] = []
        while True:
            with self._changed:
                if not self._ending:
                    self._changed.wait_for(lambda: self._urgent or self._ending, COMMIT_INTERVAL_S)
                ending, self._urgent = self._ending, False
            with contextlib.suppress(IndexError):
                while True:
                    batch.append(self._queue.popleft())
            written = self._written(batch)
            with self._changed:
                if written:
                    self._done_count += len(batch)
                    batch = []
                self._changed.notify_all()
            if ending:
                return
            if not written:
                time.sleep(0.05)

    def _written(self, batch: list[JournalEntry]) -> bool:
        """Return whether `batch` is durable now; what keeps it from that is `failure`, or a lock that may go."""
        try:
            lost = self._store.lost()
            dropped = self._store.write(batch) if batch else []
            if dropped:
                at = next((row[:2] for kind, row in batch if kind == "sample"), (0, 0.0))
                self._store.write([(EVENT, (*at, time.time(), "WARN", reason)) for reason in dropped])
        except LockedError as error:
            now = time.monotonic()
            since = self._behind_since = self._behind_since or now
            if now - since > LOCKED_AT_MOST_S:
                self._failure = (
                    f"{self._path} has been held by another program for {LOCKED_AT_MOST_S:g} s ({error}); end that"
                )
            return False
        except JournalError as error:
            self._failure = str(error)
            return False
        except BaseException as error:
            self._failure = f"{self._path} cannot be written ({type(error).__name__}: {error})"
            return False
        self._behind_since = None
        self._failure = lost
        return True
