"""Interlocks of a run at two levels, evaluated in the tick on its values.

An alarm trips: it is latched until it is acknowledged, and cannot be acknowledged while its cause lasts. A warning is
active from its on-delay until its cause has been gone, by its deadband, for its off-delay. Besides the interlocks that
the rig file declares, every rig has the `alarm` limits of its points, lost links and sensors, its own trip, its
counter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.rig_file import (
    HeaterPowerSpec,
    InterlockSpec,
    Level,
    LimitSpec,
    NoFlowSpec,
    Point,
    RateOfRiseSpec,
    ResidualSpec,
    Rig,
)
from drivers.signals import Snapshot
from hil.run.interlocks.conditions import (
    ActuatorDisagreement,
    Condition,
    FrozenCounter,
    LimitViolation,
    NoFlow,
    NoGoodValue,
    RateOfRise,
    Residuals,
    RigRestart,
    RigTrip,
    TickGap,
    TickValues,
    TwinResidual,
    heartbeat_conditions,
)

_NOT_AT_START = (RigTrip, FrozenCounter, RigRestart, ActuatorDisagreement, RateOfRise, TickGap)
"""Conditions that are not checked before a start: the first has a check of its own, the others need a history."""


@dataclass(frozen=True, slots=True)
class InterlockStatus:
    """Latched trips and active warnings of a tick, a sentence each."""

    trips: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


_NOTHING = InterlockStatus()


class Interlock:
    """Condition with its level and delays: `active` while it counts, `present` while its cause is there.

    The on-delay of what `drains`, as a point without a good value does, is a leaky integrator: time without one fills
    it, time with one drains it. A loose contact with a good value now and then would reset a plain timer for ever.
    """

    def __init__(
        self, level: Level, condition: Condition, on_delay_s: float, off_delay_s: float = 0.0, *, drains: bool = False
    ) -> None:
        self.level = level
        self.condition = condition
        self.active = False
        self.present = False
        self.reason = ""
        self._on_delay_s, self._off_delay_s = on_delay_s, off_delay_s
        self._since: float | None = None  # begin of what contradicts the present value of `active`, s
        self._drains = drains or isinstance(condition, NoGoodValue)
        self._last_s = math.nan
        self._is_quiet = True

    def update(self, tick: TickValues) -> bool:
        """Evaluate one tick; return False where it is quiet: no cause, no delay under way, not active."""
        violation = self.condition.judge(tick, self.active)
        if violation is None and self._is_quiet:
            return False
        self._advance(violation, tick.now_s)
        self._is_quiet = self._since is None and not self.active
        return True

    def _advance(self, violation: str | None, now_s: float) -> None:
        self.present = violation is not None
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
        if violation is not None and waited >= self._on_delay_s:
            self.active, self.reason, self._since = True, violation, None
        elif violation is None and self.level == "warning" and waited >= self._off_delay_s:
            self.active, self._since = False, None

    def acknowledge(self) -> bool:
        """Release a trip whose cause is gone; return True if it is not active any more."""
        if self.active and not self.present:
            self.active = False
        return not self.active


class Interlocks:
    """All interlocks of one run over the rig's polled `points`."""

    def __init__(self, rig: Rig, points: tuple[Point, ...]) -> None:
        self._names = tuple(point.name for point in points)
        self._standing = _NOTHING
        alarmed = [point for point in points if point.alarm is not None]
        heartbeat = heartbeat_conditions(rig, frozenset(self._names))
        self._watchdog = 0 if rig.heartbeat is None else rig.heartbeat.watchdog_mask
        self._restarts = [condition for condition in heartbeat if isinstance(condition, RigRestart)]
        self._rig_trips = [condition for condition in heartbeat if isinstance(condition, RigTrip)]
        all_alarms: list[tuple[Condition, float]] = [
            *((LimitViolation(point, *point.alarm), 0.0) for point in alarmed if point.alarm is not None),
            # A pause of this process comes first, since the rig's watchdog trips because of it.
            (TickGap(rig.abort_after_s + rig.period_s), 0.0),
            *((condition, 0.0) for condition in heartbeat),
            *((NoGoodValue(point, rig.abort_after_s, point.alarm is not None), rig.abort_after_s) for point in points),
        ]
        self._all = [Interlock("alarm", condition, delay) for condition, delay in all_alarms]
        for spec in rig.interlock:
            self._all += _declared(spec, rig)
        self._sensors = [item for item in self._all if isinstance(item.condition, NoGoodValue)]
        self._others = [item for item in self._all if not isinstance(item.condition, NoGoodValue)]
        self._sensors_stir = False

    def add_alarm(self, condition: Condition, on_delay_s: float = 0.0) -> None:
        """Add a condition that is evaluated as an alarm; its delay, s, is a leaky integrator."""
        item = Interlock("alarm", condition, on_delay_s, drains=True)
        self._all.append(item)
        self._others.append(item)

    @property
    def restarts(self) -> int:
        """Number of restarts of the rig's program."""
        return sum(condition.count for condition in self._restarts)

    def refusals(self, snapshot: Snapshot, *, rearm: bool = False) -> list[str]:
        """Return the alarms that prevent a start, one sentence each, without latching them.

        A trip of the rig's own prevents a start unless the operator gives `rearm`: arming would reset it without
        anybody's notice. A trip of its watchdog alone does not.
        """
        tick = self._tick(snapshot, 0.0, {}, {})
        alarms = (item for item in self._all if item.level == "alarm")
        violations = (
            item.condition.judge(tick, False) for item in alarms if not isinstance(item.condition, _NOT_AT_START)
        )
        found = list(dict.fromkeys(sentence for sentence in violations if sentence is not None))
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
    ) -> InterlockStatus:
        """Evaluate all interlocks and return their status. Call once a tick.

        Parameters
        ----------
        snapshot
            Readings of the polled points and their quality.
        now_s
            Rig time, s.
        commanded
            Commands before this tick by set-point, in their units.
        residuals
            Residuals of the twins, K.
        """
        tick = self._tick(snapshot, now_s, commanded or {}, residuals or {})
        stirred = [item.update(tick) for item in self._others]
        if self._sensors_stir or any(snapshot.quality):  # GOOD is 0: with good values a quiet one stays so
            seen = [item.update(tick) for item in self._sensors]
            self._sensors_stir = True in seen
        if True in stirred or self._sensors_stir or self._standing is not _NOTHING:
            self._standing = self._active()
        return self._standing

    def standing(self) -> InterlockStatus:
        """Return the latched trips and active warnings of the last tick."""
        return self._standing

    def _active(self) -> InterlockStatus:
        active = [item for item in self._all if item.active]
        if not active:
            return _NOTHING
        return InterlockStatus(
            tuple(item.reason for item in active if item.level == "alarm"),
            tuple(item.reason for item in active if item.level == "warning"),
        )

    def acknowledge(self) -> list[str]:
        """Release the trips whose cause is gone; return the sentences of those that stay."""
        stay = [item.reason for item in self._all if item.level == "alarm" and not item.acknowledge()]
        self._standing = self._active()
        return stay

    def rig_trip(self, snapshot: Snapshot) -> str | None:
        """Return the trip of the rig's own watchdog or thermostat as a sentence, or None."""
        tick = self._tick(snapshot, 0.0, {}, {})
        return next((trip for each in self._rig_trips if (trip := each.judge(tick, False)) is not None), None)

    def _tick(
        self, snapshot: Snapshot, now_s: float, commanded: Mapping[str, float], residuals: Residuals
    ) -> TickValues:
        values = dict(zip(self._names, snapshot.values, strict=True))
        quality = dict(zip(self._names, snapshot.quality, strict=True))
        return TickValues(now_s, values, quality, commanded, tuple(snapshot.faults), residuals)


def _declared(spec: InterlockSpec, rig: Rig) -> list[Interlock]:
    """Return a declared interlock, and one of the same level for each sensor that it needs."""
    condition, needs = _condition(spec, rig)
    on_delay_s = spec.on_delay_s
    if on_delay_s is None:
        on_delay_s = rig.get(spec.points["setpoint"]).readback_within_s
    sensors = (
        Interlock(spec.level, NoGoodValue(rig.get(name), rig.abort_after_s, True), rig.abort_after_s, spec.off_delay_s)
        for name in needs
        # An alarm on the same sensor covers it already.
        if spec.level == "alarm" or rig.get(name).alarm is None
    )
    own = [] if condition is None else [Interlock(spec.level, condition, on_delay_s, spec.off_delay_s)]
    return [*own, *sensors]


def _condition(spec: InterlockSpec, rig: Rig) -> tuple[Condition | None, tuple[str, ...]]:
    """Return the condition of `spec`, and the points that it needs a good value of."""
    if isinstance(spec, LimitSpec):
        low = -math.inf if spec.low is None else spec.low
        high = math.inf if spec.high is None else spec.high
        return LimitViolation(rig.get(spec.point), low, high, spec.deadband, spec.level), (spec.point,)
    if isinstance(spec, RateOfRiseSpec):
        return RateOfRise(spec, rig.get(spec.point).unit), (spec.point,)
    if isinstance(spec, NoFlowSpec):
        setpoint = rig.setpoint_of_column(spec.heater)
        return NoFlow(spec, None if setpoint is None else setpoint.name), (spec.flow,)
    if isinstance(spec, HeaterPowerSpec):
        setpoint = rig.get(spec.setpoint)
        assert setpoint.readback is not None
        return ActuatorDisagreement(setpoint, setpoint.readback, spec.tolerance, spec.deadband), (setpoint.readback,)
    if isinstance(spec, ResidualSpec):
        return TwinResidual(spec), ()
    return None, (spec.point,)
