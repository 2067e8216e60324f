"""Features: from a record to the network's input, one window of two hours that ends at any step.

The commissioned twin runs free from the window's beginning. The state at the first target step is that run's, corrected
by the residuals of the last minutes before it; the target itself is not used. After a long gap of a thermometer its
last residual counts, and without any reading that of the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.calibrators.hiera_unet.data.channels import ChannelTable
from twin.calibrators.hiera_unet.data.figures import Figures
from twin.calibrators.hiera_unet.data.parameters import Deviations, kernel_of
from twin.calibrators.hiera_unet.data.regimes import regimes
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries, filled_forward
from twin.calibrators.hiera_unet.data.signals import FORMULAS, SignalSegment, stuck
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET
from twin.discovery.effects.formulas import Formulas
from twin.network import Array, Network

CLOCK = 6
SETTLE_STEPS = 24
"""Steps whose residuals estimate the state at their end."""
FIRST_STEPS = 6
LARGEST = 8.0
"""Largest absolute value of a channel."""


@dataclass(frozen=True)
class Frame:
    """Window before it joins a batch: shapes as in `Windows`, without its first axis.

    Channels with the residual of a fit are missing until `Features.explained` adds them.

    Attributes:
        held: (1440, c) inputs without NaN. time: (1440,) s. measured: (1440, Y) degC. free: (1440, Y) degC.
        start: full state at the first step. begin: first step with any data. segment: input of the channels' formulas.
    """

    x: Array
    m: np.ndarray
    regime: np.ndarray
    clock: Array
    figures: Array
    target: Array
    base: Array
    state: Array
    held: Array
    time: Array
    measured: Array
    free: Array
    start: Array
    begin: int
    segment: SignalSegment


class Features:
    """Maker of windows for all rigs of one twin's structure."""

    def __init__(self, network: Network, table: ChannelTable, deviations: Deviations) -> None:
        self.network, self.table, self.deviations = network, table, deviations
        self.kernel = kernel_of(network, deviations.ids)
        self._formulas = Formulas(network)
        self._node_of = [network.nodes.index(s.node) for s in network.sensors]
        self._last: tuple[ResampledSeries, int, Array, Frame] | None = None

    def frame(self, series: ResampledSeries, end: int, values: Array) -> Frame:
        """Return the window whose last step is `end` - 1.

        Args:
            values: full vector (p,) of the commissioned twin.
        """
        last = self._last
        if last is not None and last[0] is series and last[1] == end and np.array_equal(last[2], values):
            return last[3]
        made = self._made(series, end, values)
        self._last = series, end, values, made
        return made

    def _made(self, series: ResampledSeries, end: int, values: Array) -> Frame:
        network, part = self.network, series.part(end - CONTEXT, end)
        held = filled_forward(part.inputs, network.nominal_inputs, part.earlier)
        begun = np.isfinite(part.measured).any(axis=1) | np.isfinite(part.inputs).any(axis=1)
        begin = min(int(np.argmax(begun)) if begun.any() else 0, CONTEXT - TARGET - 1)
        start = self._first_state(part.measured[begin:])
        free, state = self._free_run(part.time, held, part.measured, start, begin, values)
        base = self.kernel.trace(values, state, part.time[-TARGET:], held[-TARGET:])[0][0]
        figures = Figures.of(network, values)
        segment = SignalSegment(network, figures, part, held, free, self._heats(part, held, values, figures), values)
        x, m = self._channels(segment, begin)
        tokens = np.array([figures.token(network, what) for what in self.table.figures])
        return Frame(
            x,
            m,
            regimes(network, part.inputs),
            clock(part),
            tokens,
            part.measured[-TARGET:],
            base,
            state,
            held,
            part.time,
            part.measured,
            free,
            start,
            begin,
            segment,
        )

    def explained(self, frame: Frame, values: Array, theta: Array, steps: int) -> Frame:
        """Return the window with the channels of a fit.

        Args:
            theta: (P,) fitted deviations. steps: fitted steps before the target.
        """
        first = max(CONTEXT - TARGET - steps, frame.begin)
        full = self.deviations.full(theta, values)
        state = self.state_at(frame, first, values)
        run = np.full(frame.free.shape, np.nan)
        run[first:] = self.kernel.trace(full, state, frame.time[first:], frame.held[first:])[0][0]
        segment = replace(frame.segment, fitted=run)
        x, m = frame.x.copy(), frame.m.copy()
        for k, channel in enumerate(self.table.channels):
            if channel.formula == "fitted":
                x[:, k], m[:, k] = _masked(FORMULAS[channel.formula](segment, *channel.of), frame.begin)
        return replace(frame, x=x, m=m, segment=segment)

    def state_at(self, frame: Frame, step: int, values: Array) -> Array:
        """Return the full state at a step of the window, estimated from the readings up to it and some minutes
        after.
        """
        if step <= frame.begin:
            return frame.start
        rows = slice(frame.begin, step + 1)
        _, state = self.kernel.trace(values, frame.start, frame.time[rows], frame.held[rows])
        found = state[0].copy()
        around = slice(max(step - SETTLE_STEPS // 2, frame.begin), step + SETTLE_STEPS // 2)
        residual = frame.measured[around] - frame.free[around]
        good = np.isfinite(residual)
        means = np.where(good, residual, 0.0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
        for j, k in enumerate(self._node_of):
            found[k] += means[j]
        return found

    def _channels(self, segment: SignalSegment, begin: int) -> tuple[Array, np.ndarray]:
        x = np.stack([FORMULAS[c.formula](segment, *c.of) for c in self.table.channels], axis=1)
        return _masked(x, begin)

    def _first_state(self, measured: Array) -> Array:
        """Return the steady state of the first readings."""
        rows = measured[: FIRST_STEPS + 1]
        if not np.isfinite(rows).any():
            later = np.flatnonzero(np.isfinite(measured).any(axis=1))
            rows = measured[later[:FIRST_STEPS]] if later.size else measured[:1]
        return self.network.initial_state(rows)

    def _free_run(
        self, time: Array, held: Array, measured: Array, start: Array, begin: int, values: Array
    ) -> tuple[Array, Array]:
        """Return the readings (1440, Y) from `begin` on, NaN before, and the corrected full state at the first target
        step.
        """
        first = CONTEXT - TARGET
        free = np.full((CONTEXT, len(self.network.sensors)), np.nan)
        early, state = self.kernel.trace(values, start, time[begin : first + 1], held[begin : first + 1])
        late, _ = self.kernel.trace(values, state[0], time[first:], held[first:])
        free[begin : first + 1], free[first:] = early[0], late[0]
        corrected = state[0].copy()
        seen = np.where(stuck(measured[:first]), np.nan, measured[:first])
        corrected[: len(self.network.nodes)] += self._offsets(seen - free[:first])
        return free, corrected

    def _offsets(self, residual: Array) -> Array:
        """Return the error of each node (k,) at the step after the residuals (n, Y): lines through their last
        minutes.
        """
        found = np.full(len(self.network.nodes), np.nan)
        for j, k in enumerate(self._node_of):
            if np.isnan(found[k]):
                found[k] = _ahead(residual[:, j])
        known = found[np.isfinite(found)]
        return np.where(np.isfinite(found), found, known.mean() if known.size else 0.0)

    def _heats(self, part: ResampledSeries, held: Array, values: Array, figures: Figures) -> Array:
        sensor_of = np.array(figures.sensor_of)
        temperatures = np.where(sensor_of >= 0, part.measured[:, np.maximum(sensor_of, 0)], np.nan)
        with np.errstate(invalid="ignore"):
            return self._formulas.heats(temperatures, held, values, STEP_S)


def _masked(x: Array, begin: int) -> tuple[Array, np.ndarray]:
    """Return channels (n,) or (n, C) without NaN and within `LARGEST`, and their mask; nothing before `begin`."""
    m = np.isfinite(x)
    m[:begin] = False
    return np.clip(np.where(m, x, 0.0), -LARGEST, LARGEST), m


def _ahead(residual: Array) -> float:
    """Return the residual (n,) at step n: a line through the last `SETTLE_STEPS`, or the last value before a gap."""
    recent = residual[-SETTLE_STEPS:]
    steps = np.arange(len(recent), dtype=np.float64) - len(recent)
    good = np.isfinite(recent)
    if good.sum() >= SETTLE_STEPS // 2:
        level, slope = np.polynomial.polynomial.polyfit(steps[good], recent[good], 1)
        del slope
        return float(level)
    last = np.flatnonzero(np.isfinite(residual))[-FIRST_STEPS:]
    return float(residual[last].mean()) if last.size else float("nan")


def clock(part: ResampledSeries) -> Array:
    """Return two harmonics of the day and one of the year (n, 6); zeros if the record has no clock."""
    out = np.zeros((len(part), CLOCK))
    if np.isfinite(part.hour):
        turn = 2.0 * np.pi * (part.hour + part.time / 3600.0) / 24.0
        out[:, :4] = np.stack([np.cos(turn), np.sin(turn), np.cos(2.0 * turn), np.sin(2.0 * turn)], axis=1)
    if np.isfinite(part.day):
        turn = 2.0 * np.pi * (part.day + part.time / 86400.0) / 365.25
        out[:, 4:] = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return out
