"""Stream to PostgreSQL: samples, events and the position of a run in one transaction a block."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import psycopg
from psycopg import errors
from psycopg.conninfo import conninfo_to_dict

from drivers.historian import index_by_time
from hil.files import printable
from hil.stream.address import Address, require_known_host
from hil.stream.errors import StoreDownError, StreamError
from hil.stream.store import Block, Position, RunIdentity, iso_time
from hil.stream.tables import COPY_SAMPLES, SAMPLES, TABLES, binary_samples

ROWS = 200_000
"""Rows of a transaction at most: some 8 MB, so that little is sent again when the server goes away."""
ANSWER_WITHIN_S = 10
"""Longest time to connect, s."""
_WIRE: dict[str, Any] = {"keepalives_idle": 10, "tcp_user_timeout": 30_000}
"""Times by which a dead wire is noticed: s without data until the first probe, ms without acknowledgement."""
_LOCK = 0x68696C
"""Key of the advisory lock under which tables are made: two streams may be the first at the same time."""
_PERMANENT = (
    "authentication failed",
    "no password supplied",
    "does not exist",
    "pg_hba.conf",
    "certificate",
    "support SSL",
)
"""Words of the server and of libpq for a refusal that trying again cannot help."""


class PostgresStore:
    """Connection to the tables `hil_runs`, `hil_signals`, `hil_samples` and `hil_events` for one run.

    The position of the run is a part of its row in `hil_runs`, which each transaction locks. A sample is therefore
    stored once, also if two processes stream the same run.

    Raises
    ------
    StreamError
        The server refuses the user, the database or the tables.
    StoreDownError
        The server does not answer.
    """

    stays = False

    def __init__(self, address: Address, run: RunIdentity) -> None:
        self._shown, self._run = address.shown, run
        self._password = _parameters(address).get("password")
        self.longest_block = max(1, ROWS // max(1, len(run.signals)))
        try:
            self._base: psycopg.Connection[Any] = psycopg.connect(address.url, connect_timeout=ANSWER_WITHIN_S, **_WIRE)
        except psycopg.OperationalError as error:
            raise self._refusal(error) from None
        try:
            with self._explained():
                self._make_tables()
                self._number, self._signals = self._registered()
                self._base.commit()
        except BaseException:
            self._base.close()
            raise

    def position(self) -> Position:
        with self._explained():
            found = self._locked_position()
            self._base.rollback()
        return found

    def send(self, block: Block) -> Position:
        with self._explained():
            found = self._locked_position()
            if found != block.before:  # another process has stored more
                self._base.rollback()
                return found
            if len(block.tick):
                with self._base.cursor() as cursor, cursor.copy(COPY_SAMPLES) as pipe:
                    pipe.write(binary_samples(self._number, self._signals, block.time_us, block.values, block.quality))
            if block.events:
                with self._base.cursor() as cursor:
                    cursor.executemany(
                        "INSERT INTO hil_events (run, event, time, level, text) VALUES (%s, %s, %s, %s, %s)",
                        [
                            (self._number, event.id, iso_time(event.time_us), _text(event.level), _text(event.text))
                            for event in block.events
                        ],
                    )
            after = block.after
            self._base.execute(
                "UPDATE hil_runs SET position = %s, event = %s, state = %s, reason = %s WHERE run = %s",
                [after.tick, after.event, _text(block.state.name), _text(block.state.reason), self._number],
            )
            self._base.commit()
        return after

    def close(self, *, ended: bool) -> None:
        self._base.close()

    def _locked_position(self) -> Position:
        """Return the stored position and hold it until the transaction ends."""
        row = self._base.execute(
            "SELECT position, event FROM hil_runs WHERE run = %s FOR UPDATE", [self._number]
        ).fetchone()
        if row is None:
            raise StreamError(f"{self._shown}: the run was deleted from hil_runs; start the stream again to refill it")
        return Position(*row)

    def _make_tables(self) -> None:
        names = ("hil_runs", "hil_signals", SAMPLES, "hil_events")
        if all(self._base.execute("SELECT to_regclass(%s)", [name]).fetchone() != (None,) for name in names):
            return
        self._base.execute("SELECT pg_advisory_xact_lock(%s)", [_LOCK])
        for statement in TABLES:
            self._base.execute(statement)
        index_by_time(self._base, SAMPLES, "time")
        self._base.commit()

    def _registered(self) -> tuple[int, np.ndarray[Any, np.dtype[np.int64]]]:
        """Return the numbers of the run and of its signals, in their order."""
        run = self._run
        self._base.execute(
            "INSERT INTO hil_runs (uid, name, profile, period_s) VALUES (%s, %s, %s, %s) ON CONFLICT DO NOTHING",
            [_text(run.uid), _text(run.name), _text(run.profile), run.period_s],
        )
        found = self._base.execute("SELECT run FROM hil_runs WHERE uid = %s", [_text(run.uid)]).fetchone()
        if found is None:
            raise StreamError(f"{self._shown}: hil_runs took no row; check its rules and triggers")
        with self._base.cursor() as cursor:
            cursor.executemany(
                "INSERT INTO hil_signals (run, name, unit, kind, doc) VALUES (%s, %s, %s, %s, %s) "
                "ON CONFLICT DO NOTHING",
                [
                    (found[0], _text(signal.column), _text(signal.unit), signal.kind, _text(signal.doc))
                    for signal in run.signals
                ],
            )
        rows = self._base.execute("SELECT name, signal FROM hil_signals WHERE run = %s", [found[0]])
        numbers: dict[str, int] = dict(rows.fetchall())
        return int(found[0]), np.array([numbers[_text(signal.column)] for signal in run.signals], dtype=np.int64)

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """Convert errors of the server: to StoreDownError where trying again can help, else to StreamError."""
        try:
            yield
        except (errors.DiskFull, errors.InsufficientResources):
            raise StoreDownError(f"{self._shown}: the disk or memory of the database is full; make room") from None
        except (psycopg.OperationalError, psycopg.InterfaceError):
            raise StoreDownError(f"{self._shown} went away") from None
        except psycopg.Error as error:
            raise StreamError(f"{self._shown}: {self._first_line(error)}") from None

    def _refusal(self, error: psycopg.OperationalError) -> StreamError | StoreDownError:
        text = str(error)
        if "password" in text and any(words in text for words in _PERMANENT[:2]):
            return StreamError(
                f"{self._shown}: the server refused the password; check user and password, or set PGPASSWORD or "
                "~/.pgpass"
            )
        if any(words in text for words in _PERMANENT):
            return StreamError(f"{self._shown}: {self._first_line(error)}; check user, database and encryption")
        return StoreDownError(f"{self._shown} cannot be reached: {self._first_line(error)}")

    def _first_line(self, error: Exception) -> str:
        line = (str(error).splitlines() or ["no answer"])[0].strip()
        return line.replace(self._password, "...") if self._password else line


def require_known_database_host(address: Address) -> None:
    """Check the address of a database, and that its host has an address.

    Raises
    ------
    StreamError
        The address cannot be read, or there is no such host.
    StoreDownError
        The name service does not answer.
    """
    found = _parameters(address)
    host = found.get("host") or ""
    if host and "hostaddr" not in found and "," not in host and not host.startswith(("/", "@")):
        require_known_host(host)


def _parameters(address: Address) -> dict[str, str]:
    try:
        return {key: str(value) for key, value in conninfo_to_dict(address.url).items() if value is not None}
    except psycopg.Error:
        raise StreamError(
            f"the address of the database cannot be read; write {address.scheme}://USER@HOST:PORT/DATABASE, a password "
            "with %40 for @"
        ) from None


def _text(text: str) -> str:
    """Return text that the server takes: without NUL and lone surrogates."""
    return printable(text).replace("\x00", "")
