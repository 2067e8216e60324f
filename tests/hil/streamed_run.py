"""A run of the synthetic coolant loop for streams: finished, or written on while a stream follows it."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.signals import Quality
from hil.journal import JournalReader, JournalWriter
from hil.run_folder import RunFolder, new_manifest
from hil.stream import StreamOptions, StreamResult, stream_run
from tests.hil import synthetic_journal

NAME = "20260520T120000Z-battle_40h"


@dataclass
class StreamedRun:
    """Folder of a run whose journal grows in steps. `started_s` is the wall time of its first tick."""

    path: Path
    truth: synthetic_journal.Truth
    written: int = 0
    writer: JournalWriter | None = None
    started_s: float = 1.7e9
    _held: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    def write(self, ticks: int) -> None:
        """Append this many ticks."""
        if self.writer is None:
            self.writer = JournalWriter(self.path / "journal.sqlite", self.truth.header)
            self.writer.event(0, 0.0, "INFO", "run started")
            self.writer.state(0, 0.0, 0.0, "restoring", "start", "running", "armed")
        synthetic_journal.put_ticks(self.writer, self.truth, self.written, self.written + ticks)
        self.written += ticks
        self.writer.event(self.written - 1, float(self.truth.time_s[self.written - 1]), "WARN", f"tick {self.written}")
        self.writer.commit()

    def finish(self) -> None:
        """Append the rest, and end the run."""
        if rest := len(self.truth.time_s) - self.written:
            self.write(rest)
        assert self.writer is not None
        last = self.written - 1
        self.writer.state(last, float(self.truth.time_s[last]), 0.0, "finishing", "complete", "done", "profile over")
        self.writer.put_meta("exit_status", "done")
        self.writer.close()
        folder = RunFolder(self.path)
        folder.write_manifest(folder.read_manifest() | {"exit_status": "done"})
        self._held.close()

    def samples(self) -> dict[tuple[str, int], tuple[float | None, int]]:
        """Return value and quality by column and time in µs since 1970, from the journal; None for a bad value."""
        reader = JournalReader(self.path / "journal.sqlite")
        found, columns = reader.samples(), [signal.column for signal in reader.header.signals]
        reader.close()
        good = (found.quality == Quality.GOOD) & np.isfinite(found.values)
        return {
            (column, round((self.started_s + found.time_s[i]) * 1e6)): (
                float(found.values[i, k]) if good[i, k] else None,
                int(found.quality[i, k]),
            )
            for i in range(len(found.tick))
            for k, column in enumerate(columns)
        }


def live_run(parent: Path, ticks: int, period_s: float = 1.0) -> StreamedRun:
    """Return a run that goes on, with nothing written yet."""
    path = parent / NAME
    path.mkdir()
    folder = RunFolder(path)
    folder.write_manifest(new_manifest({}))
    run = StreamedRun(path, synthetic_journal.make(ticks, period_s=period_s, twins=("static",)))
    run._held.enter_context(folder.owned())
    return run


def finished_run(parent: Path, ticks: int, period_s: float = 1.0) -> StreamedRun:
    """Return a run that has ended."""
    run = live_run(parent, ticks, period_s)
    run.finish()
    return run


@contextlib.contextmanager
def killed_at_the_end(run: StreamedRun, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start `hil stream` in a process of its own, and end it with SIGKILL."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", "stream", str(run.path), *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait(timeout=10)


class InThread:
    """Stream in a thread of this process, with its sentences."""

    def __init__(self, run: StreamedRun, to: str, options: StreamOptions | None = None) -> None:
        self.said: list[str] = []
        self._result: StreamResult | None = None
        self._thread = threading.Thread(
            target=self._follow, args=(run.path, to, options or StreamOptions()), daemon=True
        )
        self._thread.start()

    def _follow(self, path: Path, to: str, options: StreamOptions) -> None:
        self._result = stream_run(path, to, options, self.said.append)

    def result(self) -> StreamResult:
        """Wait for the end of the stream and return its result."""
        self._thread.join(timeout=30)
        assert self._result is not None, f"the stream did not end; it said {self.said}"
        return self._result
