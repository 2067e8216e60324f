"""The crash-safe journal of a run: one SQLite file in WAL mode, append-only, readable while it grows.

The engine is the only writer. Rows are committed together at least every `COMMIT_INTERVAL_S` of wall time, with
synchronous=FULL, so a crash or a power cut loses at most that much. Everything else (record, review, report) is
derived from the journal, live or afterwards, through `JournalReader`.

Tables: `meta` (key, JSON), `samples` (a row a tick, a column a signal), `twins` (a row a tick and twin, a column a
twin sensor), `calibrations`, `proposals`, `bands`, `writes`, `events`, `states` (a row a transition), `segments` (a row
a resumption).
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.journal_reader import SCHEMA_VERSION, JournalReader
from hil.journal_rows import Header, JournalError, SegmentRow

__all__ = ["SCHEMA_VERSION", "Header", "JournalError", "JournalReader", "JournalWriter"]

COMMIT_INTERVAL_S = 0.5

_FIXED_TABLES = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS calibrations (id INTEGER PRIMARY KEY, calibrator TEXT NOT NULL, start_s REAL NOT NULL,
    end_s REAL NOT NULL, document TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS proposals (id INTEGER PRIMARY KEY, calibrator TEXT NOT NULL, time_s REAL NOT NULL,
    document TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS bands (id INTEGER PRIMARY KEY, twin TEXT NOT NULL, start_s REAL NOT NULL,
    end_s REAL NOT NULL, document TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS writes (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL,
    signal TEXT NOT NULL, value REAL NOT NULL, reason TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS events (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL,
    wall_s REAL NOT NULL, level TEXT NOT NULL, text TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS states (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL,
    wall_s REAL NOT NULL, profile_s REAL NOT NULL, source TEXT NOT NULL, event TEXT NOT NULL, target TEXT NOT NULL,
    reason TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS segments (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL,
    wall_s REAL NOT NULL, gap_s REAL NOT NULL, profile_s REAL NOT NULL, aim_tick INTEGER NOT NULL,
    reason TEXT NOT NULL);
"""


def _quoted(names: Iterable[str]) -> str:
    return ", ".join('"' + name.replace('"', '""') + '"' for name in names)


class JournalWriter:
    """Appends to a journal at `path`: a new one, or with `again` one of a run that was cut, whose header must be the
    same. Not thread-safe: the engine owns it.

    Raises JournalError where the file is there already, or with `again` is not there or of other signals.
    """

    def __init__(self, path: Path, header: Header, *, again: bool = False) -> None:
        if again:
            reader = JournalReader(path)
            known = reader.header
            reader.close()
            if known != header:
                raise JournalError(f"{path} is of other signals or twins than this run; start a new run")
        elif path.exists():
            raise JournalError(f"{path} exists already; a journal is never overwritten, choose another run folder")
        self._path = path
        self._database = sqlite3.connect(path, isolation_level=None)
        self._database.execute("PRAGMA journal_mode=WAL")
        self._database.execute("PRAGMA synchronous=FULL")
        self._database.executescript("BEGIN;" + _FIXED_TABLES + "COMMIT;")
        columns = _quoted(signal.column for signal in header.signals)
        sensors = _quoted(header.twin_sensors)
        self._database.execute(
            "CREATE TABLE IF NOT EXISTS samples (tick INTEGER PRIMARY KEY, time_s REAL NOT NULL, wall_s REAL NOT NULL, "
            f"latency_s REAL NOT NULL, {columns}, quality BLOB NOT NULL, source_time_s BLOB NOT NULL)"
        )
        self._database.execute(
            f"CREATE TABLE IF NOT EXISTS twins (id INTEGER PRIMARY KEY, twin TEXT NOT NULL, tick INTEGER NOT NULL, "
            f"time_s REAL NOT NULL{', ' + sensors if sensors else ''})"
        )
        self._database.execute("CREATE INDEX IF NOT EXISTS twins_by_tick ON twins (twin, tick)")
        marks = ", ".join("?" * (len(header.signals) + 6))
        self._insert_sample = f"INSERT INTO samples VALUES ({marks})"
        twin_marks = ", ".join("?" * (len(header.twin_sensors) + 3))
        self._insert_twin = (
            f"INSERT INTO twins (twin, tick, time_s{', ' + sensors if sensors else ''}) VALUES ({twin_marks})"
        )
        self._rows: list[tuple[Any, ...]] = []
        self._twin_rows: list[tuple[Any, ...]] = []
        self._other: list[tuple[str, tuple[Any, ...]]] = []
        self._last_commit = time.monotonic()
        if again:
            self.put_meta("exit_status", None)
        else:
            self.put_meta("schema_version", SCHEMA_VERSION)
            self.put_meta("header", asdict(header))
        self.commit()

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
        source = np.asarray(source_time_s, dtype="<f8").tobytes()
        self._rows.append((tick, time_s, wall_s, latency_s, *values, bytes(quality), source))

    def twin_outputs(self, twin: str, ticks: Sequence[int], time_s: Sequence[float], values: NDArray[Any]) -> None:
        """Append predictions of `twin`, `values (n, m)`."""
        self._twin_rows.extend(
            (twin, int(tick), float(t), *row) for tick, t, row in zip(ticks, time_s, values.tolist(), strict=True)
        )

    def calibration(self, calibrator: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """Append a finished window."""
        self._other.append(
            (
                "INSERT INTO calibrations (calibrator, start_s, end_s, document) VALUES (?, ?, ?, ?)",
                (calibrator, start_s, end_s, json.dumps(document)),
            )
        )

    def proposal(self, calibrator: str, time_s: float, document: dict[str, Any]) -> None:
        """Append a proposal."""
        self._other.append(
            (
                "INSERT INTO proposals (calibrator, time_s, document) VALUES (?, ?, ?)",
                (calibrator, time_s, json.dumps(document)),
            )
        )

    def band(self, twin: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """Append a twin's band."""
        self._other.append(
            (
                "INSERT INTO bands (twin, start_s, end_s, document) VALUES (?, ?, ?, ?)",
                (twin, start_s, end_s, json.dumps(document)),
            )
        )

    def write(self, tick: int, time_s: float, signal: str, value: float, reason: str) -> None:
        """Append a set-point change."""
        self._other.append(
            (
                "INSERT INTO writes (tick, time_s, signal, value, reason) VALUES (?, ?, ?, ?, ?)",
                (tick, time_s, signal, value, reason),
            )
        )

    def event(self, tick: int, time_s: float, level: str, text: str) -> None:
        """Append an event and commit it at once: what an operator must know outlives a crash."""
        self._other.append(
            (
                "INSERT INTO events (tick, time_s, wall_s, level, text) VALUES (?, ?, ?, ?, ?)",
                (tick, time_s, time.time(), level, text),
            )
        )
        self.commit()

    def state(
        self, tick: int, time_s: float, profile_s: float, source: str, event: str, target: str, reason: str
    ) -> None:
        """Append a transition; `profile_s` is where the profile's clock stands. Committed with the event about it."""
        self._other.append(
            (
                "INSERT INTO states (tick, time_s, wall_s, profile_s, source, event, target, reason) "
                "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (tick, time_s, time.time(), profile_s, source, event, target, reason),
            )
        )

    def segment(self, row: SegmentRow) -> None:
        """Append where the run goes on after a gap, and commit it."""
        self._other.append(("INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?, ?, ?)", astuple(row)))
        self.commit()

    def put_meta(self, key: str, value: Any) -> None:
        """Set one entry of the header table."""
        self._other.append(("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, json.dumps(value))))

    def commit_if_due(self) -> None:
        """Commit when the last commit is `COMMIT_INTERVAL_S` old."""
        if time.monotonic() - self._last_commit >= COMMIT_INTERVAL_S:
            self.commit()

    def commit(self) -> None:
        """Make everything appended so far durable; raises JournalError on a full disk or a lost file."""
        try:
            self._database.execute("BEGIN")
            if self._rows:
                self._database.executemany(self._insert_sample, self._rows)
            if self._twin_rows:
                self._database.executemany(self._insert_twin, self._twin_rows)
            for statement, values in self._other:
                self._database.execute(statement, values)
            self._database.execute("COMMIT")
        except sqlite3.Error as error:
            if self._database.in_transaction:
                self._database.execute("ROLLBACK")
            raise JournalError(
                f"{self._path} cannot be written ({error}); free the disk or move the run folder"
            ) from error
        self._rows.clear()
        self._twin_rows.clear()
        self._other.clear()
        self._last_commit = time.monotonic()

    def close(self) -> None:
        """Commit, fold the write-ahead log back into the file and close.

        What is closed is a plain file again: a reader of a database in WAL mode, which may not write, would leave its
        `-shm` and `-wal` behind. Where someone reads just now it stays as it is, and is whole all the same.
        """
        try:
            self.commit()
            self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self._database.execute("PRAGMA busy_timeout=200")
            with contextlib.suppress(sqlite3.OperationalError):
                self._database.execute("PRAGMA journal_mode=DELETE")
        finally:
            self._database.close()
