"""Leading a plant with thermal memory back to the temperatures at which a run was cut.

At safe values a rig only cools, so waiting there never ends; held at the load of the cut, it creeps towards the steady
state of that load, which after a step is not where it was. So heater and fan lead it: a rig that is colder than it was
gets more heat and less cooling than the profile asks for, a hotter one less and more, by how far it is and for how long
it has been so, and never more of either than the profile itself asks for somewhere. All else stands as the profile had
it. See decision 0012.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.points import Quality, Signal, Snapshot
from drivers.rig_model import Point, Rig
from drivers.roles import FAN, HEATER, ROOM
from hil.profile import Profile
from hil.setpoints import bind

BAND_K = 1.0
TIMEOUT_S = 7200.0
SETTLE_S = 60.0
"""So long all temperatures must stay within the band."""
FULL_AT_BANDS = 2.0
"""Mean distance, in bands, from which on heater and fan lead with all they have."""
PATIENCE_S = 600.0
"""Time in which a mean distance that stays moves heater and fan by as much again as it does at once."""
STEPS = 100
"""Parts of its range in which a set-point leads, so that noise does not move it on every tick."""
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
        self._stayed = 0.0

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
        if not stands and math.isfinite(passed := now_s - before):
            # What has come to the other side has no past.
            stayed = self._stayed if self._stayed * self._lead > 0.0 else 0.0
            self._stayed = min(max(stayed + self._lead * passed / PATIENCE_S, -1.0), 1.0)
        inside = len(self._off) == len(self._index) and all(abs(k) <= self.rule.band_K for k in self._off.values())
        if not inside or stands:
            self._inside_since = None
        elif self._inside_since is None:
            self._inside_since = now_s

    @property
    def _lead(self) -> float:
        """How far off the rig is on the mean, as a share of what asks for all of heater and fan; positive if cold."""
        mean = sum(self._off.values()) / len(self._off) if self._off else 0.0
        return min(max(-mean / (FULL_AT_BANDS * self.rule.band_K), -1.0), 1.0)

    @property
    def reached(self) -> bool:
        """Whether every temperature has been within the band for `SETTLE_S`; at once where there is none to compare."""
        return not self._aim or (self._inside_since is not None and self._now - self._inside_since >= SETTLE_S)

    @property
    def said(self) -> str:
        """How far the rig is, as a sentence."""
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
        """Why there is no going on, once the time is over."""
        if self.reached or self.elapsed_s <= self.rule.timeout_s:
            return None
        return (
            f"not resumed: after {self.rule.timeout_s:g} s of soaking {self.said}, more than the band of "
            f"{self.rule.band_K:g} K; `hil resume` again with a longer --timeout or a wider --band"
        )

    def targets(self) -> dict[str, float]:
        """Where the set-points should be now."""
        lead = min(max(self._lead + self._stayed, -1.0), 1.0)
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
