"""Controller that returns a plant with stored heat to given temperatures, at the load at which a run was interrupted.

The output is feed-forward of the load plus a proportional-integral correction of the mean deviation. Conditional
integration prevents wind-up (Astrom & Hagglund, Advanced PID Control, 2006, sec. 3.5), and a dead band suppresses
noise. The gain is halved on every overshoot, so that a plant of unexpected speed does not oscillate.
"""

from __future__ import annotations

import math
import statistics
from collections import deque

SMOOTHED_S = 10.0
"""Time constant of the filter of the mean deviation, s: the target temperatures are means of ten values, too."""
INTEGRAL_S = 600.0
"""Integral time, s: a constant deviation moves the outputs over this time by as much as it does at once."""
DEAD_BAND_SIGMAS = 3.0
"""Noise of the filtered correction, in standard deviations, that does not move the outputs."""
OVERSHOOT = 0.1
"""Share of the full correction from which on a deviation of the other sign counts as overshoot."""
LEAST_GAIN = 1.0 / 32.0
"""Least share of its gain that the controller keeps: enough to find the load that holds the temperatures."""
APPROACH_S = 90.0
"""Time, s, before arrival at which the correction begins to fall, by the fastest rate so far. It is the sum of dead
time and lag of heater and sensors on a small loop."""
RATE_S = 40.0
"""Time, s, over which a rate is measured."""
LEAST_ROWS = 8
"""Values from which on a rate is measured."""
RECENT = 50
"""Differences whose median estimates the noise: a jump of the temperatures is not noise."""
MEDIAN_SIGMAS = 0.6745 * math.sqrt(2.0)
"""Median of the absolute difference of two values of normal noise, in its standard deviations."""


class ThermalController:
    """Proportional-integral controller; `correction` of the load is in [-1, 1], positive where the plant is too cold.

    The correction is full from a deviation of `full_K` on, or from the change within `APPROACH_S` if that is larger.
    """

    def __init__(self, full_K: float) -> None:
        self._least_K = full_K
        self._fastest = 0.0
        self._past: deque[tuple[float, float]] = deque()
        self._time_s = 0.0
        self.correction = 0.0
        self._gain = 1.0
        self._integral = 0.0
        self._smooth = math.nan
        self._before = math.nan
        self._steps_K: deque[float] = deque(maxlen=RECENT)
        self._side = 0

    def step(
        self, deviation_K: float, passed_s: float, *, held: bool = False, low: bool = False, high: bool = False
    ) -> None:
        """Update `correction` with one measurement.

        Parameters
        ----------
        deviation_K
            Mean deviation, K; positive where the plant is too hot.
        passed_s
            Time since the last measurement, s.
        held
            An operator keeps the outputs, so that the integral stands.
        low
            No output can cool any more.
        high
            No output can warm any more.
        """
        if not math.isfinite(self._smooth):
            self._smooth = self._before = deviation_K
        share = 1.0 - math.exp(-max(passed_s, 0.0) / SMOOTHED_S)
        self._smooth += share * (deviation_K - self._smooth)
        self._steps_K.append(abs(deviation_K - self._before))
        self._before = deviation_K
        sigma_K = statistics.median(self._steps_K) / MEDIAN_SIGMAS
        self._measure_rate(deviation_K, sigma_K, passed_s)
        full_K = max(self._least_K, APPROACH_S * self._fastest)
        noise = sigma_K * math.sqrt(share / (2.0 - share)) / full_K
        error = -self._smooth / full_K
        self._notice_overshoot(error, noise)
        proportional = min(max(self._gain * error, -1.0), 1.0)
        if not held:
            # Half the gain acts over twice the time, too: both keep the damping.
            more = proportional * self._gain * passed_s / INTEGRAL_S
            full = abs(proportional + self._integral) >= 1.0 and more * (proportional + self._integral) > 0.0
            if not full and not (high and more > 0.0) and not (low and more < 0.0):
                self._integral = min(max(self._integral + more, -1.0), 1.0)
        wanted = min(max(proportional + self._integral, -1.0), 1.0)
        dead_band = DEAD_BAND_SIGMAS * noise * self._gain
        self.correction = min(max(self.correction, wanted - dead_band), wanted + dead_band)

    def _measure_rate(self, deviation_K: float, sigma_K: float, passed_s: float) -> None:
        """Keep the fastest significant rate, K/s; the median over a quarter of `RATE_S` ignores jumps."""
        self._time_s += passed_s
        past = self._past
        past.append((self._time_s, deviation_K))
        while self._time_s - past[0][0] > RATE_S:
            past.popleft()
        lag = len(past) // 4
        if len(past) < LEAST_ROWS or self._time_s - past[0][0] < 0.5 * RATE_S:
            return
        rates = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(past, list(past)[lag:], strict=False) if b[0] > a[0]]
        if rates:
            # Standard error of the mean of n - lag differences, each of two values.
            error = math.sqrt(2.0 / lag) * sigma_K / (0.25 * RATE_S)
            self._fastest = max(self._fastest, abs(statistics.median(rates)) - DEAD_BAND_SIGMAS * error)

    def _notice_overshoot(self, error: float, noise: float) -> None:
        """Halve gain and integral where the plant has come from one side to the other by more than its noise."""
        if abs(error) <= max(OVERSHOOT, DEAD_BAND_SIGMAS * noise):
            return
        side = 1 if error > 0.0 else -1
        if self._side == -side:
            self._gain = max(0.5 * self._gain, LEAST_GAIN)
            self._integral *= 0.5
        self._side = side
