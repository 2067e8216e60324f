"""Header and rows of a journal as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Signal


class JournalError(Exception):
    """Journal that cannot be written or read; the message names the file and the remedy."""


@dataclass(frozen=True, slots=True)
class Header:
    """Header of a journal: signals, and for each twin sensor the columns that it predicts.

    `duration_s` and `period_s` are in s of rig time, `noise_K` is the noise by twin sensor, K.
    """

    signals: tuple[Signal, ...]
    twin_sensors: dict[str, tuple[str, ...]]
    twin_names: tuple[str, ...]
    profile: str
    duration_s: float
    period_s: float
    noise_K: dict[str, float]


@dataclass(frozen=True, slots=True)
class JournalSamples:
    """Block of ticks: `tick (n,)`, `time_s (n,)`, `values (n, k)`, `quality (n, k)`, `source_time_s (n, k)`.

    Times are in s of rig time, values in the units of their signals.
    """

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
    """Finished window of a calibrator, its bounds in s; `document` is the calibrator's report as plain data."""

    id: int
    calibrator: str
    start_s: float
    end_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ProposalRow:
    """Proposal of a calibrator at `time_s`; `document` is the calibrator's report as plain data."""

    id: int
    calibrator: str
    time_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class BandRow:
    """Band of a twin over some minutes: `document` has mean error and predicted half width by sensor, K.

    See `hil.tracking.bands`.
    """

    id: int
    twin: str
    start_s: float
    end_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class WriteRow:
    """Set-point that the engine changed, in its unit, and the reason (`profile`, `slew`, `safe: ...`)."""

    id: int
    tick: int
    time_s: float
    signal: str
    value: float
    reason: str


@dataclass(frozen=True, slots=True)
class EventRow:
    """Event of a run; `level` is INFO, WARN or ERROR, `wall_s` in s since 1970."""

    id: int
    tick: int
    time_s: float
    wall_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class StateRow:
    """Transition of the run's state (see `hil.journal.states`); `profile_s` is the profile's clock."""

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
    """Segment of a resumed run: it begins at `tick` after `gap_s` without a row.

    `number` counts from 2; the first segment has no row. `profile_s` is the profile's clock. `aim_tick` is the tick
    whose temperatures the thermal restore aims at; a restore that was interrupted itself keeps the former one.
    """

    number: int
    tick: int
    time_s: float
    wall_s: float
    gap_s: float
    profile_s: float
    aim_tick: int
    reason: str
