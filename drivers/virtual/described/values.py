"""Values at rest of points that no plant drives: inside every range that the rig file declares for them."""

from __future__ import annotations

import math
from pathlib import Path

from drivers.rig_file import AlarmSpec, LimitSpec, NoFlowSpec, Point, Rig, located

PREFERRED = {"degC": 20.0, "W": 0.0, "kW": 0.0}
"""Values of a rig at rest by unit, where they are inside the declared range; else it is the middle of the range."""
_NOISE = 1e-4
"""Noise as a share of the declared range."""


def declared_range(rig: Rig, point: Point, able: tuple[float, float]) -> tuple[float, float]:
    """Return the range in which a point is plausible and trips nothing, in its unit.

    Parameters
    ----------
    rig
        The rig, with its interlocks and alarms.
    point
        One of its points.
    able
        Range that the point's encoding can hold.
    """
    ranges = [able, *(interval for interval in (point.plausible, point.alarm) if interval is not None)]
    for spec in (*rig.interlock, *rig.alarm):
        band = spec.deadband
        if isinstance(spec, NoFlowSpec) and spec.flow == point.name:
            ranges.append((spec.low + band, math.inf))
        elif isinstance(spec, LimitSpec | AlarmSpec) and spec.point == point.name:
            low, high = spec.low, spec.high
            ranges.append((-math.inf if low is None else low + band, math.inf if high is None else high - band))
    return max(low for low, _ in ranges), min(high for _, high in ranges)


def value_at_rest(rig: Rig, file: Path, point: Point, able: tuple[float, float]) -> float:
    """Return the value of a point that nothing drives; raise RigFileError where its ranges exclude each other.

    Parameters
    ----------
    rig, file
        The rig and its file, for the message.
    point
        A point that is polled.
    able
        Range that the point's encoding can hold.
    """
    if point.label_of is not None:
        return float(min(key for key in point.label_of if key not in point.sentinels))
    low, high = declared_range(rig, point, able)
    if low > high:
        what = (
            f"{point.name} cannot be served: no value is inside what its encoding holds ({able[0]:g} to {able[1]:g} "
            f"{point.unit}), its plausible and alarm range and its interlocks' limits at once; correct one of them"
        )
        raise located(file, [(("point", rig.point.index(point), "plausible"), what)])
    wanted = 0.0 if point.kind == "status" else PREFERRED.get(point.unit)
    if wanted is not None and low <= wanted <= high:
        return wanted
    if (low, high) == able:  # nothing is declared: the middle of 16 bits means nothing
        return min(max(0.0, low), high)
    return 0.5 * low + 0.5 * high


def noise_of(point: Point, span: tuple[float, float], resolution: float) -> float:
    """Return the standard deviation of a measured value, in the point's unit; 0 for states and texts.

    Parameters
    ----------
    point
        The point.
    span
        Its declared range, in its unit.
    resolution
        Its smallest step, in its unit; a noise below it would not show, and a sensor without noise counts as stuck.
    """
    if point.kind == "status" or point.type == "bool" or point.label_of is not None or point.bits is not None:
        return 0.0
    width = span[1] - span[0] if point.plausible is not None or point.alarm is not None else 1.0
    noise = max(resolution, _NOISE * width)
    return noise if point.max_change_per_s is None else min(noise, point.max_change_per_s / 6.0)
