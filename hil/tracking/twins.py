"""Twins side by side on one stream of samples: predictions, calibrations and their comparison."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.files import estimate_text
from hil.tracking.bands import Band, Bands
from twin import NORMAL90

if TYPE_CHECKING:
    from twin import Network, TwinTracker, WindowRules
    from twin.calibrators import Calibration

DEFAULT = ("pso", "least_squares", "hiera_unet")
"""Calibrators that run if none is named; the network is left out if there is none for the twin."""
STATIC = "static"
OUTDONE = "no better than static"
"""Label in place of calibrated for a window in which the static twin predicts better; see `PredictionErrors`."""


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """Settings of the twins: the twin file, the record columns of a row, the calibrators, the seed.

    `optional`: calibrators that are left out, with the reason, where they cannot be made. `static`: whether the twin
    as commissioned is among those that are handed on. `card`: of a trained ensemble in place of the shipped one.
    """

    twin: Path
    columns: tuple[str, ...]
    calibrators: tuple[str, ...]
    seed: int = 0
    optional: tuple[str, ...] = ()
    static: bool = True
    card: Path | None = None


@dataclass(frozen=True, slots=True)
class FinishedWindow:
    """Finished window of a calibrator; `document` as of `calibration_document`, and `outdone` if the static twin is
    better.
    """

    calibrator: str
    start_s: float
    end_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Proposed:
    """Proposal of a calibrator at `time_s`, within a window or at its end, with the reasons for held parameters."""

    calibrator: str
    time_s: float
    document: dict[str, Any]


@dataclass(frozen=True, slots=True)
class PredictionBlock:
    """Result of a block of n samples: predictions (n, m) degC by twin, and everything that was finished in it.

    `off_K`: (twin, sensor) -> mean of measured minus predicted, where anything was measured.
    """

    outputs: dict[str, NDArray[np.float64]]
    calibrations: tuple[FinishedWindow, ...]
    proposals: tuple[Proposed, ...]
    bands: tuple[Band, ...]
    off_K: dict[tuple[str, str], float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """RMSE in K by twin and sensor: `rows[sensor][column]`, columns in reading order, and the sensors' noise."""

    columns: tuple[str, ...]
    rows: dict[str, tuple[float, ...]]
    noise_K: dict[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class PredictionErrors:
    """Prediction errors of the static twin and a calibrator's twin in its windows so far, in units of the noise.

    Each number is the root mean square of measured minus predicted over a window's readings, each sensor in units of
    its own noise; both twins predict. A calibrator is outdone in a window where the square of its number exceeds that
    of the static twin by more than 1, which is the noise, and by more than that square itself, so that a few per cent
    do not count where both are wrong or the noise is given too small. It is outdone as a whole where that holds of all
    windows together. A transient disturbance does not discredit it: it surprises both twins at first, and
    misleads the calibrator's for about as much again when it goes.
    """

    windows: list[tuple[float, float]] = field(default_factory=list)

    def add(self, static: float, tracked: float) -> bool:
        """Add a window; return whether the calibrator is outdone in it, and as a whole."""
        self.windows.append((static, tracked))
        return self.outdone and _worse(static, tracked)

    @property
    def whole(self) -> tuple[float, float]:
        """Return both numbers over all windows together."""
        static, tracked = np.sqrt(np.mean(np.square(self.windows), axis=0)).tolist()
        return static, tracked

    @property
    def outdone(self) -> bool:
        """Return True if the calibrator is outdone as a whole."""
        return bool(self.windows) and _worse(*self.whole)


def _worse(static: float, tracked: float) -> bool:
    return tracked**2 > static**2 + max(static**2, 1.0)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of the twins at the end.

    Attributes
    ----------
    bands
        Twin -> sensor -> mean half width, K, of the bands that promised 90 %, and the share that they held.
    parameters
        Twin -> parameter -> value, half width of its 90 % interval (None without one), and whether
        it is held because it is not identifiable.
    outdone
        Calibrator -> a sentence, where the commissioned twin predicts better; see `PredictionErrors`.
    units
        Parameter -> its unit.
    """

    errors: ErrorTable
    bands: dict[str, dict[str, tuple[float, float]]] = field(default_factory=dict)
    parameters: dict[str, dict[str, tuple[float, float | None, bool]]] = field(default_factory=dict)
    outdone: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def joined_with(self, other: Comparison) -> Comparison:
        """Return both comparisons in one."""
        rows = {sensor: cells + other.errors.rows[sensor] for sensor, cells in self.errors.rows.items()}
        errors = ErrorTable(self.errors.columns + other.errors.columns, rows, self.errors.noise_K)
        parameters, outdone = self.parameters | other.parameters, self.outdone | other.outdone
        return Comparison(errors, self.bands | other.bands, parameters, outdone, self.units | other.units)


class Twins:
    """Live twins, one for each calibrator, and the static one, on the same samples.

    Results depend on the samples alone, not on the blocks.

    Raises
    ------
    TwinFileError
        The twin file, or a calibrator that is not optional, cannot be used. HieraError: there is no
        trained network for this twin.
    """

    def __init__(self, config: TrackingConfig) -> None:
        from twin import TwinFileError, TwinTracker, load
        from twin.calibrators import make_calibrator
        from twin.calibrators.hiera_unet import HieraError

        self.network: Network = load(config.twin)
        self.left_out: dict[str, str] = {}
        self._trackers: dict[str, TwinTracker] = {}
        self._last: dict[str, dict[str, Any]] = {}
        self._static = config.static
        for name in config.calibrators:
            try:
                made = make_calibrator(name, self.network, seed=config.seed, card=config.card)
                self._trackers[name] = TwinTracker(self.network, calibrator=made)
            except (HieraError, TwinFileError) as error:
                if name not in config.optional:
                    raise
                self.left_out[name] = str(error)
        self._prediction_errors = {name: PredictionErrors() for name in self._trackers}
        self._bands = Bands(self.network.sensor_names)

    @property
    def calibrators(self) -> tuple[str, ...]:
        """Return the calibrators that are not left out."""
        return tuple(self._trackers)

    def push(self, time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]) -> PredictionBlock:
        """Process a block of samples, time (n,) s and columns (n,), with every twin."""
        outputs: dict[str, NDArray[np.float64]] = {}
        calibrations: list[FinishedWindow] = []
        proposals: list[Proposed] = []
        inputs, measured = self.network.select(columns)
        for name, tracker in self._trackers.items():
            update = tracker.push(time_s, inputs, measured)
            if self._static:
                outputs.setdefault(STATIC, update.static)
            outputs[name] = update.tracked
            proposals += [Proposed(name, p["time_s"], p) for p in update.proposals]
            for c, missed in zip(update.calibrations, update.window_errors, strict=True):
                outdone = c.kind != "skipped" and self._prediction_errors[name].add(*missed)
                document = calibration_document(c) | {"outdone": outdone}
                calibrations.append(FinishedWindow(name, c.start_s, c.end_s, document))
        self._last |= {done.calibrator: done.document for done in calibrations if done.document["kind"] != "skipped"}
        bands = self._bands.push(time_s, measured, outputs)
        return PredictionBlock(outputs, tuple(calibrations), tuple(proposals), bands, self._off(measured, outputs))

    def _off(
        self, measured: NDArray[np.float64], outputs: dict[str, NDArray[np.float64]]
    ) -> dict[tuple[str, str], float]:
        found = {}
        for twin, values in outputs.items():
            for sensor, miss in zip(self.network.sensor_names, (measured - values).T, strict=True):
                good = miss[np.isfinite(miss)]
                if len(good):
                    found[twin, sensor] = float(good.mean())
        return found

    def begin_again(self) -> None:
        """Restart after a time without observation; see `TwinTracker.restart`."""
        for tracker in self._trackers.values():
            tracker.restart()

    def over(
        self, time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]], rows: int
    ) -> Iterator[tuple[int, PredictionBlock]]:
        """Process a whole record in blocks of this many rows; yield the number of samples done and the result of each
        block.

        After a gap without inputs, the twins restart.
        """
        from twin import find_segments

        begins = set(find_segments(self.network, time_s, self.network.select(columns)[0]).begins[1:])
        cuts = [*sorted({*range(0, len(time_s), rows), *begins}), len(time_s)]
        for start, end in itertools.pairwise(cuts):
            if start in begins:
                self.begin_again()
            part = slice(start, end)
            yield part.stop, self.push(time_s[part], {name: values[part] for name, values in columns.items()})

    def comparison(self) -> Comparison:
        """Return the comparison of the twins on all samples so far."""
        columns: list[str] = []
        rows: dict[str, list[float]] = {}
        noise: dict[str, float] = {}
        for name, tracker in self._trackers.items():
            static = self._static and not columns
            columns += ([STATIC] if static else []) + [f"{name} ahead", f"{name} fitted"]
            for sensor, row in tracker.table().items():
                cells = rows.setdefault(sensor, [])
                cells += ([row["static"]] if static else []) + [row["tracked"], row["fitted"]]
                noise[sensor] = row["noise"]
        errors = ErrorTable(tuple(columns), {sensor: tuple(cells) for sensor, cells in rows.items()}, noise)
        parameters = {name: _final(document) for name, document in self._last.items()}
        if self._static and parameters:
            ids = dict.fromkeys(name for values in parameters.values() for name in values)
            as_commissioned: dict[str, tuple[float, float | None, bool]] = {
                name: (self.network.parameters[name].value, None, False) for name in ids
            }
            parameters = {STATIC: as_commissioned, **parameters}
        outdone = {
            name: self._outdone_words(name)
            for name, errors_so_far in self._prediction_errors.items()
            if errors_so_far.outdone
        }
        units = {name: self.network.parameters[name].unit for values in parameters.values() for name in values}
        return Comparison(errors, self._bands.table(), parameters, outdone, units)

    def tuning(self) -> list[str]:
        """Describe the tuned parameters and window lengths, one sentence for all calibrators that agree."""
        alike: dict[tuple[str, ...], list[str]] = {}
        for name, tracker in self._trackers.items():
            alike.setdefault(tracker.calibrator.ids, []).append(name)
        every = f"windows of {self.network.rules.window_s:g} s"
        return [
            f"tuned by {', '.join(names)}: {_counted('parameter', ids)} ({self._tuned(ids)[0]}) on {every}"
            for ids, names in alike.items()
        ]

    def _outdone_words(self, name: str) -> str:
        ids, errors_so_far = self._trackers[name].calibrator.ids, self._prediction_errors[name]
        static, tracked = errors_so_far.whole
        tuned, fewer = self._tuned(ids)
        windows, parameters = _counted("window", errors_so_far.windows), _counted("parameter", ids)
        return (
            f"the commissioned twin predicts better than {name}: over the same {windows} its error is {static:.1f} "
            f"times the noise, that of {name} {tracked:.1f} times; windows of {self.network.rules.window_s:g} s "
            f"probably do not identify the {parameters} that {name} tunes ({tuned}), so its estimates of unknown heat "
            f"are left out; {fewer}, or set window_s under [windows] of the twin file to more"
        )

    def _tuned(self, ids: tuple[str, ...]) -> tuple[str, str]:
        """Return the name of the set of tuned parameters, and the way to tune fewer of them."""
        from twin.calibrators import default_tunables

        chosen = default_tunables(self.network)
        names = [*([chosen] if isinstance(chosen, str) else []), *self.network.sets]
        for name in names:
            if self.network.sets[name].members == ids:
                return f"[sets.{name}] of the twin file", f"remove some from [sets.{name}]"
        return "all of status tunable", "change the status tunable of some"


def parameter_cell(cell: Sequence[Any] | None) -> str:
    """Format a parameter of `Comparison.parameters` for a table."""
    if cell is None:
        return ""
    value, half, held = cell
    return f"{value:.4g} held" if held else f"{value:.4g}" if half is None else estimate_text(value, half)


def _final(document: dict[str, Any]) -> dict[str, tuple[float, float | None, bool]]:
    """Return the parameters of a window; a held one has no interval of its own."""
    held = set(document["frozen"])
    errors = document["standard_errors"] or {}
    found: dict[str, tuple[float, float | None, bool]] = {}
    for name, value in document["parameters"].items():
        error = None if name in held else errors.get(name)
        found[name] = (value, None if error is None else NORMAL90 * error, name in held)
    return found


def calibration_document(calibration: Calibration) -> dict[str, Any]:
    """Return a finished window as plain data for the journal, with errors in K and standard errors of parameters."""
    errors = None
    if calibration.covariance is not None:
        variances = np.diag(calibration.covariance)
        spread = [math.sqrt(v) if v >= 0 else None for v in variances.tolist()]
        errors = dict(zip(calibration.values, spread, strict=True))
    return {
        "window": calibration.window,
        "kind": calibration.kind,
        "cost": _finite(calibration.cost),
        "rmse_K": _finite(calibration.error_K),
        "rmse_before_K": _finite(calibration.error_before_K),
        "sensors_K": {name: _finite(value) for name, value in calibration.rmse.items()},
        "calibrated": bool(calibration.calibrated),
        "parameters": dict(calibration.values),
        "standard_errors": errors,
        "frozen": list(calibration.frozen),
        "condition": None if calibration.condition is None else _finite(calibration.condition),
        "disturbed": calibration.disturbed,
        "disturbed_W": calibration.disturbed_W,
        "disturbed_interval90_W": calibration.disturbed_interval90_W,
        "disturbed_since_s": calibration.disturbed_since_s,
        "flags": list(calibration.flags),
        "evaluations": calibration.evaluations,
    }


def disturbance(document: dict[str, Any]) -> str | None:
    """Return an unknown power in one of the rig's volumes as a sentence, or None.

    Return None, too, if the calibrator is outdone, since its errors are not those of the rig, or if a gate found the
    record implausible for a rig.
    """
    from twin.calibrators.hiera_unet.serve.gates import BROKEN
    from twin.discovery import disturbance_statement

    if document.get("outdone") or any(flag.startswith(BROKEN) for flag in document.get("flags", ())):
        return None
    where, power, interval = (document.get(f"disturbed{end}") for end in ("", "_W", "_interval90_W"))
    if where is None or power is None:
        return None
    bounds = None if interval is None else (float(interval[0]), float(interval[1]))
    return disturbance_statement(str(where), power, "W", bounds, document.get("disturbed_since_s"))


def window_kind(document: dict[str, Any]) -> str:
    """Return the label of a finished window in a table."""
    kind = str(document.get("kind", "window"))
    return OUTDONE if kind == "calibrated" and document.get("outdone") else kind


def _counted(noun: str, items: Sequence[Any]) -> str:
    return f"{len(items)} {noun}" if len(items) == 1 else f"{len(items)} {noun}s"


def window_words(kinds: Collection[str], rules: WindowRules) -> str:
    """Describe the kinds of windows of a table in one line; see `twin.calibrators.windows`."""
    from twin.calibrators import LEAST_ROWS, LEAST_SPAN

    near = f"within {rules.calibrated_K:g} K"
    means = {
        "calibrated": f"the twin ahead was {near} at its start or over the whole of it",
        "stall": f"the twin ahead was {near} neither at its start nor over the whole of it",
        "recovery": f"the twin ahead was more than {rules.large_K:g} K off at its start",
        OUTDONE: f"the twin ahead was {near} like a calibrated one, but the static twin predicted it clearly better",
        "skipped": f"fewer than {LEAST_ROWS} samples are there, or they span less than {LEAST_SPAN:.0%} of it",
    }
    return "the label of a window is " + "; ".join(
        f"{kind} where {what}" for kind, what in means.items() if kind in kinds
    )


def too_coarse(period_s: float, rules: WindowRules) -> str | None:
    """Return the reason why no window of a record with this `period_s` is fitted, with the remedy, or None."""
    from twin.calibrators import LEAST_ROWS

    if period_s * LEAST_ROWS <= rules.window_s:
        return None
    return (
        f"a window of {rules.window_s:g} s cannot hold {LEAST_ROWS} samples that are {period_s:g} s apart, so nothing "
        f"is fitted; set window_s under [windows] of the twin file to {2 * LEAST_ROWS * period_s:g}, say"
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
