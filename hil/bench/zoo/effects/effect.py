"""An effect: its type with the accepted answers, and one injection of it into a record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hil.bench.zoo.plants import (
    FAN_COLUMN,
    HOUR_S,
    ROOM_COLUMN,
    START_H,
    Array,
    BuiltPart,
    Drive,
    Modifier,
    Schedule,
    ZooPlant,
    wander,
)

TimeCourse = Callable[[float, Array], Array]
"""Size and course (n,) -> changed course."""
Context = Mapping[str, Array]
"""Columns of the record, and noise-free readings."""
ReadingEffect = Callable[[float, Array, Context], Array]


@dataclass(frozen=True)
class AcceptedAnswer:
    """Accepted answer: kind and place in a diagnosis's words; `drivers` () accepts any driver."""

    kind: str
    where: str
    drivers: tuple[str, ...] = ()


@dataclass(frozen=True)
class Injection:
    """One effect in one record, in proportion to a size.

    Attributes
    ----------
    unit, first, most
        Unit of the size, a first guess, and its largest absolute value.
    answers
        Accepted answers; the first one is the effect's own name.
    place
        Node of the lumped twin, or column, at which the effect acts; "loop" has no place.
    modifiers
        Disturbances of the plant at size 1.
    commands
        Column -> course that the plant gets in place of the recorded one.
    recorded
        Input column -> what the record holds in place of the true course.
    readings
        Thermometer column -> what it shows in place of the true reading.
    """

    unit: str
    first: float
    most: float
    answers: tuple[AcceptedAnswer, ...]
    place: str
    onset_s: float = 0.0
    modifiers: tuple[Modifier, ...] = ()
    commands: Mapping[str, TimeCourse] = field(default_factory=dict)
    recorded: Mapping[str, ReadingEffect] = field(default_factory=dict)
    readings: Mapping[str, ReadingEffect] = field(default_factory=dict)

    def sized(self, size: float) -> tuple[Modifier, ...]:
        """Return the disturbances of the plant at a size."""
        return tuple(replace(m, amplitude=size * m.amplitude) for m in self.modifiers)


@dataclass(frozen=True)
class Scene:
    """A record that an effect is drawn for: plant, inputs, schedule, times (n,) s, onset in s and random numbers."""

    plant: ZooPlant
    drive: Drive
    schedule: Schedule
    time_s: Array
    onset_s: float
    rng: np.random.Generator
    calm: Array
    """(n, cells) degC of the record without the effect."""

    @property
    def power_w(self) -> float:
        """Return the full power of all heaters, W."""
        return float(self.plant.full_w.sum())

    @property
    def step(self) -> Array:
        """Return 0 before the onset and 1 after it, (n,)."""
        return (self.time_s >= self.onset_s).astype(np.float64)

    @property
    def ramp(self) -> Array:
        """Return a course that rises from the onset to 1 at the end, (n,)."""
        left = max(float(self.time_s[-1]) - self.onset_s, 1.0)
        return np.clip((self.time_s - self.onset_s) / left, 0.0, 1.0)

    @property
    def saturating(self) -> Array:
        """Return a course that saturates towards 1 after the onset, (n,)."""
        left = max(float(self.time_s[-1]) - self.onset_s, 1.0)
        return 1.0 - np.exp(-np.clip(self.time_s - self.onset_s, 0.0, None) / (0.25 * left))

    @property
    def accelerating(self) -> Array:
        """Return a course that grows with the cube of the time since the onset, (n,)."""
        return self.ramp**3

    @property
    def interval(self) -> Array:
        """Return 1 in one interval, 0 elsewhere, (n,)."""
        end = float(self.time_s[-1])
        first = float(self.rng.uniform(0.2, 0.5)) * end
        last = first + float(self.rng.uniform(0.08, 0.3)) * end
        return ((self.time_s >= first) & (self.time_s < last)).astype(np.float64)

    @property
    def pulses(self) -> Array:
        """Return periodic pulses after the onset, (n,)."""
        period, duty = float(self.rng.uniform(0.4, 2.5)) * HOUR_S, float(self.rng.uniform(0.2, 0.6))
        return self.step * ((self.time_s % period) < duty * period)

    @property
    def erratic(self) -> Array:
        """Return a random course of mean 0 and variance 1 after the onset, (n,)."""
        return self.step * wander(self.time_s, 1.5 * HOUR_S, self.rng)

    @property
    def sun(self) -> Array:
        """Return a half sine between two hours of each day, (n,)."""
        rise, set_ = float(self.rng.uniform(5.0, 9.0)), float(self.rng.uniform(15.0, 20.0))
        course = np.clip(np.sin(np.pi * (self.hour - rise) / (set_ - rise)), 0.0, None)
        return self._acting(course * ((self.hour > rise) & (self.hour < set_)))

    @property
    def lamp(self) -> Array:
        """Return 1 between two hours of each day, (n,)."""
        begin = float(self.rng.uniform(9.0, 14.0))
        return self._acting((self.hour >= begin) & (self.hour < begin + float(self.rng.uniform(2.0, 5.0))))

    def _acting(self, course: np.ndarray) -> Array:
        """Return a course after the onset; raise NoSuchPlaceError if the record ends before it acts."""
        acting = self.step * course
        if not acting.any():
            raise NoSuchPlaceError("the record does not reach these hours")
        return acting

    @property
    def hour(self) -> Array:
        """Return the time of day, h (n,)."""
        return (START_H + self.time_s / HOUR_S) % 24.0

    @property
    def load(self) -> Array:
        """Return the heaters' power as a share of full power, (n,)."""
        return np.asarray(self.drive.heat.sum(axis=1) / self.power_w)

    def some_part(self, *wanted: str) -> BuiltPart:
        """Draw a part that fulfils all of: "metal", "fan", "read", "metal read", "inner" (not a tank), "tank"."""
        tests: dict[str, Callable[[BuiltPart], bool]] = {
            "metal": lambda b: bool(b.metal),
            "fan": lambda b: b.part.fan > 0.0,
            "read": lambda b: bool(b.part.reads),
            "metal read": lambda b: b.part.reads == "metal",
            "inner": lambda b: b.part.loss < 1.0 or b.part.metal > 0.0,
            "tank": lambda b: not b.metal and b.part.name != "cold",
        }
        found = [b for b in self.plant.parts if all(tests[w](b) for w in wanted)]
        if not found:
            raise NoSuchPlaceError(f"{self.plant.family} has no part that is {' and '.join(wanted)}")
        return found[int(self.rng.integers(len(found)))]

    def two_parts(self) -> tuple[BuiltPart, BuiltPart]:
        """Draw two parts of different nodes."""
        one = self.some_part("read")
        others = [b for b in self.plant.parts if b.part.node != one.part.node and b.part.reads]
        return one, others[int(self.rng.integers(len(others)))]

    def some_thermometer(self) -> str:
        """Draw the column of a thermometer that is alone at its node, if there is one."""
        nodes = [t.node for t in self.plant.thermometers]
        alone = [t.column for t in self.plant.thermometers if nodes.count(t.node) == 1]
        return str(self.rng.choice(alone))

    def quantile(self, cell: int, share: float) -> float:
        """Return a quantile of a cell's temperature in the undisturbed record, degC."""
        return float(np.quantile(self.calm[:, cell], share))

    def varies(self, column: str) -> bool:
        """Return True if a speed varies in this record."""
        return self.schedule.fan_varies if column == FAN_COLUMN else self.schedule.pump_varies


class NoSuchPlaceError(ValueError):
    """Error of an effect that a plant or a record has no place for."""


@dataclass(frozen=True)
class EffectType:
    """A type of effect.

    Attributes
    ----------
    name, group
        Name, and what it concerns: heat, loss, reading, flow, conductance, room, water, actuator.
    element
        True if the catalogue of the twin's elements holds this law in this shape. Declared here, by reading the
        elements' documentation; the scorer uses it to judge abstention.
    reserved
        True if it is drawn for sealed families alone.
    build
        Draw an injection for a scene; raises NoSuchPlaceError.
    """

    name: str
    group: str
    element: bool
    build: Callable[[Scene], Injection]
    reserved: bool = False


__all__ = ["FAN_COLUMN", "ROOM_COLUMN", "AcceptedAnswer", "EffectType", "Injection", "NoSuchPlaceError", "Scene"]
