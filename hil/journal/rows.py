"""What a journal holds, as plain data: its header and the rows of its tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Signal


class JournalError(Exception):
    """The journal cannot be written or read; the message names the file and the remedy."""


@dataclass(frozen=True, slots=True)
class Header:
    """What a reader must know before the first sample: the signals, and per twin sensor the columns it predicts."""

    signals: tuple[Signal, ...]
    twin_sensors: dict[str, tuple[str, ...]]
    twin_names: tuple[str, ...]
    profile: str
    duration_s: float
    period_s: float
    noise_K: dict[str, float]


@dataclass(frozen=True, slots=True)
class Samples:
    """A block of ticks: `tick (n,)`, `time_s (n,)`, `values (n, k)`, `quality (n, k)`, `source_time_s (n, k)`."""

    tick: NDArray[np.int64]
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]
    quality: NDArray[np.uint8]
    source_time_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TwinOutput:
    """Predictions of one twin: `tick (n,)`, `time_s (n,)` and `values (n, m)` in degC, by twin sensor."""

    twin: str
    tick: NDArray[np.int64]
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CalibrationRow:
    """One finished window of a calibrator; `document` is what the calibrator reported, as plain data."""

    id: int
    calibrator: str
    start_s: float
    end_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ProposalRow:
    """What a calibrator proposed at a moment; `document` is what it reported, as plain data."""

    id: int
    calibrator: str
    time_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class BandRow:
    """Minutes of a twin: `document` has mean error and predicted half width by sensor, K (`hil.tracking.bands`)."""

    id: int
    twin: str
    start_s: float
    end_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class WriteRow:
    """One set-point that the engine changed, and why (`profile`, `slew`, `safe: ...`)."""

    id: int
    tick: int
    time_s: float
    signal: str
    value: float
    reason: str


@dataclass(frozen=True, slots=True)
class EventRow:
    """One event; `level` is INFO, WARN or ERROR."""

    id: int
    tick: int
    time_s: float
    wall_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class StateRow:
    """One transition of the run's state (see `hil.journal.states`); `profile_s` is where the profile's clock stood."""

    id: int
    tick: int
    time_s: float
    wall_s: float
    profile_s: float
    source: str
    event: str
    target: str
    reason: str


@dataclass(frozen=True, slots=True)
class SegmentRow:
    """Where a run went on after it had been cut: from `tick` on, after `gap_s` without a row.

    `number` counts from 2, the run's beginning being the first. `profile_s` is where the profile's clock stood,
    `aim_tick` the tick whose temperatures the soak led back to (a cut soak has that of the one before).
    """

    number: int
    tick: int
    time_s: float
    wall_s: float
    gap_s: float
    profile_s: float
    aim_tick: int
    reason: str
