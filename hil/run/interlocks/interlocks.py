"""The interlocks of a run, at two levels, judged in the tick on this tick's values.

An alarm trips: it is latched until it is acknowledged, and cannot be acknowledged while its cause lasts. A warning is
active from its on-delay until its cause has been gone, by its deadband, for its off-delay. Beside those that the rig
file declares, every rig has: the `alarm` limits of its points, lost links and sensors, its own trip, its counter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.rig_file.interlock_specs import (
    HeaterPowerSpec,
    InterlockSpec,
    Level,
    LimitSpec,
    NoFlowSpec,
    RateOfRiseSpec,
    ResidualSpec,
)
from drivers.rig_file.model import Point, Rig
from drivers.signals.points import Snapshot
from hil.run.interlocks.conditions import (
    Condition,
    Disagreement,
    Frozen,
    Limit,
    NoFlow,
    Paused,
    RateOfRise,
    Residual,
    Residuals,
    Restarted,
    RigTrip,
    Tick,
    Untrusted,
    of_heartbeat,
)

_NOT_AT_START = (RigTrip, Frozen, Restarted, Disagreement, RateOfRise, Paused)
"""The first is asked by itself, the others need a history."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """What stands against the run on a tick: latched trips and active warnings, a sentence each."""

    trips: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


_NOTHING = Judgement()


class Interlock:
    """One condition with its delays: `active` while it counts, `present` while its cause is there.

    The on-delay of a point without a good value is no timer but a balance: time without one fills it, time with one
    drains it. A loose contact that is good for an instant now and then would reset a timer for ever.
    """

    def __init__(self, level: Level, condition: Condition, on_delay_s: float, off_delay_s: float = 0.0) -> None:
        self.level = level
        self.condition = condition
        self.active = False
        self.present = False
        self.reason = ""
        self._on_delay_s, self._off_delay_s = on_delay_s, off_delay_s
        self._since: float | None = None  # of what speaks against the present value of `active`
        self._drains = isinstance(condition, Untrusted)
        self._last_s = math.nan
        self._is_quiet = True

    def update(self, tick: Tick) -> bool:
        """Judge one tick; return True unless all is quiet: no cause, no delay under way, nothing active."""
        said = self.condition.judge(tick, self.active)
        if said is None and self._is_quiet:
            return False
        self._judged(said, tick.now_s)
        self._is_quiet = self._since is None and not self.active
        return True

    def _judged(self, said: str | None, now_s: float) -> None:
        self.present = said is not None
        passed, self._last_s = now_s - self._last_s, now_s
        if self._drains and not self.present and not self.active and self._since is not None:
            drained = self._since + 2.0 * passed
            self._since = drained if drained < now_s else None
            return
        if self.present == self.active:
            self._since = None
            return
        self._since = now_s if self._since is None else self._since
        waited = now_s - self._since
        if said is not None and waited >= self._on_delay_s:
            self.active, self.reason, self._since = True, said, None
        elif said is None and self.level == "warning" and waited >= self._off_delay_s:
            self.active, self._since = False, None

    def acknowledge(self) -> bool:
        """Let go of a trip whose cause is gone; whether it is gone."""
        if self.active and not self.present:
            self.active = False
        return not self.active


class Interlocks:
    """State of the interlocks of one run over the rig's polled `points`."""

    def __init__(self, rig: Rig, points: tuple[Point, ...]) -> None:
        self._names = tuple(point.name for point in points)
        self._standing = _NOTHING
        alarmed = [point for point in points if point.alarm is not None]
        heartbeat = of_heartbeat(rig, frozenset(self._names))
        self._watchdog = 0 if rig.heartbeat is None else rig.heartbeat.watchdog_mask
        self._restarts = [condition for condition in heartbeat if isinstance(condition, Restarted)]
        self._rig_trips = [condition for condition in heartbeat if isinstance(condition, RigTrip)]
        all_alarms: list[tuple[Condition, float]] = [
            *((Limit(point, *point.alarm), 0.0) for point in alarmed if point.alarm is not None),
            *((condition, 0.0) for condition in heartbeat),
            (Paused(rig.abort_after_s + rig.period_s), 0.0),
            *((Untrusted(point, rig.abort_after_s, point.alarm is not None), rig.abort_after_s) for point in points),
        ]
        self._all = [Interlock("alarm", condition, delay) for condition, delay in all_alarms]
        for spec in rig.interlock:
            self._all += _made(spec, rig)

    def add_alarm(self, condition: Condition) -> None:
        """Judge one more condition as an alarm, without delay."""
        self._all.append(Interlock("alarm", condition, 0.0))

    @property
    def restarts(self) -> int:
        """How often the rig's program was seen to begin anew."""
        return sum(condition.count for condition in self._restarts)

    def refusals(self, snapshot: Snapshot, *, rearm: bool = False) -> list[str]:
        """Alarms that stand against a start, one sentence each; nothing is latched by asking.

        A trip of the rig's own, but for its watchdog's, is one of them unless the operator says `rearm`: arming would
        wipe it out, and nobody would have looked.
        """
        tick = self._tick(snapshot, 0.0, {}, {})
        alarms = (item for item in self._all if item.level == "alarm")
        said = (item.condition.judge(tick, False) for item in alarms if not isinstance(item.condition, _NOT_AT_START))
        found = list(dict.fromkeys(sentence for sentence in said if sentence is not None))
        for trip in () if rearm else self._rig_trips:
            alone = RigTrip(trip.status, trip.mask & ~self._watchdog)
            if alone.judge(tick, False) is not None:
                found.append(
                    f"the rig tripped by itself before ({alone.status} is {tick.good(alone.status):g}) and nobody has "
                    "acknowledged it; look for the cause, then start with --rearm"
                )
        return found

    def judge(
        self,
        snapshot: Snapshot,
        now_s: float,
        commanded: Mapping[str, float] | None = None,
        residuals: Residuals | None = None,
    ) -> Judgement:
        """What stands against the run now. Call once a tick, with rig time and what was commanded before it."""
        tick = self._tick(snapshot, now_s, commanded or {}, residuals or {})
        changed = [item.update(tick) for item in self._all]  # every one is judged
        if any(changed) or self._standing is not _NOTHING:
            self._standing = self._active()
        return self._standing

    def standing(self) -> Judgement:
        """Return latched trips and active warnings."""
        return self._standing

    def _active(self) -> Judgement:
        active = [item for item in self._all if item.active]
        if not active:
            return _NOTHING
        return Judgement(
            tuple(item.reason for item in active if item.level == "alarm"),
            tuple(item.reason for item in active if item.level == "warning"),
        )

    def acknowledge(self) -> list[str]:
        """Let go of the trips of which the cause is gone; return the sentences of those that stay."""
        stay = [item.reason for item in self._all if item.level == "alarm" and not item.acknowledge()]
        self._standing = self._active()
        return stay

    def rig_trip(self, snapshot: Snapshot) -> str | None:
        """What the rig says of its own watchdog and thermostat, where it has tripped."""
        tick = self._tick(snapshot, 0.0, {}, {})
        return next((said for each in self._rig_trips if (said := each.judge(tick, False)) is not None), None)

    def _tick(self, snapshot: Snapshot, now_s: float, commanded: Mapping[str, float], residuals: Residuals) -> Tick:
        values = dict(zip(self._names, snapshot.values, strict=True))
        quality = dict(zip(self._names, snapshot.quality, strict=True))
        return Tick(now_s, values, quality, commanded, tuple(snapshot.faults), residuals)


def _made(spec: InterlockSpec, rig: Rig) -> list[Interlock]:
    """A declared interlock, and one of the same level for each sensor that it cannot do without."""
    condition, needs = _condition(spec, rig)
    on_delay_s = spec.on_delay_s
    if on_delay_s is None:
        on_delay_s = rig.get(spec.points["setpoint"]).readback_within_s
    sensors = (
        Interlock(spec.level, Untrusted(rig.get(name), rig.abort_after_s, True), rig.abort_after_s, spec.off_delay_s)
        for name in needs
        # An alarm on the same sensor speaks for it already.
        if spec.level == "alarm" or rig.get(name).alarm is None
    )
    own = [] if condition is None else [Interlock(spec.level, condition, on_delay_s, spec.off_delay_s)]
    return [*own, *sensors]


def _condition(spec: InterlockSpec, rig: Rig) -> tuple[Condition | None, tuple[str, ...]]:
    """The condition of `spec`, and the points that must be good for it to mean anything."""
    if isinstance(spec, LimitSpec):
        low = -math.inf if spec.low is None else spec.low
        high = math.inf if spec.high is None else spec.high
        return Limit(rig.get(spec.point), low, high, spec.deadband, spec.level), (spec.point,)
    if isinstance(spec, RateOfRiseSpec):
        return RateOfRise(spec, rig.get(spec.point).unit), (spec.point,)
    if isinstance(spec, NoFlowSpec):
        setpoint = rig.setpoint_of_column(spec.heater)
        return NoFlow(spec, None if setpoint is None else setpoint.name), (spec.flow,)
    if isinstance(spec, HeaterPowerSpec):
        setpoint = rig.get(spec.setpoint)
        assert setpoint.readback is not None
        return Disagreement(setpoint, setpoint.readback, spec.tolerance, spec.deadband), (setpoint.readback,)
    if isinstance(spec, ResidualSpec):
        return Residual(spec), ()
    return None, (spec.point,)
