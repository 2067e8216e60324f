"""Plants behind served devices: their interface, and one without physics."""

from __future__ import annotations

import random
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from drivers.can import FrameEncoder
from drivers.rig_file import CanBus, Point, Rig
from drivers.signals import raw_bounds
from drivers.virtual.described.values import declared_range, noise_of, value_at_rest


class PlantModel(Protocol):
    """Plant behind the devices of a rig file."""

    def step(self, outputs: Mapping[str, float], seconds: float) -> Mapping[str, float]:
        """Advance by `seconds` with set-points `outputs`, and return the values of all polled numbers.

        Both are by point name, in the units of the points.
        """


class ConstantPlant:
    """Plant without physics: set-points appear at their read-backs, all other values rest, with a little noise.

    Parameters
    ----------
    rig, file
        The rig and its file.
    seed
        Seed of the noise.

    Raises
    ------
    ConfigurationError
        A DBC file cannot be used, or the ranges of a point exclude each other.
    """

    def __init__(self, rig: Rig, file: Path, seed: int = 0) -> None:
        self._random = random.Random(seed)
        self._readback = {point.name: point.readback for point in rig.setpoints if point.readback is not None}
        self.at_rest: dict[str, float] = {}
        """Values of points that no set-point drives, by name."""
        self.noise: dict[str, float] = {}
        self._range: dict[str, tuple[float, float]] = {}
        encoders = {
            name: FrameEncoder(name, bus, [point for point in rig.point if point.bus == name])
            for name, bus in rig.bus.items()
            if isinstance(bus, CanBus)
        }
        read_back = set(self._readback.values())
        for point in (p for p in rig.point if p.is_polled):
            encoder = encoders.get(point.bus)
            able = _able(point) if encoder is None else encoder.bounds(point.name)
            resolution = _resolution(point) if encoder is None else encoder.resolution(point.name)
            if point.name not in read_back:
                self.at_rest[point.name] = value_at_rest(rig, file, point, able)
            span = declared_range(rig, point, able)
            if point.name not in read_back or point.stuck_after_s is not None:
                self.noise[point.name] = noise_of(point, span, resolution)
            self._range[point.name] = span

    def step(self, outputs: Mapping[str, float], seconds: float) -> Mapping[str, float]:
        """Return the values of all polled numbers."""
        found = self.at_rest | {
            self._readback[name]: value for name, value in outputs.items() if name in self._readback
        }
        for name, sigma in self.noise.items():
            if sigma > 0.0:
                low, high = self._range[name]
                noisy = found[name] + self._random.gauss(0.0, sigma)
                found[name] = min(max(noisy, low), high) if low <= found[name] <= high else found[name]
        return found


def _able(point: Point) -> tuple[float, float]:
    """Return the range that the registers of a point can hold, in its unit."""
    ends = [raw * point.scale + point.offset for raw in raw_bounds(point.type, point.bits)]
    return min(ends), max(ends)


def _resolution(point: Point) -> float:
    return 0.0 if point.type.startswith("float") else abs(point.scale)
