"""Historian in PostgreSQL: one table of samples, a hypertable where TimescaleDB is installed, else with a BRIN index.

A URL may hold a password; no message does. A database that goes away in the middle of reading is asked again from
the last sample that came.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
import psycopg
from numpy.typing import NDArray
from psycopg import sql

from drivers.historian.protocol import (
    COLUMNS,
    HistorianAwayError,
    HistorianError,
    HistorianFailedError,
    Samples,
    empty,
)
from drivers.historian.server import index_by_time, without_password

TABLE = "samples"
PATIENCE_S = 60.0
"""Time for which a database that went away is called again: a restart takes half a minute."""
PAUSE_S = 1.0
ROWS = 200_000
"""Rows of a piece: some 10 MB of text, so that little is lost when the database goes away."""

_TYPES = {
    "timestamp": ("D", "timestamptz"),
    "tag": ("SE", "text"),
    "value": ("N", "double precision"),
    "quality": ("N", "smallint"),
}
"""Categories of types (`pg_type.typcategory`: D time, S text, E enumeration, N number) and the usual type."""
_NO_PLACE = np.zeros((0, 2), dtype=np.int64)
_MOST_QUALITY = np.iinfo(np.int16).max

T = TypeVar("T")


@dataclass(frozen=True)
class _PlacedSamples(Samples):
    """Samples with the place of each in the table (n, 2): table of the part, and place within it."""

    place: NDArray[np.int64]


class PostgresStore:
    """A database with a table `samples` of timestamp (timestamptz), tag, value and quality.

    Parameters
    ----------
    url
        `postgresql://user:password@host:port/database`, or with the parameters of libpq.
    create
        Make the table where there is none.
    patience_s
        Time for which a database that went away is called again.
    say
        Called with a sentence when the database goes away and when it is back.
    """

    def __init__(
        self,
        url: str,
        *,
        create: bool = False,
        patience_s: float = PATIENCE_S,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._url, self._say, self._gone = url, say, False
        self.name = without_password(url)
        self._patience_s = patience_s
        self._base = self._connect()
        columns = self._again(self._columns)
        if not columns and create:
            self._again(self._create)
            columns = self._again(self._columns)
        missing = [name for name in COLUMNS if name not in columns]
        if missing:
            self.close()
            if len(missing) == len(COLUMNS):
                raise HistorianError(
                    f"{self.name}: has no table {TABLE!r}; it needs one with the columns {', '.join(COLUMNS)}"
                )
            raise HistorianError(
                f"{self.name}: table {TABLE!r} lacks the column {', '.join(missing)}; rename or add it"
            )
        for name, (categories, usual) in _TYPES.items():
            category, kind = columns[name]
            if category not in categories:
                self.close()
                raise HistorianError(f"{self.name}: column {name} of table {TABLE!r} is {kind}; make it {usual}")
        self.zoned: bool | None = "with time zone" in columns["timestamp"][1]
        self._in_place = self._again(self._keeps_places)

    def tags(self) -> tuple[str, ...]:
        # A loose index scan: a distinct over the whole table reads every sample.
        query = f"""WITH RECURSIVE t AS (
            (SELECT tag FROM {TABLE} ORDER BY tag LIMIT 1)
            UNION ALL
            SELECT (SELECT tag FROM {TABLE} WHERE tag > t.tag ORDER BY tag LIMIT 1) FROM t WHERE t.tag IS NOT NULL
        ) SELECT tag FROM t WHERE tag IS NOT NULL"""
        return tuple(row[0] for row in self._again(lambda: self._base.execute(query).fetchall()))

    def span(self) -> tuple[float, float] | None:
        query = f"SELECT extract(epoch FROM min(timestamp)), extract(epoch FROM max(timestamp)) FROM {TABLE}"
        low, high = self._again(lambda: self._base.execute(query).fetchone()) or (None, None)
        return None if low is None or high is None else (float(low), float(high))

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        return {tag: self._read_tag(tag, start_s, end_s) for tag in tags}

    def append(self, samples: Mapping[str, Samples]) -> None:
        text = io.StringIO()
        for tag, one in samples.items():
            name = tag.replace("\\", "\\\\").replace("\t", "\\t").replace("\n", "\\n")
            stamps = np.datetime_as_string(np.round(one.time_s * 1e6).astype("datetime64[us]"), unit="us")
            for stamp, value, quality in zip(stamps, one.value, one.quality, strict=True):
                text.write(f"{stamp}Z\t{name}\t{'NaN' if np.isnan(value) else repr(float(value))}\t{int(quality)}\n")

        def copy() -> None:
            query = f"COPY {TABLE} ({', '.join(COLUMNS)}) FROM STDIN"
            with self._base.cursor() as cursor, cursor.copy(query) as pipe:
                pipe.write(text.getvalue())
            self._base.commit()

        if text.tell():
            self._again(copy)

    def close(self) -> None:
        self._base.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read_tag(self, tag: str, start_s: float, end_s: float) -> Samples:
        """Return the samples of a tag as they were stored.

        They are read piece by piece in the order of time, so that an interrupted read goes on.
        """
        pieces: list[_PlacedSamples] = []
        seen_at, seen = start_s, 0
        while True:
            rows = self._again(lambda at=seen_at, skip=seen: self._piece(tag, at, end_s, skip))  # type: ignore[misc]
            if len(rows):
                pieces.append(rows)
                last = float(rows.time_s[-1])
                equal = int((rows.time_s == last).sum())
                seen = seen + equal if last == seen_at else equal
                seen_at = last
            if len(rows) < ROWS:
                break
        if not pieces:
            return empty()
        place = np.concatenate([piece.place for piece in pieces])
        order = np.lexsort((place[:, 1], place[:, 0]))
        return Samples(
            *(
                np.concatenate([getattr(piece, name) for piece in pieces])[order]
                for name in ("time_s", "value", "quality")
            )
        )

    def _piece(self, tag: str, start_s: float, end_s: float, skip: int) -> _PlacedSamples:
        where = [sql.SQL("tag = {}").format(sql.Literal(tag))]
        for sign, at in ((">=", start_s), ("<", end_s)):
            if np.isfinite(at):
                stamp = f"{np.datetime64(round(at * 1e6), 'us')}Z"
                where.append(sql.SQL(f"timestamp {sign} {{}}::timestamptz").format(sql.Literal(stamp)))
        place = "tableoid::bigint, ((ctid::text::point)[0] * 65536 + (ctid::text::point)[1])::bigint"
        query = sql.SQL(
            "COPY (SELECT (extract(epoch FROM timestamp) * 1000000)::bigint, coalesce(value::float8, 'NaN'), "
            f"coalesce(quality, 0)::bigint, {place if self._in_place else '0, 0'} "
            f"FROM {TABLE} WHERE {{}} ORDER BY timestamp, {'ctid' if self._in_place else 'value, quality'} "
            f"OFFSET {skip} LIMIT {ROWS}) TO STDOUT"
        ).format(sql.SQL(" AND ").join(where))
        with self._base.cursor() as cursor, cursor.copy(query) as pipe:
            text = b"".join(bytes(part) for part in pipe)
        self._base.commit()
        if not text:
            return _PlacedSamples(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int16), _NO_PLACE)
        kinds = [("t", np.int64), ("v", np.float64), ("q", np.int64), ("part", np.int64), ("place", np.int64)]
        rows = np.loadtxt(io.BytesIO(text), delimiter="\t", dtype=kinds, ndmin=1)
        beyond = np.flatnonzero(np.abs(rows["q"]) > _MOST_QUALITY)
        if len(beyond):
            raise HistorianError(
                f"{self.name}: tag {tag} has the quality {rows['q'][beyond[0]]}, which is no OPC code; mend the store"
            )
        places = np.stack([rows["part"], rows["place"]], axis=1)
        return _PlacedSamples(rows["t"] / 1e6, rows["v"].copy(), rows["q"].astype(np.int16), places)

    def _columns(self) -> dict[str, tuple[str, str]]:
        """Return category and type of each column."""
        query = (
            "SELECT attname, typcategory, format_type(atttypid, NULL) FROM pg_attribute "
            "JOIN pg_type t ON t.oid = atttypid "
            "WHERE attrelid = to_regclass(%s) AND attnum > 0 AND NOT attisdropped"
        )
        found = {str(row[0]): (_text(row[1]), str(row[2])) for row in self._base.execute(query, [TABLE]).fetchall()}
        self._base.commit()
        return found

    def _keeps_places(self) -> bool:
        """Return True if the place of a row tells when it was stored.

        A view has no places. In a table of which rows were removed or changed, later ones may stand before earlier
        ones; its samples then come in the order of time.
        """
        query = """SELECT relkind, (
            SELECT coalesce(sum(n_tup_upd + n_tup_del), 0) FROM pg_stat_user_tables
            WHERE relid = c.oid OR relid IN (SELECT inhrelid FROM pg_inherits WHERE inhparent = c.oid)
        ) FROM pg_class c WHERE c.oid = to_regclass(%s)"""
        kind, changed = self._base.execute(query, [TABLE]).fetchone() or ("v", 0)
        self._base.commit()
        return _text(kind) in ("r", "p", "m") and int(changed) == 0

    def _create(self) -> None:
        self._base.execute(
            f"CREATE TABLE IF NOT EXISTS {TABLE} (timestamp timestamptz NOT NULL, tag text NOT NULL, "
            "value double precision, quality smallint NOT NULL DEFAULT 0)"
        )
        self._base.execute(f"CREATE INDEX IF NOT EXISTS {TABLE}_tag_time ON {TABLE} (tag, timestamp)")
        index_by_time(self._base, TABLE, "timestamp")
        self._base.commit()

    def _connect(self) -> psycopg.Connection[Any]:
        try:
            return psycopg.connect(self._url, connect_timeout=10)
        except psycopg.Error as error:
            raise HistorianError(f"{self.name}: {_refusal(error, self._url)}") from error

    def _again(self, ask: Callable[[], T]) -> T:
        """Return what `ask` returns; a connection that is lost is made again for as long as the patience lasts."""
        deadline = time.monotonic() + self._patience_s
        while True:
            try:
                return ask()
            except (psycopg.errors.DiskFull, psycopg.errors.InsufficientResources) as error:
                self._base.rollback()
                raise HistorianFailedError(
                    f"{self.name}: the database's disk is full; make room, nothing of this call is kept"
                ) from error
            except (psycopg.OperationalError, psycopg.InterfaceError) as error:
                if time.monotonic() > deadline:
                    raise self._away() from error
                self._reconnect(deadline)
            except psycopg.Error as error:
                if not self._base.closed:
                    self._base.rollback()
                raise HistorianError(f"{self.name}: {_first_line(error)}") from error

    def _reconnect(self, deadline: float) -> None:
        if not self._gone:
            self._say(f"{self.name}: went away; it is called again every {PAUSE_S:g} s")
        self._gone = True
        while True:
            self._base.close()
            try:
                self._base = psycopg.connect(self._url, connect_timeout=10)
            except psycopg.Error as error:
                if time.monotonic() > deadline:
                    raise self._away() from error
            else:
                self._gone = False
                self._say(f"{self.name}: is back; the work goes on where it was")
                return
            time.sleep(PAUSE_S)

    def _away(self) -> HistorianAwayError:
        return HistorianAwayError(
            f"{self.name}: went away and did not come back within {self._patience_s:g} s; start it, then give the "
            f"command again"
        )


def _text(value: object) -> str:
    """Return a value of the type "char", which psycopg gives as text or as bytes."""
    return value.decode() if isinstance(value, bytes) else str(value)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["no answer"])[0]


def _refusal(error: psycopg.Error, url: str) -> str:
    text = str(error)
    if "password" in text.lower() and ("authentication failed" in text or "no password supplied" in text):
        return "refused the password; check user and password, or set PGPASSWORD or ~/.pgpass"
    password = psycopg.conninfo.conninfo_to_dict(url).get("password") if "://" in url else None
    line = _first_line(error)
    said = line.replace(str(password), "...") if password else line
    return f"cannot be reached: {said}; check host, port and database in the URL, and that the server runs"
