"""CAN thermocouple module without its wires: junction temperatures in, three frames out.

Per channel: a fixed offset drawn from the seed (at most 0.03 K), white noise of 0.05 K, 0.01 K per count, an open
circuit as 0x7FFF. Frames, 11-bit ids, little endian: 0x181 T_heater, T_pm1..3; 0x281 T_pm4..6, T_radiator;
0x381 T_tank, fault bits, uptime in ms. 0x381 goes last: a receiver that has it has them all.
"""

import struct

import numpy as np

from drivers.virtual.plant.effects import PlantEffect
from drivers.virtual.plant.geometry import CHANNELS
from drivers.virtual.plant.sensor_faults import SensorFaults

NOISE_SIGMA_K = 0.05
LARGEST_OFFSET_K = 0.03
OPEN_CIRCUIT = 0x7FFF
FRAME_IDS = (0x181, 0x281, 0x381)

_BLOCK = 2048
_LAYOUT = struct.Struct("<9hHI")


class ThermocoupleModule:
    """Converter of true junction temperatures to raw frames; reproducible for a seed.

    `unit` is the specimen, whose channels have their own offsets; by default another one for every seed.
    """

    def __init__(self, seed: int, effects: tuple[PlantEffect, ...] = (), unit: int | None = None) -> None:
        self._random = np.random.default_rng([seed, 3])
        self.offsets_K = self._random.uniform(-LARGEST_OFFSET_K, LARGEST_OFFSET_K, len(CHANNELS))
        if unit is not None:
            specimen = np.random.default_rng([unit, 3])
            self.offsets_K = specimen.uniform(-LARGEST_OFFSET_K, LARGEST_OFFSET_K, len(CHANNELS))
        self._errors: list[list[float]] = []
        self._faults = SensorFaults(effects, CHANNELS)

    def sample(self, time_s: float, junctions_C: list[float]) -> tuple[bytes, bytes, bytes]:
        """Return the payloads of the three frames, 8 bytes each, in the order of `FRAME_IDS`."""
        if not self._errors:
            noise = self._random.standard_normal((_BLOCK, len(CHANNELS))) * NOISE_SIGMA_K
            self._errors = (noise + self.offsets_K).tolist()[::-1]
        faults = self._faults
        open_channels = 0
        if faults.any:
            faults.lag(time_s, junctions_C)
        values = [true + error for true, error in zip(junctions_C, self._errors.pop(), strict=True)]
        if faults.any:
            open_channels = faults.distort(time_s, values)
        raw = [min(max(round(value * 100.0), -32768), OPEN_CIRCUIT - 1) for value in values]
        if open_channels:
            raw = [OPEN_CIRCUIT if open_channels >> k & 1 else value for k, value in enumerate(raw)]
        data = _LAYOUT.pack(*raw, open_channels, round(time_s * 1000.0) & 0xFFFFFFFF)
        return data[:8], data[8:16], data[16:]
