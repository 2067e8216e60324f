"""The crash-safe journal of a run: one SQLite file in WAL mode, append-only, readable while it grows.

The engine is the only writer. Rows are committed together at least every `COMMIT_INTERVAL_S` of wall time, with
synchronous=FULL, so a crash or a power cut loses at most that much. Everything else (record, review, report) is
derived from the journal, live or afterwards, through `JournalReader`.

Tables: `meta` (key, JSON), `samples` (a row a tick, a column a signal), `twins` (a row a tick and twin, a column a
twin sensor), `calibrations`, `proposals`, `bands`, `writes`, `events`, `states` (a row a transition).
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.points import Signal
from hil.journal_rows import (
    BandRow,
    CalibrationRow,
    EventRow,
    Header,
    ProposalRow,
    Samples,
    StateRow,
    TwinOutput,
    WriteRow,
)

SCHEMA_VERSION = 1
COMMIT_INTERVAL_S = 0.5

_FIXED_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE calibrations (id INTEGER PRIMARY KEY, calibrator TEXT NOT NULL, start_s REAL NOT NULL,
    end_s REAL NOT NULL, document TEXT NOT NULL);
CREATE TABLE proposals (id INTEGER PRIMARY KEY, calibrator TEXT NOT NULL, time_s REAL NOT NULL, document TEXT NOT NULL);
CREATE TABLE bands (id INTEGER PRIMARY KEY, twin TEXT NOT NULL, start_s REAL NOT NULL, end_s REAL NOT NULL,
    document TEXT NOT NULL);
CREATE TABLE writes (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL, signal TEXT NOT NULL,
    value REAL NOT NULL, reason TEXT NOT NULL);
CREATE TABLE events (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL, wall_s REAL NOT NULL,
    level TEXT NOT NULL, text TEXT NOT NULL);
CREATE TABLE states (id INTEGER PRIMARY KEY, tick INTEGER NOT NULL, time_s REAL NOT NULL, wall_s REAL NOT NULL,
    profile_s REAL NOT NULL, source TEXT NOT NULL, event TEXT NOT NULL, target TEXT NOT NULL, reason TEXT NOT NULL);
"""


class JournalError(Exception):
    """The journal cannot be written or read; the message names the file and the remedy."""


def _quoted(names: Iterable[str]) -> str:
    return ", ".join('"' + name.replace('"', '""') + '"' for name in names)


class JournalWriter:
    """Appends to a new journal at `path`. Not thread-safe: the engine owns it."""

    def __init__(self, path: Path, header: Header) -> None:
        if path.exists():
            raise JournalError(f"{path} exists already; a journal is never overwritten, choose another run folder")
        self._path = path
        self._database = sqlite3.connect(path, isolation_level=None)
        self._database.execute("PRAGMA journal_mode=WAL")
        self._database.execute("PRAGMA synchronous=FULL")
        self._database.executescript("BEGIN;" + _FIXED_TABLES + "COMMIT;")
        columns = _quoted(signal.column for signal in header.signals)
        sensors = _quoted(header.twin_sensors)
        self._database.execute(
            "CREATE TABLE samples (tick INTEGER PRIMARY KEY, time_s REAL NOT NULL, wall_s REAL NOT NULL, "
            f"latency_s REAL NOT NULL, {columns}, quality BLOB NOT NULL, source_time_s BLOB NOT NULL)"
        )
        self._database.execute(
            f"CREATE TABLE twins (id INTEGER PRIMARY KEY, twin TEXT NOT NULL, tick INTEGER NOT NULL, "
            f"time_s REAL NOT NULL{', ' + sensors if sensors else ''})"
        )
        self._database.execute("CREATE INDEX twins_by_tick ON twins (twin, tick)")
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
        """Commit, fold the WAL back into the file and close."""
        try:
            self.commit()
            self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        finally:
            self._database.close()


class JournalReader:
    """Reads a journal, finished or still growing. Each call sees what is committed by then."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise JournalError(f"{path} does not exist; give the folder of a run")
        self._path = path
        try:
            self._database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
            meta = dict(self._database.execute("SELECT key, value FROM meta"))
        except sqlite3.Error as error:
            raise JournalError(f"{path} is not a journal of this harness ({error})") from error
        version = json.loads(meta.get("schema_version", "0"))
        if version != SCHEMA_VERSION:
            raise JournalError(f"{path} has schema {version}, this version reads {SCHEMA_VERSION}")
        document = json.loads(meta["header"])
        signals = tuple(
            Signal(**{**item, "plausible": tuple(item["plausible"]) if item["plausible"] else None})
            for item in document.pop("signals")
        )
        sensors = {name: tuple(columns) for name, columns in document.pop("twin_sensors").items()}
        twin_names = tuple(document.pop("twin_names"))
        self.header = Header(signals=signals, twin_sensors=sensors, twin_names=twin_names, **document)

    def meta(self, key: str) -> Any:
        """One entry of the header table, or None."""
        row = self._database.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return None if row is None else json.loads(row[0])

    def samples(self, after_tick: int = -1, limit: int = -1) -> Samples:
        """Ticks later than `after_tick`, at most `limit` (-1: all)."""
        k = len(self.header.signals)
        rows = self._database.execute(
            "SELECT * FROM samples WHERE tick > ? ORDER BY tick LIMIT ?", (after_tick, limit)
        ).fetchall()
        return Samples(
            tick=np.array([row[0] for row in rows], dtype=np.int64),
            time_s=np.array([row[1] for row in rows], dtype=np.float64),
            values=np.array([row[4 : 4 + k] for row in rows], dtype=np.float64).reshape(len(rows), k),
            quality=np.frombuffer(b"".join(row[4 + k] for row in rows), dtype=np.uint8).reshape(len(rows), k),
            source_time_s=np.frombuffer(b"".join(row[5 + k] for row in rows), dtype="<f8").reshape(len(rows), k),
        )

    def latencies(self) -> NDArray[np.float64]:
        """Time from the start of each tick to the end of its work, s, shape (n,)."""
        rows = self._database.execute("SELECT latency_s FROM samples ORDER BY tick").fetchall()
        return np.array([row[0] for row in rows], dtype=np.float64)

    def twin_outputs(self, twin: str, after_tick: int = -1, limit: int = -1) -> TwinOutput:
        """Predictions of `twin` later than `after_tick`."""
        m = len(self.header.twin_sensors)
        rows = self._database.execute(
            "SELECT * FROM twins WHERE twin = ? AND tick > ? ORDER BY id LIMIT ?", (twin, after_tick, limit)
        ).fetchall()
        return TwinOutput(
            twin=twin,
            tick=np.array([row[2] for row in rows], dtype=np.int64),
            time_s=np.array([row[3] for row in rows], dtype=np.float64),
            values=np.array([row[4:] for row in rows], dtype=np.float64).reshape(len(rows), m),
        )

    def calibrations(self, after_id: int = 0) -> list[CalibrationRow]:
        """Finished windows with an id above `after_id`."""
        rows = self._database.execute("SELECT * FROM calibrations WHERE id > ? ORDER BY id", (after_id,))
        return [CalibrationRow(row[0], row[1], row[2], row[3], json.loads(row[4])) for row in rows]

    def proposals(self, after_id: int = 0) -> list[ProposalRow]:
        """Proposals with an id above `after_id`; none in a journal from before there were any."""
        rows = self._optional("proposals", after_id)
        return [ProposalRow(row[0], row[1], row[2], json.loads(row[3])) for row in rows]

    def bands(self, after_id: int = 0) -> list[BandRow]:
        """Bands with an id above `after_id`; none in a journal from before there were any."""
        rows = self._optional("bands", after_id)
        return [BandRow(row[0], row[1], row[2], row[3], json.loads(row[4])) for row in rows]

    def _optional(self, table: str, after_id: int) -> list[Any]:
        known = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
        if self._database.execute(known, (table,)).fetchone() is None:
            return []
        return self._database.execute(f"SELECT * FROM {table} WHERE id > ? ORDER BY id", (after_id,)).fetchall()

    def writes(self, after_id: int = 0) -> list[WriteRow]:
        """Set-point changes with an id above `after_id`."""
        return [
            WriteRow(*row)
            for row in self._database.execute("SELECT * FROM writes WHERE id > ? ORDER BY id", (after_id,))
        ]

    def events(self, after_id: int = 0) -> list[EventRow]:
        """Events with an id above `after_id`."""
        return [
            EventRow(*row)
            for row in self._database.execute("SELECT * FROM events WHERE id > ? ORDER BY id", (after_id,))
        ]

    def states(self, after_id: int = 0) -> list[StateRow]:
        """Transitions with an id above `after_id`; none in a journal from before there were any."""
        return [StateRow(*row) for row in self._optional("states", after_id)]

    def close(self) -> None:
        """Close the file."""
        self._database.close()
