"""Damaged journals: another value in a cell, a missing table or column, lost bytes of a disk."""

from __future__ import annotations

import json
import random
import sqlite3
from pathlib import Path

import numpy as np

from drivers.signals import Signal
from hil.bench.fuzz.texts import mutated_json
from hil.journal import Header, JournalReader, JournalWriter, SegmentRow

_CELLS = (None, -1, 0, 2**62, 1e308, float("inf"), "", "x", "[]", "{", b"", b"\0", b"\xff" * 7, "null", 10**15)
_TABLES = ("meta", "samples", "twins", "calibrations", "proposals", "bands", "writes", "events", "states", "segments")


def sound_journal(path: Path) -> None:
    """Write a small journal that has a row in every table."""
    signals = (Signal("heater", "W", "setpoint", None, "plc", (0.0, 900.0), ""), Signal("T_wall", "degC"))
    header = Header(signals, {"T_wall": ("T_wall_C",)}, ("live",), "steps", 60.0, 1.0, {"T_wall": 0.02})
    writer = JournalWriter(path, header)
    for tick in range(5):
        writer.sample(tick, float(tick), 1e9 + tick, 0.01, (1.0, 20.0 + tick), (0, 0), (float(tick), float(tick)))
    writer.twin_outputs("live", (0, 1), (0.0, 1.0), np.ones((2, 1)))
    writer.calibration("least_squares", 0.0, 4.0, {"rmse": 0.1})
    writer.proposal(
        "least_squares",
        4.0,
        {"values": {"tank.hA": 1.0}, "standard_errors": {"tank.hA": 0.1}, "held": {}, "reasons": []},
    )
    writer.band("live", 0.0, 4.0, {"mean_K": {"T_wall": 0.0}, "half_width_K": {"T_wall": 0.1}})
    writer.write(1, 1.0, "heater", 5.0, "profile")
    writer.state(0, 0.0, 0.0, "idle", "start", "running", "")
    writer.segment(SegmentRow(1, 3, 3.0, 1e9, 2.0, 3.0, 3, "cut"))
    writer.event(2, 2.0, "INFO", "begun")
    writer.close()


def damaged(sound: bytes, path: Path, pick: random.Random) -> None:
    """Write a damaged copy of a journal to `path`."""
    kind = pick.random()
    if kind < 0.35:
        path.write_bytes(_lost_bytes(sound, pick))
        return
    path.write_bytes(sound)
    database = sqlite3.connect(path, isolation_level=None)
    try:
        database.execute("PRAGMA synchronous=OFF")
        for _ in range(pick.randint(1, 2)):
            try:
                _damage(database, pick)
            except (sqlite3.Error, OverflowError):  # The schema itself refuses some: try the next one.
                continue
    finally:
        database.close()


def read_all(path: Path) -> None:
    """Read a journal with every method of its reader; raises JournalError."""
    reader = JournalReader(path)
    try:
        reader.samples()
        reader.timing()
        reader.latencies()
        for twin in reader.header.twin_names:
            reader.twin_outputs(twin)
            reader.last_twin_tick(twin)
        for read in (reader.calibrations, reader.proposals, reader.bands, reader.writes, reader.events, reader.states):
            read()
        reader.segments()
        reader.wall_s()
        reader.start_wall_s()
        reader.tick_at(reader.wall_s_at(reader.sample_count()))
        reader.last()
        reader.meta("exit_status")
    finally:
        reader.close()


def _lost_bytes(sound: bytes, pick: random.Random) -> bytes:
    raw = bytearray(sound)
    kind = pick.random()
    if kind < 0.2:
        return bytes(raw[: pick.randrange(len(raw))])
    at = pick.randrange(len(raw))
    if kind < 0.4:
        end = min(len(raw), at + pick.choice((16, 512, 4096)))
        raw[at:end] = bytes(end - at)
    else:
        for _ in range(pick.randint(1, 8)):
            raw[pick.randrange(len(raw))] = pick.randrange(256)
    return bytes(raw)


def _damage(database: sqlite3.Connection, pick: random.Random) -> None:
    kind, table = pick.random(), pick.choice(_TABLES)
    if kind < 0.3:
        key = pick.choice(("header", "schema_version", "exit_status"))
        row = database.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        try:
            document = json.loads(row[0]) if row else None
        except (ValueError, TypeError, RecursionError):  # Damaged by the mutation before this one.
            document = None
        value = mutated_json(document, pick).decode("utf-8", "replace")
        database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))
        return
    columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    column = pick.choice(columns) if columns else "id"
    if kind < 0.8:
        database.execute(f'UPDATE {table} SET "{column}" = ?', (pick.choice(_CELLS),))
    elif kind < 0.9:
        database.execute(f'ALTER TABLE {table} DROP COLUMN "{column}"')
    elif kind < 0.95:
        database.execute(f"ALTER TABLE {table} ADD COLUMN extra TEXT DEFAULT 'x'")
    else:
        database.execute(f"DROP TABLE {table}")
