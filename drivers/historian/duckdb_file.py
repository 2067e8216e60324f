"""Historian in a DuckDB file: one table of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import duckdb
import numpy as np
import pyarrow as pa

from drivers.historian.arrow import samples_by_tag, table_of
from drivers.historian.protocol import COLUMNS, HistorianError, HistorianFailedError, Samples, empty

TABLE = "samples"
_CREATE = (
    f"CREATE TABLE {TABLE} (timestamp TIMESTAMPTZ NOT NULL, tag VARCHAR NOT NULL, value DOUBLE, "
    "quality SMALLINT NOT NULL)"
)

_WHOLE = ("SMALLINT", "TINYINT", "INTEGER", "BIGINT", "HUGEINT", "UTINYINT", "USMALLINT", "UINTEGER", "UBIGINT")
_TYPES = {
    "timestamp": ("TIMESTAMP",),
    "tag": ("VARCHAR", "ENUM"),
    "value": ("DOUBLE", "FLOAT", "DECIMAL", *_WHOLE, "BOOLEAN"),
    "quality": _WHOLE,
}
"""How the types of the columns may begin, the usual one first; a list ends in a bracket."""


class DuckDBStore:
    """A DuckDB file with a table `samples` of timestamp, tag, value and quality."""

    def __init__(self, path: Path, *, create: bool = False) -> None:
        self.path = path
        if not path.exists() and not create:
            raise HistorianError(f"{path}: there is no historian; check the path")
        try:
            self._base = duckdb.connect(str(path), read_only=not create)
            self._base.execute("SET TimeZone = 'UTC'").fetchall()
            columns = self._columns()
            if not columns and create:
                self._base.execute(_CREATE).fetchall()
                columns = self._columns()
        except duckdb.Error as error:
            raise HistorianError(f"{path}: cannot be opened: {_line(error)}") from error
        if not columns:
            self.close()
            raise HistorianError(f"{path}: has no table {TABLE!r}; it needs one with the columns {', '.join(COLUMNS)}")
        missing = [name for name in COLUMNS if name not in columns]
        if missing:
            self.close()
            raise HistorianError(f"{path}: table {TABLE!r} lacks the column {', '.join(missing)}; rename or add it")
        for name, kinds in _TYPES.items():
            if not columns[name].startswith(kinds) or columns[name].endswith("]"):
                self.close()
                raise HistorianError(f"{path}: column {name} of table {TABLE!r} is {columns[name]}; make it {kinds[0]}")
        kind = columns["timestamp"]
        self.zoned: bool | None = "TZ" in kind or "TIME ZONE" in kind
        # DuckDB has no functions of times to the nanosecond.
        self._stamp = f"timestamp::{'TIMESTAMPTZ' if self.zoned else 'TIMESTAMP'}" if "_NS" in kind else "timestamp"

    def tags(self) -> tuple[str, ...]:
        return tuple(row[0] for row in self._ask(f"SELECT DISTINCT tag FROM {TABLE} ORDER BY tag").fetchall())

    def span(self) -> tuple[float, float] | None:
        query = f"SELECT epoch_ms(min({self._stamp})), epoch_ms(max({self._stamp})) FROM {TABLE}"
        low, high = self._ask(query).fetchall()[0]
        return None if low is None or high is None else (low / 1e3, high / 1e3)

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        if not tags:
            return {}
        limits = "".join(
            f" AND {self._stamp} {sign} to_timestamp({value!r})"
            for sign, value in ((">=", start_s), ("<", end_s))
            if np.isfinite(value)
        )
        places = ", ".join("?" for _ in tags)
        query = (
            f"SELECT epoch_ms({self._stamp}) AS ms, tag, value, quality FROM {TABLE} "
            f"WHERE tag IN ({places}){limits} ORDER BY rowid"
        )
        try:
            found = self._base.sql(query, params=list(tags)).to_arrow_table()
        except duckdb.Error as error:
            raise _failure(self.path, error) from error
        stamps = found["ms"].cast(pa.int64()).cast(pa.timestamp("ms", tz="UTC"))
        table = pa.table(
            {"timestamp": stamps, "tag": found["tag"], "value": found["value"], "quality": found["quality"]}
        )
        try:
            return {tag: empty() for tag in tags} | samples_by_tag(table, frozenset(tags), -np.inf, np.inf)
        except HistorianError as error:
            raise HistorianError(f"{self.path}: {error}") from error

    def append(self, samples: Mapping[str, Samples]) -> None:
        table = table_of(samples)
        if table.num_rows == 0:
            return
        self._base.register("arriving", table)
        try:
            self._ask(f"INSERT INTO {TABLE} SELECT timestamp, tag, value, quality FROM arriving").fetchall()
        finally:
            self._base.unregister("arriving")

    def close(self) -> None:
        self._base.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _columns(self) -> dict[str, str]:
        """Return the type of each column."""
        query = "SELECT column_name, data_type FROM information_schema.columns WHERE table_name = ?"
        return {str(name): str(kind) for name, kind in self._base.execute(query, [TABLE]).fetchall()}

    def _ask(self, query: str, values: list[Any] | None = None) -> Any:
        try:
            return self._base.execute(query, values or [])
        except duckdb.Error as error:
            raise _failure(self.path, error) from error


def _failure(path: Path, error: duckdb.Error) -> HistorianError:
    """Return the error of a store that fails while it is used, or holds what cannot be converted."""
    kind = HistorianFailedError if isinstance(error, duckdb.OperationalError) else HistorianError
    return kind(f"{path}: {_line(error)}")


def _line(error: Exception) -> str:
    return (str(error).splitlines() or ["no reason is given"])[0]
