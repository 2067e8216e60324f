"""Choice of a store by its address."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.historian.protocol import HistorianError, HistorianStore

POSTGRES = ("postgresql://", "postgres://")
DUCKDB_ENDINGS = (".duckdb", ".db")


def open_store(
    address: str | Path, *, create: bool = False, say: Callable[[str], None] = lambda text: None
) -> HistorianStore:
    """Return the store at `address`.

    A folder with Parquet files (or a single Parquet file), a DuckDB file (`.duckdb`, `.db`), or a PostgreSQL
    database by its URL (`postgresql://user@host/database`).

    Parameters
    ----------
    address
        Path or URL.
    create
        Make an empty store where there is none.
    say
        Called with a sentence when a database goes away and when it is back.

    Raises
    ------
    HistorianError
        There is no store, it cannot be opened, or the library for it is not installed.
    """
    text = str(address)
    if text.startswith(POSTGRES):
        postgres: HistorianStore = _library("postgres", "psycopg").PostgresStore(text, create=create, say=say)
        return postgres
    if "://" in text:
        raise HistorianError(
            f"{text.split('://')[0]}:// is no historian that is known; use a folder, a .duckdb file or postgresql://"
        )
    path = Path(text)
    if path.suffix in DUCKDB_ENDINGS:
        duckdb: HistorianStore = _library("duckdb_file", "duckdb").DuckDBStore(path, create=create)
        return duckdb
    from drivers.historian.parquet import ParquetStore

    return ParquetStore(path, create=create)


def _library(module: str, package: str) -> Any:
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise HistorianError(
            f"this store needs the package {package}, which is not installed; pip install 'hil-rig[historian]'"
        ) from error
    return importlib.import_module(f"drivers.historian.{module}")
