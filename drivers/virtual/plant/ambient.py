"""Room air around the rig: a slow daily swing and draughts, reproducible for a seed."""

import math

import numpy as np

MEAN_C = 21.0
DAILY_SWING_K = 1.1
WARMEST_HOUR = 15.5
SLOW_SIGMA_K, SLOW_TIME_S = 0.22, 2400.0
"""Doors, people, heating: Ornstein-Uhlenbeck."""
DRAUGHT_SIGMA_K, DRAUGHT_TIME_S = 0.08, 45.0
START_HOUR = 8.0
"""Clock at rig time zero."""

_BLOCK = 2048


def hour_of_day(time_s: float) -> float:
    """Return the clock in hours, 0 to 24, at a rig time in s."""
    return (START_HOUR + time_s / 3600.0) % 24.0


class Room:
    """Room temperature as a function of rig time, advanced in equal steps."""

    def __init__(self, seed: int, period_s: float) -> None:
        self._random = np.random.default_rng([seed, 1])
        self._slow_keep = math.exp(-period_s / SLOW_TIME_S)
        self._slow_kick = SLOW_SIGMA_K * math.sqrt(1.0 - self._slow_keep**2)
        self._draught_keep = math.exp(-period_s / DRAUGHT_TIME_S)
        self._draught_kick = DRAUGHT_SIGMA_K * math.sqrt(1.0 - self._draught_keep**2)
        self._slow = self._draught = 0.0
        self._numbers: list[float] = []

    def step(self, time_s: float) -> float:
        """Return the temperature in degC at `time_s`; call once per period."""
        if not self._numbers:
            self._numbers = self._random.standard_normal(2 * _BLOCK).tolist()
        self._slow = self._slow * self._slow_keep + self._slow_kick * self._numbers.pop()
        self._draught = self._draught * self._draught_keep + self._draught_kick * self._numbers.pop()
        phase = 2.0 * math.pi * (hour_of_day(time_s) - WARMEST_HOUR) / 24.0
        return MEAN_C + DAILY_SWING_K * math.cos(phase) + self._slow + self._draught
