"""What goes into a calibrator and what comes out: one completed window, one calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from twin.network import Array

WindowKind = Literal["calibrated", "recovery", "stall", "skipped"]


@dataclass(frozen=True)
class Window:
    """A completed window of samples, and what the live twin made of it.

    Attributes:
        number: from 0; windows without a sample are not made.
        time: (n,) s. inputs: (n, c), without NaN. measured: (n, m) degC, NaN where masked.
        read: (n, c) bool, which inputs were read at the sample; the others are what was read last.
        state: of the live twin at the first sample. parameters: (p,) full vector it ran with.
        live: (n, m) its readings, made before the window was seen.
        first: how many samples count as the beginning of the window.
        initial_mismatch_K: root mean square over sensors of the mean mismatch in that beginning.
        error_K: root mean square of the live twin's mismatch over the window and all sensors.
        kind: which cost applies; "skipped" for a window with too little data to fit.
    """

    number: int
    time: Array
    inputs: Array
    measured: Array
    read: np.ndarray
    state: Array
    parameters: Array
    live: Array
    first: int
    initial_mismatch_K: float
    error_K: float
    kind: WindowKind


@dataclass(frozen=True)
class Calibration:
    """What a calibrator concluded from one window.

    Attributes:
        window, start_s, end_s: which window. kind: its cost.
        values: parameter id -> value, for the calibrated tunables.
        covariance: (q, q) of `values` in their own units, or None where the method gives none.
        frozen: parameters that this window cannot tell and that were therefore left as they were; their
            numbers are older than the window.
        alone: parameter id -> standard error that this window alone would give, with all tunables and the
            initial state unknown; huge where it says nothing. Empty where nothing was fitted.
        condition: condition number of that information, scaled to unit diagonal; None where nothing was fitted.
        cost: dimensionless value of the window's cost at these values.
        rmse: sensor -> K over the window after calibration (NaN without a measurement); the values were
            fitted on these very samples.
        error_before_K: of the live twin over the window and all sensors, a prediction.
        error_K: the same after calibration.
        calibrated: error_K below the twin's threshold.
        fitted: (n, m) degC, readings after calibration. state: fitted or carried, at the first sample.
            end: at the last sample, from which the live twin goes on.
        flags: plain words on anything unusual. evaluations: simulations of the window.
        disturbed: node in which an unknown power explains what the live twin missed in this window, or None.
        disturbed_W, disturbed_interval90_W, disturbed_since_s: that power and its onset.
        explains: node -> share of the mismatch that a power there explains; empty in quiet windows.
    """

    window: int
    start_s: float
    end_s: float
    kind: WindowKind
    values: Mapping[str, float]
    covariance: Array | None
    cost: float
    rmse: Mapping[str, float]
    error_before_K: float
    error_K: float
    calibrated: bool
    fitted: Array
    state: Array
    end: Array
    flags: tuple[str, ...]
    evaluations: int
    frozen: tuple[str, ...] = ()
    alone: Mapping[str, float] = field(default_factory=dict)
    condition: float | None = None
    disturbed: str | None = None
    disturbed_W: float | None = None
    disturbed_interval90_W: tuple[float, float] | None = None
    disturbed_since_s: float | None = None
    explains: Mapping[str, float] = field(default_factory=dict)


class Calibrator(Protocol):
    """Turns completed windows into parameters, one after the other, and remembers what it needs to."""

    name: str
    ids: tuple[str, ...]

    def calibrate(self, window: Window) -> Calibration:
        """Values for the tunables `ids` from a window of kind calibrated, recovery or stall."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything needed to go on, as plain JSON-able data, random generator included."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave."""
        ...


@dataclass(frozen=True)
class FilteredReadings:
    """Readings that have seen the samples they describe: filtered (n, m) degC, spread (n, m) K, one sigma."""

    filtered: Array
    spread: Array


@runtime_checkable
class SampleFilter(Protocol):
    """A calibrator that works sample by sample as well."""

    def follow(self, time: Array, inputs: Array, measured: Array, read: np.ndarray, state: Array) -> FilteredReadings:
        """Take in samples, in order; arrays as in `Window`. `state`, that of the live twin at the first of them, is for
        a start from nothing."""
        ...


@runtime_checkable
class Restartable(Protocol):
    """A calibrator that holds a state of the rig of its own from sample to sample."""

    def restart(self) -> None:
        """Nobody knows what the rig did since the last sample: the next one says anew where it stands."""
        ...


@runtime_checkable
class Proposer(Protocol):
    """A calibrator that proposes within a window too, every `cycle_s` from its beginning."""

    cycle_s: float

    def between(self, window: Window) -> tuple[Array, Array] | None:
        """Propose from the part of a window that has gone by.

        The live twin takes on values (q,) of `ids` and a state (k,) at the last sample; None leaves it as it is.
        """
        ...

    def take(self) -> tuple[dict[str, Any], ...]:
        """Every proposal since this was last asked, as plain data: `time_s`, `values`, `standard_errors`,
        `held` (parameter -> code), `reasons`; those at the ends of windows included."""
        ...


def to_json(a: Array) -> Any:
    """Nested lists with None for what is not finite: strict JSON."""
    out = a.astype(object)
    out[~np.isfinite(a)] = None
    return out.tolist()


def from_json(data: Any) -> Array:
    """The array that `plain` took apart, with NaN for None."""
    return np.array(data, dtype=np.float64)


def normalised_misfit(window: Window, sigma: Array) -> float:
    """Root mean square of the live twin's mismatch in units of the noise (m,) K; 1 without a measurement."""
    r = (window.live - window.measured) / sigma
    good = np.isfinite(r)
    return float(np.sqrt(np.mean(r[good] ** 2))) if good.any() else 1.0


def total_rmse(residual: Array) -> float:
    """Root mean square over all finite entries, K; 0 if there is none."""
    good = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(good**2))) if good.size else 0.0


def rmse(residual: Array) -> list[float]:
    """Root mean square of each column over its finite entries; NaN for a column without any."""
    good = np.isfinite(residual)
    total = np.where(good, residual, 0.0)
    count = good.sum(axis=0)
    mean = np.where(count > 0, (total**2).sum(axis=0) / np.maximum(count, 1), np.nan)
    return [float(v) for v in np.sqrt(mean)]
