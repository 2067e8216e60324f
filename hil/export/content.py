"""Content of a run for exports: its channels with unit, quality and raw counts, its events, its identity."""

from __future__ import annotations

import datetime
import difflib
import fnmatch
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.rig_file import Point, Rig, RigFileError, file_sha256, load_rig
from drivers.signals import DriverError, Quality, Signal, split_column
from hil import __version__
from hil.journal import EventRow, JournalReader, all_samples, profile_times
from hil.run_folder import RunFolder, label_texts

QUALITY_CODES = {member.name: int(member) for member in Quality}
"""Name of each quality -> its code in the quality column of an export."""
_KIND_ORDER = {"measured": 0, "setpoint": 1, "status": 2}


class ExportError(ValueError):
    """Export that cannot be made; the message is one plain sentence with the remedy."""


@dataclass(frozen=True, eq=False)
class RawCounts:
    """Whole numbers `(n,)` in the registers of a signal, and its rule: value = counts * scale + offset.

    `counts` is 0 where nothing arrived; the channel's quality is then not GOOD.
    """

    counts: NDArray[np.int64]
    scale: float
    offset: float


@dataclass(frozen=True, eq=False)
class Channel:
    """One column of a run: `values (n,)` in `unit`, NaN where missing or not GOOD, and `quality (n,)`.

    `kind` is that of the signal, or `clock` for profile time and number of the segment.
    """

    column: str
    unit: str
    kind: str
    values: NDArray[np.float64]
    quality: NDArray[np.uint8]
    role: str = ""
    bus: str = ""
    doc: str = ""
    plausible: tuple[float, float] | None = None
    raw: RawCounts | None = None

    @property
    def bad(self) -> NDArray[np.bool_]:
        """Return `(n,)`, True where the value is not GOOD."""
        found: NDArray[np.bool_] = self.quality != Quality.GOOD
        return found

    @property
    def comment(self) -> str:
        """Return kind, role, bus and description in one line."""
        parts = [self.kind, self.role and f"role {self.role}", self.bus and f"bus {self.bus}", self.doc]
        return "; ".join(part for part in parts if part)


@dataclass(frozen=True, eq=False)
class RunContent:
    """Content of a run: `time_s (n,)` in s of rig time, `channels`, `events`, and `about`, its identity as text.

    `started` is the UTC time at which rig time began, by the wall time of the first tick.
    """

    time_s: NDArray[np.float64]
    channels: tuple[Channel, ...]
    events: tuple[EventRow, ...]
    about: Mapping[str, str]
    started: datetime.datetime | None = None

    def chosen(self, signals: Iterable[str]) -> RunContent:
        """Return the content with the channels that `signals` name: columns, signals without unit, or patterns (`*`).

        Raises
        ------
        ExportError
            A name fits no channel.
        """
        wanted: set[str] = set()
        for name in signals:
            found = {c.column for c in self.channels if fnmatch.fnmatchcase(c.column, name) or _stem(c) == name}
            if not found:
                columns = [channel.column for channel in self.channels]
                near = difflib.get_close_matches(name, [*columns, *map(_stem, self.channels)], n=1, cutoff=0.6)
                hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(columns)}"
                raise ExportError(f"the run has no signal {name!r}; {hint}")
            wanted |= found
        return replace(self, channels=tuple(c for c in self.channels if c.column in wanted))


def _stem(channel: Channel) -> str:
    parts = split_column(channel.column)
    return parts[0] if parts else channel.column


def read_run(folder: Path) -> RunContent:
    """Return the content of the run in `folder`, from its journal; the run may have been interrupted, or be live.

    Columns stand in the order of the record: measured signals, set-points, status signals. A run that waited or was
    resumed has `profile_s` and `segment` besides. Raw counts are there if the rig file that `run.json` names still has
    the hash of the run: the journal holds values, and the scale of the rig file gives the counts back.

    Raises
    ------
    ExportError
        The folder holds no journal, or a journal without samples.
    JournalError
        The journal cannot be read.
    RunFolderError
        `folder` is no run folder, or its `run.json` cannot be read.
    """
    run = RunFolder(folder)
    manifest = run.read_manifest()
    if not run.journal.is_file():
        raise ExportError(f"{folder} holds no journal.sqlite, from which exports are made; give a complete run folder")
    reader = JournalReader(run.journal)
    try:
        header = reader.header
        tick, time_s, values, quality = all_samples(reader)
        states = reader.states()
        profile_s = profile_times(states, tick, header.period_s) if states else time_s
        begins = [row.tick for row in reader.segments()]
        events = tuple(reader.events())
        started = _utc(reader.start_wall_s())
    finally:
        reader.close()
    if not len(time_s):
        raise ExportError(f"{run.journal} holds no samples yet; there is nothing to export")
    points = _points(manifest)
    order = sorted(range(len(header.signals)), key=lambda index: _KIND_ORDER[header.signals[index].kind])
    channels = [_channel(header.signals[k], values[:, k], quality[:, k], points) for k in order]
    if not np.allclose(profile_s, time_s):
        segment = np.asarray(1.0 + np.searchsorted(begins, tick, side="right"), dtype=np.float64)
        good = np.zeros(len(tick), dtype=np.uint8)
        channels += [
            Channel("profile_s", "s", "clock", np.asarray(profile_s, dtype=np.float64), good, doc="profile time"),
            Channel("segment", "1", "clock", segment, good, doc="number of the segment of a resumed run"),
        ]
    about = {
        "profile": header.profile,
        "run": str(manifest.get("uid", "")),
        "started": "" if started is None else started.isoformat(timespec="milliseconds"),
        "exit_status": str(manifest.get("exit_status", "")),
        "period_s": f"{header.period_s:g}",
        "software": f"hil {__version__}",
        **label_texts(run, manifest),
    }
    return RunContent(time_s, tuple(channels), events, about, started)


def _channel(
    signal: Signal, values: NDArray[np.float64], quality: NDArray[np.uint8], points: Mapping[str, Point]
) -> Channel:
    return Channel(
        signal.column,
        signal.unit,
        signal.kind,
        np.where(quality == Quality.GOOD, values, np.nan),
        quality.copy(),
        signal.role or "",
        signal.bus,
        signal.doc,
        signal.plausible,
        _raw_counts(values, points.get(signal.name)),
    )


def _raw_counts(values: NDArray[np.float64], point: Point | None) -> RawCounts | None:
    """Return the counts from which the journal's values came, or None where they are not whole numbers of counts.

    The driver computes raw * scale + offset in double precision. Counts are taken only if the same computation gives
    every value that is there back, bit by bit.
    """
    if point is None or point.type in ("float32", "float64", "string") or point.table is None:
        return None
    there = np.isfinite(values)
    if not there.any():
        return None
    counts = np.zeros(len(values))
    counts[there] = np.round((values[there] - point.offset) / point.scale)
    if not np.array_equal(counts[there] * point.scale + point.offset, values[there]) or np.abs(counts).max() >= 2**53:
        return None
    return RawCounts(counts.astype(np.int64), point.scale, point.offset)


def _points(manifest: Mapping[str, Any]) -> dict[str, Point]:
    """Return the points of the run's rig by name; none where its file is gone or was changed since the run."""
    entry = manifest.get("files", {}).get("rig")
    if not isinstance(entry, dict):
        return {}
    path = Path(str(entry.get("path", "")))
    try:
        if file_sha256(path) != entry.get("sha256"):
            return {}
        rig: Rig = load_rig(path)
    except (OSError, RigFileError, DriverError):
        return {}
    return {point.name: point for point in rig.point}


def _utc(wall_s: float) -> datetime.datetime | None:
    """Return a time in s since 1970 as UTC; None for one that no calendar has."""
    try:
        return datetime.datetime.fromtimestamp(wall_s, datetime.UTC)
    except (OverflowError, OSError, ValueError):
        return None


__all__ = ["QUALITY_CODES", "Channel", "ExportError", "RawCounts", "RunContent", "read_run"]
