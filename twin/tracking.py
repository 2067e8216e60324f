"""The live twin: a stream of samples in, predictions and calibrations out.

Two twins run beside each other. The static one keeps the commissioned parameters and runs free from its initial
state. The tracked one predicts each sample with parameters and a state that come from earlier windows only;
when a window completes it is calibrated, and goes on from the calibrated state. So `tracked` is never fitted on
the samples that it predicts, while `Calibration.fitted` is. A calibrator that proposes within windows too
(`Proposer`) moves the live twin there as well (docs/decisions/0010): what follows is still predicted.

For its first seconds (SETTLE_S) the initial state is found recursively: each sample is predicted, then the state
moves by 1/n towards what was measured, which makes it the mean of the first n. Sample by sample, so that nothing
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
from twin.calibrators.windows import last_row_of_window, make_window, window_index
from twin.kernel import Kernel, hold_inputs
from twin.network import Array, Network, TwinFileError

SETTLE_S = 30.0
USUALLY = 0.5
"""Share of a window's samples in which an input is read that is there; in some window before, for one to be lost."""


@dataclass(frozen=True)
class TrackerUpdate:
    """What one push yielded.

    Attributes:
        static, tracked: (n, m) degC, for exactly the pushed samples, in the network's sensor order.
        calibrations: of the windows completed inside the block, in order.
        misses: root mean square of what the static and the tracked twin missed in each of these windows, over all
            sensors and in units of their noise; both predictions, NaN in a skipped window.
        skipped: samples whose stamp does not advance (or is not finite): predicted with the state as it
            was, left out of every fit.
        filtered, spread: (n, m) degC and K, what a calibrator that follows every sample makes of it once it has
            seen it, with one standard deviation; no prediction. None for the other calibrators. Until the
            filter begins, `filtered` is `tracked` and `spread` NaN.
        proposals: made inside the block by a calibrator that proposes, as plain data.
    """

    static: Array
    tracked: Array
    calibrations: tuple[Calibration, ...]
    skipped: int
    filtered: Array | None = None
    spread: Array | None = None
    proposals: tuple[dict[str, Any], ...] = ()
    misses: tuple[tuple[float, float], ...] = ()


@dataclass
class _Buffer:
    """Samples of the window under way; `state` and `parameters` are those at its first sample."""

    time: list[Array] = field(default_factory=list)
    inputs: list[Array] = field(default_factory=list)
    measured: list[Array] = field(default_factory=list)
    read: list[np.ndarray] = field(default_factory=list)
    live: list[Array] = field(default_factory=list)
    static: list[Array] = field(default_factory=list)
    state: Array | None = None


class TwinTracker:
    """A twin that follows a rig.

    Args:
        network: the commissioned twin; it is never changed.
        calibrator: a name (see `twin.calibrators.make`) or a `Calibrator`.
        seed: of the calibrator's random generator.
        tunables: set of the twin to calibrate; each calibrator has a default.
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
        k, m, c = len(network.nodes), len(network.sensors), len(network.inputs)
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
        self._misses: list[tuple[float, float]] = []
        # rows: squared errors and counts of static, tracked, fitted
        self._sums = np.zeros((6, m))
        self._reads = [(j, network.nodes.index(s.node)) for j, s in enumerate(network.sensors)]

    @property
    def values(self) -> dict[str, float]:
        """Tunables of the live twin as they are now, by parameter id."""
        index = self.network.index(self.calibrator.ids)
        return dict(zip(self.calibrator.ids, self._parameters[index].tolist(), strict=True))

    def push(self, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike) -> TrackerUpdate:
        """Predict a block of samples, in order, and calibrate every window that it completes.

        Args:
            time_s: (n,) s, n >= 1 (a scalar for one sample).
            inputs: (n, c), NaN holds the last good value. measured: (n, m) degC, NaN is masked.

        Raises:
            TwinFileError: shapes do not fit the network.
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        y = np.atleast_2d(np.asarray(measured, dtype=np.float64))
        u = hold_inputs(self.network, inputs, self._last_good)
        n, m = len(t), len(self.network.sensors)
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
        self._misses.clear()
        at = 0
        before = self._readings() if rows.size < n and self._origin is not None else None
        ahead = (t, u, y, read) if rows.size == n else (t[rows], u[rows], y[rows], read[rows])
        while at < rows.size:
            part = (ahead[0][at:], ahead[1][at:], ahead[2][at:], ahead[3][at:])
            at += self._some(*part, out[:, at:], calibrations)
        if follows:
            out[2] = np.where(np.isfinite(out[2]), out[2], out[1])
        self._count(0, out[0] - ahead[2])
        self._count(1, out[1] - ahead[2])
        if rows.size < n:
            out = self._repeat(out, rows, n, before, y)
        proposals = self.calibrator.take() if isinstance(self.calibrator, Proposer) else ()
        filtered, spread = (out[2], out[3]) if follows else (None, None)
        misses = tuple(self._misses)
        return TrackerUpdate(out[0], out[1], tuple(calibrations), n - rows.size, filtered, spread, proposals, misses)

    def table(self) -> dict[str, dict[str, float]]:
        """Sensor -> K: ``static`` and ``tracked`` RMSE (both predictions), ``fitted`` (same window), ``noise``.

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

    def begin_again(self) -> None:
        """After a time in which nobody saw the rig: the next samples say anew where it stands, as the first ones did.

        Parameters and all that the calibrator has learned stay; the window under way is not calibrated.
        """
        self._origin, self._pace, self._window, self._cycles = None, 0.0, 0, 0
        self._seen[:] = 0.0
        self._buffer = _Buffer()
        if isinstance(self.calibrator, Restartable):
            self.calibrator.begin_again()

    def _advancing(self, t: Array) -> np.ndarray:
        """Positions of the samples whose stamp is finite and later than all before it."""
        stamps = np.where(np.isfinite(t), t, -np.inf)
        latest = np.maximum.accumulate(np.concatenate([[-np.inf if self._origin is None else self._time], stamps]))
        return np.flatnonzero(stamps > latest[:-1])

    def _some(self, t: Array, u: Array, y: Array, read: np.ndarray, out: Array, calibrations: list[Calibration]) -> int:
        """Work off some of the advancing samples, at least one; their number is returned."""
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
        """When a calibrator that proposes does so next in the window up to `end`; past it where no more.

        What is due at the sample of `now` is done: proposed from what came before it.
        """
        if not isinstance(self.calibrator, Proposer):
            return np.inf
        cycle, window_s = self.calibrator.cycle_s, self.network.rules.window_s
        due = end - window_s + (self._cycles + 1) * cycle
        if now >= due < end:
            self._cycles = int((now - end + window_s) / cycle)
            due = end - window_s + (self._cycles + 1) * cycle
            if self._buffer.state is not None:
                moved = self.calibrator.between(self._so_far())
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
        for j, k in self._reads:
            if np.isfinite(y[j]):
                self._seen[k] += 1.0
                self._static[k] += (y[j] - self._static[k]) / self._seen[k]
        self._tracked = self._static.copy()

    def _readings(self) -> Array:
        """Readings (2, m) of both twins as they stand."""
        here, drive = np.array([self._time]), self._inputs[None, :]
        both = ((self.network.values, self._static), (self._parameters, self._tracked))
        return np.stack([self._kernel.trace(p, state, here, drive)[0][0, 0] for p, state in both])

    def _complete(self, calibrations: list[Calibration]) -> None:
        """Calibrate the buffered window, if it holds anything, and go on from there."""
        self._cycles = 0
        if self._buffer.state is None:
            return
        window = self._so_far()
        unmoved = replace(window, live=np.concatenate(self._buffer.static))
        self._buffer = _Buffer()
        self._number += 1
        if window.kind == "skipped":
            self._misses.append((np.nan, np.nan))
            done = skipped_calibration(self.network, window, self.calibrator.ids, self._tracked.copy())
        else:
            sigma = self.network.sigma
            self._misses.append((normalised_misfit(unmoved, sigma), normalised_misfit(window, sigma)))
            done = self._placed(window, self.calibrator.calibrate(window))
            self._count(2, done.fitted - window.measured)
        self._parameters[self.network.index(self.calibrator.ids)] = list(done.values.values())
        self._tracked = done.end.copy()
        calibrations.append(done)

    def _placed(self, window: Window, done: Calibration) -> Calibration:
        """With where an unknown power sits, or which inputs nobody read: what those did is not the rig's."""
        read = window.read.mean(axis=0) >= USUALLY
        lost = [c for c, usual, now in zip(self.network.input_columns, self._usual, read, strict=True) if usual > now]
        self._usual = np.maximum(self._usual, read)
        if lost:
            return replace(done, flags=(*done.flags, f"not read: {', '.join(lost)}"))
        return self._localiser.locate(window).enter(done)

    def _so_far(self) -> Window:
        """The buffered part of the window under way."""
        buffer = self._buffer
        assert buffer.state is not None
        return make_window(
            self._number,
            np.concatenate(buffer.time),
            np.concatenate(buffer.inputs),
            np.concatenate(buffer.measured),
            buffer.state,
            self._parameters.copy(),
            np.concatenate(buffer.live),
            self.network.rules,
            np.concatenate(buffer.read),
        )

    def _count(self, row: int, residual: Array) -> None:
        # A running sum, never a pairwise one: the total must not depend on how the stream was cut.
        good = np.isfinite(residual)
        squares = np.where(good, residual, 0.0) ** 2
        self._sums[row] = np.cumsum(np.vstack([self._sums[row], squares]), axis=0)[-1]
        self._sums[row + 3] += good.sum(axis=0)

    def _repeat(self, out: Array, rows: np.ndarray, n: int, before: Array | None, y: Array) -> Array:
        """Predictions (2 or 4, n, m): a sample that does not advance repeats the one before it."""
        if before is None:
            first = self.network.initial_state(y[0])
            before = np.stack([first[[k for _, k in self._reads]]] * 2)
        before = np.vstack([before, before[1:], np.full_like(before[1:], np.nan)])[: len(out)]
        known = np.concatenate([before[:, None, :], out], axis=1)
        position = np.searchsorted(rows, np.arange(n), side="right")
        return known[:, position]

    def state(self) -> dict[str, Any]:
        """Everything needed to go on, as plain JSON-able data (None stands for NaN)."""
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
        """Go on from what `state` gave; network and calibrator must be the same as then.

        Raises:
            TwinFileError: the saved state belongs to another twin or calibrator.
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
