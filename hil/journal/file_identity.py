"""Detection of a journal that another program replaces while a run writes it.

Inode, size and time of the database's files are compared before every write with those after the last write of this
process. A difference, or a commit of another program, starts a full check. The mark in the file's header and a second
connection then decide. A lock or a checkpoint of another program leaves the rows of this run whole. A file that was
copied or restored over the journal does not.
"""

from __future__ import annotations

import contextlib
import os
import random
import sqlite3
from pathlib import Path

BUSY_S = 0.1
"""Longest wait of the second connection for a lock of another program, s. A longer lock defers the check to the next
write."""
_File = tuple[int, int, int, int]
_SIDE_FILES = ("-wal", "-shm")
_MARK_AT = 68
"""Offset of the application id in the header of a database (https://www.sqlite.org/fileformat2.html, section 1.3)."""


def put_mark(database: sqlite3.Connection) -> None:
    """Set a random application id in a database without one: it identifies the file."""
    if int(database.execute("PRAGMA application_id").fetchone()[0]) == 0:
        database.execute(f"PRAGMA application_id={random.SystemRandom().randrange(1, 1 << 31)}")


class FileIdentity:
    """State of the files of the journal at `path` after the last write of this process, and the rows that it must hold.

    `database` is the connection that writes. Not thread-safe.
    """

    def __init__(self, path: Path, database: sqlite3.Connection) -> None:
        self._path = path
        self._database = database
        self.overwritten: str | None = None
        """Sentence about an overwritten file, which must not be written any more; None while it is whole."""
        self._last: int | None = None
        self._mark = self._header_mark()
        self._stated: dict[str, _File] = {}
        self.recount()
        self._commits = self._foreign_commits()

    def wrote(self, ticks: list[int]) -> None:
        """Store the state of the files after a write of this process, and the `ticks` of the samples in it."""
        self._rows += len(ticks)
        self._last = ticks[-1] if ticks else self._last
        self._stated = self._kept()

    def recount(self) -> None:
        """Store the state of the files and count the samples, after a write in which some rows could not be stored."""
        self._rows = self._count(self._database)
        self._stated = self._kept()

    def replaced(self) -> str | None:
        """Return why the journal is not the file of this process any more; None while it is."""
        if self.overwritten is not None:
            return self.overwritten
        state = self._state()
        for name in ("", *_SIDE_FILES):
            before, now = self._stated.get(name), state.get(name)
            if before is not None and now is None:
                return f"{self._path}{name} is gone: it was deleted or moved while the run goes on"
            if before is not None and now is not None and before[:2] != now[:2]:
                return f"{self._path}{name} is another file than the run's: it was replaced while the run goes on"
        try:
            commits = self._foreign_commits()
            if state == self._stated and commits == self._commits:
                return None
            problem = self._other_file(state) or self._missing()
        except sqlite3.OperationalError as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                return None  # checked again before the next write
            problem = str(error)
        except sqlite3.Error as error:
            problem = str(error)
        else:
            if problem is None:
                self._stated, self._commits = state, commits
                return None
        self.overwritten = (
            f"{self._path} was overwritten by another program while the run goes on ({problem}); keep copies and "
            "backups of a journal out of its run's folder"
        )
        return self.overwritten

    def _state(self) -> dict[str, _File]:
        found = {}
        for name in ("", *_SIDE_FILES):
            with contextlib.suppress(OSError):
                status = os.stat(f"{self._path}{name}")
                # The index of the write-ahead log is written by every reader.
                changes = (0, 0) if name == "-shm" else (status.st_size, status.st_mtime_ns)
                found[name] = (status.st_dev, status.st_ino, *changes)
        return found

    def _kept(self) -> dict[str, _File]:
        """Return the present state, but of what went or was replaced since the last write the state before.

        That may happen in the midst of a write, which does not notice. The next check has to.
        """
        state = self._state()
        for name, before in self._stated.items():
            if name not in state or state[name][:2] != before[:2]:
                state[name] = before
        return state

    def _foreign_commits(self) -> int:
        """Return SQLite's count of commits that other connections made."""
        return int(self._database.execute("PRAGMA data_version").fetchone()[0])

    def _other_file(self, state: dict[str, _File]) -> str | None:
        """Return why the file itself is not this run's, independent of the write-ahead log; None if it is."""
        if self._mark is not None and self._header_mark() != self._mark:
            return "it is another database"
        shrunk_by = self._stated[""][2] - state[""][2]
        return f"it has lost {shrunk_by} bytes" if shrunk_by > 0 else None

    def _header_mark(self) -> bytes | None:
        """Return the application id in the file, read by SQLite's own descriptor; None where that is not known.

        A descriptor of our own would not do: closing it would drop the locks that SQLite holds on the file.
        """
        with contextlib.suppress(OSError):
            status = os.stat(self._path)
            for name in os.listdir("/proc/self/fd"):
                with contextlib.suppress(OSError):
                    if os.path.samestat(os.fstat(int(name)), status):
                        return os.pread(int(name), 4, _MARK_AT)
        return None

    def _missing(self) -> str | None:
        """Return a text about rows of this run that a new connection does not find, or None; raises sqlite3.Error."""
        other = sqlite3.connect(self._path, timeout=BUSY_S)
        try:
            other.execute("PRAGMA query_only=ON")
            last = "SELECT 1 FROM samples WHERE tick = ?"
            if self._last is not None and other.execute(last, (self._last,)).fetchone() is None:
                return f"the sample of tick {self._last} is gone"
            if (found := self._count(other)) < self._rows:
                return f"{self._rows - found} samples are gone"
            sound = str(other.execute("PRAGMA quick_check(1)").fetchone()[0])
            return None if sound == "ok" else sound
        finally:
            other.close()

    @staticmethod
    def _count(database: sqlite3.Connection) -> int:
        return int(database.execute("SELECT count(*) FROM samples").fetchone()[0])
