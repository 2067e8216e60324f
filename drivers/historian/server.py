"""Parts of a PostgreSQL client that need no library: addresses without passwords, and tables that are read by time."""

from __future__ import annotations

import re
from typing import Any, Protocol


class Connection(Protocol):
    """Connection of psycopg, as far as it is used here."""

    def execute(self, query: Any, params: Any = None) -> Any:
        """Execute one statement and return its cursor."""


def without_password(url: str) -> str:
    """Return the URL without its password, in its place before the host or among the parameters."""
    shown = re.sub(r"^(\w+://[^:/@]*):[^/]*@(?=[^@]*$)", r"\1@", url)
    return re.sub(r"([?&]password=)[^&]*", r"\1...", shown)


def index_by_time(base: Connection, table: str, column: str) -> None:
    """Make `table` a hypertable over `column` where TimescaleDB is installed, else give the column a BRIN index.

    Raises
    ------
    psycopg.Error
        The server refuses it.
    """
    if base.execute("SELECT 1 FROM pg_extension WHERE extname = 'timescaledb'").fetchone():
        base.execute("SELECT create_hypertable(%s, %s, if_not_exists => true)", [table, column])
    else:
        base.execute(f"CREATE INDEX IF NOT EXISTS {table}_time ON {table} USING brin ({column})")
