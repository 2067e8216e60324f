"""Reader of a journal, finished or still growing; see `hil.journal.writer` for its tables."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Signal
from hil.files import LONGEST_DATABASE_PATH, connect_read_only
from hil.journal.check import (
    DAMAGE_ERRORS,
    checked_reader,
    on_one_line,
    reports_damage,
    require_header,
    require_tables,
    require_time,
)
from hil.journal.documents import ShapeError
from hil.journal.rows import (
    BandRow,
    CalibrationRow,
    EventRow,
    Header,
    JournalError,
    JournalSamples,
    ProposalRow,
    SegmentRow,
    StateRow,
    TwinOutput,
    WriteRow,
)
from hil.journal.states import RunEvent, State

SCHEMA_VERSION = 1


def _with_present_names(row: StateRow) -> StateRow:
    """Return a transition with the present names of its states and its event; older journals have others.

    Raises
    ------
    ShapeError
        The target is no state of a run.
    """
    try:
        target = State(row.target)
    except ValueError:
        raise ShapeError(f"{str(row.target)[:40]!r} is no state of a run") from None
    source = State.RESTORING if row.source == "soaking" else row.source
    event = RunEvent.RESTORE if row.event == "soak" else row.event
    return replace(row, target=target.value, source=str(source), event=str(event))


@checked_reader
class JournalReader:
    """Reader of a journal, finished or still growing. Each call reads the committed rows, and may raise
    JournalError."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise JournalError(f"{path} does not exist; give the folder of a run")
        self._path = path
        try:
            self._database = connect_read_only(path)
            require_tables(self._database, path)
            begun = self._database.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone()
            meta = dict(self._database.execute("SELECT key, value FROM meta")) if begun else {}
        except DAMAGE_ERRORS as error:
            if len(os.fsencode(path.resolve())) > LONGEST_DATABASE_PATH:
                raise JournalError(
                    f"{path} cannot be opened: SQLite takes {LONGEST_DATABASE_PATH} bytes for a path; move the run's "
                    "folder to a shorter one"
                ) from error
            raise JournalError(f"{path} is not a journal of this harness ({on_one_line(error)})") from error
        if "header" not in meta:
            raise JournalError(
                f"{path} was cut while it was made, before anything moved, or is no journal; start a new run"
            )
        self.header = self._read_header(meta)

    @reports_damage
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
        header = Header(signals=signals, twin_sensors=sensors, twin_names=twin_names, **document)
        require_header(header)
        return header

    def meta(self, key: str) -> Any:
        """Return one entry of the header table, or None."""
        row = self._database.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return None if row is None else json.loads(row[0])

    def samples(self, after_tick: int = -1, limit: int = -1) -> JournalSamples:
        """Return the ticks later than `after_tick`, at most `limit` (-1: all)."""
        k = len(self.header.signals)
        rows = self._database.execute(
            "SELECT * FROM samples WHERE tick > ? ORDER BY tick LIMIT ?", (after_tick, limit)
        ).fetchall()
        for row in rows[:1] + rows[-1:]:
            require_time(float(row[1]))
        return JournalSamples(
            tick=np.array([row[0] for row in rows], dtype=np.int64),
            time_s=np.array([row[1] for row in rows], dtype=np.float64),
            values=np.array([row[4 : 4 + k] for row in rows], dtype=np.float64).reshape(len(rows), k),
            quality=np.frombuffer(b"".join(row[4 + k] for row in rows), dtype=np.uint8).reshape(len(rows), k),
            source_time_s=np.frombuffer(b"".join(row[5 + k] for row in rows), dtype="<f8").reshape(len(rows), k),
        )

    def timing(self) -> NDArray[np.float64]:
        """Return for each tick (n, 3) its number, the begin of its work, s since 1970, and the duration of the work,
        s."""
        rows = self._database.execute(
            "SELECT tick, wall_s - latency_s, latency_s FROM samples ORDER BY tick"
        ).fetchall()
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3)

    def latencies(self) -> NDArray[np.float64]:
        """Return the time from the start of each tick to the end of its work, s, shape (n,)."""
        rows = self._database.execute("SELECT latency_s FROM samples ORDER BY tick").fetchall()
        return np.array([row[0] for row in rows], dtype=np.float64)

    def twin_outputs(self, twin: str, after_tick: int = -1, limit: int = -1) -> TwinOutput:
        """Return the predictions of `twin` later than `after_tick`, at most `limit` (-1: all)."""
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

    def last_twin_tick(self, twin: str) -> int:
        """Return the latest tick with a prediction of `twin`, -1 for none."""
        row = self._database.execute("SELECT max(tick) FROM twins WHERE twin = ?", (twin,)).fetchone()
        return -1 if row[0] is None else int(row[0])

    def calibrations(self, after_id: int = 0) -> list[CalibrationRow]:
        """Return the finished windows with an id above `after_id`."""
        rows = self._database.execute("SELECT * FROM calibrations WHERE id > ? ORDER BY id", (after_id,))
        return [CalibrationRow(row[0], row[1], row[2], row[3], json.loads(row[4])) for row in rows]

    def proposals(self, after_id: int = 0) -> list[ProposalRow]:
        """Return the proposals with an id above `after_id`; none in a journal of an older version."""
        rows = self._optional("proposals", after_id)
        return [ProposalRow(row[0], row[1], row[2], json.loads(row[3])) for row in rows]

    def bands(self, after_id: int = 0) -> list[BandRow]:
        """Return the bands with an id above `after_id`; none in a journal of an older version."""
        rows = self._optional("bands", after_id)
        return [BandRow(row[0], row[1], row[2], row[3], json.loads(row[4])) for row in rows]

    def _optional(self, table: str, after_id: int) -> list[Any]:
        known = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
        if self._database.execute(known, (table,)).fetchone() is None:
            return []
        return self._database.execute(f"SELECT * FROM {table} WHERE id > ? ORDER BY id", (after_id,)).fetchall()

    def writes(self, after_id: int = 0) -> list[WriteRow]:
        """Return the set-point changes with an id above `after_id`."""
        return [
            WriteRow(*row)
            for row in self._database.execute("SELECT * FROM writes WHERE id > ? ORDER BY id", (after_id,))
        ]

    def events(self, after_id: int = 0) -> list[EventRow]:
        """Return the events with an id above `after_id`."""
        return [
            EventRow(*row)
            for row in self._database.execute("SELECT * FROM events WHERE id > ? ORDER BY id", (after_id,))
        ]

    def states(self, after_id: int = 0) -> list[StateRow]:
        """Return the transitions with an id above `after_id`; none in a journal of an older version."""
        return [_with_present_names(StateRow(*row)) for row in self._optional("states", after_id)]

    def segments(self) -> list[SegmentRow]:
        """Return the segments after the first in order; none for an uninterrupted run."""
        return [SegmentRow(*row) for row in self._optional("segments", 0)]

    def wall_s(self) -> float:
        """Return the wall time of all ticks, without the gaps between segments, s."""
        ends = [*(row.tick for row in self.segments()), 2**62]
        spans = [
            self._database.execute(
                "SELECT max(wall_s) - min(wall_s) FROM samples WHERE tick >= ? AND tick < ?", span
            ).fetchone()[0]
            for span in zip([-1, *ends], ends, strict=False)
        ]
        return float(sum(span or 0.0 for span in spans)) or float("nan")

    def last(self) -> tuple[int, float]:
        """Return the last recorded tick and its time, s since 1970; -1 and NaN where there is none."""
        row = self._database.execute("SELECT tick, wall_s FROM samples ORDER BY tick DESC LIMIT 1").fetchone()
        return (-1, math.nan) if row is None else (int(row[0]), require_time(float(row[1])))

    def sample_count(self) -> int:
        """Return the number of recorded ticks."""
        return int(self._database.execute("SELECT count(*) FROM samples").fetchone()[0])

    def start_wall_s(self) -> float:
        """Return the wall time at which rig time began by the first recorded tick, s since 1970; NaN for none."""
        row = self._database.execute("SELECT wall_s - time_s FROM samples ORDER BY tick LIMIT 1").fetchone()
        return math.nan if row is None else require_time(float(row[0]))

    def wall_s_at(self, tick: int) -> float:
        """Return the wall time of the last row up to `tick`, s since 1970; NaN where there is none."""
        row = self._database.execute(
            "SELECT wall_s FROM samples WHERE tick <= ? ORDER BY tick DESC LIMIT 1", (tick,)
        ).fetchone()
        return math.nan if row is None else require_time(float(row[0]))

    def tick_at(self, wall_s: float) -> int:
        """Return the last tick whose row is not later than `wall_s`, s since 1970; 0 where there is none."""
        row = self._database.execute("SELECT max(tick) FROM samples WHERE wall_s <= ?", (wall_s,)).fetchone()
        return 0 if row[0] is None else int(row[0])

    def close(self) -> None:
        """Close the file."""
        self._database.close()
