"""What the rig asks of any bus, and the one place where a raw number becomes a value with a quality."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from drivers.points import Quality
from drivers.rig_model import Point

Clock = Callable[[], float]
_GOOD, _OUT_OF_RANGE, _SENSOR_FAULT = int(Quality.GOOD), int(Quality.OUT_OF_RANGE), int(Quality.SENSOR_FAULT)


@dataclass(frozen=True, slots=True)
class Readings:
    """What one bus says on one tick, in the order of its `points`; NaN where nothing was received."""

    values: list[float]
    quality: list[int]
    source_time_s: list[float]
    fault: str | None = None


class Bus(Protocol):
    """A bus that is polled once a tick. `points` are the polled ones, in the order of `Readings`."""

    name: str
    points: tuple[Point, ...]

    async def connect(self) -> None:
        """Open the bus; raises a DriverError that says what is wrong and what to do."""

    async def read(self) -> Readings:
        """This tick's readings. A lost link is a quality, not an exception."""

    async def write(self, values: Mapping[str, float]) -> None:
        """Write engineering values by point name; raises a DriverError where that failed."""

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Engineering values of writable points as the device holds them; raises a DriverError."""

    async def close(self) -> None:
        """Close the bus; never raises."""


def judge(point: Point, raw: float) -> tuple[float, int]:
    """Engineering value of a raw number, and its quality by the point's sentinels, labels and plausible range.

    What the device gives instead of a value is none: of a SENSOR_FAULT the value is NaN.
    """
    value = raw * point.scale + point.offset
    quality = quality_of(point, value, raw)
    return (math.nan if quality == _SENSOR_FAULT else value), quality


def quality_of(point: Point, value: float, raw: float) -> int:
    """GOOD, SENSOR_FAULT (not finite, or one of the point's `invalid`, raw or scaled) or OUT_OF_RANGE."""
    if not math.isfinite(value) or raw in point.sentinels:
        return _SENSOR_FAULT
    for sentinel in point.invalid:
        if abs(value - sentinel) <= 1e-9 * max(1.0, abs(sentinel)):
            return _SENSOR_FAULT
    if point.label_of is not None and raw not in point.label_of:
        return _OUT_OF_RANGE
    if point.plausible is not None and not point.plausible[0] <= value <= point.plausible[1]:
        return _OUT_OF_RANGE
    return _GOOD
