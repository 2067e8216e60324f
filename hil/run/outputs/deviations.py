"""Deviations of a run: set-points whose meters, over the whole run, did not show what was asked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.rig_file import Rig


@dataclass(slots=True)
class _ReadbackSums:
    asked: float = 0.0
    measured: float = 0.0
    moved: float = 0.0
    last: float = math.nan
    count: int = 0
    unknown: int = 0


class ReadbackDeviations:
    """Sums of what was asked and measured of every set-point with a `readback`, tick by tick while the run runs.

    A meter that follows with a lag of first order, and settles within `readback_within_s`, misses a
    limited part of the integral of the set-point: `readback_within_s` times the sum of the sizes of its steps. A
    meter whose mean is off by more than that and `readback_tolerance` has no lag: the actuator failed to follow.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        moved = [(point.name, point.readback) for point in rig.setpoints if point.readback is not None]
        self._sums = {name: _ReadbackSums() for name, _ in moved}
        self._moved = tuple((name, meter, self._sums[name]) for name, meter in moved)
        self.meters = frozenset(meter for _, meter in moved)
        """Points that `tick` needs the readings of."""

    def tick(self, asked: Mapping[str, float], readings: Mapping[str, float]) -> None:
        """Add a tick: set-points in their units, and the good readings by point."""
        for name, meter, sums in self._moved:
            value, reading = asked[name], readings.get(meter, math.nan)
            if reading != reading:  # NaN
                sums.unknown += 1
                continue
            if value != sums.last:
                # The way begins where the actuator is found.
                sums.moved += abs(value - (reading if math.isnan(sums.last) else sums.last))
                sums.last = value
            sums.asked += value
            sums.measured += reading
            sums.count += 1

    def found(self, period_s: float) -> list[str]:
        """Return what deviates, a sentence each, after ticks of `period_s`."""
        sentences = []
        for name, sums in self._sums.items():
            point = self._rig.get(name)
            if sums.count == 0:
                if sums.unknown:
                    sentences.append(f"{point.readback} had no good value: what {name} did is not known")
                continue
            asked, measured = sums.asked / sums.count, sums.measured / sums.count
            lag = sums.moved * point.readback_within_s / (sums.count * period_s)
            if abs(measured - asked) > point.readback_tolerance + lag:
                sentences.append(
                    f"{name} asked for {asked:.4g} {point.unit} in the mean and {point.readback} read "
                    f"{measured:.4g} {point.unit}; look at the actuator, its meter and their scales"
                )
        return sentences
