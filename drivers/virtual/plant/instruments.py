"""Instruments on the PLC's side: noise, resolution and lag of power meter, flow meter, speeds and room sensor."""

import numpy as np

from drivers.virtual.plant.effects import READINGS, PlantEffect
from drivers.virtual.plant.sensor_faults import SensorFaults
from drivers.virtual.plant.simulated_plant import SimulatedPlant

_BLOCK = 2048
AMBIENT_SIGMA_K, POWER_SIGMA_W, FLOW_SIGMA, PUMP_SIGMA_PCT, FAN_SIGMA_PCT = 0.03, 0.8, 0.006, 0.05, 0.08
POWER_STEP_W, FLOW_STEP = 0.1, 0.002
"""Resolution of the meters; the other readings are rounded by their registers."""
AMBIENT_LAG_S = 20.0
LARGEST_OFFSET_K = 0.03
"""Largest offset of the room sensor, K."""


class Instruments:
    """Readings in the order of `READINGS`, reproducible for a seed.

    `unit` is the specimen, whose room sensor has its own offset; by default another one for every seed.
    """

    def __init__(self, seed: int, period_s: float, effects: tuple[PlantEffect, ...], unit: int | None = None) -> None:
        self._random = np.random.default_rng([seed, 2])
        offset = float(self._random.uniform(-LARGEST_OFFSET_K, LARGEST_OFFSET_K))
        if unit is not None:
            offset = float(np.random.default_rng([unit, 2]).uniform(-LARGEST_OFFSET_K, LARGEST_OFFSET_K))
        self._ambient_offset = offset
        self._sigma = (AMBIENT_SIGMA_K, POWER_SIGMA_W, FLOW_SIGMA, PUMP_SIGMA_PCT, FAN_SIGMA_PCT)
        self._noise: list[list[float]] = []
        self._share = 1.0 - float(np.exp(-period_s / AMBIENT_LAG_S))
        self._ambient: float | None = None
        self._faults = SensorFaults(effects, READINGS)

    def read(self, plant: SimulatedPlant) -> list[float]:
        """Return the readings of this period: ambient degC, heater power W, flow L/min, pump and fan speed %."""
        if not self._noise:
            self._noise = (self._random.standard_normal((_BLOCK, 5)) * self._sigma).tolist()
        noise = self._noise.pop()
        if self._ambient is None:
            self._ambient = plant.ambient_C
        self._ambient += self._share * (plant.ambient_C - self._ambient)
        values = [
            self._ambient + self._ambient_offset,
            plant.heater_power_W,
            plant.flow_L_per_min,
            plant.pump_speed_pct,
            plant.fan_speed_pct,
        ]
        faults = self._faults
        if faults.any:
            faults.lag(plant.time_s, values)
        # A meter at rest reads zero exactly: its noise comes with the quantity.
        for i, value in enumerate(values):
            if value > 1e-3:
                values[i] = value + noise[i]
        if faults.any:
            faults.distort(plant.time_s, values)
        values[1] = max(round(values[1] / POWER_STEP_W) * POWER_STEP_W, 0.0)
        values[2] = max(round(values[2] / FLOW_STEP) * FLOW_STEP, 0.0)
        return values
