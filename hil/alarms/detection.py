"""Conditions of alarms on blocks of ticks.

A detector returns for each tick whether its condition would come (`beyond`), whether one that is there stays (`still`:
the limit less the deadband), and the value that is compared. Results do not depend on how a run is cut into blocks.
The conditions are those of `hil.run.interlocks`, which a tick evaluates; a test compares both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.signals import Quality, Signal
from hil.alarms.definitions import AlarmDefinition

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
_LOST = (int(Quality.STALE), int(Quality.LINK_FAULT))


@dataclass(frozen=True, slots=True)
class Ticks:
    """Block of ticks: `time_s (n,)` of rig time, `values (n, k)`, `quality (n, k)` in the order of the signals."""

    time_s: Floats
    values: Floats
    quality: NDArray[np.uint8]

    def good(self, column: int) -> Floats:
        """Return the values of a column (n,), NaN where the quality is not GOOD."""
        return np.where(self.quality[:, column] == Quality.GOOD, self.values[:, column], np.nan)


@dataclass(frozen=True, slots=True)
class Detected:
    """Course of a condition over a block: `beyond (n,)`, `still (n,)`, `value (n,)`; see the module."""

    beyond: Flags
    still: Flags
    value: Floats


class Detector(Protocol):
    """Condition of one alarm, which keeps what it needs of the blocks before."""

    def block(self, ticks: Ticks) -> Detected:
        """Return the course of the condition over the next ticks."""


class _Bound:
    """Reading beyond a limit. An implausible one counts, too; one that is not known ends no alarm."""

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int]) -> None:
        self._column = columns[item.points[0]]
        self._sign = 1.0 if item.kind == "high" else -1.0
        assert item.limit is not None
        self._limit, self._deadband = item.limit, item.deadband

    def block(self, ticks: Ticks) -> Detected:
        quality, value = ticks.quality[:, self._column], ticks.values[:, self._column]
        known = (quality == Quality.GOOD) | (quality == Quality.OUT_OF_RANGE)
        excess = self._sign * (value - self._limit)
        inside = excess <= -self._deadband
        return Detected(known & ~(excess <= 0.0), ~(known & inside), value)


class _Rate:
    """Good reading that rises too fast over a window; see `hil.run.interlocks`."""

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int]) -> None:
        assert item.limit is not None
        self._column, self._window_s = columns[item.points[0]], item.window_s
        self._limit, self._deadband = item.limit, item.deadband
        self._past_s, self._past = np.zeros(0), np.zeros(0)

    def block(self, ticks: Ticks) -> Detected:
        value = ticks.good(self._column)
        is_good = np.isfinite(value)
        times = np.concatenate([self._past_s, ticks.time_s[is_good]])
        values = np.concatenate([self._past, value[is_good]])
        now = np.arange(len(self._past_s), len(times))
        first = np.searchsorted(times, times[now] - self._window_s)
        span = times[now] - times[first]
        long_enough = (span >= 0.5 * self._window_s) & (span > 0.0)
        rise = np.divide(values[now] - values[first], span, out=np.full(len(now), np.nan), where=long_enough)
        rate = np.full(len(value), np.nan)
        rate[is_good] = rise
        if len(times):
            keep = np.searchsorted(times, times[-1] - self._window_s)
            self._past_s, self._past = times[keep:], values[keep:]
        return Detected(rate > self._limit, rate > self._limit - self._deadband, rate)


class _NoFlow:
    """Heat, measured or asked for on the tick before, without flow."""

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int]) -> None:
        assert item.limit is not None
        self._flow, self._heater = columns[item.points[0]], columns[item.points[1]]
        self._asked = _Asked(columns[item.points[2]] if len(item.points) > 2 else None)
        self._limit, self._above, self._deadband = item.limit, item.above, item.deadband

    def block(self, ticks: Ticks) -> Detected:
        flow, measured, asked = ticks.good(self._flow), ticks.good(self._heater), self._asked.block(ticks)
        heat = np.where(np.isnan(measured), asked, np.fmax(asked, measured))
        # A flow that is not known is no condition by itself, and ends none.
        return Detected((flow < self._limit) & (heat > self._above), ~(flow >= self._limit + self._deadband), flow)


class _Asked:
    """Set-point as it was before a tick: the journal has it as the tick left it."""

    def __init__(self, column: int | None) -> None:
        self._column, self._last = column, 0.0

    def block(self, ticks: Ticks) -> Floats:
        if self._column is None or not len(ticks.time_s):
            return np.zeros(len(ticks.time_s))
        after = ticks.values[:, self._column]
        before = np.concatenate([[self._last], after[:-1]])
        self._last = float(after[-1])
        return before


class _Disagreement:
    """Reading that differs from its set-point by more than a tolerance."""

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int]) -> None:
        assert item.limit is not None
        self._asked, self._meter = _Asked(columns[item.points[0]]), columns[item.points[1]]
        self._limit, self._deadband = item.limit, item.deadband

    def block(self, ticks: Ticks) -> Detected:
        off = np.abs(self._asked.block(ticks) - ticks.good(self._meter))
        return Detected(off > self._limit, off > self._limit - self._deadband, off)


class _Deviation:
    """Reading outside the range that its set-point had within the time that its actuator may take to follow.

    A meter that follows with any lag below `window_s` stays within this range.
    """

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int], period_s: float) -> None:
        assert item.limit is not None
        self._set, self._meter, self._limit = columns[item.points[0]], columns[item.points[1]], item.limit
        self._count = max(1, math.ceil(item.window_s / period_s)) + 1
        self._past = np.zeros(0)

    def block(self, ticks: Ticks) -> Detected:
        asked = np.concatenate([self._past, ticks.values[:, self._set]])
        missing = self._count - 1 - len(self._past)
        known = np.concatenate([np.full(missing, asked[0] if len(asked) else 0.0), asked])
        self._past = asked[-(self._count - 1) :]
        if not len(ticks.time_s):
            return Detected(np.zeros(0, bool), np.zeros(0, bool), np.zeros(0))
        windows = sliding_window_view(known, self._count)
        low, high = windows.min(axis=1), windows.max(axis=1)
        meter = ticks.good(self._meter)
        off = np.fmax(meter - high, low - meter)
        beyond = off > self._limit
        return Detected(beyond, beyond, np.where(np.isnan(meter), np.nan, np.maximum(off, 0.0)))


class _Link:
    """All readings of a bus lost."""

    def __init__(self, columns: list[int]) -> None:
        self._columns = columns

    def block(self, ticks: Ticks) -> Detected:
        lost: Flags = np.asarray(np.isin(ticks.quality[:, self._columns], _LOST).all(axis=1))
        return Detected(lost, lost, np.full(len(lost), np.nan))


class _Sensor:
    """Reading that is not good while another one of its bus is; alone on a bus, one that is implausible or faulty."""

    def __init__(self, column: int, bus: list[int]) -> None:
        self._column, self._link = column, _Link(bus)

    def block(self, ticks: Ticks) -> Detected:
        bad = ticks.quality[:, self._column] != Quality.GOOD
        faulty = bad & ~self._link.block(ticks).beyond
        # The value is the quality: what the sensor read is no value.
        return Detected(faulty, faulty, ticks.quality[:, self._column].astype(np.float64))


class _RigTrip:
    """Bits of the rig's status that report a trip of its own."""

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int]) -> None:
        self._column, self._mask = columns[item.points[0]], item.mask

    def block(self, ticks: Ticks) -> Detected:
        status = ticks.good(self._column)
        bits = np.where(np.abs(status) < 2**53, status, 0.0).astype(np.int64) & self._mask
        return Detected(bits != 0, bits != 0, bits.astype(np.float64))


class _Counter:
    """Counter of the rig that does not change for longer than `window_s`."""

    def __init__(self, item: AlarmDefinition, columns: Mapping[str, int]) -> None:
        self._column, self._window_s = columns[item.points[0]], item.window_s
        self._last, self._since_s = math.nan, math.inf

    def block(self, ticks: Ticks) -> Detected:
        value = ticks.good(self._column)
        is_good = np.isfinite(value)
        found = np.zeros(len(value), bool)
        known, times = value[is_good], ticks.time_s[is_good]
        if len(known):
            changed = known != np.concatenate([[self._last], known[:-1]])
            since = np.maximum.accumulate(np.where(changed, times, -np.inf))
            since = np.where(np.isfinite(since), since, self._since_s)
            found[is_good] = ~changed & (times - since > self._window_s)
            self._last, self._since_s = float(known[-1]), float(since[-1])
        return Detected(found, found, value)


_BY_COLUMNS = {
    "high": _Bound, "low": _Bound, "rate_of_rise": _Rate, "no_flow": _NoFlow, "disagreement": _Disagreement,
    "rig_trip": _RigTrip, "rig_counter": _Counter,
}  # fmt: skip


def detector_of(item: AlarmDefinition, signals: tuple[Signal, ...], period_s: float) -> Detector | None:
    """Return the detector of an alarm on the ticks of a run, None for one that follows other rows of the journal.

    An alarm on a signal that the run does not record has none either.
    """
    columns: dict[str, int] = {signal.name: k for k, signal in enumerate(signals)}
    bus = [k for k, signal in enumerate(signals) if signal.bus == item.bus and signal.kind != "setpoint"]
    if any(name not in columns for name in item.points):
        return None
    if item.kind == "link":
        return _Link(bus) if bus else None
    if item.kind == "sensor":
        return _Sensor(columns[item.points[0]], bus)
    if item.kind == "deviation":
        return _Deviation(item, columns, period_s)
    made: Any = _BY_COLUMNS.get(item.kind)
    return None if made is None else made(item, columns)


class Delay:
    """On-delay and off-delay between a condition and its alarm, as `hil.run.interlocks` has them.

    With `drains` the on-delay is a leaky integrator: time without the condition drains it twice as fast.
    """

    def __init__(self, item: AlarmDefinition) -> None:
        self._on_s, self._off_s, self._drains = item.on_delay_s, item.off_delay_s, item.drains
        self.active = False
        self._since_s: float | None = None
        self._last_s = math.nan

    def block(self, time_s: Floats, found: Detected) -> list[tuple[int, bool]]:
        """Return the ticks of the block on which the alarm comes (True) or goes (False), in order."""
        if not len(time_s):
            return []
        if self._since_s is None and (bool(found.still.all()) if self.active else not found.beyond.any()):
            self._last_s = float(time_s[-1])
            return []
        changes = []
        rows = zip(time_s.tolist(), found.beyond.tolist(), found.still.tolist(), strict=True)
        for k, (now_s, beyond, still) in enumerate(rows):
            was = self.active
            self._tick(now_s, still if was else beyond)
            if self.active is not was:
                changes.append((k, self.active))
        return changes

    def _tick(self, now_s: float, present: bool) -> None:
        passed_s, self._last_s = now_s - self._last_s, now_s
        if self._drains and not present and not self.active and self._since_s is not None:
            drained_s = self._since_s + 2.0 * passed_s
            self._since_s = drained_s if drained_s < now_s else None
            return
        if present == self.active:
            self._since_s = None
            return
        self._since_s = now_s if self._since_s is None else self._since_s
        if now_s - self._since_s >= (self._on_s if present else self._off_s):
            self.active, self._since_s = present, None
