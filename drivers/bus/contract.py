"""What the rig asks of any bus, and the one place where a raw number becomes a value with a quality."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from drivers.rig_file.model import Point
from drivers.signals.points import Quality
from drivers.signals.units import plausible_range

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

    async def write_and_read_back(self, values: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
        """Write `values`, then ask for writable points `names` as the device holds them; raises a DriverError."""

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Engineering values of writable points as the device holds them; raises a DriverError."""

    async def close(self) -> None:
        """Close the bus; never raises."""


Judge = Callable[[float], tuple[float, int]]


def judge_of(point: Point) -> Judge:
    """What turns a raw number of `point` into its engineering value and quality; made once, since it is asked often.

    Quality is SENSOR_FAULT (not finite, or one of the point's `invalid`, raw or scaled), OUT_OF_RANGE (no label, or
    outside the plausible range of the point, else of its unit) or GOOD. What the device gives instead of a value is
    none: of a SENSOR_FAULT the value is NaN.
    """
    scale, offset, sentinels, labels = point.scale, point.offset, point.sentinels, point.label_of
    scaled = tuple((sentinel, 1e-9 * max(1.0, abs(sentinel))) for sentinel in point.invalid)
    low, high = plausible_range(point.unit) if point.plausible is None else point.plausible

    def judged(raw: float) -> tuple[float, int]:
        value = raw * scale + offset
        if not math.isfinite(value) or raw in sentinels:
            return math.nan, _SENSOR_FAULT
        for sentinel, tolerance in scaled:
            if abs(value - sentinel) <= tolerance:
                return math.nan, _SENSOR_FAULT
        if (labels is not None and raw not in labels) or not low <= value <= high:
            return value, _OUT_OF_RANGE
        return value, _GOOD

    return judged


def judge(point: Point, raw: float) -> tuple[float, int]:
    """Engineering value and quality of a single raw number."""
    return judge_of(point)(raw)
