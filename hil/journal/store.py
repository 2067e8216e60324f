"""Journal file: the SQLite database behind a journal, its tables, and the one transaction that fills them."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from hil.files import plain
from hil.journal.file_identity import FileIdentity, put_mark
from hil.journal.reader import SCHEMA_VERSION, JournalReader
from hil.journal.rows import Header, JournalError

BUSY_S = 0.1
"""So long a write waits for a lock of another program before it is tried again later, s."""
_BUSY_CODES = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)

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
EVENT = "INSERT INTO events (tick, time_s, wall_s, level, text) VALUES (?, ?, ?, ?, ?)"

Row = tuple[Any, ...]
JournalEntry = tuple[Literal["sample", "twin"] | str, Row]
"""Row to write: a sample, a twin's outputs, or any other SQL statement, and its values."""


class LockedError(Exception):
    """Another program holds the journal just now; the same batch can be written later."""


class JournalStore:
    """Open database of a journal. Not thread-safe: one thread at a time."""

    def __init__(self, path: Path, header: Header, *, again: bool) -> None:
        if again:
            reader = JournalReader(path)
            known = reader.header
            reader.close()
            if known != header:
                raise JournalError(f"{path} is of other signals or twins than this run; start a new run")
        elif path.exists():
            raise JournalError(f"{path} exists already; a journal is never overwritten, choose another run folder")
        self._path = path
        self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=BUSY_S)
        put_mark(self._database)
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
        first: list[JournalEntry] = [_meta("exit_status", None)]
        if not again:
            first = [_meta("schema_version", SCHEMA_VERSION), _meta("header", asdict(header))]
        self._transact(first, one_by_one=False)
        self._identity = FileIdentity(path, self._database)
        self._folder_name = os.fspath(path.parent)  # asked for with every batch

    def lost(self) -> str | None:
        """Return why what is written would be lost with this process: the file is not at its place, or not the same."""
        if (replaced := self._identity.replaced()) is not None:
            return replaced
        if not os.access(self._folder_name, os.W_OK):
            return f"{self._path.parent} has become read-only while the run goes on"
        return None

    def write(self, batch: list[JournalEntry]) -> list[str]:
        """Write `batch` in one transaction; returns the reasons of rows that no database can hold and were dropped.

        Raises LockedError where another program holds the file, JournalError on a full or broken disk; nothing of the
        batch is written then. What another program put in the place of the journal is left as it is.
        """
        if self._identity.overwritten is not None:
            raise JournalError(self._identity.overwritten)
        try:
            try:
                self._transact(batch, one_by_one=False)
                self._identity.wrote([row[0] for kind, row in batch if kind == "sample"])
                return []
            except (sqlite3.OperationalError, sqlite3.DatabaseError) as error:
                if not isinstance(error, sqlite3.IntegrityError | sqlite3.ProgrammingError | sqlite3.DataError):
                    raise
            except (ValueError, TypeError, OverflowError, sqlite3.InterfaceError):
                pass
            # Some row cannot be stored: it must not take its neighbours.
            dropped = self._transact(batch, one_by_one=True)
            self._identity.recount()
            return dropped
        except sqlite3.Error as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF in _BUSY_CODES:
                raise LockedError(str(error)) from error
            raise JournalError(
                f"{self._path} cannot be written ({error}); free the disk or move the run folder"
            ) from error

    def _transact(self, batch: list[JournalEntry], *, one_by_one: bool) -> list[str]:
        dropped: list[str] = []
        execute = self._database.execute
        try:
            execute("BEGIN IMMEDIATE")
            if one_by_one:
                for entry in batch:
                    try:
                        execute(self._statement(entry[0]), entry[1])
                    except (
                        ValueError,
                        TypeError,
                        OverflowError,
                        sqlite3.InterfaceError,
                        sqlite3.ProgrammingError,
                        sqlite3.IntegrityError,
                        sqlite3.DataError,
                    ) as error:
                        dropped.append(plain(f"{_named(entry)} could not be journaled ({error}) and is left out", 300))
            else:
                for kind in ("sample", "twin"):
                    rows = [row for name, row in batch if name == kind]
                    if rows:
                        self._database.executemany(self._statement(kind), rows)
                for name, row in batch:
                    if name not in ("sample", "twin"):
                        execute(name, row)
            execute("COMMIT")
        except BaseException:
            if self._database.in_transaction:
                execute("ROLLBACK")
            raise
        return dropped

    def _statement(self, kind: str) -> str:
        return {"sample": self._insert_sample, "twin": self._insert_twin}.get(kind, kind)

    def close(self, *, tidy: bool) -> None:
        """Close; `tidy` folds the write-ahead log back into the file first.

        What is closed so is a plain file again: a reader of a database in WAL mode, which may not write, would leave
        its `-shm` and `-wal` behind. Where someone reads just now it stays as it is, and is whole all the same.
        """
        try:
            if tidy:
                self._database.execute("PRAGMA busy_timeout=200")
                with contextlib.suppress(sqlite3.Error):
                    self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                    self._database.execute("PRAGMA journal_mode=DELETE")
        finally:
            self._database.close()


def _quoted(names: Iterable[str]) -> str:
    return ", ".join('"' + name.replace('"', '""') + '"' for name in names)


def _meta(key: str, value: Any) -> JournalEntry:
    return "INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, json.dumps(value))


def _named(entry: JournalEntry) -> str:
    """Return what a row is, for a person."""
    kind, row = entry
    if kind == "sample":
        return f"the sample of tick {row[0]!r}"
    if kind == "twin":
        return f"an output of the twin {row[0]!r}"
    return f"a row of {kind.split()[2]}" if len(kind.split()) > 2 else "a row"
