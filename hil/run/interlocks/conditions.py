"""Conditions of interlocks: each is evaluated on the values of one tick and states its violation in a sentence.

`judge` returns the sentence, or None. With `engaged` the condition is active already and applies its deadband before it
clears (ANSI/ISA-18.2). Delays and latches are those of `interlocks`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from drivers.rig_file import NoFlowSpec, Point, RateOfRiseSpec, ResidualSpec, Rig
from drivers.signals import Quality
from hil.journal import NO_TICK

_GOOD = int(Quality.GOOD)
_MEASURED = (_GOOD, int(Quality.OUT_OF_RANGE))
Residuals = Mapping[tuple[str, str], float]
"""(twin, sensor of the twin file) -> measured minus predicted, K, of the latest block of ticks."""


@dataclass(frozen=True, slots=True)
class TickValues:
    """Values of one tick: rig time in s, readings and their quality by point, commands before the tick.

    Readings and commands are in the units of their points.
    """

    now_s: float
    values: Mapping[str, float]
    quality: Mapping[str, int]
    commanded: Mapping[str, float]
    faults: tuple[str, ...] = ()
    residuals: Residuals = field(default_factory=dict)

    def good(self, name: str) -> float:
        """Return the value of a point in its unit, NaN where its quality is not GOOD."""
        return self.values[name] if self.quality[name] == _GOOD else math.nan


class Condition(Protocol):
    """Condition that an interlock evaluates on every tick."""

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation as a sentence, or None."""


@dataclass(frozen=True, slots=True)
class LimitViolation:
    """Reading beyond its limits. An implausible one counts, too: it may be the worst violation."""

    point: Point
    low: float
    high: float
    deadband: float = 0.0
    what: str = "alarm"

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation outside `low` to `high`; engaged, outside these limits less the deadband."""
        if tick.quality[self.point.name] not in _MEASURED:
            return f"{self.point.name} was beyond its {self.what} limits and is not known now" if engaged else None
        value, inside = tick.values[self.point.name], self.deadband if engaged else 0.0
        if self.low + inside <= value <= self.high - inside:
            return None
        limits = (
            f"above {self.low:g}"
            if self.high == math.inf
            else f"below {self.high:g}"
            if self.low == -math.inf
            else f"{self.low:g} to {self.high:g}"
        )
        return f"{self.point.name} is {value:.2f} {self.point.unit}, its {self.what} limits are {limits}"


@dataclass(frozen=True, slots=True)
class NoGoodValue:
    """Point without a good value. Without `strict` a faulty sensor is allowed and a lost link is not."""

    point: Point
    after_s: float
    strict: bool

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation while the quality is not GOOD."""
        quality = tick.quality[self.point.name]
        if quality == _GOOD or not (self.strict or quality in (Quality.STALE, Quality.LINK_FAULT)):
            return None
        why = Quality(quality).name.lower().replace("_", " ")
        cause = f" ({tick.faults[0]})" if tick.faults else ""
        return f"{self.point.name} has been without a good value for {self.after_s:g} s: {why}{cause}"


@dataclass(slots=True)
class TickGap:
    """Gap between two ticks: the process or its machine was paused, and the rig was not supervised."""

    after_s: float
    _last_s: float = math.nan

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation on the first tick after a gap of more than `after_s`."""
        passed, self._last_s = tick.now_s - self._last_s, tick.now_s
        if not passed > self.after_s:
            return None
        return (
            f"{NO_TICK} {passed:.1f} s, at most {self.after_s:g} s is allowed: this process or its machine was paused"
        )


@dataclass(slots=True)
class RateOfRise:
    """Reading that rises too fast, over a window of good values."""

    spec: RateOfRiseSpec
    unit: str
    _past: deque[tuple[float, float]] = field(default_factory=deque)

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation above `high`; None until half a window is known."""
        value, spec = tick.good(self.spec.point), self.spec
        if math.isnan(value):
            return None
        past = self._past
        past.append((tick.now_s, value))
        while past[0][0] < tick.now_s - spec.window_s:
            past.popleft()
        span = tick.now_s - past[0][0]
        if span < 0.5 * spec.window_s:
            return None
        rate = (value - past[0][1]) / span
        if rate <= spec.high - (spec.deadband if engaged else 0.0):
            return None
        return f"{spec.point} rises by {rate:.3g} {self.unit}/s, at most {spec.high:g} is allowed"


@dataclass(frozen=True, slots=True)
class NoFlow:
    """Heat without flow. Engaged, it clears with the flow alone: a heater at zero does not prove a flow."""

    spec: NoFlowSpec
    commanded: str | None
    """Set-point behind the heater's reading: a command counts before it is measured."""

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation while there is heat, measured or commanded, and too little flow."""
        spec, flow = self.spec, tick.good(self.spec.flow)
        if math.isnan(flow) and not engaged:
            return None
        asked = tick.commanded.get(self.commanded, 0.0) if self.commanded is not None else 0.0
        measured = tick.good(spec.heater)
        heat = asked if math.isnan(measured) else max(asked, measured)
        if flow >= spec.low + (spec.deadband if engaged else 0.0) or not (engaged or heat > spec.above):
            return None
        state = "not known" if math.isnan(flow) else f"{flow:.2f}, at least {spec.low:g} is needed"
        return f"heat without flow: {spec.heater} is {heat:.0f} W, {spec.flow} is {state}"


@dataclass(frozen=True, slots=True)
class ActuatorDisagreement:
    """Actuator whose reading disagrees with its command."""

    setpoint: Point
    measured: str
    tolerance: float
    deadband: float

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation while command and reading differ by more than the tolerance."""
        commanded, measured = tick.commanded.get(self.setpoint.name, math.nan), tick.good(self.measured)
        if not abs(commanded - measured) > self.tolerance - (self.deadband if engaged else 0.0):
            return None
        unit = self.setpoint.unit
        return f"{self.setpoint.name} asks for {commanded:.0f} {unit}, {self.measured} is {measured:.0f} {unit}"


@dataclass(frozen=True, slots=True)
class TwinResidual:
    """Residual between a reading and its prediction by a twin."""

    spec: ResidualSpec

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation beyond `high`, K; None while there is no prediction."""
        spec = self.spec
        residual_K = tick.residuals.get((spec.twin, spec.sensor), math.nan)
        if not abs(residual_K) > spec.high - (spec.deadband if engaged else 0.0):
            return None
        return f"{spec.sensor} is {residual_K:+.2f} K off the twin {spec.twin}, at most {spec.high:g} K is expected"


@dataclass(frozen=True, slots=True)
class RigTrip:
    """Trip of the rig's own watchdog or thermostat, from its status bits."""

    status: str
    mask: int

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation while one of the rig's trip bits is set."""
        value = tick.good(self.status)
        bits = 0 if math.isnan(value) else int(value) & self.mask
        if not bits:
            return None
        return (
            f"the rig tripped by itself ({self.status} has bits {bits:#06b} set); look for the cause, then arm it again"
        )


@dataclass(slots=True)
class FrozenCounter:
    """Counter of the rig that does not advance: the rig answers, but its program does not run."""

    counter: str
    timeout_s: float
    _value: float = math.nan
    _since: float = -math.inf

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation when the counter has not advanced for longer than the time-out."""
        value = tick.good(self.counter)
        if math.isnan(value):
            return None
        if value != self._value:
            self._value, self._since = value, tick.now_s
        elif tick.now_s - self._since > self.timeout_s:
            return f"the rig has stopped: {self.counter} has not advanced for {self.timeout_s:g} s"
        return None


@dataclass(slots=True)
class RigRestart:
    """Restart of the rig: its clock or counter went back, and its program has lost all commands.

    A counter that passes the end of its range begins at 0, too. It is recognised by a step from the last hundredth of
    the range into the first.
    """

    point: Point
    count: int = 0
    _value: float = math.nan

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation on the tick on which the clock or counter went back."""
        before, value = self._value, tick.good(self.point.name)
        if math.isnan(value):
            return None
        self._value = value
        if not value < before:
            return None
        end = math.inf if self.point.type.startswith("float") else 2.0 ** (16 * self.point.width) * self.point.scale
        if before > 0.99 * end and value < 0.01 * end:
            return None
        self.count += 1
        return f"the rig has restarted: {self.point.name} went back from {before:g} to {value:g}"


def heartbeat_conditions(rig: Rig, polled: frozenset[str]) -> list[Condition]:
    """Return the conditions on the rig's half of the heartbeat, for those of its points that are polled."""
    found: list[Condition] = []
    heartbeat = rig.heartbeat
    if heartbeat is None:
        return found
    if heartbeat.status in polled and heartbeat.status is not None:
        found.append(RigTrip(heartbeat.status, heartbeat.trip_mask))
    if heartbeat.counter in polled and heartbeat.counter is not None:
        found.append(FrozenCounter(heartbeat.counter, heartbeat.timeout_s))
    uptime = rig.bus[rig.get(heartbeat.point).bus].uptime
    clock = next((name for name in (uptime, heartbeat.counter) if name in polled), None)
    if clock is not None:
        found.append(RigRestart(rig.get(clock)))
    return found
