"""Live twin: a stream of samples in, predictions and calibrations out.

Two twins run in parallel. The static one keeps the commissioned parameters and runs free from its initial state. The
tracked one predicts each sample with parameters and a state from earlier windows only; when a window is complete it is
calibrated, and continues from the calibrated state. So `tracked` is never fitted on the samples that it predicts, while
`Calibration.fitted` is. A calibrator that proposes within windows too (`Proposer`) moves the live twin there as well
(docs/decisions/0010): the samples that follow are still predicted.

For its first seconds (SETTLE_S) the initial state is found recursively. Each sample is predicted, then the state moves
by 1/n towards the measurement, which makes it the mean of the first n. It goes sample by sample, so that nothing
depends on how the stream is cut into blocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.calibrators import Calibration, Calibrator, make_calibrator
from twin.calibrators.base import Proposer, Restartable, SampleFilter, Window, from_json, normalised_misfit, to_json
from twin.calibrators.disturbance import DisturbanceLocaliser
from twin.calibrators.results import skipped_calibration
from twin.calibrators.windows import WindowSamples, last_row_of_window, make_window, window_index
from twin.elements.sensor import Sensor
from twin.kernel import Kernel, hold_inputs
from twin.network import Array, Network, TwinFileError

SETTLE_S = 30.0
"""Time over which the initial state is averaged, s."""
USUALLY = 0.5
"""Share of a window's samples in which an input must be read to count as available. An input is lost where it was
available in some window before.
"""


@dataclass(frozen=True)
class TrackerUpdate:
    """Result of one push.

    Attributes
    ----------
    static, tracked
        (n, m) degC, for exactly the pushed samples, in the network's sensor order.
    calibrations
        Calibrations of the windows completed inside the block, in order.
    window_errors
        Root mean square error of the static and of the tracked twin in each of these windows, over all sensors and in
        units of their noise. Both are predictions; NaN in a skipped window.
    skipped
        Samples whose stamp does not advance (or is not finite): predicted with the unchanged state, left out of every
        fit.
    filtered, spread
        (n, m) degC and K: the estimate of a calibrator that follows every sample, after it has seen the sample, with
        one standard deviation; no prediction. None for the other calibrators. Until the filter begins, `filtered` is
        `tracked` and `spread` NaN.
    proposals
        Proposals made inside the block by a calibrator that proposes, as plain data.
    """

    static: Array
    tracked: Array
    calibrations: tuple[Calibration, ...]
    skipped: int
    filtered: Array | None = None
    spread: Array | None = None
    proposals: tuple[dict[str, Any], ...] = ()
    window_errors: tuple[tuple[float, float], ...] = ()


@dataclass
class _Buffer:
    """Samples of the window under way, and the state at its first sample."""

    time: list[Array] = field(default_factory=list)
    inputs: list[Array] = field(default_factory=list)
    measured: list[Array] = field(default_factory=list)
    read: list[np.ndarray] = field(default_factory=list)
    live: list[Array] = field(default_factory=list)
    static: list[Array] = field(default_factory=list)
    state: Array | None = None


class TwinTracker:
    """A twin that follows a rig.

    Parameters
    ----------
    network
        The commissioned twin; it is never changed.
    calibrator
        A name (see `twin.calibrators.make_calibrator`) or a `Calibrator`.
    seed
        Seed of the calibrator's random generator.
    tunables
        Set of the twin to calibrate; each calibrator has a default.

    Raises
    ------
    TwinFileError
        There is no such calibrator or set.
    """

    def __init__(
        self,
        network: Network,
        calibrator: str | Calibrator = "pso",
        seed: int = 0,
        tunables: str | None = None,
    ) -> None:
        self.network = network
        self.calibrator = (
            make_calibrator(calibrator, network, tunables, seed) if isinstance(calibrator, str) else calibrator
        )
        self._kernel = Kernel(network, self.calibrator.ids)
        self._localiser = DisturbanceLocaliser(network)
        k, m, c = len(network.nodes), len(network.instruments), len(network.inputs)
        self._parameters = network.values.copy()
        self._last_good = network.nominal_inputs.copy()
        self._origin: float | None = None
        self._time = 0.0
        self._pace = 0.0
        self._inputs = np.zeros(c)
        self._static = np.zeros(k)
        self._tracked = np.zeros(k)
        self._seen = np.zeros(k)
        self._usual = np.zeros(c)
        self._window = 0
        self._number = 0
        self._cycles = 0
        self._buffer = _Buffer()
        self._window_errors: list[tuple[float, float]] = []
        # rows: squared errors and counts of static, tracked, fitted
        self._sums = np.zeros((6, m))
        self._reads = [
            (j, network.nodes.index(s.node)) for j, s in enumerate(network.instruments) if isinstance(s, Sensor)
        ]

    @property
    def values(self) -> dict[str, float]:
        """Return the present tunables of the live twin, by parameter id."""
        index = self.network.index(self.calibrator.ids)
        return dict(zip(self.calibrator.ids, self._parameters[index].tolist(), strict=True))

    def push(self, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike) -> TrackerUpdate:
        """Predict a block of samples, in order, and calibrate every window that it completes.

        Parameters
        ----------
        time_s
            (n,) s, n >= 1 (a scalar for one sample).
        inputs
            (n, c), NaN holds the last good value.
        measured
            (n, m) degC, NaN is masked.

        Raises
        ------
        TwinFileError
            Shapes do not fit the network.
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        y = np.atleast_2d(np.asarray(measured, dtype=np.float64))
        u = hold_inputs(self.network, inputs, self._last_good)
        n, m = len(t), len(self.network.instruments)
        if n == 0 or t.ndim != 1 or u.shape[0] != n or y.shape != (n, m):
            raise TwinFileError(
                f"a block of {n} samples needs inputs ({n}, {len(self.network.inputs)}) and measured ({n}, {m}), "
                f"got {u.shape} and {y.shape}"
            )
        y, read = np.where(np.isfinite(y), y, np.nan), np.isfinite(np.atleast_2d(np.asarray(inputs, dtype=np.float64)))
        self._last_good = u[-1].copy()
        rows = self._advancing(t)
        follows = isinstance(self.calibrator, SampleFilter)
        out = np.full((4 if follows else 2, rows.size, m), np.nan)
        calibrations: list[Calibration] = []
        self._window_errors.clear()
        at = 0
        before = self._readings() if rows.size < n and self._origin is not None else None
        ahead = (t, u, y, read) if rows.size == n else (t[rows], u[rows], y[rows], read[rows])
        while at < rows.size:
            part = (ahead[0][at:], ahead[1][at:], ahead[2][at:], ahead[3][at:])
            at += self._process(*part, out[:, at:], calibrations)
        if follows:
            out[2] = np.where(np.isfinite(out[2]), out[2], out[1])
        self._count(0, out[0] - ahead[2])
        self._count(1, out[1] - ahead[2])
        if rows.size < n:
            out = self._repeat(out, rows, n, before, y)
        proposals = self.calibrator.take() if isinstance(self.calibrator, Proposer) else ()
        filtered, spread = (out[2], out[3]) if follows else (None, None)
        window_errors = tuple(self._window_errors)
        return TrackerUpdate(
            out[0], out[1], tuple(calibrations), n - rows.size, filtered, spread, proposals, window_errors
        )

    def table(self) -> dict[str, dict[str, float]]:
        """Return, per sensor in K, the RMSE ``static`` and ``tracked`` (both predictions), ``fitted`` (same window),
        and ``noise``.

        NaN where nothing was measured, or no window was calibrated yet.
        """
        squares, counts = self._sums[:3], self._sums[3:]
        error = np.sqrt(np.where(counts > 0.0, squares / np.maximum(counts, 1.0), np.nan))
        rows = {
            name: dict(zip(("static", "tracked", "fitted"), error[:, j].tolist(), strict=True))
            for j, name in enumerate(self.network.sensor_names)
        }
        for name, sigma in zip(rows, self.network.sigma.tolist(), strict=True):
            rows[name]["noise"] = sigma
        return rows

    def restart(self) -> None:
        """Restart after a time without samples: the next ones determine the state anew, as the first ones did.

        Parameters and all that the calibrator has learned stay; the window under way is not calibrated.
        """
        self._origin, self._pace, self._window, self._cycles = None, 0.0, 0, 0
        self._seen[:] = 0.0
        self._buffer = _Buffer()
        if isinstance(self.calibrator, Restartable):
            self.calibrator.restart()

    def _advancing(self, t: Array) -> np.ndarray:
        """Return the positions of the samples whose stamp is finite and later than all before it."""
        stamps = np.where(np.isfinite(t), t, -np.inf)
        latest = np.maximum.accumulate(np.concatenate([[-np.inf if self._origin is None else self._time], stamps]))
        return np.flatnonzero(stamps > latest[:-1])

    def _process(
        self, t: Array, u: Array, y: Array, read: np.ndarray, out: Array, calibrations: list[Calibration]
    ) -> int:
        """Process some of the advancing samples, at least one; return their number."""
        rules = self.network.rules
        if self._origin is None:
            self._origin = float(t[0])
            self._static = self.network.initial_state(y[0])
            self._tracked = self._static.copy()
            self._seen[[k for j, k in self._reads if np.isfinite(y[0, j])]] = 1.0
            out[:2, 0] = self._readings()
            self._time, self._inputs = float(t[0]), u[0].copy()
            return 1
        if t[0] - self._origin < SETTLE_S:
            self._advance(t[:1], u[:1], out)
            self._settle(y[0])
            return 1
        end = self._origin + (self._window + 1) * rules.window_s
        if t[0] >= end:
            self._complete(calibrations)
            self._window = window_index(float(t[0]), self._origin, rules)
            end = self._origin + (self._window + 1) * rules.window_s
        due = self._due(float(t[0]), end)
        t = t[: int(np.searchsorted(t, end)) + 1 if due >= end else int(np.searchsorted(t, due))]
        intervals = np.diff(t, prepend=self._time)
        earlier = np.concatenate([[self._pace or intervals[0]], intervals[:-1]])
        last = last_row_of_window(t, np.minimum(intervals, earlier), end)
        take = int(np.searchsorted(t, end)) if last is None else last + 1
        if self._buffer.state is None:
            take, last = 1, None if last != 0 else 0
        self._advance(t[:take], u[:take], out)
        buffer = self._buffer
        if buffer.state is None:
            buffer.state = self._tracked.copy()
        buffer.time.append(t[:take].copy())
        buffer.inputs.append(u[:take].copy())
        buffer.measured.append(y[:take].copy())
        buffer.read.append(read[:take].copy())
        buffer.live.append(out[1, :take].copy())
        buffer.static.append(out[0, :take].copy())
        if isinstance(self.calibrator, SampleFilter):
            seen = self.calibrator.follow(t[:take], u[:take], y[:take], read[:take], buffer.state)
            out[2, :take], out[3, :take] = seen.filtered, seen.spread
        if last is not None:
            self._complete(calibrations)
            self._window += 1
        return take

    def _due(self, now: float, end: float) -> float:
        """Return the time of the calibrator's next proposal in the window up to `end`; past it where there is none.

        A proposal that is due at the sample of `now` is made first, from the samples before it.
        """
        if not isinstance(self.calibrator, Proposer):
            return np.inf
        cycle, window_s = self.calibrator.cycle_s, self.network.rules.window_s
        due = end - window_s + (self._cycles + 1) * cycle
        if now >= due < end:
            self._cycles = int((now - end + window_s) / cycle)
            due = end - window_s + (self._cycles + 1) * cycle
            if self._buffer.state is not None:
                moved = self.calibrator.between(self._current_window())
                if moved is not None:
                    self._parameters[self.network.index(self.calibrator.ids)], self._tracked = moved
        return due

    def _advance(self, t: Array, u: Array, out: Array) -> None:
        """Predict samples at `t` (n,) with both twins; inputs of the sample before hold up to the first."""
        times = np.concatenate([[self._time], t])
        drive = np.vstack([self._inputs, u])
        readings, end = self._kernel.trace(self.network.values, self._static, times, drive)
        out[0, : len(t)], self._static = readings[0, 1:], end[0]
        readings, end = self._kernel.trace(self._parameters, self._tracked, times, drive)
        out[1, : len(t)], self._tracked = readings[0, 1:], end[0]
        self._pace = float(times[-1] - times[-2])
        self._time, self._inputs = float(t[-1]), u[-1].copy()

    def _settle(self, y: Array) -> None:
        """Move the initial state towards one sample's readings."""
        for j, k in self._reads:
            if np.isfinite(y[j]):
                self._seen[k] += 1.0
                self._static[k] += (y[j] - self._static[k]) / self._seen[k]
        self._tracked = self._static.copy()

    def _readings(self) -> Array:
        """Return the present readings (2, m) of both twins."""
        here, drive = np.array([self._time]), self._inputs[None, :]
        both = ((self.network.values, self._static), (self._parameters, self._tracked))
        return np.stack([self._kernel.trace(p, state, here, drive)[0][0, 0] for p, state in both])

    def _complete(self, calibrations: list[Calibration]) -> None:
        """Calibrate the buffered window, if it holds anything, and continue from there."""
        self._cycles = 0
        if self._buffer.state is None:
            return
        window = self._current_window()
        unmoved = replace(window, live=np.concatenate(self._buffer.static))
        self._buffer = _Buffer()
        self._number += 1
        if window.kind == "skipped":
            self._window_errors.append((np.nan, np.nan))
            done = skipped_calibration(self.network, window, self.calibrator.ids, self._tracked.copy())
        else:
            sigma = self.network.sigma
            self._window_errors.append((normalised_misfit(unmoved, sigma), normalised_misfit(window, sigma)))
            done = self._with_disturbance(window, self.calibrator.calibrate(window))
            self._count(2, done.fitted - window.measured)
        self._parameters[self.network.index(self.calibrator.ids)] = list(done.values.values())
        self._tracked = done.end.copy()
        calibrations.append(done)

    def _with_disturbance(self, window: Window, done: Calibration) -> Calibration:
        """Return the calibration with the place of an unknown power, or with the inputs that were not read.

        The effect of an input that nobody read is not a fault of the rig.
        """
        read = window.read.mean(axis=0) >= USUALLY
        lost = [c for c, usual, now in zip(self.network.input_columns, self._usual, read, strict=True) if usual > now]
        self._usual = np.maximum(self._usual, read)
        if lost:
            return replace(done, flags=(*done.flags, f"not read: {', '.join(lost)}"))
        return self._localiser.locate(window).enter(done)

    def _current_window(self) -> Window:
        """Return the buffered part of the window under way."""
        buffer = self._buffer
        assert buffer.state is not None
        return make_window(
            self._number,
            WindowSamples(
                *(np.concatenate(part) for part in (buffer.time, buffer.inputs, buffer.measured, buffer.read))
            ),
            buffer.state,
            self._parameters.copy(),
            np.concatenate(buffer.live),
            self.network.rules,
            self.network.kelvin_per_unit,
        )

    def _count(self, row: int, residual: Array) -> None:
        # A running sum, never a pairwise one: the total must not depend on how the stream is cut.
        """Add residuals to the sums of squares."""
        good = np.isfinite(residual)
        squares = np.where(good, residual, 0.0) ** 2
        self._sums[row] = np.cumsum(np.vstack([self._sums[row], squares]), axis=0)[-1]
        self._sums[row + 3] += good.sum(axis=0)

    def _repeat(self, out: Array, rows: np.ndarray, n: int, before: Array | None, y: Array) -> Array:
        """Return predictions (2 or 4, n, m) in which a sample that does not advance repeats the one before it."""
        if before is None:
            first = self.network.initial_state(y[0])
            before = np.full((2, y.shape[1]), np.nan)
            for j, k in self._reads:
                before[:, j] = first[k]
        before = np.vstack([before, before[1:], np.full_like(before[1:], np.nan)])[: len(out)]
        known = np.concatenate([before[:, None, :], out], axis=1)
        position = np.searchsorted(rows, np.arange(n), side="right")
        return known[:, position]

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue, as plain JSON-able data (None stands for NaN)."""
        buffer = self._buffer
        return {
            "format": 2,
            "network": self.network.name,
            "calibrator": {"name": self.calibrator.name, "state": self.calibrator.state()},
            "scalars": [self._origin, self._time, self._pace, self._window, self._number, self._cycles],
            "arrays": {key: to_json(getattr(self, f"_{key}")) for key in _ARRAYS},
            "buffer": None
            if buffer.state is None
            else {
                "state": to_json(buffer.state),
                **{key: to_json(np.concatenate(getattr(buffer, key))) for key in (*_BUFFERED, "read")},
            },
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`; network and calibrator must be the same as then.

        Raises
        ------
        TwinFileError
            The saved state belongs to another twin or calibrator.
        """
        saved = (state.get("network"), state.get("calibrator", {}).get("name"))
        if saved != (self.network.name, self.calibrator.name):
            raise TwinFileError(
                f"the saved tracker belongs to twin {saved[0]!r} with calibrator {saved[1]!r}, not to "
                f"{self.network.name!r} with {self.calibrator.name!r}"
            )
        self.calibrator.restore(state["calibrator"]["state"])
        scalars = state["scalars"]
        self._origin, self._time, self._pace, self._window, self._number, self._cycles = scalars
        for key in _ARRAYS:
            setattr(self, f"_{key}", from_json(state["arrays"].get(key, to_json(getattr(self, f"_{key}")))))
        self._buffer = _Buffer()
        if state["buffer"] is not None:
            self._buffer.state = from_json(state["buffer"]["state"])
            for key in _BUFFERED:
                getattr(self._buffer, key).append(from_json(state["buffer"][key]))
            inputs = self._buffer.inputs[0]
            self._buffer.read.append(from_json(state["buffer"].get("read", np.isfinite(inputs))).astype(bool))


_ARRAYS = ("parameters", "last_good", "inputs", "static", "tracked", "seen", "usual", "sums")
_BUFFERED = ("time", "inputs", "measured", "live", "static")
