"""Set-points on the way to a profile's targets: clamped to the limits, no faster than the slew rate."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.rig_file import Point, Rig
from drivers.signals import ConfigurationError, split_column
from hil.run.outputs.heaters import is_heater

_FLOAT_ERROR = 1e-6
"""Relative error of a number in a float32 register, with that of unit conversion."""


def count_tolerance(point: Point) -> float:
    """Return how far a value that is read back may be from the one that was written, in the unit of `point`.

    Half a raw count is lost in rounding to it; a float loses digits.
    """
    largest = max(abs(limit) for limit in point.limits or (0.0,))
    digits = _FLOAT_ERROR * max(largest, abs(point.scale))
    return digits if point.type.startswith("float") else 0.5 * abs(point.scale) + digits


def bind(rig: Rig, columns: Sequence[str]) -> list[Point]:
    """Return the set-point of each profile column; raises ConfigurationError on a name or unit that the rig lacks."""
    bound = []
    for column in columns:
        named = split_column(column)
        point = rig.setpoint_of_column(named[0]) if named is not None else None
        if named is None or point is None or point.unit != named[1]:
            known = ", ".join(setpoint_columns(rig))
            raise ConfigurationError(f"the rig {rig.name} has no set-point {column}; it has {known}")
        bound.append(point)
    return bound


def setpoint_columns(rig: Rig) -> dict[str, Point]:
    """Return the set-points by profile column: that of the point it moves, else its own."""
    columns = {}
    for point in rig.setpoints:
        target = rig.get(point.readback) if point.readback is not None else point
        columns[target.as_signal().column] = point
    return columns


class Setpoints:
    """Current value of each of the rig's set-points; moves towards targets within limits and slew rates."""

    def __init__(self, rig: Rig, start: dict[str, float] | None = None) -> None:
        self._rig = rig
        self._points = rig.setpoints
        self._by_name = {point.name: point for point in self._points}
        self.values: dict[str, float] = {
            point.name: self._clamped(point, (start or {}).get(point.name, point.safe_value or 0.0))
            for point in self._points
        }

    @staticmethod
    def _clamped(point: Point, value: float) -> float:
        if not math.isfinite(value):
            raise ConfigurationError(f"{point.name} cannot be set to {value}; correct the profile")
        assert point.limits is not None
        return min(max(value, point.limits[0]), point.limits[1])

    def move(self, targets: dict[str, float], elapsed_s: float) -> dict[str, float]:
        """Advance towards `targets` (by point name) for `elapsed_s`; return the values that changed."""
        changed = {}
        for name, point in self._by_name.items():
            if name not in targets:
                continue
            target = self._clamped(point, targets[name])
            value = self.values[name]
            if target == value:
                continue
            if point.max_rate is not None:
                reach = point.max_rate * elapsed_s
                target = min(max(target, value - reach), value + reach)
            if target != value:
                self.values[name] = target
                changed[name] = target
        return changed

    def put_safe(self) -> None:
        """Go to the safe values at once, without slew."""
        self.values.update(self.safe_values())

    def safe_values(self) -> dict[str, float]:
        """Return the safe value of each set-point, in the order in which they are to be applied: by `safe_order`, and
        heaters first where that says nothing."""
        ordered = sorted(self._points, key=lambda point: (point.safe_order, not is_heater(self._rig, point)))
        return {point.name: point.safe_value or 0.0 for point in ordered}
