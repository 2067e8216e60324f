"""Reads a journal, finished or still growing; see `hil.journal` for its tables."""

from __future__ import annotations

import functools
import json
import math
import os
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.points import Signal
from hil.file_names import LONGEST_DATABASE_PATH, connect_read_only
from hil.journal_rows import (
    BandRow,
    CalibrationRow,
    EventRow,
    Header,
    JournalError,
    ProposalRow,
    Samples,
    SegmentRow,
    StateRow,
    TwinOutput,
    WriteRow,
)

SCHEMA_VERSION = 1


_DAMAGE = (sqlite3.Error, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError)
"""Errors of SQLite, JSON and numpy where a row, a cell or a table of the journal is not what the writer made."""


_LONGEST_SAID = 120
"""Characters of SQLite's words: a damaged schema is quoted in them."""


def _on_one_line(error: Exception) -> str:
    text = "".join(letter if letter.isprintable() else " " for letter in str(error))
    return " ".join(text.split())[:_LONGEST_SAID]


P = ParamSpec("P")
T = TypeVar("T")


def _guarded(read: Callable[P, T]) -> Callable[P, T]:
    """Return a method of the reader that raises JournalError where the journal is damaged."""

    @functools.wraps(read)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return read(*args, **kwargs)
        except _DAMAGE as error:
            path = args[0]._path  # type: ignore[attr-defined]
            name = read.__name__.replace("_read_", "")
            why = _on_one_line(error) if isinstance(error, sqlite3.Error) else "a row is not as this version writes it"
            raise JournalError(
                f"{path} is damaged: its {name} cannot be read ({why}); take a copy of the run folder that is whole"
            ) from error

    return guarded


class JournalReader:
    """Reads a journal, finished or still growing. Each call sees what is committed, and may raise JournalError."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise JournalError(f"{path} does not exist; give the folder of a run")
        self._path = path
        try:
            self._database = connect_read_only(path)
            begun = self._database.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone()
            meta = dict(self._database.execute("SELECT key, value FROM meta")) if begun else {}
        except (sqlite3.Error, ValueError, TypeError) as error:
            if len(os.fsencode(path.resolve())) > LONGEST_DATABASE_PATH:
                raise JournalError(
                    f"{path} cannot be opened: SQLite takes {LONGEST_DATABASE_PATH} bytes for a path; move the run's "
                    "folder to a shorter one"
                ) from error
            why = _on_one_line(error)
            raise JournalError(f"{path} is not a journal of this harness ({why})") from error
        if "header" not in meta:
            raise JournalError(
                f"{path} was cut while it was made, before anything moved, or is no journal; start a new run"
            )
        self.header = self._read_header(meta)

    @_guarded
    def _read_header(self, meta: dict[str, str]) -> Header:
        version = json.loads(meta.get("schema_version", "0"))
        if version != SCHEMA_VERSION:
            raise JournalError(f"{self._path} has schema {version}, this version reads {SCHEMA_VERSION}")
        document = json.loads(meta["header"])
        signals = tuple(
            Signal(**{**item, "plausible": tuple(item["plausible"]) if item["plausible"] else None})
            for item in document.pop("signals")
        )
        sensors = {name: tuple(columns) for name, columns in document.pop("twin_sensors").items()}
        twin_names = tuple(document.pop("twin_names"))
        return Header(signals=signals, twin_sensors=sensors, twin_names=twin_names, **document)

    @_guarded
    def meta(self, key: str) -> Any:
        """One entry of the header table, or None."""
        row = self._database.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return None if row is None else json.loads(row[0])

    @_guarded
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

    @_guarded
    def timing(self) -> NDArray[np.float64]:
        """Of each tick (n, 3): its number, when its work began, s since 1970, and how long that took, s."""
        rows = self._database.execute(
            "SELECT tick, wall_s - latency_s, latency_s FROM samples ORDER BY tick"
        ).fetchall()
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3)

    @_guarded
    def latencies(self) -> NDArray[np.float64]:
        """Time from the start of each tick to the end of its work, s, shape (n,)."""
        rows = self._database.execute("SELECT latency_s FROM samples ORDER BY tick").fetchall()
        return np.array([row[0] for row in rows], dtype=np.float64)

    @_guarded
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

    @_guarded
    def last_twin_tick(self, twin: str) -> int:
        """Latest tick that `twin` has answered, -1 for none."""
        row = self._database.execute("SELECT max(tick) FROM twins WHERE twin = ?", (twin,)).fetchone()
        return -1 if row[0] is None else int(row[0])

    @_guarded
    def calibrations(self, after_id: int = 0) -> list[CalibrationRow]:
        """Finished windows with an id above `after_id`."""
        rows = self._database.execute("SELECT * FROM calibrations WHERE id > ? ORDER BY id", (after_id,))
        return [CalibrationRow(row[0], row[1], row[2], row[3], json.loads(row[4])) for row in rows]

    @_guarded
    def proposals(self, after_id: int = 0) -> list[ProposalRow]:
        """Proposals with an id above `after_id`; none in a journal from before there were any."""
        rows = self._optional("proposals", after_id)
        return [ProposalRow(row[0], row[1], row[2], json.loads(row[3])) for row in rows]

    @_guarded
    def bands(self, after_id: int = 0) -> list[BandRow]:
        """Bands with an id above `after_id`; none in a journal from before there were any."""
        rows = self._optional("bands", after_id)
        return [BandRow(row[0], row[1], row[2], row[3], json.loads(row[4])) for row in rows]

    def _optional(self, table: str, after_id: int) -> list[Any]:
        known = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
        if self._database.execute(known, (table,)).fetchone() is None:
            return []
        return self._database.execute(f"SELECT * FROM {table} WHERE id > ? ORDER BY id", (after_id,)).fetchall()

    @_guarded
    def writes(self, after_id: int = 0) -> list[WriteRow]:
        """Set-point changes with an id above `after_id`."""
        return [
            WriteRow(*row)
            for row in self._database.execute("SELECT * FROM writes WHERE id > ? ORDER BY id", (after_id,))
        ]

    @_guarded
    def events(self, after_id: int = 0) -> list[EventRow]:
        """Events with an id above `after_id`."""
        return [
            EventRow(*row)
            for row in self._database.execute("SELECT * FROM events WHERE id > ? ORDER BY id", (after_id,))
        ]

    @_guarded
    def states(self, after_id: int = 0) -> list[StateRow]:
        """Transitions with an id above `after_id`; none in a journal from before there were any."""
        return [StateRow(*row) for row in self._optional("states", after_id)]

    @_guarded
    def segments(self) -> list[SegmentRow]:
        """Where the run went on after a gap, in order; none in a run that nothing cut."""
        return [SegmentRow(*row) for row in self._optional("segments", 0)]

    @_guarded
    def wall_s(self) -> float:
        """Wall time that the ticks took, without the gaps between segments, s."""
        ends = [*(row.tick for row in self.segments()), 2**62]
        spans = [
            self._database.execute(
                "SELECT max(wall_s) - min(wall_s) FROM samples WHERE tick >= ? AND tick < ?", span
            ).fetchone()[0]
            for span in zip([-1, *ends], ends, strict=False)
        ]
        return float(sum(span or 0.0 for span in spans)) or float("nan")

    @_guarded
    def last(self) -> tuple[int, float]:
        """Tick that was recorded last, and when, s since 1970; -1 and NaN where there is none."""
        row = self._database.execute("SELECT tick, wall_s FROM samples ORDER BY tick DESC LIMIT 1").fetchone()
        return (-1, math.nan) if row is None else (int(row[0]), float(row[1]))

    def close(self) -> None:
        """Close the file."""
        self._database.close()
