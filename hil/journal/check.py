"""Checks of a journal before it is queried: a SQLite file can hold more than tables.

A view or a trigger would run statements of the file's author in a query or a write. A virtual table would call an
extension, and a generated column could compute without end. A journal has none of these.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

from hil.journal.documents import ShapeError, require_document
from hil.journal.rows import Header, JournalError

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C")
_LONGEST_SAID = 120
"""Characters of a message of SQLite that are shown: it quotes a damaged schema."""
_KINDS = {"int": (int,), "float": (int, float), "str": (str,), "dict[str, Any]": (dict,)}
_LONGEST_TIME_S = 8e9
"""Greatest time of a row, s, from 1970 to the year 2223; it also bounds a rig time."""
_ROLLBACK = bytes.fromhex("d9d505f920a163d7")
"""Magic of a rollback journal, which ends with it too where it names a super-journal."""
DAMAGE_ERRORS = (
    sqlite3.Error,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
)
"""Errors of SQLite, JSON and numpy for a row, cell or table that the writer did not make."""


def require_tables(database: sqlite3.Connection, path: Path) -> None:
    """Check that a journal holds tables and indices only, and set SQLite to trust nothing in it.

    Raises
    ------
    JournalError
        It holds something else. sqlite3.Error: it is damaged.
    """
    database.execute("PRAGMA trusted_schema=OFF")
    database.execute("PRAGMA cell_size_check=ON")
    database.execute("PRAGMA query_only=ON")
    kinds = "SELECT type, name, sql FROM sqlite_master"
    for kind, name, sql in database.execute(kinds):
        words = str(sql or "").upper().split()
        plain = kind in ("table", "index") and words[:2] != ["CREATE", "VIRTUAL"]
        plain = plain and not (kind == "index" and str(sql or "").count("(") > 1)  # an expression in place of a column
        if not plain or (kind == "table" and _computed(database, str(name))):
            raise JournalError(
                f"{path} holds the {kind} {str(name)[:40]!r}, which no journal of this harness has; nothing in it is "
                "used: take the journal from the machine that made it"
            )


def _computed(database: sqlite3.Connection, table: str) -> bool:
    """Return True for a table with generated columns; the last field of `table_xinfo` is 2 or 3 for these."""
    return any(row[6] for row in database.execute("SELECT * FROM pragma_table_xinfo(?)", (table,)))


def require_header(header: Header) -> None:
    """Check that the entries of a header are consistent; raises ShapeError."""
    columns = {signal.column for signal in header.signals}
    unknown = [c for sensor in header.twin_sensors.values() for c in sensor if c not in columns]
    if unknown:
        raise ShapeError(f"a sensor of the twin reads {str(unknown[0])[:40]!r}, which is no signal")
    if not all(isinstance(name, str) for name in (*header.twin_names, header.profile)):
        raise ShapeError("a name is no text")
    if not all(math.isfinite(value) and value > 0.0 for value in (header.period_s, header.duration_s)):
        raise ShapeError("its period or duration is no positive number")
    if not all(math.isfinite(value) for value in header.noise_K.values()):
        raise ShapeError("a noise is no number")


def require_time(value: float) -> float:
    """Return a time of a row, s; raises ShapeError for one that no clock shows."""
    if not abs(value) <= _LONGEST_TIME_S:
        raise ShapeError(f"{str(value)[:40]} s is no time")
    return value


def require_alone(journal: Path) -> None:
    """Check that the rollback journal beside a journal names no further file.

    SQLite takes the name of a "super-journal" from the end of a rollback journal and deletes that file when it is
    done with it (https://www.sqlite.org/fileformat2.html, section 3.3). A journal of a run is a database by itself.

    Raises
    ------
    JournalError
        The rollback journal names one.
    """
    beside = journal.with_name(f"{journal.name}-journal")
    try:
        with beside.open("rb") as file:
            file.seek(max(beside.stat().st_size - len(_ROLLBACK), 0))
            ends = file.read()
    except OSError:
        return
    if ends == _ROLLBACK:
        raise JournalError(f"{beside} names another file that SQLite would delete; take it away and resume again")


def reports_damage(read: Callable[P, R]) -> Callable[P, R]:
    """Return a reader's method that raises JournalError for content that the writer did not make."""

    @functools.wraps(read)
    def checked(*arguments: P.args, **options: P.kwargs) -> R:
        try:
            found = read(*arguments, **options)
            for row in found if isinstance(found, list) else ():
                _require_kinds(row)
            return found
        except DAMAGE_ERRORS as error:
            part = read.__name__.replace("_read_", "")
            raise _damaged(getattr(arguments[0], "_path", "the journal"), part, error) from error

    return checked


def _require_kinds(row: object) -> None:
    """Check the cells of a row against the types that its class declares: SQLite stores any type in any column."""
    for field in dataclasses.fields(row):  # type: ignore[arg-type]
        kinds = _KINDS.get(str(field.type))
        cell = getattr(row, field.name)
        if kinds is not None and (not isinstance(cell, kinds) or (isinstance(cell, float) and not math.isfinite(cell))):
            raise ShapeError(f"{type(row).__name__}.{field.name} is {str(cell)[:40]!r}, no {field.type}")
        if isinstance(cell, int | float) and field.name in ("time_s", "wall_s", "start_s", "end_s"):
            require_time(cell)
        if isinstance(cell, dict):
            require_document(type(row).__name__, cell)


def on_one_line(error: Exception) -> str:
    """Return the message of an error on one line without control characters, cut to `_LONGEST_SAID`."""
    text = "".join(letter if letter.isprintable() else " " for letter in str(error))
    return " ".join(text.split())[:_LONGEST_SAID]


def _damaged(path: object, part: str, error: Exception) -> JournalError:
    """Return the error for a journal with an unreadable part, in one sentence."""
    named = isinstance(error, sqlite3.Error | ShapeError)  # messages of Python's own errors help no user
    why = on_one_line(error) if named else "a row is not as this version writes it"
    return JournalError(
        f"{path} is damaged: its {part} cannot be read ({why}); take the journal from the machine that made it"
    )


def checked_reader(cls: type[C]) -> type[C]:
    """Wrap every public method of a reader in `reports_damage`."""
    for name, value in vars(cls).items():
        if callable(value) and not name.startswith("_") and name != "close":
            setattr(cls, name, reports_damage(value))
    return cls


__all__ = [
    "DAMAGE_ERRORS",
    "checked_reader",
    "on_one_line",
    "reports_damage",
    "require_alone",
    "require_header",
    "require_tables",
    "require_time",
]
