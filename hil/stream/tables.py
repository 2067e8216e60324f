"""Tables of runs in PostgreSQL, and rows in the binary form of COPY.

Form: https://www.postgresql.org/docs/current/sql-copy.html, "Binary Format". A row is the number of its fields, and for
each field its length in bytes and its bytes, most significant first; NULL has the length -1 and no bytes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SAMPLES = "hil_samples"
TABLES = (
    """CREATE TABLE IF NOT EXISTS hil_runs (
        run integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        uid text NOT NULL UNIQUE,
        name text NOT NULL,
        profile text NOT NULL,
        period_s double precision NOT NULL,
        state text NOT NULL DEFAULT '',
        reason text NOT NULL DEFAULT '',
        position bigint NOT NULL DEFAULT -1,
        event bigint NOT NULL DEFAULT 0
    )""",
    """CREATE TABLE IF NOT EXISTS hil_signals (
        signal integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        run integer NOT NULL REFERENCES hil_runs ON DELETE CASCADE,
        name text NOT NULL,
        unit text NOT NULL,
        kind text NOT NULL,
        doc text NOT NULL,
        UNIQUE (run, name)
    )""",
    f"""CREATE TABLE IF NOT EXISTS {SAMPLES} (
        run integer NOT NULL,
        time timestamptz NOT NULL,
        signal integer NOT NULL,
        value double precision,
        quality smallint NOT NULL
    )""",
    f"CREATE INDEX IF NOT EXISTS {SAMPLES}_signal_time ON {SAMPLES} (signal, time)",
    """CREATE TABLE IF NOT EXISTS hil_events (
        run integer NOT NULL REFERENCES hil_runs ON DELETE CASCADE,
        event bigint NOT NULL,
        time timestamptz NOT NULL,
        level text NOT NULL,
        text text NOT NULL,
        PRIMARY KEY (run, event)
    )""",
)
"""Statements that make the tables. Position and event of a run are the last that are stored."""
COPY_SAMPLES = f"COPY {SAMPLES} (run, time, signal, value, quality) FROM STDIN (FORMAT BINARY)"
_EPOCH_US = 946_684_800_000_000
"""2000-01-01, where the server's clock begins, in µs since 1970."""
_HEADER = b"PGCOPY\n\xff\r\n\x00" + bytes(8)
_TRAILER = b"\xff\xff"
_BEGIN = [("fields", ">i2"), *[("run_bytes", ">i4"), ("run", ">i4")], ("time_bytes", ">i4"), ("time", ">i8")]
_SIGNAL = [("signal_bytes", ">i4"), ("signal", ">i4"), ("value_bytes", ">i4")]
_END = [("quality_bytes", ">i4"), ("quality", ">i2")]
_VALUE = np.dtype([*_BEGIN, *_SIGNAL, ("value", ">f8"), *_END])
_NULL = np.dtype([*_BEGIN, *_SIGNAL, *_END])


def binary_samples(
    run: int,
    signals: NDArray[np.int64],
    time_us: NDArray[np.int64],
    values: NDArray[np.float64],
    quality: NDArray[np.uint8],
) -> bytes:
    """Return the rows of a block for `COPY_SAMPLES`: one for each tick and signal, NaN as NULL.

    Parameters
    ----------
    run
        Number of the run.
    signals
        Numbers of its signals, (k,).
    time_us
        Times in µs since 1970, (n,).
    values, quality
        Values in the units of their signals, and their qualities, (n, k).
    """
    tick, column = np.nonzero(~np.isnan(values))
    good = _rows(_VALUE, run, signals[column], time_us[tick], quality[tick, column])
    good["value_bytes"], good["value"] = 8, values[tick, column]
    tick, column = np.nonzero(np.isnan(values))
    missing = _rows(_NULL, run, signals[column], time_us[tick], quality[tick, column])
    missing["value_bytes"] = -1
    return b"".join((_HEADER, good.tobytes(), missing.tobytes(), _TRAILER))


def _rows(
    kind: np.dtype[np.void],
    run: int,
    signal: NDArray[np.int64],
    time_us: NDArray[np.int64],
    quality: NDArray[np.uint8],
) -> NDArray[np.void]:
    rows = np.zeros(len(signal), dtype=kind)
    rows["fields"] = 5
    for name, size in (("run", 4), ("time", 8), ("signal", 4), ("quality", 2)):
        rows[f"{name}_bytes"] = size
    rows["run"], rows["signal"], rows["quality"] = run, signal, quality
    rows["time"] = time_us - _EPOCH_US
    return rows
