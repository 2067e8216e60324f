"""The calibrators of a run that was cut, brought back by what they had seen: the journal's samples, once more.

What a calibrator makes of a stream depends on its samples alone, so this restores swarm, covariance, network history,
bands, error sums and random generators to the bit, from the one thing that is crash-safe anyway. Results that had not
reached the journal before the cut are added to it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.journal.writer import JournalReader, JournalWriter
from hil.tracking.process import Tracking
from hil.tracking.results import Results

PAGE = 3600
SAY_EVERY_S = 5.0


class Remainder:
    """Passes on to `journal` what it does not have yet, and the events that belong to that."""

    def __init__(self, journal: Results, known: JournalReader) -> None:
        self._journal = journal
        self._ticks = {twin: known.last_twin_tick(twin) for twin in known.header.twin_names}
        self._windows = {row.calibrator: row.end_s for row in known.calibrations()}
        self._proposals = {row.calibrator: row.time_s for row in known.proposals()}
        self._bands = {row.twin: row.end_s for row in known.bands()}
        self._news = False

    def twin_outputs(self, twin: str, ticks: Sequence[int], time_s: Sequence[float], values: NDArray[Any]) -> None:
        """Predictions of ticks that have none."""
        first = int(np.searchsorted(np.asarray(ticks), self._ticks.get(twin, -1), side="right"))
        if first < len(ticks):
            self._journal.twin_outputs(twin, ticks[first:], time_s[first:], values[first:])

    def calibration(self, calibrator: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """A window later than those known."""
        self._news = end_s > self._windows.get(calibrator, -np.inf)
        if self._news:
            self._journal.calibration(calibrator, start_s, end_s, document)

    def proposal(self, calibrator: str, time_s: float, document: dict[str, Any]) -> None:
        """A proposal later than those known."""
        self._news = time_s > self._proposals.get(calibrator, -np.inf)
        if self._news:
            self._journal.proposal(calibrator, time_s, document)

    def band(self, twin: str, start_s: float, end_s: float, document: dict[str, Any]) -> None:
        """A band later than those known."""
        if end_s > self._bands.get(twin, -np.inf):
            self._journal.band(twin, start_s, end_s, document)

    def event(self, tick: int, time_s: float, level: str, text: str) -> None:
        """What is said of the window or proposal before it; a calibrator that stops is always news."""
        if self._news or level == "ERROR":
            self._journal.event(tick, time_s, level, text)


async def restore(tracking: Tracking, journal: JournalWriter, path: Path, say: Callable[[str], None]) -> None:
    """Show `tracking` the samples of the journal at `path`, gaps as gaps; `say` is told how far it is.

    What fails shows in `tracking.failures`. Raises JournalError.
    """
    reader = JournalReader(path)
    try:
        tracking.attach(Remainder(journal, reader))
        last = reader.last()[0]
        # A segment ends where the next begins, the last one after the last tick.
        ends = [*(row.tick for row in reader.segments() if row.tick <= last), last + 1]
        after, said = -1, time.monotonic()
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
                if time.monotonic() - said > SAY_EVERY_S:
                    said = time.monotonic()
                    say(f"restoring the calibrators: {after / max(last, 1):.0%}")
        tracking.begin_again()
    finally:
        reader.close()
    tracking.attach(journal)
