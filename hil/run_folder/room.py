"""Space that a run needs on disk, at most: journal, record, review, pages and write-ahead log.

Measured on journals with white noise in each value, which no file can shorten:

| file | bytes of a tick |
|---|---|
| journal | 24 for each signal, 40 for each twin, 10 for each prediction |
| record | 10 for each signal |
| review | 25 for each signal, 39 for each prediction |
"""

from __future__ import annotations

from dataclasses import dataclass

BYTES_OF_ANY_RUN = 10_000_000
"""Space that a run of no ticks needs, bytes: write-ahead log 4.2 MB, report 2 MB, review 1.5 MB, diagnosis and copies
of twin and healthy record 1.3 MB; rounded up."""


@dataclass(frozen=True, slots=True)
class RunSize:
    """Size of a run: number of ticks, of signals, of twins, and of the sensors that each of these predicts."""

    ticks: int
    signals: int = 0
    twins: int = 0
    sensors: int = 0

    @property
    def bytes_needed(self) -> int:
        """Space for all files of the run, bytes."""
        predictions = self.twins * self.sensors
        of_tick = 100 + 59 * self.signals + 40 * self.twins + 49 * predictions
        return BYTES_OF_ANY_RUN + self.ticks * of_tick
