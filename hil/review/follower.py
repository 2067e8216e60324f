"""Follower of a journal, finished or growing: writes a review file and feeds a viewer."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

from hil.diagnosis import Findings, read_findings
from hil.files import replacing, utf8_path
from hil.journal import JournalError, JournalReader
from hil.review.batches import GROUP, BatchCollector, ReviewBatch, Rows, merged, needed_rows
from hil.review.diagnosis_tab import batches, findings_of_run, notes, plan_of_findings, with_findings
from hil.review.plan import ReviewPlan
from hil.review.rerun_io import Recording
from hil.review.viewer import listens, require_complete

POLL_S = 0.25
FILE_ROWS = 3600
"""Rows of an entity that are collected for one chunk of the file: each chunk costs over a kilobyte."""
_VIEWER_TIMEOUT_S = 10.0
_JOURNAL_TIMEOUT_S = 10.0

_log = logging.getLogger(__name__)


class _ReviewFile:
    """File of the review: collects batches so that a slow run does not make a large file."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._pending: dict[str, list[ReviewBatch]] = {}
        self._rows: dict[str, int] = {}

    def send(self, batch: ReviewBatch) -> None:
        self._pending.setdefault(batch.entity, []).append(batch)
        self._rows[batch.entity] = self._rows.get(batch.entity, 0) + len(batch.time_s)
        if self._rows[batch.entity] >= FILE_ROWS:
            self._write(batch.entity)

    def _write(self, entity: str, *, last: bool = False) -> None:
        batch = merged(self._pending.pop(entity))
        del self._rows[entity]
        if isinstance(batch, Rows) and batch.tolerance > 0.0:
            batch, rest = _thinned(batch, last)
            if rest is not None:
                self._pending[entity], self._rows[entity] = [rest], len(rest.time_s)
        self._recording.send(batch)

    def close(self) -> None:
        for entity in list(self._pending):
            self._write(entity, last=True)
        self._recording.close()


def _thinned(rows: Rows, last: bool) -> tuple[Rows, Rows | None]:
    """Return the rows that the file needs, and those that wait for later rows."""
    whole = len(rows.time_s) if last else max(len(rows.time_s) - 1, 0) // GROUP * GROUP
    found = needed_rows(rows.time_s, rows.values, rows.tolerance)[:whole]
    part = replace(rows, time_s=rows.time_s[:whole][found], values=rows.values[:whole][found])
    return part, None if last else replace(rows, time_s=rows.time_s[whole:], values=rows.values[whole:])


class _Screen:
    """Viewer of the review: sends everything at once, until the viewer is gone."""

    def __init__(self, collector: BatchCollector, name: str, url: str) -> None:
        self._recording: Recording | None = None
        port = urlsplit(url.removeprefix("rerun+")).port
        # A connection to no server would block for seconds.
        if port is None or not listens(port):
            _log.warning("no viewer listens at %s; the review is written to its file only", url)
            return
        self._recording = Recording(collector.plan, name, url=url)

    def send(self, batch: ReviewBatch) -> None:
        if self._recording is not None:
            self._recording.send(batch)

    def settle(self, collector: BatchCollector) -> None:
        """Update the layout; return True while the viewer takes data."""
        if self._recording is None:
            return
        if self._recording.plan is not collector.plan:
            self._recording.extend(collector.plan)
            self._recording.layout(collector.plan, collector.plan.header.duration_s)
        if not self._recording.flush(_VIEWER_TIMEOUT_S):
            _log.warning("the viewer is gone; `hil review RUN --follow` opens another one")
            self._recording = None

    @property
    def open(self) -> bool:
        return self._recording is not None

    def close(self) -> None:
        if self._recording is not None:
            self._recording.close()


@contextlib.contextmanager
def _reader(journal: Path, stop: Callable[[], bool]) -> Iterator[JournalReader]:
    """Open the journal, also directly after its creation; raise JournalError."""
    deadline = time.monotonic() + _JOURNAL_TIMEOUT_S
    while True:
        try:
            reader = JournalReader(journal)
            break
        except JournalError:
            if stop() or time.monotonic() > deadline:
                raise
        time.sleep(0.05)
    try:
        yield reader
    finally:
        reader.close()


def write_review(journal: Path, rrd: Path) -> None:
    """Write the content of `journal` to `rrd`, completely or not at all; raise JournalError or OSError."""
    follow(journal, rrd=rrd, viewer=None, stop=lambda: True)


def write_findings_review(folder: Path, rrd: Path) -> None:
    """Write the diagnosis in a results folder to `rrd`, completely or not at all; raise DiagnosisFolderError or
    OSError.
    """
    found = read_findings(folder)
    name = folder.resolve().name
    plan = plan_of_findings(found, name)
    with replacing(rrd) as unfinished, utf8_path(unfinished) as path:
        recording = Recording(plan, name, path=path)
        _send_findings(recording, found, plan)
        recording.layout(plan, plan.header.duration_s)
        recording.close()
        require_complete(path)


def _send_findings(recording: Recording, found: Findings, plan: ReviewPlan) -> None:
    recording.extend(plan)
    for entity, markdown in notes(found).items():
        recording.note(entity, markdown)
    for batch in batches(found):
        recording.send(batch)


def follow(
    journal: Path,
    *,
    rrd: Path | None,
    viewer: str | None,
    stop: Callable[[], bool],
    poll_s: float = POLL_S,
) -> None:
    """Send a journal to a file and to a viewer as it grows.

    The function ends when the run has ended, when `stop()` is true, or without a file when the viewer is gone, in each
    case after everything committed by then has been sent.

    Parameters
    ----------
    journal
        Journal of the run.
    rrd
        Rerun file to write, or None; it appears when it is complete.
    viewer
        URL of a viewer, or None.
    stop
        Function that is asked on every round.
    poll_s
        Time between two looks at the journal, s.

    Raises
    ------
    JournalError
        The journal cannot be read.
    OSError
        The file cannot be written.
    """
    with contextlib.ExitStack() as stack:
        reader = stack.enter_context(_reader(journal, stop))
        collector = BatchCollector(reader)
        name = journal.resolve().parent.name
        path = None if rrd is None else stack.enter_context(utf8_path(stack.enter_context(replacing(rrd))))
        recording = None if path is None else Recording(collector.plan, name, path=path)
        file = None if recording is None else _ReviewFile(recording)
        screen = None if viewer is None else _Screen(collector, name, viewer)
        try:
            while True:
                last = stop() or collector.finished()
                for batch in collector.poll(last=last):
                    if file is not None:
                        file.send(batch)
                    if screen is not None:
                        screen.send(batch)
                if screen is not None:
                    screen.settle(collector)
                if last or (file is None and screen is not None and not screen.open):
                    break
                time.sleep(poll_s)
        finally:
            if recording is not None and file is not None:
                plan = collector.plan
                recording.extend(plan)
                found = findings_of_run(journal)
                if found is not None:
                    plan = with_findings(plan, found)
                    _send_findings(recording, found, plan)
                recording.layout(plan, collector.end_s or plan.header.duration_s)
                file.close()
            if screen is not None:
                screen.close()
        if path is not None:
            require_complete(path)
