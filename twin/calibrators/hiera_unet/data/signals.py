"""Formulas of the channels, over a segment of a record and the commissioned twin's run beside it.

Every value is causal: means and slopes are of the past.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from twin.calibrators.hiera_unet.data.figures import Figures
from twin.calibrators.hiera_unet.data.regimes import since_last
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries
from twin.elements.flow import Flow
from twin.first_order_lag import lagged, recursion
from twin.network import Array, Network

RATE_S = 60.0
BALANCE_S = 120.0
MINUTE_S = 60.0
SPREAD_K = 0.1
FLOW_SHARE = 0.01
STUCK_STEPS = 36
"""Steps without a change from which a reading counts as stuck and is left out."""
NOISES = 2.0
"""Standard deviations of a single thermometer up to which residuals are linear; they are logarithmic beyond."""


@dataclass
class SignalSegment:
    """Input of the formulas: n steps of `series`, of which some may be missing.

    Attributes:
        inputs: (n, c) held, without NaN. free: (n, Y) degC, free run of the commissioned twin from the beginning.
        heats: (n, k) W into each node by the twin's formulas at the measured temperatures; NaN where one is missing.
        values: full vector (p,) of the commissioned twin.
        fitted: (n, Y) degC, run of the fitted twin over its fit's segment and beyond; NaN before.
    """

    network: Network
    figures: Figures
    series: ResampledSeries
    inputs: Array
    free: Array
    heats: Array
    values: Array
    fitted: Array | None = None
    since: dict[str, Array] = field(default_factory=dict)

    def input(self, column: str) -> Array:
        return self.series.inputs[:, self.network.input_columns.index(column)]

    def held(self, column: str) -> Array:
        return self.inputs[:, self.network.input_columns.index(column)]

    def reading(self, sensor: str) -> Array:
        return self.series.measured[:, self.network.sensor_names.index(sensor)]

    @property
    def room(self) -> Array:
        """Return the room temperature (n,), degC; the nominal one if the twin has no such input."""
        return self.held(self.figures.room) if self.figures.room else np.full(len(self.series), self.figures.room_C)


def signed_log(x: Array) -> Array:
    """Return asinh(x): linear near 0, logarithmic far from it."""
    return np.arcsinh(x)


def quick(values: Array, constant_s: float) -> Array:
    """Return values (n,) less their causal running mean over `constant_s`."""
    return values - lagged(values, float(np.exp(-STEP_S / constant_s)))


def slope(values: Array, span_s: float) -> Array:
    """Return the change per s (n,) over the `span_s` before each step; NaN before there is one."""
    back = int(span_s / STEP_S)
    half = max(back // 4, 1)
    mean = past_mean(values, half)
    out = np.full(len(values), np.nan)
    out[back:] = (mean[back:] - mean[:-back]) / (back * STEP_S)
    return out


def past_mean(values: Array, steps: int) -> Array:
    """Return the mean (n,) of the finite values among a step and those before it; NaN if there is none."""
    good = np.isfinite(values)
    total = np.concatenate([[0.0], np.cumsum(np.where(good, values, 0.0))])
    count = np.concatenate([[0], np.cumsum(good)])
    last = np.arange(1, len(values) + 1)
    first = np.maximum(last - steps, 0)
    number = count[last] - count[first]
    mean: Array = np.where(number > 0, (total[last] - total[first]) / np.maximum(number, 1), np.nan)
    return mean


def flat_steps(values: Array) -> Array:
    """Return the steps (n, Y) for which each reading (n, Y) has been constant, gaps left out; 0 where it is missing."""
    out = np.zeros(values.shape)
    for j, column in enumerate(values.T):
        there = np.flatnonzero(np.isfinite(column))
        if there.size:
            seen = column[there]
            moved = np.concatenate([[True], seen[1:] != seen[:-1]])
            begun = there[np.maximum.accumulate(np.where(moved, np.arange(there.size), 0))]
            out[there, j] = there - begun
    return out


def stuck(values: Array) -> np.ndarray:
    """Return the readings (n, Y) bool that belong to a constant segment of at least `STUCK_STEPS`, all of it."""
    flat = flat_steps(values)
    out = flat >= STUCK_STEPS
    for j, column in enumerate(out.T):
        for end in np.flatnonzero(column)[::-1]:
            out[end - int(flat[end, j]) : end, j] = True
    return out


def _level(s: SignalSegment, column: str) -> Array:
    spec = s.network.inputs[column]
    if column.endswith("_C"):
        return (s.input(column) - s.figures.room_C) / s.figures.rise_K
    return s.input(column) / max(abs(spec.nominal), 1e-9)


def _scale(s: SignalSegment, column: str) -> float:
    return s.figures.rise_K if column.endswith("_C") else max(abs(s.network.inputs[column].nominal), 1e-9)


def _quick(s: SignalSegment, column: str, constant_s: str) -> Array:
    return 5.0 * quick(s.held(column), float(constant_s)) / _scale(s, column)


def _measured(s: SignalSegment, name: str) -> Array:
    flow = s.series.extra.get(name)
    return np.full(len(s.series), np.nan) if flow is None else flow / s.figures.flow_L_per_min


def _flow_gap(s: SignalSegment, name: str, flow: str) -> Array:
    column = s.series.extra.get(name)
    if column is None:
        return np.full(len(s.series), np.nan)
    element = next(e for e in s.network.elements if isinstance(e, Flow) and e.name == flow)
    share = np.maximum(s.held(element.pump), 0.0) * 0.01
    return signed_log((column / s.figures.flow_L_per_min - share) / FLOW_SHARE) * 0.5


def _reading(s: SignalSegment, sensor: str) -> Array:
    return (s.reading(sensor) - s.room) / s.figures.rise_K


def _base(s: SignalSegment, sensor: str) -> Array:
    return (s.free[:, s.network.sensor_names.index(sensor)] - s.room) / s.figures.rise_K


def _rate(s: SignalSegment, sensor: str) -> Array:
    return 0.5 * signed_log(slope(s.reading(sensor), RATE_S) * MINUTE_S / (NOISES * s.figures.noise_K))


def _drop(s: SignalSegment, before: str, after: str) -> Array:
    return (s.reading(after) - s.reading(before)) / s.figures.drop_K


def _residual(s: SignalSegment, sensor: str) -> Array:
    free = s.free[:, s.network.sensor_names.index(sensor)]
    return 0.5 * signed_log((s.reading(sensor) - free) / (NOISES * s.figures.noise_K))


def _fitted(s: SignalSegment, sensor: str) -> Array:
    """Return the residual of a fit: the part of the error that the twin's parameters cannot explain."""
    if s.fitted is None:
        return np.full(len(s.series), np.nan)
    run = s.fitted[:, s.network.sensor_names.index(sensor)]
    return signed_log((s.reading(sensor) - run) / (NOISES * s.figures.noise_K))


def _balance(s: SignalSegment, node: str) -> Array:
    """Return the power that the twin's formulas lack at the measured temperatures, over the last minutes."""
    names = list(s.network.nodes)
    missing = [_missing_power(s, k) for k in (range(len(names)) if node == "all" else (names.index(node),))]
    return 0.5 * signed_log(np.sum(missing, axis=0) / (0.02 * s.figures.power_W))


def _missing_power(s: SignalSegment, k: int) -> Array:
    sensor = s.figures.sensor_of[k]
    if sensor < 0:
        return np.full(len(s.series), np.nan)
    rate = slope(s.series.measured[:, sensor], BALANCE_S)
    # The slope compares means that end at the step and a span before: it is that of the span's middle.
    back = int(BALANCE_S / STEP_S)
    mean = past_mean(s.heats[:, k], back + max(back // 4, 1))
    return s.figures.capacity_J_per_K[k] * rate - mean


def _stale(s: SignalSegment, name: str) -> Array:
    values = s.input(name) if name in s.network.inputs else s.reading(name)
    return _log_steps(since_last(np.isfinite(values)))


def _flat(s: SignalSegment, sensor: str) -> Array:
    """Return the time for which a reading has been constant."""
    values = s.reading(sensor)
    return np.where(np.isfinite(values), _log_steps(flat_steps(values[:, None])[:, 0]), np.nan)


def _spread(s: SignalSegment, sensor: str) -> Array:
    return signed_log(s.series.spread[:, s.network.sensor_names.index(sensor)] / SPREAD_K)


def _step(s: SignalSegment, column: str) -> Array:
    """Return the last step of a command, decaying over some minutes."""
    change = np.diff(s.held(column), prepend=s.held(column)[0]) / _scale(s, column)
    big = np.where(np.abs(change) > 0.01, change, 0.0)
    keep = float(np.exp(-STEP_S / 180.0))
    return signed_log(10.0 * recursion(big, keep))


def _since(s: SignalSegment, column: str) -> Array:
    if column not in s.since:
        change = np.abs(np.diff(s.held(column), prepend=s.held(column)[0])) / _scale(s, column)
        s.since[column] = _log_steps(since_last(np.asarray(change > 0.01)))
    return s.since[column]


def _age(s: SignalSegment) -> Array:
    """Return the time since the record began, within the segment."""
    begun = np.asarray(np.isfinite(np.hstack([s.series.inputs, s.series.measured])).any(axis=1))
    first = int(np.argmax(begun)) if begun.any() else len(begun)
    return _log_steps(np.maximum(np.arange(len(begun), dtype=np.float64) - first, 0.0))


def _log_steps(steps: Array) -> Array:
    """Return the log-scaled steps (n,) since an event: 0 at it, 1 after two hours or without one."""
    capped = np.minimum(np.where(np.isfinite(steps), steps, np.inf), 1440.0)
    return np.log1p(capped) / np.log1p(1440.0)


FORMULAS: dict[str, Callable[..., Array]] = {
    "level": _level,
    "quick": _quick,
    "measured": _measured,
    "flow_gap": _flow_gap,
    "reading": _reading,
    "base": _base,
    "rate": _rate,
    "drop": _drop,
    "residual": _residual,
    "fitted": _fitted,
    "balance": _balance,
    "stale": _stale,
    "flat": _flat,
    "spread": _spread,
    "step": _step,
    "since": _since,
    "age": _age,
}
"""Formula -> function of segment and arguments to values (n,), NaN where missing."""
