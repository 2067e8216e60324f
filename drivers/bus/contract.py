"""Contract of a bus, and the conversion of raw numbers to engineering values with a quality."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from drivers.rig_file import Point
from drivers.signals import Quality, plausible_range

Clock = Callable[[], float]
_GOOD, _OUT_OF_RANGE, _SENSOR_FAULT = int(Quality.GOOD), int(Quality.OUT_OF_RANGE), int(Quality.SENSOR_FAULT)


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings of one bus on one tick, in the order of its `points`; a value is NaN where nothing was received.

    `quality` holds numbers of `Quality`, `source_time_s` times in s; `fault` is a sentence for the log, or None.
    """

    values: list[float]
    quality: list[int]
    source_time_s: list[float]
    fault: str | None = None


class Bus(Protocol):
    """Bus that is polled once a tick. `points` are the polled ones, in the order of `Readings`."""

    name: str
    points: tuple[Point, ...]

    async def connect(self) -> None:
        """Open the bus; raise a DriverError with the cause and the remedy where that fails."""

    async def read(self) -> Readings:
        """Return this tick's readings. A lost link is a quality, not an exception."""

    async def write(self, values: Mapping[str, float]) -> None:
        """Write engineering values by point name; raise a DriverError where that fails."""

    async def write_and_read_back(self, values: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
        """Write `values`, then return the values of writable points `names` in the device; raise a DriverError."""

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return the engineering values of writable points in the device; raise a DriverError."""

    async def close(self) -> None:
        """Close the bus; never raise."""


Judge = Callable[[float], tuple[float, int]]


def judge_of(point: Point) -> Judge:
    """Return the function that converts a raw number of `point` to its engineering value and quality.

    Quality is SENSOR_FAULT (not finite, or one of the point's `invalid`, raw or scaled), OUT_OF_RANGE (no label, or
    outside the plausible range of the point, else of its unit) or GOOD. The value of a SENSOR_FAULT is NaN: a sentinel
    is no measurement.
    """
    scale, offset, sentinels, labels = point.scale, point.offset, point.sentinels, point.label_of
    scaled = point.scaled_sentinels
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
    """Return engineering value and quality of a single raw number."""
    return judge_of(point)(raw)
