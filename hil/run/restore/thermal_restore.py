"""Thermal restore: return of a plant with stored heat to the temperatures at which a run was interrupted.

At safe values a rig only cools, so that waiting there never ends. At the load of the interruption it approaches the
steady state of that load, which after a step differs from its former temperatures. Heater and fan therefore act: a rig
that is too cold gets more heat and less cooling than the profile asks for, a hot one the opposite. A
proportional-integral controller of the mean deviation sets the correction. No output leaves the range that the profile
uses. All other outputs keep the values of the profile. See decision 0012.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.rig_file import Point, Rig
from drivers.signals import FAN, HEATER, ROOM, Quality, Signal, Snapshot
from hil.profile import Profile
from hil.run.outputs import bind
from hil.run.restore.controller import ThermalController
from hil.run.restore.limits import ThermalLimits

BAND_K = 1.0
"""Usual tolerance of each temperature, K."""
TIMEOUT_S = 7200.0
"""Usual time-out, s of rig time."""
SETTLE_S = 60.0
"""Time for which all temperatures must stay within the band, s."""
FULL_AT_BANDS = 2.0
"""Mean deviation, in bands, from which on the correction is full. For a band narrower than `BAND_K` it counts in
multiples of `BAND_K`: a narrow band makes no plant faster."""
STEPS = 100
"""Steps of a set-point over its range: a smaller correction is not written."""
_DIRECTION: dict[str | None, int] = {HEATER: 1, FAN: -1}
"""Roles of set-points that restore temperatures: 1 where more of them warms the rig, -1 where it cools."""


@dataclass(frozen=True, slots=True)
class RestoreRule:
    """Tolerance of each temperature, K, and time-out, s of rig time."""

    band_K: float = BAND_K
    timeout_s: float = TIMEOUT_S


def stores_heat(signal: Signal) -> bool:
    """Return True for a measured temperature of the rig, which stores heat; the room's is none."""
    return signal.kind == "measured" and signal.unit == "degC" and signal.role != ROOM


class ThermalRestore:
    """Thermal restore towards `aim`, point name -> degC, at the load that `profile` has at `profile_s`."""

    def __init__(
        self,
        rig: Rig,
        points: tuple[Point, ...],
        profile: Profile,
        profile_s: float,
        aim: Mapping[str, float],
        rule: RestoreRule,
    ) -> None:
        self.rule = rule
        self.elapsed_s = 0.0
        self._aim = dict(aim)
        self._index = {point.name: i for i, point in enumerate(points) if point.name in self._aim}
        targets = bind(rig, profile.columns)
        self._load = dict(zip((p.name for p in targets), profile.at(profile_s), strict=True))
        self._actuators: list[tuple[str, float, float, int]] = []
        for column, point in enumerate(targets):
            warms = _DIRECTION.get(_actuator_role(rig, point))
            if warms is not None:
                values = profile.values[:, column]
                low = float(point.safe_value or 0.0) if warms > 0 else float(values.min())
                self._actuators.append((point.name, low, float(values.max()), warms))
        self._inside_since: float | None = None
        self._now = math.nan
        self._off: dict[str, float] = {}
        self._control = ThermalController(FULL_AT_BANDS * max(rule.band_K, BAND_K))
        self._limits = ThermalLimits(tuple(self._index), rule.band_K, SETTLE_S, rule.timeout_s)

    def update(self, snapshot: Snapshot, now_s: float, *, stopped: bool = False) -> None:
        """Update the restore with the readings of one tick, `now_s` in s of rig time.

        Its clock stands while an operator has `stopped` it.
        """
        if not stopped and math.isfinite(self._now):
            self.elapsed_s += now_s - self._now
        before, self._now = self._now, now_s
        self._off = {
            name: snapshot.values[i] - self._aim[name]
            for name, i in self._index.items()
            if snapshot.quality[i] == Quality.GOOD
        }
        mean = sum(self._off.values()) / len(self._off) if self._off else 0.0
        passed = now_s - before if math.isfinite(before) else 0.0
        low, high = self._at_limits()
        self._control.step(mean, passed, held=stopped, low=low, high=high)
        self._judge(now_s, mean, stopped=stopped)
        inside = len(self._off) == len(self._index) and all(abs(k) <= self.rule.band_K for k in self._off.values())
        if not inside or stopped:
            self._inside_since = None
        elif self._inside_since is None:
            self._inside_since = now_s

    def _judge(self, now_s: float, mean: float, *, stopped: bool) -> None:
        """Update the forecast; it begins anew after a lost reading or a stop."""
        if stopped or not self._off or len(self._off) < len(self._index):
            self._limits.clear()
            return
        found = self.targets()
        outputs = [(found[name] - low) / (high - low) for name, low, high, _ in self._actuators if high > low]
        colder, warmer = self._at_limits()
        full = (mean > 0.0 and colder) or (mean < 0.0 and warmer)
        self._limits.take(now_s, list(self._off.values()), outputs, self.rule.timeout_s - self.elapsed_s, full=full)

    def _at_limits(self) -> tuple[bool, bool]:
        """Return two flags: every actuator cools as much as it may, and every one warms as much as it may."""
        found = self.targets()
        ends = [(low, high) if warms > 0 else (high, low) for _, low, high, warms in self._actuators]
        values = [found[name] for name, *_ in self._actuators]
        cools = all(value == end[0] for value, end in zip(values, ends, strict=True))
        return cools, all(value == end[1] for value, end in zip(values, ends, strict=True))

    @property
    def reached(self) -> bool:
        """True once every temperature has been within the band for `SETTLE_S`, or where there is none to compare."""
        return not self._aim or (self._inside_since is not None and self._now - self._inside_since >= SETTLE_S)

    @property
    def progress(self) -> str:
        """Sentence about the largest deviation, with the time within the band, or a sufficient band where the restore
        is too slow."""
        if self._inside_since is not None:
            inside_s = self._now - self._inside_since
            return (
                f"{self._largest}; all within the band of {self.rule.band_K:g} K for {inside_s:.0f} s of the "
                f"{SETTLE_S:g} s that the run waits there"
            )
        if self._limits.in_time or self._limits.sufficient_K is None:
            return self._largest
        return f"{self._largest}; too slow for the timeout, --band {self._limits.sufficient_K:g} would do now"

    @property
    def _largest(self) -> str:
        """Sentence about the largest deviation."""
        lost = [name for name in self._index if name not in self._off]
        if lost:
            return f"{lost[0]} has no good value, so that its deviation is not known"
        if not self._off:
            return "no temperature to compare"
        name, off = max(self._off.items(), key=lambda item: abs(item[1]))
        return (
            f"{name} is {self._aim[name] + off:.1f} degC, {abs(off):.1f} K {'above' if off > 0 else 'below'} the "
            f"{self._aim[name]:.1f} that it had when the run was cut"
        )

    @property
    def failure(self) -> str | None:
        """Sentence about why the run cannot go on: the time is over, or the band is out of reach; else None."""
        if self.reached:
            return None
        if self._limits.obstacle is not None:
            return f"not resumed: {self._limits.obstacle}"
        if self.elapsed_s <= self.rule.timeout_s:
            return None
        band_K = self._limits.sufficient_K
        wider = "a wider --band" if band_K is None or band_K <= self.rule.band_K else f"--band {band_K:g}"
        return (
            f"not resumed: after {self.rule.timeout_s:g} s of thermal restore {self._largest}, and not all "
            f"temperatures stayed within the band of {self.rule.band_K:g} K for {SETTLE_S:g} s; `hil resume` again "
            f"with a longer --timeout or {wider}"
        )

    def targets(self) -> dict[str, float]:
        """Return the values of the set-points by name, in their units."""
        correction = self._control.correction
        found = dict(self._load)
        for name, low, high, warms in self._actuators:
            step = (high - low) / STEPS
            moved = round(warms * correction * STEPS) * step
            found[name] = min(max(self._load[name] + moved, low), high)
        return found


def role_of(rig: Rig, setpoint: Point) -> str | None:
    """Return the role of a set-point, its own or that of its read-back; None without one."""
    return setpoint.role or (rig.get(setpoint.readback).role if setpoint.readback is not None else None)


def restore_obstacle(rig: Rig, setpoints: Sequence[Point]) -> str | None:
    """Return why these set-points cannot restore the temperatures, as a sentence; None where one of them can."""
    if not setpoints or any(_actuator_role(rig, point) in _DIRECTION for point in setpoints):
        return None
    names = ", ".join(point.name for point in setpoints)
    return (
        f"no set-point restores the rig's temperatures when a run is resumed: none of {names} has the "
        f"role {HEATER} or {FAN} (its own or that of its readback) or, without a role, is set in W with a safe_value "
        f"of 0, so that `hil resume` keeps the profile's load and waits; give the heater role = {HEATER!r}"
    )


def _actuator_role(rig: Rig, setpoint: Point) -> str | None:
    """Return the role of a set-point; without a role, one in W with a safe value of 0 is a heater.

    A cooler in W has a safe value at which it still cools.
    """
    role = role_of(rig, setpoint)
    return HEATER if role is None and setpoint.unit == "W" and not setpoint.safe_value else role
