"""Restore of the calibrators of an interrupted run by a replay of the journal's samples.

The state of a calibrator depends on its samples alone. The replay therefore restores swarm, covariance, network
history, bands, error sums and random generators to the bit, from the one file that is crash-safe. Results that had not
reached the journal before the interruption are added to it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.journal import JournalReader, JournalWriter
from hil.tracking import Results, Tracking

PAGE = 3600
"""Ticks read from the journal at a time: an hour at 1 Hz, some megabytes."""
REPORT_EVERY_S = 5.0
"""Interval of progress reports, s of wall time."""


class NewResults:
    """Filter in front of `journal` that passes on the results that it does not hold yet, and their events."""

    def __init__(self, journal: Results, known: JournalReader) -> None:
        self._journal = journal
        self._ticks = {twin: known.last_twin_tick(twin) for twin in known.header.twin_names}
        self._windows = {row.calibrator: row.end_s for row in known.calibrations()}
        self._proposals = {row.calibrator: row.time_s for row in known.proposals()}
        self._bands = {row.twin: row.end_s for row in known.bands()}
        self._is_new = False

    def twin_outputs(self, twin: str, ticks: Sequence[int], time_s: Sequence[float], values: NDArray[Any]) -> None:
        """Pass on predictions of ticks that have none; `time_s (n,)` in s, `values (n, m)` in degC."""
        first = int(np.searchsorted(np.asarray(ticks), self._ticks.get(twin, -1), side="right"))
        if first < len(ticks):
            self._journal.twin_outputs(twin, ticks[first:], time_s[first:], values[first:])

    def calibration(self, calibrator: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """Pass on a window later than those known; its bounds in s."""
        self._is_new = end_s > self._windows.get(calibrator, -np.inf)
        if self._is_new:
            self._journal.calibration(calibrator, start_s, end_s, document)

    def proposal(self, calibrator: str, time_s: float, document: dict[str, Any]) -> None:
        """Pass on a proposal later than those known, at `time_s`."""
        self._is_new = time_s > self._proposals.get(calibrator, -np.inf)
        if self._is_new:
            self._journal.proposal(calibrator, time_s, document)

    def band(self, twin: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """Pass on a band later than those known; its bounds in s."""
        if end_s > self._bands.get(twin, -np.inf):
            self._journal.band(twin, start_s, end_s, document)

    def event(self, tick: int, time_s: float, level: str, text: str) -> None:
        """Pass on an event about a new window or proposal, and every event of level ERROR (a calibrator that stops)."""
        if self._is_new or level == "ERROR":
            self._journal.event(tick, time_s, level, text)


async def restore_calibrators(
    tracking: Tracking, journal: JournalWriter, path: Path, announce: Callable[[str], None]
) -> None:
    """Replay the samples of the journal at `path` to `tracking`, gaps as gaps; then attach `journal` to it.

    Parameters
    ----------
    tracking
        Calibrators that have seen nothing yet; a failure of theirs is in `tracking.failures`.
    journal
        Writer of the same journal, which gets results that it lacks.
    path
        File of the journal.
    announce
        Gets a progress report every `REPORT_EVERY_S`.

    Raises
    ------
    JournalError
        The journal cannot be read.
    """
    reader = JournalReader(path)
    try:
        tracking.attach(NewResults(journal, reader))
        last = reader.last()[0]
        # A segment ends where the next begins, the last one after the last tick.
        ends = [*(row.tick for row in reader.segments() if row.tick <= last), last + 1]
        after, reported_s = -1, time.monotonic()
        for position, end in enumerate(ends):
            if position:
                tracking.begin_again()
            while after < end - 1 and len((page := reader.samples(after, PAGE)).tick):
                count = int(np.searchsorted(page.tick, end))
                if count == 0:
                    break
                good = np.where(page.quality == Quality.GOOD, page.values, np.nan)
                await tracking.publish(page.tick[:count].tolist(), page.time_s[:count].tolist(), good[:count].tolist())
                await tracking.settled()
                after = int(page.tick[count - 1])
                if time.monotonic() - reported_s > REPORT_EVERY_S:
                    reported_s = time.monotonic()
                    announce(f"restoring the calibrators: {after / max(last, 1):.0%}")
        tracking.begin_again()
    finally:
        reader.close()
    tracking.attach(journal)
