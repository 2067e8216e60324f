"""Interface of calibrators: one completed window in, one calibration out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from twin.network import Array

WindowKind = Literal["calibrated", "recovery", "stall", "skipped"]


@dataclass(frozen=True)
class Window:
    """A completed window of samples, with the live twin's prediction of it.

    Attributes
    ----------
    number
        Counts from 0; windows without a sample are not made.
    time, inputs, measured
        (n,) s; (n, c) without NaN; (n, m) degC, NaN where masked.
    read
        (n, c) bool, True where an input was read at the sample; the others hold their last value.
    state, parameters
        State of the live twin at the first sample, and its full parameter vector (p,).
    live
        (n, m) degC, the live twin's readings, predicted before the window was seen.
    first
        Number of samples that count as the beginning of the window.
    initial_mismatch_K
        Root mean square over sensors of the mean mismatch in that beginning.
    error_K
        Root mean square of the live twin's mismatch over the window and all sensors.
    kind
        Selects the cost; "skipped" for a window with too little data to fit.
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
    """Result of a calibrator for one window.

    Attributes
    ----------
    window, start_s, end_s, kind
        The window, its time range and its kind.
    values
        Parameter id -> value, for the calibrated tunables.
    covariance
        (q, q) of `values` in their own units, or None where the method has none.
    frozen
        Parameters that are not identifiable in this window and were held; their values are older than the window.
    window_errors
        Parameter id -> standard error from this window alone, with all tunables and the initial state unknown; huge
        where there is no information. Empty where nothing was fitted.
    condition
        Condition number of that information, scaled to unit diagonal; None where nothing was fitted.
    cost
        Dimensionless value of the window's cost at these values.
    rmse
        Sensor -> K over the window after calibration (NaN without a measurement), on the fitted samples themselves.
    error_before_K, error_K
        Error of the live twin over the window and all sensors, a prediction; the same after calibration.
    calibrated
        True if error_K is below the twin's threshold.
    fitted
        (n, m) degC, readings after calibration.
    state, end
        State at the first sample, fitted or carried over; state at the last sample, from which the live twin continues.
    flags
        Plain phrases on anything unusual.
    evaluations
        Simulations of the window.
    disturbed
        Node in which an unknown power explains the live twin's mismatch in this window, or None.
    disturbed_W, disturbed_interval90_W, disturbed_since_s
        That power and its onset.
    explains
        Node -> share of the mismatch that a power there explains; empty in quiet windows.
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
    window_errors: Mapping[str, float] = field(default_factory=dict)
    condition: float | None = None
    disturbed: str | None = None
    disturbed_W: float | None = None
    disturbed_interval90_W: tuple[float, float] | None = None
    disturbed_since_s: float | None = None
    explains: Mapping[str, float] = field(default_factory=dict)


class Calibrator(Protocol):
    """An object that turns completed windows into parameters, one after the other, and keeps the state that it
    needs.
    """

    name: str
    ids: tuple[str, ...]

    def calibrate(self, window: Window) -> Calibration:
        """Return values for the tunables `ids` from a window of kind calibrated, recovery or stall."""
        ...

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue, as plain JSON-able data, random generator included."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`."""
        ...


@dataclass(frozen=True)
class FilteredReadings:
    """Estimated readings that have seen the samples they describe: filtered (n, m) degC, spread (n, m) K, one sigma."""

    filtered: Array
    spread: Array


@runtime_checkable
class SampleFilter(Protocol):
    """A calibrator that works sample by sample as well."""

    def follow(self, time: Array, inputs: Array, measured: Array, read: np.ndarray, state: Array) -> FilteredReadings:
        """Filter samples, in order; arrays as in `Window`.

        `state` is that of the live twin at the first of them, for a start from nothing.
        """
        ...


@runtime_checkable
class Restartable(Protocol):
    """A calibrator that holds a state of the rig of its own from sample to sample."""

    def restart(self) -> None:
        """Forget the state of the rig after a time without samples; the next sample determines it anew."""
        ...


@runtime_checkable
class Proposer(Protocol):
    """A calibrator that proposes within a window too, every `cycle_s` from its beginning."""

    cycle_s: float

    def between(self, window: Window) -> tuple[Array, Array] | None:
        """Propose from the part of a window that has passed.

        The live twin takes on values (q,) of `ids` and a state (k,) at the last sample; None leaves it unchanged.
        """
        ...

    def take(self) -> tuple[dict[str, Any], ...]:
        """Return every proposal since the last call, as plain data, those at the ends of windows included.

        Keys: `time_s`, `values`, `standard_errors`, `held` (parameter -> code), `reasons`.
        """
        ...


def to_json(a: Array) -> Any:
    """Return an array as nested lists with None for entries that are not finite: strict JSON."""
    out = a.astype(object)
    out[~np.isfinite(a)] = None
    return out.tolist()


def from_json(data: Any) -> Array:
    """Return the array that `to_json` wrote, with NaN for None."""
    return np.array(data, dtype=np.float64)


def normalised_misfit(window: Window, sigma: Array) -> float:
    """Return the root mean square of the live twin's mismatch in units of the noise (m,) K; 1 without a measurement."""
    r = (window.live - window.measured) / sigma
    good = np.isfinite(r)
    return float(np.sqrt(np.mean(r[good] ** 2))) if good.any() else 1.0


def total_rmse(residual: Array) -> float:
    """Return the root mean square over all finite entries, K; 0 if there is none."""
    good = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(good**2))) if good.size else 0.0


def rmse(residual: Array) -> list[float]:
    """Return the root mean square of each column over its finite entries; NaN for a column without any."""
    good = np.isfinite(residual)
    total = np.where(good, residual, 0.0)
    count = good.sum(axis=0)
    mean = np.where(count > 0, (total**2).sum(axis=0) / np.maximum(count, 1), np.nan)
    return [float(v) for v in np.sqrt(mean)]
