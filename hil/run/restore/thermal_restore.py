"""Leading a plant with thermal memory back to the temperatures at which a run was cut.

At safe values a rig only cools, so waiting there never ends; held at the load of the cut, it creeps towards the steady
state of that load, which after a step is not where it was. So heater and fan lead it: a rig that is colder than it was
gets more heat and less cooling than the profile asks for, a hotter one less and more, by a proportional-integral
correction of the mean deviation, and never more of either than the profile itself asks for somewhere. All else stands
as the profile had it. See decision 0012.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.rig_file import Point, Rig
from drivers.signals import FAN, HEATER, ROOM, Quality, Signal, Snapshot
from hil.profile.load_profile import Profile
from hil.run.outputs.setpoints import bind
from hil.run.restore.controller import ThermalController
from hil.run.restore.limits import ThermalLimits

BAND_K = 1.0
TIMEOUT_S = 7200.0
SETTLE_S = 60.0
"""So long all temperatures must stay within the band."""
FULL_AT_BANDS = 2.0
"""Mean deviation, in bands, from which on heater and fan lead with all they have; of a band narrower than `BAND_K` in
multiples of that, since a plant does not get faster because its band is narrow."""
STEPS = 100
"""Parts of its range in which a set-point leads: a correction this small is none."""
_WARMS: dict[str | None, int] = {HEATER: 1, FAN: -1}
"""Roles of set-points that lead, and whether more of them warms the rig or cools it."""


@dataclass(frozen=True, slots=True)
class SoakRule:
    """How near, K, the temperatures must come, and within how long, s of rig time."""

    band_K: float = BAND_K
    timeout_s: float = TIMEOUT_S


def has_memory(signal: Signal) -> bool:
    """Whether a signal tells of heat stored in the rig: a temperature that is not the room's."""
    return signal.kind == "measured" and signal.unit == "degC" and signal.role != ROOM


class Soak:
    """One soak towards `aim`, point name -> degC, at the load that `profile` has at `profile_s`."""

    def __init__(
        self,
        rig: Rig,
        points: tuple[Point, ...],
        profile: Profile,
        profile_s: float,
        aim: Mapping[str, float],
        rule: SoakRule,
    ) -> None:
        self.rule = rule
        self.elapsed_s = 0.0
        self._aim = dict(aim)
        self._index = {point.name: i for i, point in enumerate(points) if point.name in self._aim}
        targets = bind(rig, profile.columns)
        self._load = dict(zip((p.name for p in targets), profile.at(profile_s), strict=True))
        self._leads: list[tuple[str, float, float, int]] = []
        for column, point in enumerate(targets):
            warms = _WARMS.get(_leading_role(rig, point))
            if warms is not None:
                values = profile.values[:, column]
                low = float(point.safe_value or 0.0) if warms > 0 else float(values.min())
                self._leads.append((point.name, low, float(values.max()), warms))
        self._inside_since: float | None = None
        self._now = math.nan
        self._off: dict[str, float] = {}
        self._control = ThermalController(FULL_AT_BANDS * max(rule.band_K, BAND_K))
        self._limits = ThermalLimits(tuple(self._index), rule.band_K, SETTLE_S, rule.timeout_s)

    def look(self, snapshot: Snapshot, now_s: float, *, stands: bool = False) -> None:
        """Take in one tick, rig time in s. While an operator has stopped the soak its clock `stands`."""
        if not stands and math.isfinite(self._now):
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
        self._control.step(mean, passed, held=stands, low=low, high=high)
        self._judge(now_s, mean, stands=stands)
        inside = len(self._off) == len(self._index) and all(abs(k) <= self.rule.band_K for k in self._off.values())
        if not inside or stands:
            self._inside_since = None
        elif self._inside_since is None:
            self._inside_since = now_s

    def _judge(self, now_s: float, mean: float, *, stands: bool) -> None:
        """Estimate whether the temperatures can come within the band; what was lost or stopped begins anew."""
        if stands or not self._off or len(self._off) < len(self._index):
            self._limits.clear()
            return
        found = self.targets()
        outputs = [(found[name] - low) / (high - low) for name, low, high, _ in self._leads if high > low]
        colder, warmer = self._at_limits()
        full = (mean > 0.0 and colder) or (mean < 0.0 and warmer)
        self._limits.take(now_s, list(self._off.values()), outputs, self.rule.timeout_s - self.elapsed_s, full=full)

    def _at_limits(self) -> tuple[bool, bool]:
        """Whether everything that leads cools, or warms, as much as it may."""
        found = self.targets()
        ends = [(low, high) if warms > 0 else (high, low) for _, low, high, warms in self._leads]
        values = [found[name] for name, *_ in self._leads]
        cools = all(value == end[0] for value, end in zip(values, ends, strict=True))
        return cools, all(value == end[1] for value, end in zip(values, ends, strict=True))

    @property
    def reached(self) -> bool:
        """Whether every temperature has been within the band for `SETTLE_S`; at once where there is none to compare."""
        return not self._aim or (self._inside_since is not None and self._now - self._inside_since >= SETTLE_S)

    @property
    def said(self) -> str:
        """Deviation that is the largest, as a sentence, and the band that would do where this one does not in time."""
        if self._limits.in_time or self._limits.enough_K is None:
            return self._furthest
        return f"{self._furthest}; too slow for the timeout, --band {self._limits.enough_K:g} would do now"

    @property
    def _furthest(self) -> str:
        """Deviation that is the largest, as a sentence."""
        lost = [name for name in self._index if name not in self._off]
        if lost:
            return f"{lost[0]} is not known, so nobody can tell whether the rig is where it was"
        if not self._off:
            return "no temperature to compare"
        name, off = max(self._off.items(), key=lambda item: abs(item[1]))
        return (
            f"{name} is {self._aim[name] + off:.1f} degC, {abs(off):.1f} K {'above' if off > 0 else 'below'} the "
            f"{self._aim[name]:.1f} that it had when the run was cut"
        )

    @property
    def failure(self) -> str | None:
        """Why there is no going on: the time is over, or the band is certain to be out of reach."""
        if self.reached:
            return None
        if self._limits.why is not None:
            return f"not resumed: {self._limits.why}"
        if self.elapsed_s <= self.rule.timeout_s:
            return None
        enough_K = self._limits.enough_K
        wider = "a wider --band" if enough_K is None or enough_K <= self.rule.band_K else f"--band {enough_K:g}"
        return (
            f"not resumed: after {self.rule.timeout_s:g} s of soaking {self._furthest}, and not all temperatures "
            f"stayed within the band of {self.rule.band_K:g} K for {SETTLE_S:g} s; `hil resume` again with a longer "
            f"--timeout or {wider}"
        )

    def targets(self) -> dict[str, float]:
        """Where the set-points should be now."""
        lead = self._control.correction
        found = dict(self._load)
        for name, low, high, warms in self._leads:
            step = (high - low) / STEPS
            moved = round(warms * lead * STEPS) * step
            found[name] = min(max(self._load[name] + moved, low), high)
        return found


def role_of(rig: Rig, setpoint: Point) -> str | None:
    """Role of a set-point, its own or that of its read-back."""
    return setpoint.role or (rig.get(setpoint.readback).role if setpoint.readback is not None else None)


def unled(rig: Rig, setpoints: Sequence[Point]) -> str | None:
    """Why a rig cannot be led back by these of its set-points, as a sentence; None where one of them leads."""
    if not setpoints or any(_leading_role(rig, point) in _WARMS for point in setpoints):
        return None
    return (
        f"nothing leads the rig back when a run is resumed: none of {', '.join(p.name for p in setpoints)} has the "
        f"role {HEATER} or {FAN} (its own or that of its readback) or, without a role, is set in W with a safe_value "
        f"of 0, so that `hil resume` only holds the profile's load and waits; give the heater role = {HEATER!r}"
    )


def _leading_role(rig: Rig, setpoint: Point) -> str | None:
    """What a set-point is; without a role, what is set in W and safe at 0 is a heater.

    What cools and is set in W is safe where it still does.
    """
    role = role_of(rig, setpoint)
    return HEATER if role is None and setpoint.unit == "W" and not setpoint.safe_value else role
