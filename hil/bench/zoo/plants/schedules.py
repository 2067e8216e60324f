"""Schedules of a record: heater, pump and fan over time, and the room.

Six kinds of load; pump and fan either vary in steps of their own or stand still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.bench.zoo.plants.cells import Array, Drive

KINDS = ("steps", "drive cycle", "day and night", "telegraph", "ramps", "pulses with rests")
HOUR_S = 3600.0
START_H = 8.0
"""Time of day at 0 s."""
LEAST_PUMP, LEAST_FAN = 0.5, 0.25
"""Lowest shares of full speed where a speed varies."""
FIXED_FAN = 0.7


@dataclass(frozen=True)
class Schedule:
    """Kind of load, whether pump and fan vary, length in h and sampling period in s."""

    kind: str
    pump_varies: bool
    fan_varies: bool
    hours: float
    period_s: float

    @property
    def rows(self) -> int:
        """Return the number of samples."""
        return int(self.hours * HOUR_S / self.period_s) + 1

    @property
    def times(self) -> Array:
        """Return the times of the samples (n,), s."""
        return np.arange(self.rows, dtype=np.float64) * self.period_s


def draw_drive(schedule: Schedule, full_w: Array, loops: int, rng: np.random.Generator) -> Drive:
    """Draw the inputs of a record; `full_w` (k,) W is the full power of each heat column."""
    n, t = schedule.rows, schedule.times
    common = load(schedule.kind, t, rng)
    heat = np.empty((n, len(full_w)))
    for k, full in enumerate(full_w):
        own = common if k == 0 else 0.6 * common + 0.4 * _steps(t, rng, 0.7, 3.0, 0.0, 1.0)
        heat[:, k] = full * own
    pump = np.column_stack(
        [_steps(t, rng, 1.0, 4.0, LEAST_PUMP, 1.0) if schedule.pump_varies else np.ones(n) for _ in range(loops)]
    )
    fan = _steps(t, rng, 0.8, 3.5, LEAST_FAN, 1.0) if schedule.fan_varies else np.full(n, FIXED_FAN)
    room = draw_room(t, rng)
    hour = START_H + t / HOUR_S
    humidity = 0.5 + 0.15 * np.sin(2.0 * np.pi * (hour - 4.0) / 24.0) + 0.05 * wander(t, 2.0 * HOUR_S, rng)
    noise = [1.0 + size * wander(t, 300.0, rng) for size in (0.002, 0.005)]
    return Drive(pump, fan, heat, room, np.clip(humidity, 0.1, 0.95), noise[0], noise[1])


def load(kind: str, t: Array, rng: np.random.Generator) -> Array:
    """Return the course of a load, shares of full power (n,) at the times `t` in s."""
    if kind == "steps":
        return _steps(t, rng, 0.5, 2.0, 0.15, 1.0)
    if kind == "drive cycle":
        slow = _steps(t, rng, 0.1, 0.6, 0.2, 0.8)
        return np.clip(slow + 0.15 * wander(t, 120.0, rng), 0.0, 1.0)
    if kind == "day and night":
        hour = (START_H + t / HOUR_S) % 24.0
        day = 0.5 * (1.0 + np.tanh(2.0 * (hour - 7.0))) * 0.5 * (1.0 - np.tanh(2.0 * (hour - 19.0)))
        return np.clip(0.15 + 0.7 * day + 0.1 * wander(t, 1800.0, rng), 0.0, 1.0)
    if kind == "telegraph":
        low, high = rng.uniform(0.0, 0.3), rng.uniform(0.7, 1.0)
        return np.where(telegraph(t, 0.5 * HOUR_S, rng), high, low)
    if kind == "ramps":
        knots = _times(t, rng, 0.7, 2.5)
        return np.interp(t, knots, rng.uniform(0.1, 1.0, len(knots)))
    if kind == "pulses with rests":
        period, width = rng.uniform(1.5, 4.0) * HOUR_S, rng.uniform(0.2, 0.5)
        return np.where((t % period) < width * period, rng.uniform(0.7, 1.0), 0.0)
    raise ValueError(f"no load {kind!r}; there are {', '.join(KINDS)}")


def draw_room(t: Array, rng: np.random.Generator) -> Array:
    """Draw the room's temperature (n,) degC: a daily course, a drift and a slow random walk that returns."""
    hour = START_H + t / HOUR_S
    day = rng.uniform(0.0, 2.5) * np.sin(2.0 * np.pi * (hour - rng.uniform(8.0, 11.0)) / 24.0)
    drift = rng.uniform(-0.08, 0.08) * t / HOUR_S
    room: Array = rng.uniform(16.0, 26.0) + day + drift + rng.uniform(0.1, 0.6) * wander(t, 1.5 * HOUR_S, rng)
    return room


def wander(t: Array, constant_s: float, rng: np.random.Generator) -> Array:
    """Return an Ornstein-Uhlenbeck course (n,) of unit variance with a correlation time in s."""
    from scipy.signal import lfilter

    period = float(t[1] - t[0]) if len(t) > 1 else 1.0
    a = np.exp(-period / constant_s)
    shocks = rng.normal(size=len(t)) * np.sqrt(1.0 - a * a)
    shocks[0] = rng.normal()
    course: Array = lfilter([1.0], [1.0, -a], shocks)
    return course


def telegraph(t: Array, mean_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return a random telegraph signal (n,) of booleans with mean dwell in s."""
    switches = np.cumsum(rng.exponential(mean_s, int(4 * t[-1] / mean_s) + 20))
    return np.searchsorted(switches, t) % 2 == 1


def _times(t: Array, rng: np.random.Generator, shortest_h: float, longest_h: float) -> Array:
    count = int(t[-1] / (shortest_h * HOUR_S)) + 3
    return np.concatenate([[0.0], np.cumsum(rng.uniform(shortest_h, longest_h, count) * HOUR_S)])


def _steps(t: Array, rng: np.random.Generator, shortest_h: float, longest_h: float, low: float, high: float) -> Array:
    times = _times(t, rng, shortest_h, longest_h)
    levels = rng.uniform(low, high, len(times))
    return np.asarray(levels[np.searchsorted(times, t, side="right") - 1])
