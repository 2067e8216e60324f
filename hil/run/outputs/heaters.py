"""Heaters of a rig and their meters: the measured power below which an output counts as safe, and the way there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from drivers.rig_file import Point, Rig
from drivers.signals import Quality, Snapshot

_MEASURED = (int(Quality.GOOD), int(Quality.OUT_OF_RANGE))
OFF_SHARE = 0.05
"""A heater that takes more of its range than this is on, whatever tolerance its rig file gives."""


@dataclass(frozen=True, slots=True)
class SafeLimit:
    """A heater's meter, the highest reading, in the meter's unit, at which the heater is safe, and how long it may take
    the meter to get there, s."""

    heater: str
    meter: str
    at_most: float
    within_s: float


def is_heater(rig: Rig, point: Point) -> bool:
    """Return whether a set-point asks for heat: in W or kW, or for a point with the role heater_power."""
    moved = None if point.readback is None else rig.get(point.readback)
    return (
        point.unit in ("W", "kW")
        or point.role == "heater_power"
        or (moved is not None and moved.role == "heater_power")
    )


def safe_limit(rig: Rig, point: Point) -> SafeLimit | None:
    """Return the meter of a heater and its limit; None for another set-point, and for a heater that nothing measures.

    The limit is `safe_below` of the set-point, else its safe value and `readback_tolerance`, but no more of its range
    than `OFF_SHARE`: a tolerance of 1 is nothing in W and everything in kW.
    """
    if point.readback is None or not is_heater(rig, point):
        return None
    at_most = point.safe_below
    if at_most is None:
        low, high = point.limits or (0.0, math.inf)
        at_most = (point.safe_value or 0.0) + min(point.readback_tolerance, OFF_SHARE * (high - low))
    return SafeLimit(point.name, point.readback, at_most, point.readback_within_s)


def safe_limits(rig: Rig) -> tuple[SafeLimit, ...]:
    """Return the limits of all heaters that are measured."""
    found = (safe_limit(rig, point) for point in rig.setpoints)
    return tuple(limit for limit in found if limit is not None)


def still_hot(rig: Rig, limits: tuple[SafeLimit, ...], readings: Mapping[str, float]) -> str:
    """Return which meter still reads more than is safe, as a sentence; empty where none does.

    `readings` are good values by point; one that is missing or NaN proves nothing, and is left to the interlocks.
    """
    for limit in limits:
        value = readings.get(limit.meter, math.nan)
        if abs(value) > limit.at_most:  # a meter that is connected the wrong way round reads less than nothing
            unit = rig.get(limit.meter).unit
            return f"{limit.meter} still reads {value:.1f} {unit}, safe is {limit.at_most:g} {unit} at most"
    return ""


def not_cold(rig: Rig, limits: tuple[SafeLimit, ...], readings: Mapping[str, float]) -> str:
    """Return what keeps a heater from being known as off, as a sentence: a meter that reads more than is safe, or one
    that reads nothing; empty where every meter says that its heater is off."""
    dead = next((limit for limit in limits if math.isnan(readings.get(limit.meter, math.nan))), None)
    hot = still_hot(rig, limits, readings)
    if hot or dead is None:
        return hot
    return f"{dead.meter} has no good value: whether {dead.heater} is off is not known"


DEAD_TIME_S = 1.0
"""So long a meter may show nothing of a heater that was switched off, s: it samples, averages and is polled."""
STANDS = 0.5
"""Share of the fall of a straight line to the limit below which a meter stands still."""
LEAST_STOOD = 2
"""Checks at which a meter stood still, from which its heater did not obey: noise may hold a falling one up once."""


class Descent:
    """Way of the meters down after the heaters were told to be safe.

    The rig file declares that a meter is at its limit within `readback_within_s`. A first-order lag that just does so
    falls along an exponential from its first reading to the limit, after a dead time; what reads more than that does
    not follow: the heater has not obeyed, whatever it answers.
    """

    def __init__(self, rig: Rig, limits: tuple[SafeLimit, ...], period_s: float) -> None:
        self._rig = rig
        self._limits = limits
        self._dead_s = max(DEAD_TIME_S, 2.0 * period_s)
        self._first: dict[str, tuple[float, float]] = {}
        self._last: dict[str, tuple[float, float]] = {}
        self._stood: dict[str, int] = {}
        self._said: dict[str, str] = {}

    def clear(self) -> None:
        """Forget the way: the heaters are heated again. The heaters that have not obeyed stay known."""
        self._first.clear()
        self._last.clear()

    def not_obeyed(self) -> str:
        """Return which meter stood still or rose after its heater was told to be safe, as a sentence; empty for none.

        It is one that did not come down as declared (`stays`), and fell by less than `STANDS` of the straight line to
        its limit, the slowest way that keeps the declared time.
        """
        return next((self._said[meter] for meter, times in self._stood.items() if times >= LEAST_STOOD), "")

    def stays(self, readings: Mapping[str, float], now_s: float) -> str:
        """Return which meter does not come down as declared, as a sentence; empty where all do or are there."""
        for limit in self._limits:
            value = readings.get(limit.meter, math.nan)
            if not abs(value) > limit.at_most:
                continue
            value = abs(value)
            first, began_s = self._first.setdefault(limit.meter, (value, now_s))
            before, before_s = self._last.get(limit.meter, (value, now_s))
            self._last[limit.meter] = value, now_s
            share = min((now_s - began_s - self._dead_s) / limit.within_s, 1.0)
            if share <= 0.0:
                continue
            floor = max(limit.at_most, 1e-3 * first)
            if value > first * (floor / first) ** share + self._rig.get(limit.heater).readback_tolerance:
                unit = self._rig.get(limit.meter).unit
                if now_s > before_s and before - value < STANDS * first * (now_s - before_s) / limit.within_s:
                    self._stood[limit.meter] = self._stood.get(limit.meter, 0) + 1
                    self._said[limit.meter] = f"{limit.meter} read {value:.1f} {unit}, and {first:.1f} {unit} at first"
                return f"{limit.meter} does not come down: it reads {value:.1f} {unit}, and {first:.1f} {unit} at first"
        return ""


class GoodReadings:
    """Good values of a few of the polled `points`, picked out of each snapshot; as `good_readings` of all of them."""

    def __init__(self, points: tuple[Point, ...], names: Iterable[str]) -> None:
        wanted = frozenset(names)
        self._places = tuple((point.name, index) for index, point in enumerate(points) if point.name in wanted)

    def of(self, snapshot: Snapshot | None) -> dict[str, float]:
        """Return the good values by point name; implausible ones count, since they may be the worst."""
        if snapshot is None:
            return {}
        values, quality = snapshot.values, snapshot.quality
        return {name: values[index] for name, index in self._places if quality[index] in _MEASURED}


def good_readings(points: tuple[Point, ...], snapshot: Snapshot | None) -> dict[str, float]:
    """Return the good values of a snapshot by point name; implausible ones count, since they may be the worst."""
    if snapshot is None:
        return {}
    rows = zip(points, snapshot.values, snapshot.quality, strict=True)
    return {point.name: value for point, value, quality in rows if quality in _MEASURED}
