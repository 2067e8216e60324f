"""What an interlock watches: conditions that are judged on one tick's values, each with its own sentence.

A condition says why it is violated, or None. `engaged` tells it that it counts already, so that it asks for its
deadband before it lets go (ANSI/ISA-18.2). Delays and latches are those of `interlocks`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from drivers.rig_file import NoFlowSpec, Point, RateOfRiseSpec, ResidualSpec, Rig
from drivers.signals import Quality

_GOOD = int(Quality.GOOD)
_MEASURED = (_GOOD, int(Quality.OUT_OF_RANGE))
Residuals = Mapping[tuple[str, str], float]
"""(twin, sensor of the twin file) -> measured minus predicted, K, of the latest block of ticks."""


@dataclass(frozen=True, slots=True)
class Tick:
    """What is known on one tick: rig time in s, readings and their quality by point, what was commanded before it."""

    now_s: float
    values: Mapping[str, float]
    quality: Mapping[str, int]
    commanded: Mapping[str, float]
    faults: tuple[str, ...] = ()
    residuals: Residuals = field(default_factory=dict)

    def good(self, name: str) -> float:
        """Value of a point, NaN where it cannot be trusted."""
        return self.values[name] if self.quality[name] == _GOOD else math.nan


class Condition(Protocol):
    """One thing that is watched."""

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Why this is violated, or None."""


@dataclass(frozen=True, slots=True)
class Limit:
    """A reading beyond its limits. One that is implausible counts too: it may be the worst of them."""

    point: Point
    low: float
    high: float
    deadband: float = 0.0
    what: str = "alarm"

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated outside `low` to `high`; engaged, outside the same less the deadband."""
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
class Untrusted:
    """A point without a good value. Not `strict`: its sensor may be faulty, only its link may not be lost."""

    point: Point
    after_s: float
    strict: bool

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated while the quality is not GOOD."""
        quality = tick.quality[self.point.name]
        if quality == _GOOD or not (self.strict or quality in (Quality.STALE, Quality.LINK_FAULT)):
            return None
        why = Quality(quality).name.lower().replace("_", " ")
        cause = f" ({tick.faults[0]})" if tick.faults else ""
        return f"{self.point.name} has been without a good value for {self.after_s:g} s: {why}{cause}"


@dataclass(slots=True)
class Paused:
    """A gap between two ticks: the process or its machine stood still, and nobody watched the rig."""

    after_s: float
    _last_s: float = math.nan

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated on the first tick after a gap of more than `after_s`."""
        passed, self._last_s = tick.now_s - self._last_s, tick.now_s
        if not passed > self.after_s:
            return None
        return (
            f"no tick for {passed:.1f} s, at most {self.after_s:g} s is allowed: this process or its machine was paused"
        )


@dataclass(slots=True)
class RateOfRise:
    """A reading that rises too fast, over a window of good values."""

    spec: RateOfRiseSpec
    unit: str
    _past: deque[tuple[float, float]] = field(default_factory=deque)

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated above `high`; silent until half a window is known."""
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
    """Heat without flow. Engaged, it waits for the flow: a heater that was switched off is no proof of it."""

    spec: NoFlowSpec
    commanded: str | None
    """The set-point behind the heater's reading: what is asked for counts before it is measured."""

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated while there is heat, measured or asked for, and not flow enough."""
        spec, flow = self.spec, tick.good(self.spec.flow)
        if math.isnan(flow) and not engaged:
            return None
        asked = tick.commanded.get(self.commanded, 0.0) if self.commanded is not None else 0.0
        measured = tick.good(spec.heater)
        heat = asked if math.isnan(measured) else max(asked, measured)
        if flow >= spec.low + (spec.deadband if engaged else 0.0) or not (engaged or heat > spec.above):
            return None
        told = "not known" if math.isnan(flow) else f"{flow:.2f}, at least {spec.low:g} is needed"
        return f"heat without flow: {spec.heater} is {heat:.0f} W, {spec.flow} is {told}"


@dataclass(frozen=True, slots=True)
class Disagreement:
    """An actuator that does not do what it is asked."""

    setpoint: Point
    measured: str
    tolerance: float
    deadband: float

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated while command and reading are further apart than the tolerance."""
        asked, measured = tick.commanded.get(self.setpoint.name, math.nan), tick.good(self.measured)
        if not abs(asked - measured) > self.tolerance - (self.deadband if engaged else 0.0):
            return None
        unit = self.setpoint.unit
        return f"{self.setpoint.name} asks for {asked:.0f} {unit}, {self.measured} is {measured:.0f} {unit}"


@dataclass(frozen=True, slots=True)
class Residual:
    """A twin that is off."""

    spec: ResidualSpec

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated beyond `high`; silent while the twin has said nothing."""
        spec = self.spec
        off = tick.residuals.get((spec.twin, spec.sensor), math.nan)
        if not abs(off) > spec.high - (spec.deadband if engaged else 0.0):
            return None
        return f"{spec.sensor} is {off:+.2f} K off the twin {spec.twin}, at most {spec.high:g} K is expected"


@dataclass(frozen=True, slots=True)
class RigTrip:
    """What the rig says of its own watchdog and thermostat."""

    status: str
    mask: int

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated while one of the rig's trip bits is set."""
        value = tick.good(self.status)
        bits = 0 if math.isnan(value) else int(value) & self.mask
        if not bits:
            return None
        return (
            f"the rig tripped by itself ({self.status} has bits {bits:#06b} set); look for the cause, then arm it again"
        )


@dataclass(slots=True)
class Frozen:
    """A rig whose counter stands still: it answers, but its program does not run."""

    counter: str
    timeout_s: float
    _value: float = math.nan
    _since: float = -math.inf

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated when the counter has not advanced for longer than the time-out."""
        value = tick.good(self.counter)
        if math.isnan(value):
            return None
        if value != self._value:
            self._value, self._since = value, tick.now_s
        elif tick.now_s - self._since > self.timeout_s:
            return f"the rig has stopped: {self.counter} has not advanced for {self.timeout_s:g} s"
        return None


@dataclass(slots=True)
class Restarted:
    """A rig whose clock or counter has gone back: its program began anew, and knows nothing of what it was told.

    One that passes the end of its range begins at 0 too: it comes from the last hundredth and arrives in the first.
    """

    point: Point
    count: int = 0
    _value: float = math.nan

    def judge(self, tick: Tick, engaged: bool) -> str | None:
        """Violated on the tick on which it is seen."""
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


def of_heartbeat(rig: Rig, polled: frozenset[str]) -> list[Condition]:
    """What the rig's half of the heartbeat says, as far as its points are read."""
    found: list[Condition] = []
    heartbeat = rig.heartbeat
    if heartbeat is None:
        return found
    if heartbeat.status in polled and heartbeat.status is not None:
        found.append(RigTrip(heartbeat.status, heartbeat.trip_mask))
    if heartbeat.counter in polled and heartbeat.counter is not None:
        found.append(Frozen(heartbeat.counter, heartbeat.timeout_s))
    uptime = rig.bus[rig.get(heartbeat.point).bus].uptime
    clock = next((name for name in (uptime, heartbeat.counter) if name in polled), None)
    if clock is not None:
        found.append(Restarted(rig.get(clock)))
    return found
