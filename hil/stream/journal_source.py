"""Source of a stream: the journal of a live or finished run in blocks with UTC times."""

from __future__ import annotations

import math
import time
from pathlib import Path, PurePath
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.signals import Quality
from hil.journal import JournalError, JournalReader, StateRow
from hil.run_folder import RunFolder, RunFolderError
from hil.stream.errors import StreamError
from hil.stream.store import Block, Position, RunEvent, RunIdentity, RunState

BEGIN_WITHIN_S = 10.0
"""So long a run that has just begun may take until its journal can be read, s."""
CUT_CHECK_S = 5.0
"""Time without a new tick after which the source asks whether the run was interrupted, s."""
_LATEST_S = 8e9
"""Latest time that a block may have, s since 1970: the year 2223. A later one is no time of a run."""


class JournalSource:
    """Journal of the run in `folder`, read as it grows.

    The time of a sample is that of rig time, from the wall time of the first tick. In a run in real time both are the
    same; a run in lockstep keeps its own seconds.

    Raises
    ------
    RunFolderError
        `folder` is no run folder.
    StreamError
        It has no journal.
    JournalError
        The journal cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = RunFolder(folder)
        manifest = self._folder.read_manifest()
        self._reader = self._opened(manifest)
        header = self._reader.header
        name = folder.resolve().name
        self.run = RunIdentity(
            str(manifest.get("uid") or name),
            name,
            header.profile,
            header.period_s,
            tuple(header.signals),
            _rig_name(manifest),
        )
        self._start_s = math.nan
        self._state: StateRow | None = None
        self._cut = False
        self._checked_at = -math.inf

    def ended(self) -> bool:
        """Return True if the run has ended or was interrupted. Call it before `read`, which then reads the rest."""
        if self._reader.meta("exit_status") is not None:
            self._cut = False
            return True
        now = time.monotonic()
        if now - self._checked_at >= CUT_CHECK_S:
            self._checked_at = now
            self._cut = self._folder.was_cut or self._lacks_end()
        return self._cut

    def last_position(self) -> Position:
        """Return the position before the last tick and after the last event of the journal."""
        last, _ = self._reader.last()
        events = self._reader.events()
        return Position(last - 1 if last >= 0 else -1, events[-1].id if events else 0)

    def _lacks_end(self) -> bool:
        """Return True for the copy of a journal that ends before its run, which `run.json` says to have ended."""
        try:
            has_ended = self._folder.read_manifest().get("exit_status", "running") != "running"
        except RunFolderError:
            return False
        return has_ended and self._folder.is_held is False and self._reader.meta("exit_status") is None

    def read(self, before: Position, limit: int, *, ended: bool) -> Block:
        """Return at most `limit` ticks after `before`, all later events, and the present state.

        Events wait for the first tick, whose time is theirs, unless the run has ended.

        Raises
        ------
        StreamError
            A time in the journal is none.
        """
        samples = self._reader.samples(before.tick, limit)
        if len(samples.tick):
            self._checked_at = time.monotonic()  # it grows, so it was not interrupted
        if not math.isfinite(self._start_s):
            self._start_s = self._reader.start_wall_s()
        started = math.isfinite(self._start_s)
        events = self._reader.events(before.event) if started or ended else []
        values = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
        at_us = self._utc_us(samples.time_s)
        return Block(
            before,
            samples.tick,
            at_us,
            values,
            samples.values,
            samples.quality,
            tuple(RunEvent(row.id, self._moment_us(row.time_s, row.wall_s), row.level, row.text) for row in events),
            self._present_state(),
        )

    def tick_before(self, time_us: int) -> int:
        """Return the last tick whose time is earlier than `time_us`, µs since 1970 (UTC), or -1.

        Raises
        ------
        StreamError
            A time in the journal is none.
        """
        if not math.isfinite(self._start_s):
            self._start_s = self._reader.start_wall_s()
        before, not_before = -1, self._reader.last()[0]
        while before < not_before:
            middle = (before + not_before) // 2
            row = self._reader.samples(middle, 1)
            if len(row.tick) and int(self._utc_us(row.time_s)[0]) < time_us:
                before = int(row.tick[0])
            else:
                not_before = middle
        return before

    def close(self) -> None:
        """Close the journal."""
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _opened(self, manifest: dict[str, Any]) -> JournalReader:
        """Return the open journal; that of a run that begins just now may not be there at once."""
        deadline = time.monotonic() + (BEGIN_WITHIN_S if manifest.get("exit_status") == "running" else 0.0)
        while True:
            try:
                return JournalReader(self._folder.journal)
            except JournalError:
                if time.monotonic() >= deadline or self._folder.was_cut:
                    if not self._folder.journal.is_file():
                        raise StreamError(
                            f"{self._folder.path} holds no journal.sqlite, which a stream follows; give a complete run "
                            "folder"
                        ) from None
                    raise
            time.sleep(0.1)

    def _present_state(self) -> RunState:
        for row in self._reader.states(0 if self._state is None else self._state.id):
            self._state = row
        if self._state is None:
            status = self._reader.meta("exit_status")
            name, reason, at_us = str(status or "running"), "", self._moment_us(0.0, 0.0)
        else:
            name, reason = self._state.target, self._state.reason
            at_us = self._moment_us(self._state.time_s, self._state.wall_s)
        if self._cut:
            at_us = max(at_us, self._last_us())
            return RunState("interrupted", at_us, "the run was killed, or the power failed")
        return RunState(name, at_us, reason)

    def _last_us(self) -> int:
        """Return the UTC time of the last sample; 0 without one."""
        tick, _ = self._reader.last()
        times_us = self._utc_us(self._reader.samples(tick - 1, 1).time_s)
        return int(times_us[-1]) if len(times_us) else 0

    def _moment_us(self, time_s: float, wall_s: float) -> int:
        """Return the UTC time of a row: by rig time, or by the wall clock before the first tick."""
        at_s = self._start_s + time_s if math.isfinite(self._start_s) else wall_s
        return int(self._checked_us(np.array([at_s]))[0])

    def _utc_us(self, time_s: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.int64]]:
        return self._checked_us(self._start_s + time_s) if len(time_s) else np.zeros(0, dtype=np.int64)

    def _checked_us(self, at_s: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.int64]]:
        if not bool(np.all(np.abs(at_s) < _LATEST_S)):  # false for NaN, too
            raise StreamError(
                f"{self._folder.journal} is damaged: it holds a time that is none; take the journal from the machine "
                "that made it"
            )
        return np.asarray(np.round(at_s * 1e6), dtype=np.int64)


def _rig_name(manifest: dict[str, Any]) -> str:
    """Return the name of the rig file of a run, "rig" where the manifest has none."""
    files = manifest.get("files")
    rig = files.get("rig") if isinstance(files, dict) else None
    path = rig.get("path") if isinstance(rig, dict) else None
    return (PurePath(path).stem if isinstance(path, str) else "") or "rig"
